//! The greedy fill.

use super::Search;
use crate::solver::table::{Table, Utility};

/// Number of passes of single moves after a fill.
const FILL_PASSES: usize = 2;
/// Factor by which a move must raise the product of the fill utilities.
const FILL_FACTOR_MIN: f64 = 1.0 + 1e-9;

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
            self.give(m, self.trial.served[m], table, utility);
        }
        for _ in 0..FILL_PASSES {
            for &m in &table.useful {
                let from = self.trial.served[m];
                if table.spill.shares(m) {
                    self.refill(m, from, table, utility);
                    continue;
                }
                let loss = table.line(m)[from];
                let without = (self.amplitude[from] - loss).max(table.los_amplitude[from]);
                let lost = utility.fill_utility(from, without) * self.inverse_fill[from];
                let (user, gained) = self.best_to_fill(m, Some(from), table, utility);
                if let Some(to) = user
                    && lost * gained > FILL_FACTOR_MIN
                {
                    self.trial.served[m] = to;
                    self.shift(from, without - self.amplitude[from], utility);
                    self.shift(to, table.line(m)[to], utility);
                }
            }
        }
        self.trial.settle(table, utility);
    }

    /// Moves a mirror whose light reaches several users to the aim with the largest increase, if that
    /// is larger than the decrease.
    fn refill(&mut self, m: usize, from: usize, table: &Table, utility: &Utility) {
        let mut lost = 1.0;
        for (place, (k, gain)) in table.aim(m, from).enumerate() {
            self.before[place] = (self.amplitude[k], self.inverse_fill[k]);
            let without = (self.amplitude[k] - gain).max(table.los_amplitude[k]);
            let remaining = utility.fill_utility(k, without);
            if self.allowed[k] {
                lost *= remaining * self.inverse_fill[k];
            }
            (self.amplitude[k], self.inverse_fill[k]) = (without, 1.0 / remaining);
        }
        let (user, gained) = self.best_to_fill(m, Some(from), table, utility);
        match user {
            Some(to) if lost * gained > FILL_FACTOR_MIN => {
                self.trial.served[m] = to;
                self.give(m, to, table, utility);
            }
            _ => {
                for (place, (k, _)) in table.aim(m, from).enumerate() {
                    (self.amplitude[k], self.inverse_fill[k]) = self.before[place];
                }
            }
        }
    }

    /// Adds the gains of mirror m at an aim.
    fn give(&mut self, m: usize, aim: usize, table: &Table, utility: &Utility) {
        for (k, gain) in table.aim(m, aim) {
            self.shift(k, gain, utility);
        }
    }

    /// The aim at which mirror m raises the fill utilities of the allowed users by the largest
    /// factor, and that factor; an allowed user, or a midpoint of two.
    fn best_to_fill(&self, m: usize, except: Option<usize>, table: &Table, utility: &Utility) -> (Option<usize>, f64) {
        let mut best = (None, 0.0);
        for (k, &gain) in table.line(m).iter().enumerate() {
            let spilled = table.spill.of(k, m);
            if self.allowed[k] && (gain > 0.0 || !spilled.is_empty()) && except != Some(k) {
                let mut factor = utility.fill_utility(k, self.amplitude[k] + gain) * self.inverse_fill[k];
                for &(other, gain) in spilled.iter().filter(|(other, _)| self.allowed[*other]) {
                    factor *= utility.fill_utility(other, self.amplitude[other] + gain) * self.inverse_fill[other];
                }
                if factor > best.1 {
                    best = (Some(k), factor);
                }
            }
        }
        for &aim in table.spill.aims_of(m).iter().filter(|aim| **aim >= table.users) {
            if table.spill.is_allowed(aim, &self.allowed) && except != Some(aim) {
                let mut factor = 1.0;
                for &(k, gain) in table.spill.of(aim, m).iter().filter(|(k, _)| self.allowed[*k]) {
                    factor *= utility.fill_utility(k, self.amplitude[k] + gain) * self.inverse_fill[k];
                }
                if factor > best.1 {
                    best = (Some(aim), factor);
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
