//! One assignment of mirrors to users, and the moves that improve it.

use super::table::{Table, Utility};

/// A move must raise the product of (1 + x^2) by more than this share, so that rounding cannot make a search cycle.
const WORTHWHILE: f64 = 1.0 + 1e-12;

/// Most exchanges between the same users in one round.
const EXCHANGES_MAX: usize = 200;
/// Chains are looked for among at most this many users: their number grows with the cube.
const CHAIN_USERS_MAX: usize = 6;

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

    /// Gives each mirror in turn to the user for whom that is worth most. Whether any moved.
    pub(super) fn move_each(&mut self, table: &Table, utility: &Utility) -> bool {
        let mut moved = false;
        for &m in &table.useful {
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
            if lost * gained > WORTHWHILE {
                self.served[m] = to;
                self.set(from, without);
                self.set(to, self.amplitude[to] + line[to]);
                moved = true;
            }
        }
        moved
    }

    /// Exchanges the users of two mirrors wherever that is worthwhile. Whether any changed.
    pub(super) fn swap_pairs(&mut self, table: &Table, utility: &Utility, scratch: &mut Scratch) -> bool {
        let mut changed = false;
        for i in 0..table.users {
            for j in i + 1..table.users {
                changed |= self.exchange_all([i, j, i], table, utility, scratch);
            }
        }
        changed
    }

    /// Moves one mirror from i to j and another on from j to l, wherever that is worthwhile. Whether any changed.
    ///
    /// At the kink of a minimum rate neither move may help alone: j can spare nothing until it is given something. Does nothing
    /// for more than [`CHAIN_USERS_MAX`] users.
    pub(super) fn chain_moves(&mut self, table: &Table, utility: &Utility, scratch: &mut Scratch) -> bool {
        let mut changed = false;
        let users = table.users;
        if users > CHAIN_USERS_MAX {
            return false;
        }
        for i in 0..users {
            for j in (0..users).filter(|&j| j != i) {
                for l in (0..users).filter(|&l| l != i && l != j) {
                    changed |= self.exchange_all([i, j, l], table, utility, scratch);
                }
            }
        }
        changed
    }

    fn exchange_all(&mut self, path: [usize; 3], table: &Table, utility: &Utility, scratch: &mut Scratch) -> bool {
        let mut changed = false;
        for _ in 0..EXCHANGES_MAX {
            if !self.exchange(path, table, utility, scratch) {
                break;
            }
            changed = true;
        }
        changed
    }

    /// One exchange along i, j, l: a mirror m goes from i to j and a mirror n from j to l, where l may be i. Whether one was made.
    ///
    /// ln(1 + u) <= u bounds what it can bring by r_m + r_n + slack, with r_m = w_j a_jm - w_i a_im the first-order worth
    /// of moving m, r_n that of moving n, and the slack for the squares of the changes. Pairs whose
    /// bound is not positive are skipped; the bound is exact, so nothing is missed.
    fn exchange(&mut self, path: [usize; 3], table: &Table, utility: &Utility, scratch: &mut Scratch) -> bool {
        let [i, j, l] = path;
        let rows = path.map(|k| &table.by_user[k * table.mirrors..(k + 1) * table.mirrors]);
        let bounds = path.map(|k| self.bound(k, table, utility));
        let slack = bounds[0].1 + bounds[1].1 + if l == i { 0.0 } else { bounds[2].1 };
        let weights = bounds.map(|bound| bound.0);
        scratch
            .gather(&self.served, table, path, |m, from, to| weights[to] * rows[to][m] - weights[from] * rows[from][m]);
        for &(m, leave) in &scratch.first {
            if leave + scratch.best_second + slack <= 0.0 {
                continue;
            }
            let mut partner = None;
            let mut best = WORTHWHILE;
            for &(n, on) in &scratch.second {
                if leave + on + slack <= 0.0 {
                    continue;
                }
                let to_i = self.amplitude[i] - rows[0][m] + if l == i { rows[0][n] } else { 0.0 };
                let to_j = self.amplitude[j] - rows[1][n] + rows[1][m];
                let mut factor = self.factor(utility, i, to_i.max(table.floor[i]))
                    * self.factor(utility, j, to_j.max(table.floor[j]));
                if l != i {
                    factor *= self.factor(utility, l, self.amplitude[l] + rows[2][n]);
                }
                if factor > best {
                    (best, partner) = (factor, Some(n));
                }
            }
            if let Some(n) = partner {
                (self.served[m], self.served[n]) = (j, l);
                self.set(i, (self.amplitude[i] - rows[0][m]).max(table.floor[i]));
                self.set(j, (self.amplitude[j] - rows[1][n] + rows[1][m]).max(table.floor[j]));
                self.set(l, self.amplitude[l] + rows[2][n]);
                return true;
            }
        }
        false
    }

    /// Slope of the rate at the amplitude of user k times the steepness, and the most that the square term can add.
    fn bound(&self, k: usize, table: &Table, utility: &Utility) -> (f64, f64) {
        let steepness = utility.steepness(k, self.amplitude[k]);
        let largest = table.largest[k];
        (2.0 * self.amplitude[k] * self.inverse[k] * steepness, largest * largest * self.inverse[k] * steepness)
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

    /// `worth` takes a mirror and the places in the path between which it moves.
    fn gather(
        &mut self,
        served: &[usize],
        table: &Table,
        [i, j, _]: [usize; 3],
        worth: impl Fn(usize, usize, usize) -> f64,
    ) {
        self.first.clear();
        self.second.clear();
        self.best_second = f64::NEG_INFINITY;
        for &m in &table.useful {
            if served[m] == i {
                self.first.push((m, worth(m, 0, 1)));
            } else if served[m] == j {
                let on = worth(m, 1, 2);
                self.best_second = self.best_second.max(on);
                self.second.push((m, on));
            }
        }
    }
}
