//! One assignment of mirrors to users, and the moves that improve it.

use super::table::{Table, Utility};

/// A move must raise the product of (1 + x^2) by more than this share, so that rounding cannot make a search cycle.
const WORTHWHILE: f64 = 1.0 + 1e-12;

/// Most pairs that move between the same users in one round.
const PAIRS_MAX: usize = 200;
/// Any two moves are combined among at most this many users: the combinations grow with the fourth power.
const PAIRS_USERS_MAX: usize = 6;

/// Which user each mirror serves, and the amplitudes that follow.
#[derive(Clone, Debug)]
pub(super) struct Assignment {
    pub(super) served: Vec<usize>,
    pub(super) amplitude: Vec<f64>,
    /// 1 / (1 + amplitude^2).
    inverse: Vec<f64>,
    /// Sum of utilities in nats, as of the last [`Assignment::settle`].
    pub(super) nats: f64,
}

impl Assignment {
    pub(super) fn new(users: usize, mirrors: usize) -> Self {
        Self {
            served: vec![0; mirrors],
            amplitude: vec![0.0; users],
            inverse: vec![1.0; users],
            nats: f64::NEG_INFINITY,
        }
    }

    pub(super) fn copy_from(&mut self, other: &Assignment) {
        self.served.copy_from_slice(&other.served);
        self.amplitude.copy_from_slice(&other.amplitude);
        self.inverse.copy_from_slice(&other.inverse);
        self.nats = other.nats;
    }

    /// Sums the amplitudes anew from `served`.
    pub(super) fn settle(&mut self, table: &Table, utility: &Utility) {
        self.amplitude.copy_from_slice(&table.floor);
        for (m, &k) in self.served.iter().enumerate() {
            self.amplitude[k] += table.by_user[k * table.mirrors + m];
        }
        self.note(utility);
    }

    /// Brings what is derived from the amplitudes up to date.
    fn note(&mut self, utility: &Utility) {
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

    /// Gives each mirror in turn to the user for whom that is worth most, at most `passes` times, until none has moved since its last turn.
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

    /// Gives mirror m to the user for whom that is worth most. Whether it moved.
    #[inline]
    fn move_one(&mut self, m: usize, table: &Table, utility: &Utility) -> bool {
        let line = table.line(m);
        let from = self.served[m];
        let without = (self.amplitude[from] - line[from]).max(table.floor[from]);
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
        let moved = lost * gained > WORTHWHILE;
        if moved {
            self.served[m] = to;
            self.set(from, without);
            self.set(to, self.amplitude[to] + line[to]);
        }
        moved
    }

    /// A 64-bit hash (FNV-1a, a user a step) of who is served by the mirrors that matter.
    pub(super) fn fingerprint(&self, table: &Table) -> u64 {
        let step = |hash: u64, &m: &usize| (hash ^ self.served[m] as u64).wrapping_mul(0x0100_0000_01b3);
        table.useful.iter().fold(0xcbf2_9ce4_8422_2325, step)
    }

    /// Exchanges the users of two mirrors wherever that is worthwhile. Whether any changed.
    pub(super) fn swap_pairs(&mut self, table: &Table, utility: &Utility, scratch: &mut Scratch) -> bool {
        let mut changed = false;
        for i in 0..table.users {
            for j in i + 1..table.users {
                changed |= self.pair_all([(i, j), (j, i)], table, utility, scratch);
            }
        }
        changed
    }

    /// Moves any two mirrors at once wherever that is worthwhile. Whether any changed.
    ///
    /// At the kink of a minimum rate neither move may help alone: a user can spare nothing until given something, and may need two
    /// mirrors to get there. Does nothing for more than [`PAIRS_USERS_MAX`] users.
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
                changed |= self.pair_all([ends(first), ends(second)], table, utility, scratch);
            }
        }
        changed
    }

    fn pair_all(&mut self, moves: [Ends; 2], table: &Table, utility: &Utility, scratch: &mut Scratch) -> bool {
        let mut changed = false;
        for _ in 0..PAIRS_MAX {
            if !self.pair(moves, table, utility, scratch) {
                break;
            }
            changed = true;
        }
        changed
    }

    /// Two moves at once: a mirror m between the users of the first, a mirror n between those of the second. Whether
    /// any such pair was worthwhile, and was moved.
    ///
    /// ln(1 + u) <= u bounds what they can bring by r_m + r_n + slack, with r_m = w_j a_jm - w_i a_im the first-order worth
    /// of moving m from i to j, and the slack for the squares of the changes. Pairs whose
    /// bound is not positive are skipped; the bound is exact, so nothing is missed.
    fn pair(&mut self, moves: [Ends; 2], table: &Table, utility: &Utility, scratch: &mut Scratch) -> bool {
        let touched = Touched::by(moves);
        let slack: f64 = touched.users().iter().map(|&k| self.slack(k, moves, table, utility)).sum();
        scratch.gather(self, moves, table, utility);
        for &(m, worth_m) in &scratch.first {
            if worth_m + scratch.best_second + slack <= 0.0 {
                continue;
            }
            let mut best = WORTHWHILE;
            let mut partner = None;
            for &(n, worth_n) in &scratch.second {
                if worth_m + worth_n + slack <= 0.0 || m == n {
                    continue;
                }
                let factor: f64 = touched
                    .users()
                    .iter()
                    .map(|&k| self.factor(utility, k, self.amplitude_after(k, [(m, moves[0]), (n, moves[1])], table)))
                    .product();
                if factor > best {
                    (best, partner) = (factor, Some(n));
                }
            }
            if let Some(n) = partner {
                let after = touched.users.map(|k| self.amplitude_after(k, [(m, moves[0]), (n, moves[1])], table));
                for (&k, &amplitude) in touched.users().iter().zip(&after) {
                    self.set(k, amplitude);
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
            let gain = table.by_mirror[m * table.users + k];
            if to == k {
                amplitude += gain;
            } else if from == k {
                amplitude -= gain;
            }
        }
        amplitude.max(table.floor[k])
    }

    /// Derivative of the rate of user k by amplitude, times the steepness.
    fn weight(&self, k: usize, utility: &Utility) -> f64 {
        2.0 * self.amplitude[k] * self.inverse[k] * utility.steepness(k, self.amplitude[k])
    }

    /// The most that the square of a change by two moves can add to the rate of user k, times the steepness.
    fn slack(&self, k: usize, [first, second]: [Ends; 2], table: &Table, utility: &Utility) -> f64 {
        // One mirror given and one taken change less than either; two given or two taken add up.
        let mirrors =
            if first.0 == second.0 && k == first.0 || first.1 == second.1 && k == first.1 { 2.0 } else { 1.0 };
        let largest = mirrors * table.largest[k];
        largest * largest * self.inverse[k] * utility.steepness(k, self.amplitude[k])
    }
}

/// The user from whom and the user to whom a mirror moves.
type Ends = (usize, usize);

/// The two to four users whose amplitudes a pair of moves changes.
#[derive(Clone, Copy)]
struct Touched {
    users: [usize; 4],
    count: usize,
}

impl Touched {
    fn by(moves: [Ends; 2]) -> Self {
        let mut touched = Self { users: [moves[0].0; 4], count: 0 };
        for k in [moves[0].0, moves[0].1, moves[1].0, moves[1].1] {
            if !touched.users().contains(&k) {
                touched.users[touched.count] = k;
                touched.count += 1;
            }
        }
        touched
    }

    fn users(&self) -> &[usize] {
        &self.users[..self.count]
    }
}

/// The mirrors of two users with the worth of moving each, kept to avoid allocation.
#[derive(Clone, Debug)]
pub(super) struct Scratch {
    first: Vec<(usize, f64)>,
    second: Vec<(usize, f64)>,
    best_second: f64,
}

impl Scratch {
    pub(super) fn new(mirrors: usize) -> Self {
        Self { first: Vec::with_capacity(mirrors), second: Vec::with_capacity(mirrors), best_second: f64::NEG_INFINITY }
    }

    fn gather(&mut self, assignment: &Assignment, moves: [Ends; 2], table: &Table, utility: &Utility) {
        self.first.clear();
        self.second.clear();
        self.best_second = f64::NEG_INFINITY;
        let [(from, to), (from_second, to_second)] = moves;
        let weight = |k: usize| assignment.weight(k, utility);
        let [paid, bought, paid_second, bought_second] = [from, to, from_second, to_second].map(weight);
        for &m in &table.useful {
            let line = table.line(m);
            if assignment.served[m] == from {
                self.first.push((m, bought * line[to] - paid * line[from]));
            }
            if assignment.served[m] == from_second {
                let worth = bought_second * line[to_second] - paid_second * line[from_second];
                self.best_second = self.best_second.max(worth);
                self.second.push((m, worth));
            }
        }
    }
}
