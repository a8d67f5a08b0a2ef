//! A table of values: one for each state and each entry of a codebook.

use anyhow::ensure;

use crate::checkpoint::Store;

/// Values Q(state, entry), all zero at first, and how often each was learned.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    entries: usize,
    values: Vec<f32>,
    visits: Vec<f32>,
}

impl Table {
    /// A table of zeros.
    pub fn new(states: usize, entries: usize) -> Self {
        Self { entries, values: vec![0.0; states * entries], visits: vec![0.0; states * entries] }
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.values.len() / self.entries
    }

    /// Number of entries.
    pub fn entries(&self) -> usize {
        self.entries
    }

    /// All values, state by state.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Size of the values in bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.values.as_slice())
    }

    /// How many pairs were learned at least once.
    pub fn tried(&self) -> usize {
        self.visits.iter().filter(|visits| **visits > 0.0).count()
    }

    /// The value of a pair.
    pub fn value(&self, state: usize, entry: usize) -> f32 {
        self.values[state * self.entries + entry]
    }

    /// The entry of the largest value, the first of equals.
    pub fn best(&self, state: usize) -> usize {
        let row = &self.values[state * self.entries..][..self.entries];
        (1..row.len()).fold(0, |best, entry| if row[entry] > row[best] { entry } else { best })
    }

    /// Moves the value of a pair, (state, entry), towards a target by max(alpha, 1 / n) of the way, n being its visits with this one.
    pub fn learn(&mut self, (state, entry): (usize, usize), target: f32, alpha: f32) {
        let pair = state * self.entries + entry;
        self.visits[pair] += 1.0;
        self.values[pair] += alpha.max(1.0 / self.visits[pair]) * (target - self.values[pair]);
    }

    /// Keeps the table in a checkpoint.
    ///
    /// # Errors
    /// Those of candle.
    pub fn save(&self, store: &mut Store) -> anyhow::Result<()> {
        store.put_floats("table.values", &self.values)?;
        store.put_floats("table.visits", &self.visits)
    }

    /// Takes over the table of a checkpoint.
    ///
    /// # Errors
    /// A table that is missing or of another size.
    pub fn restore(&mut self, store: &Store) -> anyhow::Result<()> {
        let (values, visits) = (store.floats("table.values")?, store.floats("table.visits")?);
        let (wanted, found) = (self.values.len(), [values.len(), visits.len()]);
        ensure!(found == [wanted; 2], "the checkpoint's table has {found:?} values, this run's {wanted}");
        (self.values, self.visits) = (values, visits);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_visits_count_as_in_a_mean_and_later_ones_by_alpha() {
        let mut table = Table::new(2, 3);
        for target in [1.0, 2.0, 6.0] {
            table.learn((1, 2), target, 0.25);
        }
        assert_eq!(table.value(1, 2), 3.0);
        (3..6).for_each(|_| table.learn((1, 2), 3.0, 0.25));
        table.learn((1, 2), 7.0, 0.25);
        assert_eq!((table.value(1, 2), table.best(1), table.best(0), table.tried()), (4.0, 2, 0, 1));
    }
}
