//! Search over normals: the fixed point over the shared weights, and the starts of the oracle.

use super::table::{Table, Utility};
use crate::geometry::Vec3;

/// Steps of each start of the oracle before the best starts continue.
const SCREENING_STEPS: usize = 6;
/// Largest number of steps to convergence.
const STEPS_MAX: usize = 200;
/// Relative change of the objective per step at which the search has converged.
const CONVERGED: f64 = 1e-14;
/// Number of starts of the oracle that continue to convergence.
const FOLLOWED: usize = 4;
/// Number of users from which the oracle forms starts with one or two users.
const PAIRED_USERS_MAX: usize = 8;
/// Number of starts with weights spread over several orders of magnitude.
const SPREAD_STARTS: usize = 12;

/// Buffers of the search; components have separate arrays, so that the loops over mirrors
/// vectorise.
#[derive(Clone, Debug)]
pub(super) struct NormalSearch {
    /// c_km u_km times the amplitude scale: x, y and z. Shape of each: K * M.
    gain_vector: [Vec<f64>; 3],
    /// Normals of the current step. Shape of each: M.
    normal: [Vec<f64>; 3],
    amplitude: Vec<f64>,
    weights: Vec<f64>,
    /// The starts that continue: objective in nats and weights.
    followed: Vec<(f64, Vec<f64>)>,
    /// Normals of the last solution.
    pub(super) best: Vec<Vec3>,
    /// Amplitudes of the last solution.
    pub(super) best_amplitude: Vec<f64>,
    best_nats: f64,
}

impl NormalSearch {
    pub(super) fn new(users: usize, mirrors: usize) -> Self {
        let pairs = || vec![0.0; users * mirrors];
        Self {
            gain_vector: [pairs(), pairs(), pairs()],
            normal: [vec![0.0; mirrors], vec![0.0; mirrors], vec![0.0; mirrors]],
            amplitude: vec![0.0; users],
            weights: vec![0.0; users],
            followed: vec![(f64::NEG_INFINITY, vec![0.0; users]); FOLLOWED],
            best: vec![Vec3::zeros(); mirrors],
            best_amplitude: vec![0.0; users],
            best_nats: f64::NEG_INFINITY,
        }
    }

    /// Changes the number of users.
    pub(super) fn resize(&mut self, users: usize) {
        for pairs in &mut self.gain_vector {
            pairs.resize(users * self.best.len(), 0.0);
        }
        for list in [&mut self.amplitude, &mut self.weights, &mut self.best_amplitude] {
            list.resize(users, 0.0);
        }
        for (_, weights) in &mut self.followed {
            weights.resize(users, 0.0);
        }
    }

    /// Multiplies gains and directions; a direction that is not finite counts as gain 0.
    pub(super) fn load(&mut self, table: &Table, directions: &[Vec3]) {
        assert_eq!(directions.len(), table.by_user.len(), "one direction a user and mirror");
        for (index, (&gain, direction)) in table.by_user.iter().zip(directions).enumerate() {
            let usable = direction.iter().all(|component| component.is_finite());
            for (axis, gain_vector) in self.gain_vector.iter_mut().enumerate() {
                gain_vector[index] = if usable { gain * direction[axis] } else { 0.0 };
            }
        }
    }

    /// Fixed point from the given weights and from neutral ones; writes the weights of the better
    /// one.
    pub(super) fn fixed_point(&mut self, table: &Table, utility: &Utility, weights: &mut [f64]) {
        self.best_nats = f64::NEG_INFINITY;
        table.neutral_weights(&mut self.weights);
        self.iterate(table, utility, STEPS_MAX);
        self.weights.copy_from_slice(weights);
        if weights.iter().any(|&weight| weight > 0.0) {
            self.iterate(table, utility, STEPS_MAX);
        }
        self.finish(utility, weights);
    }

    /// Search from many starts, of which the best few continue; see
    /// [`Solver::oracle`](super::Solver::oracle).
    pub(super) fn oracle(&mut self, table: &Table, utility: &Utility, weights: &mut [f64]) {
        let users = table.users;
        self.best_nats = f64::NEG_INFINITY;
        for entry in &mut self.followed {
            entry.0 = f64::NEG_INFINITY;
        }
        self.weights.fill(1.0);
        self.screen(table, utility);
        table.neutral_weights(&mut self.weights);
        self.screen(table, utility);
        for first in 0..users.min(PAIRED_USERS_MAX) {
            for second in first..users.min(PAIRED_USERS_MAX) {
                self.weights.fill(0.0);
                self.weights[first] = 1.0;
                self.weights[second] = 1.0;
                self.screen(table, utility);
            }
        }
        for start in 0..SPREAD_STARTS {
            table.neutral_weights(&mut self.weights);
            for (k, weight) in self.weights.iter_mut().enumerate() {
                *weight *= spread(start, k);
            }
            self.screen(table, utility);
        }
        for index in 0..FOLLOWED {
            if self.followed[index].0 > f64::NEG_INFINITY {
                self.weights.copy_from_slice(&self.followed[index].1);
                self.iterate(table, utility, STEPS_MAX);
            }
        }
        self.finish(utility, weights);
    }

    /// A few steps from the current weights; keeps the result if it is among the best and not yet
    /// in the list.
    fn screen(&mut self, table: &Table, utility: &Utility) {
        let nats = self.iterate(table, utility, SCREENING_STEPS);
        let close = 1e-6 * nats.abs();
        let place = self.followed.partition_point(|entry| entry.0 > nats + close);
        if place < FOLLOWED && (self.followed[place].0 - nats).abs() > close {
            self.followed[place..].rotate_right(1);
            self.followed[place].0 = nats;
            self.followed[place].1.copy_from_slice(&self.weights);
        }
    }

    /// Fixed point from the current weights; keeps the best step and returns the objective of the
    /// last step in nats.
    fn iterate(&mut self, table: &Table, utility: &Utility, steps: usize) -> f64 {
        let mut before = f64::NEG_INFINITY;
        for step in 0..steps {
            self.turn(table);
            let nats = utility.total(&self.amplitude);
            if nats > self.best_nats {
                self.keep(nats);
            }
            if (nats - before).abs() <= CONVERGED * nats.abs() {
                break;
            }
            before = nats;
            // The scale of the start weights is arbitrary, so the first step has no damping.
            let share = if step == 0 { 1.0 } else { 0.6 };
            for (k, weight) in self.weights.iter_mut().enumerate() {
                *weight += share * (utility.slope(k, self.amplitude[k]) - *weight);
            }
        }
        before
    }

    fn keep(&mut self, nats: f64) {
        self.best_nats = nats;
        self.best_amplitude.copy_from_slice(&self.amplitude);
        for (m, best) in self.best.iter_mut().enumerate() {
            *best = Vec3::new(self.normal[0][m], self.normal[1][m], self.normal[2][m]);
        }
    }

    fn finish(&mut self, utility: &Utility, weights: &mut [f64]) {
        for (k, weight) in weights.iter_mut().enumerate() {
            *weight = utility.slope(k, self.best_amplitude[k]);
        }
    }

    /// Sets each normal to the direction of the weighted sum, and computes the amplitudes.
    fn turn(&mut self, table: &Table) {
        let mirrors = table.mirrors;
        for (normal, gain_vector) in self.normal.iter_mut().zip(&self.gain_vector) {
            normal.fill(0.0);
            for (&weight, line) in self.weights.iter().zip(gain_vector.chunks_exact(mirrors)) {
                for (sum, &gain_vector) in normal.iter_mut().zip(line) {
                    *sum += weight * gain_vector;
                }
            }
        }
        let [x, y, z] = &mut self.normal;
        for ((x, y), z) in x.iter_mut().zip(y).zip(z) {
            let length = (*x * *x + *y * *y + *z * *z).sqrt();
            let scale = if length > 0.0 { 1.0 / length } else { 0.0 };
            (*x, *y, *z) = (*x * scale, *y * scale, *z * scale);
        }
        if self.receive(table) < 0.0 {
            for m in 0..mirrors {
                self.exclude_hidden_users(m, mirrors);
            }
            self.receive(table);
        }
    }

    /// Computes the amplitudes; returns the smallest dot product n_m . c_km u_km among users with a
    /// weight.
    ///
    /// The result is negative if a mirror faces away from such a user.
    fn receive(&mut self, table: &Table) -> f64 {
        let mirrors = table.mirrors;
        let [x, y, z] = &self.normal;
        let mut smallest = 0.0_f64;
        for (k, amplitude) in self.amplitude.iter_mut().enumerate() {
            let [px, py, pz] =
                self.gain_vector.each_ref().map(|gain_vector| &gain_vector[k * mirrors..(k + 1) * mirrors]);
            let mut sums = [0.0; 4];
            let mut lowest = [0.0; 4];
            let mut m = 0;
            while m < mirrors {
                let lanes = (mirrors - m).min(4);
                for lane in 0..lanes {
                    let i = m + lane;
                    let product = x[i] * px[i] + y[i] * py[i] + z[i] * pz[i];
                    sums[lane] += if product > 0.0 { product } else { 0.0 };
                    lowest[lane] = if product < lowest[lane] { product } else { lowest[lane] };
                }
                m += lanes;
            }
            *amplitude = table.los_amplitude[k] + (sums[0] + sums[1]) + (sums[2] + sums[3]);
            if self.weights[k] > 0.0 {
                smallest = lowest.iter().fold(smallest, |a, &b| a.min(b));
            }
        }
        smallest
    }

    /// Excludes from the sum for mirror m the users that the mirror faces away from, until it faces
    /// all remaining users.
    fn exclude_hidden_users(&mut self, m: usize, mirrors: usize) {
        let gain_vector = |k: usize| {
            Vec3::new(
                self.gain_vector[0][k * mirrors + m],
                self.gain_vector[1][k * mirrors + m],
                self.gain_vector[2][k * mirrors + m],
            )
        };
        let mut normal = Vec3::new(self.normal[0][m], self.normal[1][m], self.normal[2][m]);
        for _ in 0..self.weights.len() {
            let facing = |k: &usize| normal.dot(&gain_vector(*k)) > 0.0;
            let users = 0..self.weights.len();
            let sum: Vec3 = users.filter(facing).map(|k| self.weights[k] * gain_vector(k)).sum();
            let length = sum.norm();
            if length <= 0.0 {
                break;
            }
            let next = sum / length;
            if next == normal {
                break;
            }
            normal = next;
        }
        for (axis, line) in self.normal.iter_mut().enumerate() {
            line[m] = normal[axis];
        }
    }
}

/// Factors from 1/30 to 30 with an even logarithmic distribution over starts and users, without a
/// random generator.
fn spread(start: usize, user: usize) -> f64 {
    // Fractional parts of multiples of an irrational number are evenly distributed (Weyl).
    let place =
        (start as f64 + 1.0) * 0.618_033_988_749_895 + (user as f64 * (start as f64 + 1.0)) * std::f64::consts::SQRT_2;
    (6.8 * (place.fract() - 0.5)).exp()
}
