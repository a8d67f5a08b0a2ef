//! Moves of mirrors whose light reaches several users.
//!
//! The light of a mirror reaches all users in the spot around its aim. A move
//! then changes the amplitudes of all users of both spots. Mirrors that reach one user at a time use
//! the faster functions of [`Assignment`].

use super::{Assignment, MIN_FACTOR};
use crate::solver::table::{Table, Utility};

impl Assignment {
    /// Adds the amplitudes of users at whom no mirror is aimed.
    pub(super) fn settle_spill(&mut self, table: &Table) {
        if table.spill.is_empty() {
            return;
        }
        for (m, &aim) in self.served.iter().enumerate() {
            for &(user, gain) in table.spill.of(aim, m) {
                self.amplitude[user] += gain;
            }
        }
    }

    /// As [`Assignment::move_one`], for any mirror.
    pub(super) fn move_sharing(&mut self, m: usize, table: &Table, utility: &Utility) -> bool {
        let from = self.served[m];
        let mut lost = 1.0;
        for (place, (k, gain)) in table.aim(m, from).enumerate() {
            self.before[place] = (self.amplitude[k], self.inverse[k]);
            let without = (self.amplitude[k] - gain).max(table.los_amplitude[k]);
            lost *= self.factor(utility, k, without);
            self.set(k, without);
        }
        let (mut to, mut gained) = (from, 0.0);
        for aim in table.aims(m).filter(|aim| *aim != from) {
            let factor: f64 =
                table.aim(m, aim).map(|(k, gain)| self.factor(utility, k, self.amplitude[k] + gain)).product();
            if factor > gained {
                (to, gained) = (aim, factor);
            }
        }
        let moved = lost * gained > MIN_FACTOR;
        if moved {
            self.served[m] = to;
            for (k, gain) in table.aim(m, to) {
                self.set(k, self.amplitude[k] + gain);
            }
        } else {
            for (place, (k, _)) in table.aim(m, from).enumerate() {
                (self.amplitude[k], self.inverse[k]) = self.before[place];
            }
        }
        moved
    }
}
