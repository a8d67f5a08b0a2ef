//! The subsets of users from which the oracle starts.

use super::table::{Table, Utility};

/// All subsets are tried up to this many users.
const COMPLETE_USERS_MAX: usize = 6;
/// Largest number of nested subsets of one order, above that.
const NESTED_MAX: usize = 16;

/// A list of subsets: all subsets for few users, nested subsets for many.
///
/// A nested subset has the first n users of an order, for up to [`NESTED_MAX`] values of n. There
/// are two orders: by the amplitude that the complete array can add, and by the increase of the
/// user's utility.
#[derive(Clone, Debug)]
pub(super) struct Starts {
    users: usize,
    /// Users, by decreasing amplitude of the complete array.
    by_reach: Vec<usize>,
    /// Users, by decreasing increase of the utility.
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

    /// Changes the number of users.
    pub(super) fn resize(&mut self, users: usize) {
        self.users = users;
        for order in [&mut self.by_reach, &mut self.by_rise] {
            order.clear();
            order.extend(0..users);
        }
        self.reach.resize(users, 0.0);
        self.rise.resize(users, 0.0);
    }

    /// Largest length of the list for any number of users.
    pub(super) const LEN_MAX: usize = (1 << COMPLETE_USERS_MAX) - 1;

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
            self.rise[k] = utility.value(k, table.los_amplitude[k] + sum) - utility.value(k, table.los_amplitude[k]);
        }
        let (reach, rise) = (&self.reach, &self.rise);
        // The index breaks ties, so that the order depends on the problem only.
        self.by_reach.sort_unstable_by(|&a, &b| reach[b].total_cmp(&reach[a]).then(a.cmp(&b)));
        self.by_rise.sort_unstable_by(|&a, &b| rise[b].total_cmp(&rise[a]).then(a.cmp(&b)));
    }

    /// Marks the users of one subset; returns false if another subset is equivalent.
    ///
    /// A user that no mirror reaches has no effect. In the complete list, only the subset of all
    /// users may include one.
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
