//! One assignment of mirrors to users, and the moves that improve it.

mod sharing;

use super::table::{Table, Utility};

/// Factor by which a move must raise the product of (1 + x^2), so that rounding cannot cause a
/// cycle.
const MIN_FACTOR: f64 = 1.0 + 1e-12;

/// Largest number of pairs that move between the same users in one round.
const PAIRS_MAX: usize = 200;
/// Largest number of users for pairs of moves, whose number grows with the fourth power.
const PAIRS_USERS_MAX: usize = 6;

/// The aim of each mirror, and the resulting amplitudes.
///
/// The aims are the users and the midpoints of [`Spill`](crate::scene::Spill).
#[derive(Clone, Debug)]
pub(super) struct Assignment {
    pub(super) served: Vec<usize>,
    pub(super) amplitude: Vec<f64>,
    /// 1 / (1 + amplitude^2).
    inverse: Vec<f64>,
    /// Amplitude and `inverse` of the users of an aim, while its mirror is taken away.
    before: Vec<(f64, f64)>,
    /// Sum of utilities in nats, as of the last [`Assignment::settle`].
    pub(super) nats: f64,
}

impl Assignment {
    pub(super) fn new(users: usize, mirrors: usize) -> Self {
        Self {
            served: vec![0; mirrors],
            amplitude: vec![0.0; users],
            inverse: vec![1.0; users],
            before: vec![(0.0, 1.0); users],
            nats: f64::NEG_INFINITY,
        }
    }

    /// Changes the number of users. `now_at` gives the new index of a user, or `None` for one who
    /// has left; the mirrors of such a user serve user 0.
    pub(super) fn resize(&mut self, users: usize, now_at: impl Fn(usize) -> Option<usize>) {
        for served in &mut self.served {
            *served = now_at(*served).unwrap_or(0);
        }
        self.amplitude.resize(users, 0.0);
        self.inverse.resize(users, 1.0);
        self.before.resize(users, (0.0, 1.0));
        self.nats = f64::NEG_INFINITY;
    }

    pub(super) fn copy_from(&mut self, other: &Assignment) {
        self.served.copy_from_slice(&other.served);
        self.amplitude.copy_from_slice(&other.amplitude);
        self.inverse.copy_from_slice(&other.inverse);
        self.nats = other.nats;
    }

    /// Computes the amplitudes from `served`.
    pub(super) fn settle(&mut self, table: &Table, utility: &Utility) {
        self.amplitude.copy_from_slice(&table.los_amplitude);
        for (m, &k) in self.served.iter().enumerate().filter(|(_, aim)| **aim < table.users) {
            self.amplitude[k] += table.by_user[k * table.mirrors + m];
        }
        self.settle_spill(table);
        self.derive(utility);
    }

    /// Computes the values derived from the amplitudes.
    fn derive(&mut self, utility: &Utility) {
        for (inverse, &x) in self.inverse.iter_mut().zip(&self.amplitude) {
            *inverse = 1.0 / (1.0 + x * x);
        }
        self.nats = utility.total(&self.amplitude);
    }

    #[inline]
    fn set(&mut self, k: usize, amplitude: f64) {
        self.amplitude[k] = amplitude;
        self.inverse[k] = 1.0 / (1.0 + amplitude * amplitude);
    }

    #[inline]
    fn factor(&self, utility: &Utility, k: usize, to: f64) -> f64 {
        utility.factor(k, self.amplitude[k], self.inverse[k], to)
    }

    /// Assigns each mirror in turn to the user with the largest increase, until no mirror moves or
    /// after `passes` passes.
    pub(super) fn move_each(&mut self, table: &Table, utility: &Utility, passes: usize) {
        let mut unmoved = 0;
        for _ in 0..passes {
            for &m in &table.useful {
                unmoved = if self.move_one(m, table, utility) { 0 } else { unmoved + 1 };
                if unmoved == table.useful.len() {
                    return;
                }
            }
        }
    }

    /// Assigns mirror m to the user with the largest increase; returns whether it moved.
    #[inline]
    fn move_one(&mut self, m: usize, table: &Table, utility: &Utility) -> bool {
        if table.spill.shares(m) {
            return self.move_sharing(m, table, utility);
        }
        let line = table.line(m);
        let from = self.served[m];
        let without = (self.amplitude[from] - line[from]).max(table.los_amplitude[from]);
        let lost = self.factor(utility, from, without);
        let (mut to, mut gained) = (from, 0.0);
        for (k, &gain) in line.iter().enumerate() {
            if k != from && gain > 0.0 {
                let factor = self.factor(utility, k, self.amplitude[k] + gain);
                if factor > gained {
                    (to, gained) = (k, factor);
                }
            }
        }
        let moved = lost * gained > MIN_FACTOR;
        if moved {
            self.served[m] = to;
            self.set(from, without);
            self.set(to, self.amplitude[to] + line[to]);
        }
        moved
    }

    /// A 64-bit FNV-1a hash of the users that the useful mirrors serve.
    pub(super) fn fingerprint(&self, table: &Table) -> u64 {
        let step = |hash: u64, &m: &usize| (hash ^ self.served[m] as u64).wrapping_mul(0x0100_0000_01b3);
        table.useful.iter().fold(0xcbf2_9ce4_8422_2325, step)
    }

    /// Swaps the users of two mirrors where that raises the objective; returns whether a mirror
    /// moved.
    pub(super) fn swap_pairs(&mut self, table: &Table, utility: &Utility, scratch: &mut Scratch) -> bool {
        let mut changed = false;
        for i in 0..table.users {
            for j in i + 1..table.users {
                changed |= self.improve_pairs([(i, j), (j, i)], table, utility, scratch);
            }
        }
        changed
    }

    /// Moves two mirrors at once where that raises the objective; returns whether a mirror moved.
    ///
    /// At the kink of a minimum rate, a single move may lower the objective although two moves
    /// raise it. Has no effect for more than [`PAIRS_USERS_MAX`] users.
    pub(super) fn move_pairs(&mut self, table: &Table, utility: &Utility, scratch: &mut Scratch) -> bool {
        let users = table.users;
        if users > PAIRS_USERS_MAX {
            return false;
        }
        let moves = users * users;
        let ends = |code: usize| (code / users, code % users);
        let mut changed = false;
        for first in (0..moves).filter(|&code| ends(code).0 != ends(code).1) {
            for second in (first..moves).filter(|&code| ends(code).0 != ends(code).1) {
                changed |= self.improve_pairs([ends(first), ends(second)], table, utility, scratch);
            }
        }
        changed
    }

    fn improve_pairs(&mut self, moves: [Ends; 2], table: &Table, utility: &Utility, scratch: &mut Scratch) -> bool {
        let mut changed = false;
        for _ in 0..PAIRS_MAX {
            if !self.pair(moves, table, utility, scratch) {
                break;
            }
            changed = true;
        }
        changed
    }

    /// Two moves at once: mirror m between the users of the first, mirror n between those of the
    /// second. Returns whether a pair raised the objective and was moved.
    ///
    /// By ln(1 + u) <= u, the increase is at most r_m + r_n + slack. Here r_m = w_j a_jm - w_i a_im
    /// is the first-order increase of moving m from i to j, and the slack bounds the squares of the
    /// changes. Pairs with a bound of at most 0 are skipped, which loses no improvement.
    fn pair(&mut self, moves: [Ends; 2], table: &Table, utility: &Utility, scratch: &mut Scratch) -> bool {
        scratch.gather(self, moves, table, utility);
        let slack: f64 = scratch.touched.iter().map(|&k| self.slack(k, moves, table, utility)).sum();
        for &(m, increase_m) in &scratch.first {
            if increase_m + scratch.best_second + slack <= 0.0 {
                continue;
            }
            let mut best = MIN_FACTOR;
            let mut partner = None;
            for &(n, increase_n) in &scratch.second {
                if increase_m + increase_n + slack <= 0.0 || m == n {
                    continue;
                }
                let factor: f64 = scratch
                    .touched
                    .iter()
                    .map(|&k| self.factor(utility, k, self.amplitude_after(k, [(m, moves[0]), (n, moves[1])], table)))
                    .product();
                if factor > best {
                    (best, partner) = (factor, Some(n));
                }
            }
            if let Some(n) = partner {
                for &k in &scratch.touched {
                    self.set(k, self.amplitude_after(k, [(m, moves[0]), (n, moves[1])], table));
                }
                (self.served[m], self.served[n]) = (moves[0].1, moves[1].1);
                return true;
            }
        }
        false
    }

    /// Amplitude of user k after two moves.
    #[inline]
    fn amplitude_after(&self, k: usize, moves: [(usize, Ends); 2], table: &Table) -> f64 {
        let mut amplitude = self.amplitude[k];
        for (m, (from, to)) in moves {
            amplitude += table.gain_of_aim(m, to, k) - table.gain_of_aim(m, from, k);
        }
        amplitude.max(table.los_amplitude[k])
    }

    /// Derivative of the rate of user k by amplitude, times the steepness.
    fn weight(&self, k: usize, utility: &Utility) -> f64 {
        2.0 * self.amplitude[k] * self.inverse[k] * utility.steepness(k, self.amplitude[k])
    }

    /// Bound of the second-order increase of the rate of user k by two moves, times the steepness.
    fn slack(&self, k: usize, moves: [Ends; 2], table: &Table, utility: &Utility) -> f64 {
        let [first, second] = moves;
        let spilled = |(from, to): Ends| table.spill.reaches(from, k) || table.spill.reaches(to, k);
        let changes = |ends: Ends| spilled(ends) || ends.0 == k || ends.1 == k;
        // A gained and a lost mirror partly cancel; two gained or two lost mirrors add.
        let adding = first.0 == second.0 && k == first.0 || first.1 == second.1 && k == first.1;
        let either = moves.into_iter().any(spilled) && changes(first) && changes(second);
        let mirrors = if adding || either { 2.0 } else { 1.0 };
        let largest = mirrors * table.largest[k];
        largest * largest * self.inverse[k] * utility.steepness(k, self.amplitude[k])
    }
}

/// The users before and after a move of one mirror.
type Ends = (usize, usize);

/// The mirrors of two users with the first-order increase of moving each; reused to avoid
/// allocation.
#[derive(Clone, Debug)]
pub(super) struct Scratch {
    first: Vec<(usize, f64)>,
    second: Vec<(usize, f64)>,
    best_second: f64,
    /// The users whose amplitudes change in a pair of moves: those of the moves, and those in their
    /// spots.
    touched: Vec<usize>,
}

impl Scratch {
    pub(super) fn new(users: usize, mirrors: usize) -> Self {
        Self {
            first: Vec::with_capacity(mirrors),
            second: Vec::with_capacity(mirrors),
            best_second: f64::NEG_INFINITY,
            touched: Vec::with_capacity(users),
        }
    }

    fn gather(&mut self, assignment: &Assignment, moves: [Ends; 2], table: &Table, utility: &Utility) {
        self.first.clear();
        self.second.clear();
        self.best_second = f64::NEG_INFINITY;
        self.touch(moves, table);
        let weight = |k: usize| assignment.weight(k, utility);
        let weights = moves.map(|(from, to)| (weight(from), weight(to)));
        let spilled = |m: usize, k: usize| table.spill.of(k, m).iter().map(|(k, gain)| weight(*k) * gain).sum::<f64>();
        let increase = |m: usize, (from, to): Ends, weights: (f64, f64)| {
            let line = table.line(m);
            weights.1 * line[to] - weights.0 * line[from] + (spilled(m, to) - spilled(m, from))
        };
        for &m in &table.useful {
            if assignment.served[m] == moves[0].0 {
                self.first.push((m, increase(m, moves[0], weights[0])));
            }
            if assignment.served[m] == moves[1].0 {
                let increase = increase(m, moves[1], weights[1]);
                self.best_second = self.best_second.max(increase);
                self.second.push((m, increase));
            }
        }
    }

    /// Lists the users whose amplitudes change.
    fn touch(&mut self, moves: [Ends; 2], table: &Table) {
        let ends = [moves[0].0, moves[0].1, moves[1].0, moves[1].1];
        self.touched.clear();
        for k in ends {
            if !self.touched.contains(&k) {
                self.touched.push(k);
            }
        }
        if !table.spill.is_empty() {
            let spilled = (0..table.users).filter(|k| ends.iter().any(|end| table.spill.reaches(*end, *k)));
            self.touched.extend(spilled.filter(|k| !ends.contains(k)));
        }
    }
}
