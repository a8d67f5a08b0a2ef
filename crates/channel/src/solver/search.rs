//! Search over assignments: damped fixed point, greedy fill, single moves, and the starts of the
//! oracle.

mod assign;
mod fill;
mod local;

use super::assignment::{Assignment, Scratch};
use super::starts::Starts;
use super::table::{Table, Utility};
use crate::scene::MIDPOINTS_MAX;

/// Largest number of steps of one damped fixed point.
const FIXED_POINT_STEPS: usize = 20;
/// Number of steps without improvement after which a fixed point ends.
const PATIENCE: usize = 5;
/// Largest number of steps that raise the weights of users below their minimum rate, and the factor
/// per step.
const RAISING_STEPS: usize = 40;
const RAISE: f64 = 1.07;
/// Largest number of passes of single moves to a local optimum.
const MOVE_PASSES_MAX: usize = 50;
/// Largest number of trials that exclude one user.
const EXCLUSION_TRIALS: usize = 16;
/// Smallest and largest number of assignments that the oracle refines by swaps.
const REFINED: std::ops::RangeInclusive<usize> = 4..=16;
/// Approximate product of users, mirrors and refined assignments.
const REFINED_WORK: usize = 2000;

/// Buffers of the searches.
#[derive(Clone, Debug)]
pub(super) struct Search {
    /// The last solution.
    pub(super) best: Assignment,
    trial: Assignment,
    /// The best assignments of all starts of the oracle, best first.
    shortlist: Vec<Assignment>,
    /// How many entries of the shortlist are in use.
    refined: usize,
    starts: Starts,
    /// The users of the midpoints to which `best` refers.
    pub(super) midpoints: Vec<[usize; 2]>,
    /// Fingerprints of the assignments from which single moves have started.
    searched: Vec<u64>,
    /// Users that may be assigned mirrors.
    allowed: Vec<bool>,
    /// Weights of the current step, and of the best step so far.
    weights: Vec<f64>,
    trial_weights: Vec<f64>,
    amplitude: Vec<f64>,
    /// Weights of the current step; zero for users that are not allowed.
    effective: Vec<f64>,
    /// User with the largest weighted gain of each mirror, as f64 so that it has the width of a
    /// gain in a SIMD register.
    owners: Vec<f64>,
    inverse_fill: Vec<f64>,
    /// Amplitude and `inverse_fill` of the users of an aim, while its mirror is taken away.
    before: Vec<(f64, f64)>,
    scratch: Scratch,
}

impl Search {
    pub(super) fn new(users: usize, mirrors: usize) -> Self {
        Self {
            best: Assignment::new(users, mirrors),
            trial: Assignment::new(users, mirrors),
            shortlist: vec![Assignment::new(users, mirrors); *REFINED.end()],
            refined: refined(users, mirrors),
            searched: Vec::with_capacity(2 * Starts::LEN_MAX),
            starts: Starts::new(users),
            midpoints: Vec::with_capacity(MIDPOINTS_MAX),
            allowed: vec![true; users],
            weights: vec![0.0; users],
            trial_weights: vec![0.0; users],
            amplitude: vec![0.0; users],
            effective: vec![0.0; users],
            owners: vec![0.0; mirrors],
            inverse_fill: vec![0.0; users],
            before: vec![(0.0, 1.0); users],
            scratch: Scratch::new(users, mirrors),
        }
    }

    /// Changes the number of users, as [`Assignment::resize`] does.
    pub(super) fn resize(&mut self, users: usize, now_at: impl Fn(usize) -> Option<usize>) {
        let (former_users, midpoints) = (self.allowed.len(), &self.midpoints);
        // A midpoint becomes its first user, since no midpoint of the new users is known yet.
        let now_at = |aim: usize| match aim.checked_sub(former_users) {
            Some(index) => midpoints.get(index).and_then(|[user, _]| now_at(*user)),
            None => now_at(aim),
        };
        self.best.resize(users, now_at);
        self.trial.resize(users, now_at);
        for entry in &mut self.shortlist {
            entry.resize(users, now_at);
        }
        self.midpoints.clear();
        self.refined = refined(users, self.owners.len());
        self.starts.resize(users);
        self.allowed.resize(users, true);
        self.before.resize(users, (0.0, 1.0));
        let lists = [
            &mut self.weights,
            &mut self.trial_weights,
            &mut self.amplitude,
            &mut self.effective,
            &mut self.inverse_fill,
        ];
        for list in lists {
            list.resize(users, 0.0);
        }
    }

    /// Converts the aims of `best` to those of a new problem of the same users.
    ///
    /// A midpoint that is no longer an aim of its mirror becomes its first user.
    pub(super) fn follow_midpoints(&mut self, table: &Table) {
        for (m, served) in self.best.served.iter_mut().enumerate() {
            if let Some(index) = served.checked_sub(table.users) {
                let users = self.midpoints[index];
                let now = table.spill.midpoints_of(m).find(|(_, others)| *others == users);
                *served = now.map_or(users[0], |(aim, _)| aim);
            }
        }
        self.midpoints.clear();
        self.midpoints.extend_from_slice(table.spill.midpoints());
    }

    /// Damped fixed point from the given weights and from neutral ones; the better goes to `best`,
    /// its weights to `weights`.
    pub(super) fn fixed_point(&mut self, table: &Table, utility: &Utility, weights: &mut [f64]) {
        self.allowed.fill(true);
        table.neutral_weights(&mut self.weights);
        // A user with weight 0 would keep it in every step.
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

    /// The best of fixed point, fill and last assignment after `passes` of single moves, then
    /// trials that exclude users.
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
        self.exclude_users(table, utility, passes);
        self.slopes(utility, weights);
    }

    /// Search from many starts, of which the best few are refined; see
    /// [`Solver::oracle`](super::Solver::oracle).
    pub(super) fn oracle(&mut self, table: &Table, utility: &Utility, weights: &mut [f64]) {
        for entry in &mut self.shortlist {
            entry.nats = f64::NEG_INFINITY;
        }
        self.searched.clear();
        self.starts.order(table, utility);
        for index in 0..self.starts.len() {
            if self.starts.choose(index, &mut self.allowed) {
                table.neutral_weights(&mut self.weights);
                self.iterate(table, utility);
                self.search_locally(table, utility);
                self.fill(table, utility);
                self.search_locally(table, utility);
            }
        }
        self.best.nats = f64::NEG_INFINITY;
        let small = self.refined == *REFINED.end();
        for index in 0..self.refined {
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
            self.exclude_users(table, utility, MOVE_PASSES_MAX);
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

    /// Single moves from `trial`, whose result may enter the shortlist; no effect for an assignment
    /// that was used before.
    fn search_locally(&mut self, table: &Table, utility: &Utility) {
        let fingerprint = self.trial.fingerprint(table);
        if !self.searched.contains(&fingerprint) {
            self.searched.push(fingerprint);
            self.move_passes(table, utility, MOVE_PASSES_MAX);
            self.shortlist_trial();
        }
    }

    /// Writes the derivatives of the objective at the last solution.
    pub(super) fn slopes(&self, utility: &Utility, weights: &mut [f64]) {
        for (k, weight) in weights.iter_mut().enumerate() {
            *weight = utility.slope(k, self.best.amplitude[k]);
        }
    }

    /// Excludes one served user after another, and keeps each improvement.
    ///
    /// Single moves cannot do this, since near amplitude 0 the rate is flat.
    fn exclude_users(&mut self, table: &Table, utility: &Utility, passes: usize) {
        let mut trials = 0;
        let mut since_better = 0;
        for user in (0..table.users).cycle() {
            if trials == EXCLUSION_TRIALS || since_better == table.users {
                break;
            }
            since_better += 1;
            for (k, allowed) in self.allowed.iter_mut().enumerate() {
                *allowed = k != user && self.best.amplitude[k] > table.los_amplitude[k];
            }
            if self.best.amplitude[user] > table.los_amplitude[user] && self.allowed.contains(&true) {
                trials += 1;
                self.fill(table, utility);
                self.move_passes(table, utility, passes);
                if self.keep_better() {
                    since_better = 0;
                }
            }
        }
    }

    /// Damped fixed point among the allowed users from the current weights; the best step goes to
    /// `trial` and `trial_weights`.
    ///
    /// The damping averages 1 / w, which is proportional to the amplitude for large amplitudes. It
    /// grows with the steps, because the assignment is discontinuous in the weights.
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
            self.raise_short_users(table, utility);
        }
        self.trial.settle(table, utility);
    }

    /// Raises the weights of users below their minimum rate, step by step from the best weights so
    /// far.
    ///
    /// At the kink of a minimum rate the derivative jumps by a factor of 1 + lambda, so the fixed
    /// point does not converge.
    fn raise_short_users(&mut self, table: &Table, utility: &Utility) {
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

    /// Copies the current step to `trial`.
    fn adopt(&mut self, nats: f64) {
        self.trial.nats = nats;
        self.trial_weights.copy_from_slice(&self.weights);
        for (served, &user) in self.trial.served.iter_mut().zip(&self.owners) {
            *served = user as usize;
        }
    }

    /// Copies `trial` to `best` if it is better; returns whether it was.
    fn keep_better(&mut self) -> bool {
        let better = self.trial.nats > self.best.nats;
        if better {
            self.best.copy_from(&self.trial);
        }
        better
    }

    /// Inserts `trial` into the shortlist, unless it is not better than the last entry or is
    /// already there.
    fn shortlist_trial(&mut self) {
        let nats = self.trial.nats;
        let same = |entry: &Assignment| (entry.nats - nats).abs() <= 1e-12 * nats.abs();
        let shortlist = &mut self.shortlist[..self.refined];
        let place = shortlist.partition_point(|entry| entry.nats > nats + 1e-12 * nats.abs());
        if place < shortlist.len() && !same(&shortlist[place]) {
            shortlist[place..].rotate_right(1);
            shortlist[place].copy_from(&self.trial);
        }
    }
}

/// The number of assignments that the oracle refines for this size of problem.
fn refined(users: usize, mirrors: usize) -> usize {
    (REFINED_WORK / (users * mirrors)).clamp(*REFINED.start(), *REFINED.end())
}
