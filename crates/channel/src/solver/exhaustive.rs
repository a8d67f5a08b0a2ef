//! Every assignment, by depth-first search with an exact bound.
//!
//! Midpoints are left out where the assignments with them would be too many.

use super::assignment::Assignment;
use super::problem::{ASSIGNMENTS_MAX, SolverError};
use super::table::{Table, Utility};

/// Writes the best assignment to `best`.
pub(super) fn search(table: &Table, utility: &Utility, best: &mut Assignment) -> Result<(), SolverError> {
    let (users, mirrors) = (table.users, table.mirrors);
    SolverError::check_assignments(users, mirrors)?;
    let midpoints = |m: usize| table.spill.midpoints_of(m).map(|(aim, _)| aim);
    let all: f64 = (0..mirrors).map(|m| (users + midpoints(m).count()) as f64).product();
    let aims: Vec<Vec<usize>> =
        (0..mirrors).map(|m| (0..users).chain(midpoints(m).filter(|_| all <= ASSIGNMENTS_MAX)).collect()).collect();
    best.served.fill(0);
    best.settle(table, utility);
    let mut search = DepthFirst { table, utility, best, aims: &aims, served: vec![0; mirrors] };
    // Sum of the largest amplitudes of the mirrors from m on, per user. Shape: (M + 1) * K.
    let mut ahead = vec![0.0; (mirrors + 1) * users];
    for m in (0..mirrors).rev() {
        for k in 0..users {
            let largest = aims[m].iter().map(|aim| table.gain_of_aim(m, *aim, k)).fold(0.0, f64::max);
            ahead[m * users + k] = ahead[(m + 1) * users + k] + largest;
        }
    }
    search.descend(0, &table.los_amplitude, &ahead);
    search.best.settle(table, utility);
    Ok(())
}

struct DepthFirst<'a> {
    table: &'a Table,
    utility: &'a Utility,
    best: &'a mut Assignment,
    /// The aims of each mirror.
    aims: &'a [Vec<usize>],
    served: Vec<usize>,
}

impl DepthFirst<'_> {
    fn descend(&mut self, m: usize, amplitude: &[f64], ahead: &[f64]) {
        let users = self.table.users;
        // Upper bound: every user gets all remaining mirrors. Utilities do not decrease with
        // amplitude.
        let bound: f64 = (0..users).map(|k| self.utility.value(k, amplitude[k] + ahead[m * users + k])).sum();
        if bound <= self.best.nats {
            return;
        }
        if m == self.table.mirrors {
            self.best.nats = bound;
            self.best.served.copy_from_slice(&self.served);
            return;
        }
        let mut next = amplitude.to_vec();
        for &aim in &self.aims[m] {
            self.served[m] = aim;
            for (user, gain) in self.table.aim(m, aim) {
                next[user] += gain;
            }
            self.descend(m + 1, &next, ahead);
            for (user, _) in self.table.aim(m, aim) {
                next[user] = amplitude[user];
            }
        }
    }
}
