//! A table of values for pairs of a state and a codeword.

use anyhow::ensure;

use crate::training::store::{Persistent, Store};

/// Values Q(state, codeword), initially zero, and the number of updates of each.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    codewords: usize,
    values: Vec<f32>,
    visits: Vec<f32>,
}

impl Table {
    /// A table of zeros.
    pub fn new(states: usize, codewords: usize) -> Self {
        Self { codewords, values: vec![0.0; states * codewords], visits: vec![0.0; states * codewords] }
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.values.len() / self.codewords
    }

    /// Number of codewords.
    pub fn codewords(&self) -> usize {
        self.codewords
    }

    /// All values, state by state.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Size of the values in bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.values.as_slice())
    }

    /// Number of pairs with at least one update.
    pub fn visited(&self) -> usize {
        self.visits.iter().filter(|visits| **visits > 0.0).count()
    }

    /// The value of a pair.
    pub fn value(&self, state: usize, codeword: usize) -> f32 {
        self.values[state * self.codewords + codeword]
    }

    /// The codeword with the largest value, the first of equal ones.
    pub fn best(&self, state: usize) -> usize {
        let row = &self.values[state * self.codewords..][..self.codewords];
        (1..row.len()).fold(0, |best, codeword| if row[codeword] > row[best] { codeword } else { best })
    }

    /// Moves the value of a pair (state, codeword) towards a target: Q <- Q + max(alpha, 1 / n)
    /// (target - Q) in its n-th update.
    pub fn learn(&mut self, (state, codeword): (usize, usize), target: f32, alpha: f32) {
        let pair = state * self.codewords + codeword;
        self.visits[pair] += 1.0;
        self.values[pair] += alpha.max(1.0 / self.visits[pair]) * (target - self.values[pair]);
    }
}

impl Persistent for Table {
    fn save(&self, name: &str, store: &mut Store) -> anyhow::Result<()> {
        store.put_floats(&format!("{name}.values"), &self.values)?;
        store.put_floats(&format!("{name}.visits"), &self.visits)
    }

    fn restore(&mut self, name: &str, store: &Store) -> anyhow::Result<()> {
        let (values, visits) = (store.floats(&format!("{name}.values"))?, store.floats(&format!("{name}.visits"))?);
        let (expected, found) = (self.values.len(), [values.len(), visits.len()]);
        ensure!(found == [expected; 2], "{name} in the checkpoint has {found:?} values, expected {expected}");
        (self.values, self.visits) = (values, visits);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_updates_form_a_mean_and_later_ones_use_alpha() {
        let mut table = Table::new(2, 3);
        for target in [1.0, 2.0, 6.0] {
            table.learn((1, 2), target, 0.25);
        }
        assert_eq!(table.value(1, 2), 3.0);
        (3..6).for_each(|_| table.learn((1, 2), 3.0, 0.25));
        table.learn((1, 2), 7.0, 0.25);
        assert_eq!((table.value(1, 2), table.best(1), table.best(0), table.visited()), (4.0, 2, 0, 1));
    }
}
