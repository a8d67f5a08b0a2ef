//! The rows of a network's input, for engines whose model takes a fixed or any number of rows.

use heliostat_core::policy::{PolicyError, PolicyResult};

/// Input and output of a network, and how many rows one run of the engine takes.
pub struct Batch {
    row_length: usize,
    rows: usize,
    /// The first extent that the model fixes; `None` where it takes any number of rows.
    rows_per_run: Option<usize>,
    input: Vec<f32>,
    /// A copy of the last output.
    output: Vec<f32>,
}

impl Batch {
    /// One row, or as many as the model fixes.
    pub fn new(row_length: usize, rows_per_run: Option<usize>) -> Self {
        let rows = rows_per_run.unwrap_or(1);
        Self { row_length, rows, rows_per_run, input: vec![0.0; rows * row_length], output: Vec::new() }
    }

    /// Sets the number of rows.
    ///
    /// # Errors
    /// No row, or a number that is no multiple of what the model fixes.
    pub fn set_rows(&mut self, rows: usize) -> PolicyResult {
        let multiple = self.rows_per_run.unwrap_or(1);
        if rows == 0 || !rows.is_multiple_of(multiple) {
            let message = format!("the input has {rows} rows: expected a positive multiple of {multiple}");
            return Err(PolicyError::Inference { message });
        }
        self.rows = rows;
        self.input.resize(rows * self.row_length, 0.0);
        Ok(())
    }

    /// The input, row after row.
    pub fn input_mut(&mut self) -> &mut [f32] {
        &mut self.input
    }

    /// Lets `evaluate` append the output of each part of the input, given with its shape.
    ///
    /// # Errors
    /// That of `evaluate`.
    pub fn run(
        &mut self,
        mut evaluate: impl FnMut([usize; 2], &[f32], &mut Vec<f32>) -> PolicyResult,
    ) -> PolicyResult<&[f32]> {
        let rows = self.rows_per_run.unwrap_or(self.rows);
        self.output.clear();
        // An input without columns has no values, but a run.
        if self.row_length == 0 {
            evaluate([rows, 0], &[], &mut self.output)?;
        }
        for part in self.input.chunks(rows * self.row_length.max(1)) {
            evaluate([rows, self.row_length], part, &mut self.output)?;
        }
        Ok(&self.output)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The shapes of the runs for so many rows of two values, and the sums of the rows.
    fn runs(rows_per_run: Option<usize>, rows: usize) -> (Vec<[usize; 2]>, Vec<f32>) {
        let mut batch = Batch::new(2, rows_per_run);
        batch.set_rows(rows).expect("a multiple");
        batch.input_mut().iter_mut().enumerate().for_each(|(index, value)| *value = index as f32);
        let mut shapes = Vec::new();
        let evaluate = |shape, input: &[f32], output: &mut Vec<f32>| {
            shapes.push(shape);
            output.extend(input.chunks(2).map(|row| row.iter().sum::<f32>()));
            Ok(())
        };
        let sums = batch.run(evaluate).expect("it cannot fail").to_vec();
        (shapes, sums)
    }

    #[test]
    fn a_fixed_extent_runs_part_by_part_and_an_open_one_at_once() {
        let sums = vec![1.0, 5.0, 9.0, 13.0];
        assert_eq!(runs(Some(1), 4), (vec![[1, 2]; 4], sums.clone()));
        assert_eq!(runs(Some(2), 4), (vec![[2, 2]; 2], sums.clone()));
        assert_eq!(runs(None, 4), (vec![[4, 2]], sums));
    }

    #[test]
    fn no_row_and_parts_of_a_run_are_refused() {
        assert!(Batch::new(2, None).set_rows(0).is_err());
        let refusal = Batch::new(2, Some(4)).set_rows(6).expect_err("no multiple of 4").to_string();
        assert!(refusal.contains("6 rows") && refusal.contains("multiple of 4"), "{refusal}");
    }
}
