//! The subsets of users from which the oracle starts.

use super::table::{Table, Utility};

/// All subsets are tried up to this many users.
const COMPLETE_USERS_MAX: usize = 6;
/// Most nested subsets of one order, above that.
const NESTED_MAX: usize = 16;

/// A list of subsets: all of them for few users; nested ones for many.
///
/// Nested means the first n of the users, for up to [`NESTED_MAX`] values of n, in two orders: by the light that the whole array
/// can bring, and by how much that would raise the user's utility.
#[derive(Clone, Debug)]
pub(super) struct Starts {
    users: usize,
    /// Users, the one with most reachable light first.
    by_reach: Vec<usize>,
    /// Users, the one who would gain most first.
    by_rise: Vec<usize>,
    reach: Vec<f64>,
    rise: Vec<f64>,
}

impl Starts {
    pub(super) fn new(users: usize) -> Self {
        Self {
            users,
            by_reach: (0..users).collect(),
            by_rise: (0..users).collect(),
            reach: vec![0.0; users],
            rise: vec![0.0; users],
        }
    }

    /// Whether every subset is in the list.
    pub(super) fn complete(&self) -> bool {
        self.users <= COMPLETE_USERS_MAX
    }

    pub(super) fn len(&self) -> usize {
        if self.complete() { (1 << self.users) - 1 } else { 2 * self.users.min(NESTED_MAX) }
    }

    /// Sorts the users for this problem.
    pub(super) fn order(&mut self, table: &Table, utility: &Utility) {
        for (k, line) in table.by_user.chunks_exact(table.mirrors).enumerate() {
            let sum: f64 = line.iter().sum();
            self.reach[k] = sum;
            self.rise[k] = utility.value(k, table.floor[k] + sum) - utility.value(k, table.floor[k]);
        }
        let (reach, rise) = (&self.reach, &self.rise);
        // Ties by index, so that the order depends on nothing but the problem.
        self.by_reach.sort_unstable_by(|&a, &b| reach[b].total_cmp(&reach[a]).then(a.cmp(&b)));
        self.by_rise.sort_unstable_by(|&a, &b| rise[b].total_cmp(&rise[a]).then(a.cmp(&b)));
    }

    /// Marks the users of one subset; false when another subset stands for it.
    ///
    /// A user whom no mirror reaches makes no difference: of the complete list, only the subset of all users may have such.
    pub(super) fn choose(&self, index: usize, allowed: &mut [bool]) -> bool {
        if self.complete() {
            for (k, allowed) in allowed.iter_mut().enumerate() {
                *allowed = ((index + 1) >> k) & 1 == 1;
            }
            let reached = allowed.iter().zip(&self.reach).all(|(&allowed, &reach)| !allowed || reach > 0.0);
            return reached || index + 1 == self.len();
        }
        let steps = self.users.min(NESTED_MAX);
        let order = if index < steps { &self.by_reach } else { &self.by_rise };
        // 1, 2, 3, ... at first, then wider steps up to all users.
        let step = index % steps + 1;
        let even = (step * self.users).div_ceil(steps);
        let members = if step <= steps / 2 { step } else { even };
        allowed.fill(false);
        for &k in &order[..members] {
            allowed[k] = true;
        }
        true
    }
}
