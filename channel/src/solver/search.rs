//! Searches over assignments: damped fixed point, greedy fill, single moves, and the oracle's many starts.

use super::assignment::{Assignment, Scratch};
use super::starts::Starts;
use super::table::{Table, Utility};
use crate::wide::widest;

/// Most steps of one damped fixed point.
const FIXED_POINT_STEPS: usize = 20;
/// A fixed point ends when this many steps in a row have brought nothing.
const PATIENCE: usize = 5;
/// Most steps in which the weights of the needy rise, and by how much each time.
const RAISING_STEPS: usize = 40;
const RAISE: f64 = 1.07;
/// Passes of single moves over a fill.
const FILL_PASSES: usize = 2;
/// Most passes of single moves on the way to a local optimum.
const MOVE_PASSES_MAX: usize = 50;
/// Most rounds of swaps on the way to a local optimum.
const EXCHANGE_ROUNDS_MAX: usize = 20;
/// Most users that are left out on trial.
const LEAVE_OUT_TRIALS: usize = 16;
/// Most rounds of pairs of moves.
const PAIR_ROUNDS_MAX: usize = 3;
/// How many assignments the oracle refines by swaps, at least and at most: small problems can afford more.
const REFINED: std::ops::RangeInclusive<usize> = 4..=16;
/// Users times mirrors times refined assignments.
const REFINED_WORK: usize = 2000;
/// Mirrors given out at once.
const OWNED_AT_ONCE: usize = 8;

/// Workspace of the searches.
#[derive(Clone, Debug)]
pub(super) struct Search {
    /// The last solution.
    pub(super) best: Assignment,
    trial: Assignment,
    /// The best assignments of the oracle's starts, best first.
    shortlist: Vec<Assignment>,
    starts: Starts,
    /// Fingerprints of the assignments from which the oracle has climbed.
    climbed: Vec<u64>,
    /// Users among whom mirrors are given out.
    allowed: Vec<bool>,
    /// Weights of the present step, and of the best step so far.
    weights: Vec<f64>,
    trial_weights: Vec<f64>,
    amplitude: Vec<f64>,
    /// Weights of the present step, zero for those who are not allowed.
    effective: Vec<f64>,
    /// To whom each mirror is worth most, as f64 so that it is as wide in a SIMD register as a gain.
    owners: Vec<f64>,
    inverse_invitation: Vec<f64>,
    scratch: Scratch,
}

impl Search {
    pub(super) fn new(users: usize, mirrors: usize) -> Self {
        Self {
            best: Assignment::new(users, mirrors),
            trial: Assignment::new(users, mirrors),
            shortlist: vec![
                Assignment::new(users, mirrors);
                (REFINED_WORK / (users * mirrors)).clamp(*REFINED.start(), *REFINED.end())
            ],
            climbed: Vec::with_capacity(2 * Starts::new(users).len()),
            starts: Starts::new(users),
            allowed: vec![true; users],
            weights: vec![0.0; users],
            trial_weights: vec![0.0; users],
            amplitude: vec![0.0; users],
            effective: vec![0.0; users],
            owners: vec![0.0; mirrors],
            inverse_invitation: vec![0.0; users],
            scratch: Scratch::new(mirrors),
        }
    }

    /// Damped fixed point from the given weights and from neutral ones; the better goes to `best`, its weights to `weights`.
    pub(super) fn fixed_point(&mut self, table: &Table, utility: &Utility, weights: &mut [f64]) {
        self.allowed.fill(true);
        self.neutral_weights(table);
        // A user who was given up has weight zero, and would never be tried again.
        for (weight, &neutral) in weights.iter_mut().zip(&self.weights) {
            if *weight <= 0.0 {
                *weight = neutral;
            }
        }
        self.iterate(table, utility);
        self.best.copy_from(&self.trial);
        self.weights.copy_from_slice(weights);
        weights.copy_from_slice(&self.trial_weights);
        self.iterate(table, utility);
        if self.trial.nats > self.best.nats {
            self.best.copy_from(&self.trial);
            weights.copy_from_slice(&self.trial_weights);
        }
    }

    /// The better of fixed point, fill and last assignment after `passes` of single moves, then without the users who are best left out.
    pub(super) fn greedy(&mut self, table: &Table, utility: &Utility, weights: &mut [f64], passes: usize) {
        self.trial.served.copy_from_slice(&self.best.served);
        self.trial.settle(table, utility);
        self.move_passes(table, utility, passes);
        self.shortlist[0].copy_from(&self.trial);
        self.fixed_point(table, utility, weights);
        self.trial.copy_from(&self.best);
        self.move_passes(table, utility, passes);
        self.keep_better();
        self.trial.copy_from(&self.shortlist[0]);
        self.keep_better();
        self.allowed.fill(true);
        self.fill(table, utility);
        self.move_passes(table, utility, passes);
        self.keep_better();
        self.leave_out(table, utility, passes);
        self.slopes(utility, weights);
    }

    /// Many starts, the best few refined; see [`Solver::oracle`](super::Solver::oracle).
    pub(super) fn oracle(&mut self, table: &Table, utility: &Utility, weights: &mut [f64]) {
        for entry in &mut self.shortlist {
            entry.nats = f64::NEG_INFINITY;
        }
        self.climbed.clear();
        self.starts.order(table, utility);
        for index in 0..self.starts.len() {
            if self.starts.choose(index, &mut self.allowed) {
                self.neutral_weights(table);
                self.iterate(table, utility);
                self.climb(table, utility);
                self.fill(table, utility);
                self.climb(table, utility);
            }
        }
        self.best.nats = f64::NEG_INFINITY;
        let small = self.shortlist.len() == *REFINED.end();
        for index in 0..self.shortlist.len() {
            if self.shortlist[index].nats > f64::NEG_INFINITY {
                self.trial.copy_from(&self.shortlist[index]);
                self.refine(table, utility);
                if utility.penalised() && small {
                    self.move_pairs(table, utility);
                }
                self.keep_better();
            }
        }
        if !self.starts.complete() {
            self.leave_out(table, utility, MOVE_PASSES_MAX);
            self.trial.copy_from(&self.best);
            self.refine(table, utility);
            self.keep_better();
        }
        if utility.penalised() && small {
            self.force_moves(table, utility);
        }
        if utility.penalised() && !small {
            self.trial.copy_from(&self.best);
            self.move_pairs(table, utility);
            self.keep_better();
        }
        self.slopes(utility, weights);
    }

    /// Single moves from `trial`, and a place on the shortlist for where they lead; nothing if they began there before, as many do.
    fn climb(&mut self, table: &Table, utility: &Utility) {
        let foot = self.trial.fingerprint(table);
        if !self.climbed.contains(&foot) {
            self.climbed.push(foot);
            self.move_passes(table, utility, MOVE_PASSES_MAX);
            self.note_trial();
        }
    }

    /// Writes the derivatives of the objective at the last solution.
    pub(super) fn slopes(&self, utility: &Utility, weights: &mut [f64]) {
        for (k, weight) in weights.iter_mut().enumerate() {
            *weight = utility.slope(k, self.best.amplitude[k]);
        }
    }

    /// Leaves out one served user after another, and keeps what helps.
    ///
    /// One mirror at a time can neither give up a user nor take one in: near amplitude zero the rate is flat.
    fn leave_out(&mut self, table: &Table, utility: &Utility, passes: usize) {
        let mut trials = 0;
        let mut since_better = 0;
        for user in (0..table.users).cycle() {
            if trials == LEAVE_OUT_TRIALS || since_better == table.users {
                break;
            }
            since_better += 1;
            for (k, allowed) in self.allowed.iter_mut().enumerate() {
                *allowed = k != user && self.best.amplitude[k] > table.floor[k];
            }
            if self.best.amplitude[user] > table.floor[user] && self.allowed.contains(&true) {
                trials += 1;
                self.fill(table, utility);
                self.move_passes(table, utility, passes);
                if self.keep_better() {
                    since_better = 0;
                }
            }
        }
    }

    /// Damped fixed point among the allowed users from the present weights; the best step goes to `trial` and `trial_weights`.
    ///
    /// The damping averages 1 / w, which for large amplitudes is proportional to the amplitude, and grows from step to step,
    /// because the assignment jumps whenever a weight passes the ratio of two gains.
    fn iterate(&mut self, table: &Table, utility: &Utility) {
        self.trial.nats = f64::NEG_INFINITY;
        let mut fruitless = 0;
        for step in 1..=FIXED_POINT_STEPS {
            self.assign(table);
            let nats = utility.total(&self.amplitude);
            if nats > self.trial.nats {
                self.adopt(nats);
                fruitless = 0;
            } else {
                fruitless += 1;
                if fruitless == PATIENCE {
                    break;
                }
            }
            let share = 0.7 / (1.0 + step as f64 / 6.0);
            for (k, weight) in self.weights.iter_mut().enumerate() {
                let target = utility.slope(k, self.amplitude[k]);
                let mean = (1.0 - share) * target + share * *weight;
                *weight = if mean > 0.0 { *weight * target / mean } else { 0.0 };
            }
        }
        if utility.penalised() {
            self.raise_the_needy(table, utility);
        }
        self.trial.settle(table, utility);
    }

    /// Raises the weights of those whose need is not met, step by step from the best weights met so far.
    ///
    /// At the kink of a minimum rate the derivative jumps by a factor of 1 + lambda, and the fixed point jumps with it.
    fn raise_the_needy(&mut self, table: &Table, utility: &Utility) {
        self.weights.copy_from_slice(&self.trial_weights);
        for _ in 0..RAISING_STEPS {
            self.assign(table);
            let nats = utility.total(&self.amplitude);
            if nats > self.trial.nats {
                self.adopt(nats);
            }
            let mut raised = false;
            for (k, weight) in self.weights.iter_mut().enumerate() {
                if self.allowed[k] && utility.steepness(k, self.amplitude[k]) > 1.0 {
                    *weight *= RAISE;
                    raised = true;
                }
            }
            if !raised {
                break;
            }
        }
    }

    /// Copies the present step to `trial`.
    fn adopt(&mut self, nats: f64) {
        self.trial.nats = nats;
        self.trial_weights.copy_from_slice(&self.weights);
        for (served, &user) in self.trial.served.iter_mut().zip(&self.owners) {
            *served = user as usize;
        }
    }

    /// Gives each mirror to the allowed user with the largest weight times gain, and sums the amplitudes.
    ///
    /// Selections instead of branches, and a few mirrors at a time: the compiler keeps them in SIMD registers through all users.
    fn assign(&mut self, table: &Table) {
        for (weight, (&wanted, &allowed)) in self.effective.iter_mut().zip(self.weights.iter().zip(&self.allowed)) {
            *weight = if allowed { wanted } else { 0.0 };
        }
        widest(
            #[inline(always)]
            || {
                let (blocks, rest) = self.owners.as_chunks_mut::<OWNED_AT_ONCE>();
                let done = blocks.len() * OWNED_AT_ONCE;
                for (block, owners) in blocks.iter_mut().enumerate() {
                    *owners = strongest(&self.effective, table, block * OWNED_AT_ONCE);
                }
                for (index, owner) in rest.iter_mut().enumerate() {
                    [*owner] = strongest(&self.effective, table, done + index);
                }
                for (k, line) in table.by_user.chunks_exact(table.mirrors).enumerate() {
                    self.amplitude[k] = table.floor[k] + owned_sum(line, &self.owners, k as f64);
                }
            },
        );
    }

    /// 1 / total gain: weights that ask nobody's channel to be good.
    fn neutral_weights(&mut self, table: &Table) {
        for (weight, line) in self.weights.iter_mut().zip(table.by_user.chunks_exact(table.mirrors)) {
            let sum: f64 = line.iter().sum();
            *weight = if sum > 0.0 { 1.0 / sum } else { 0.0 };
        }
    }

    /// Gives the mirrors out one after another, each to the allowed user to whom it is worth most, then moves single mirrors
    /// among the allowed users. The result goes to `trial`.
    ///
    /// Works on [`Utility::invitation`], so that every allowed user is served as well as the others permit.
    fn fill(&mut self, table: &Table, utility: &Utility) {
        let first = self.allowed.iter().position(|&allowed| allowed).unwrap_or(0);
        self.trial.served.fill(first);
        self.amplitude.copy_from_slice(&table.floor);
        for k in 0..table.users {
            self.inverse_invitation[k] = 1.0 / utility.invitation(k, self.amplitude[k]);
        }
        for &m in &table.useful {
            let (user, _) = self.most_invited(m, None, table, utility);
            self.trial.served[m] = user.unwrap_or(first);
            self.shift(self.trial.served[m], table.line(m)[self.trial.served[m]], utility);
        }
        for _ in 0..FILL_PASSES {
            for &m in &table.useful {
                let from = self.trial.served[m];
                let loss = table.line(m)[from];
                let without = (self.amplitude[from] - loss).max(table.floor[from]);
                let lost = utility.invitation(from, without) * self.inverse_invitation[from];
                let (user, gained) = self.most_invited(m, Some(from), table, utility);
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

    /// The allowed user to whose invitation mirror m adds the largest factor, and that factor.
    fn most_invited(&self, m: usize, except: Option<usize>, table: &Table, utility: &Utility) -> (Option<usize>, f64) {
        let mut best = (None, 0.0);
        for (k, &gain) in table.line(m).iter().enumerate() {
            if self.allowed[k] && gain > 0.0 && except != Some(k) {
                let factor = utility.invitation(k, self.amplitude[k] + gain) * self.inverse_invitation[k];
                if factor > best.1 {
                    best = (Some(k), factor);
                }
            }
        }
        best
    }

    fn shift(&mut self, user: usize, change: f64, utility: &Utility) {
        self.amplitude[user] += change;
        self.inverse_invitation[user] = 1.0 / utility.invitation(user, self.amplitude[user]);
    }

    /// At most `passes` passes of single moves on `trial`, fewer when nothing moves any more.
    fn move_passes(&mut self, table: &Table, utility: &Utility, passes: usize) {
        self.trial.move_each(table, utility, passes);
        self.trial.settle(table, utility);
    }

    /// Moves and swaps until `trial` is a local optimum.
    fn refine(&mut self, table: &Table, utility: &Utility) {
        for _ in 0..EXCHANGE_ROUNDS_MAX {
            self.move_passes(table, utility, MOVE_PASSES_MAX);
            if !self.trial.swap_pairs(table, utility, &mut self.scratch) {
                break;
            }
        }
        self.trial.settle(table, utility);
    }

    /// Any two moves at once and what follows from them, on `trial`: a minimum rate puts a kink into the objective, at which
    /// moves and swaps get stuck.
    fn move_pairs(&mut self, table: &Table, utility: &Utility) {
        for _ in 0..PAIR_ROUNDS_MAX {
            if !self.trial.move_pairs(table, utility, &mut self.scratch) {
                break;
            }
            self.refine(table, utility);
        }
    }

    /// Forces each single move on `best` and sees what it leads to: three moves at once, and more. For small problems.
    fn force_moves(&mut self, table: &Table, utility: &Utility) {
        for _ in 0..PAIR_ROUNDS_MAX {
            let before = self.best.nats;
            for &m in &table.useful {
                for user in 0..table.users {
                    self.trial.copy_from(&self.best);
                    self.trial.served[m] = user;
                    self.trial.settle(table, utility);
                    // Swaps and pairs first: a single move would only take the mirror back.
                    self.trial.swap_pairs(table, utility, &mut self.scratch);
                    self.move_pairs(table, utility);
                    self.keep_better();
                }
            }
            if self.best.nats <= before {
                break;
            }
        }
    }

    /// Copies `trial` to `best` if it is better. Whether it was.
    fn keep_better(&mut self) -> bool {
        let better = self.trial.nats > self.best.nats;
        if better {
            self.best.copy_from(&self.trial);
        }
        better
    }

    /// Enters `trial` into the shortlist, unless it is no better than the last of it or there already.
    fn note_trial(&mut self) {
        let nats = self.trial.nats;
        let same = |entry: &Assignment| (entry.nats - nats).abs() <= 1e-12 * nats.abs();
        let place = self.shortlist.partition_point(|entry| entry.nats > nats + 1e-12 * nats.abs());
        if place < self.shortlist.len() && !same(&self.shortlist[place]) {
            self.shortlist[place..].rotate_right(1);
            self.shortlist[place].copy_from(&self.trial);
        }
    }
}

/// The user with the largest weight times gain of each of `N` mirrors from an index on; the first one where nobody has any.
#[inline(always)]
fn strongest<const N: usize>(weights: &[f64], table: &Table, first: usize) -> [f64; N] {
    let (mut most, mut owners) = ([0.0; N], [0.0; N]);
    for (k, &weight) in weights.iter().enumerate() {
        let start = k * table.mirrors + first;
        let Some(gains) = table.by_user[start..].first_chunk::<N>() else { break };
        for lane in 0..N {
            let worth = weight * gains[lane];
            let better = worth > most[lane];
            most[lane] = if better { worth } else { most[lane] };
            owners[lane] = if better { k as f64 } else { owners[lane] };
        }
    }
    owners
}

/// Sum of the gains of the mirrors that a user owns, in four independent sums so that additions overlap.
#[inline(always)]
fn owned_sum(line: &[f64], owners: &[f64], user: f64) -> f64 {
    let mut sums = [0.0; 4];
    let (lines, rest) = line.as_chunks::<4>();
    let (owner_lines, owner_rest) = owners.as_chunks::<4>();
    for (gains, owners) in lines.iter().zip(owner_lines) {
        for lane in 0..4 {
            sums[lane] += if owners[lane] == user { gains[lane] } else { 0.0 };
        }
    }
    let tail: f64 = rest.iter().zip(owner_rest).map(|(&gain, &owner)| if owner == user { gain } else { 0.0 }).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + tail
}
