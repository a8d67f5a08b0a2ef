//! The greedy fill.

use super::Search;
use crate::solver::table::{Table, Utility};

/// Number of passes of single moves after a fill.
const FILL_PASSES: usize = 2;

impl Search {
    /// Assigns the mirrors one after another, each to the allowed user with the largest increase,
    /// then moves single mirrors among the allowed users. The result goes to `trial`.
    ///
    /// The increase is that of [`Utility::fill_utility`], so that every allowed user is served.
    pub(super) fn fill(&mut self, table: &Table, utility: &Utility) {
        let first = self.allowed.iter().position(|&allowed| allowed).unwrap_or(0);
        self.trial.served.fill(first);
        self.amplitude.copy_from_slice(&table.los_amplitude);
        for k in 0..table.users {
            self.inverse_fill[k] = 1.0 / utility.fill_utility(k, self.amplitude[k]);
        }
        for &m in &table.useful {
            let (user, _) = self.best_to_fill(m, None, table, utility);
            self.trial.served[m] = user.unwrap_or(first);
            self.shift(self.trial.served[m], table.line(m)[self.trial.served[m]], utility);
        }
        for _ in 0..FILL_PASSES {
            for &m in &table.useful {
                let from = self.trial.served[m];
                let loss = table.line(m)[from];
                let without = (self.amplitude[from] - loss).max(table.los_amplitude[from]);
                let lost = utility.fill_utility(from, without) * self.inverse_fill[from];
                let (user, gained) = self.best_to_fill(m, Some(from), table, utility);
                if let Some(to) = user
                    && lost * gained > 1.0 + 1e-9
                {
                    self.trial.served[m] = to;
                    self.shift(from, without - self.amplitude[from], utility);
                    self.shift(to, table.line(m)[to], utility);
                }
            }
        }
        self.trial.settle(table, utility);
    }

    /// The allowed user whose fill utility mirror m raises by the largest factor, and that factor.
    fn best_to_fill(&self, m: usize, except: Option<usize>, table: &Table, utility: &Utility) -> (Option<usize>, f64) {
        let mut best = (None, 0.0);
        for (k, &gain) in table.line(m).iter().enumerate() {
            if self.allowed[k] && gain > 0.0 && except != Some(k) {
                let factor = utility.fill_utility(k, self.amplitude[k] + gain) * self.inverse_fill[k];
                if factor > best.1 {
                    best = (Some(k), factor);
                }
            }
        }
        best
    }

    fn shift(&mut self, user: usize, change: f64, utility: &Utility) {
        self.amplitude[user] += change;
        self.inverse_fill[user] = 1.0 / utility.fill_utility(user, self.amplitude[user]);
    }
}
