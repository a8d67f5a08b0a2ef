//! The data of a problem for the searches: dimensionless amplitudes in two layouts, and the utility
//! of each user.

use super::problem::Problem;
use super::spill_table::SpillTable;

/// Upper limit of an amplitude, so that no sum of squares overflows.
const AMPLITUDE_MAX: f64 = 1e60;

/// Utility of each user as a function of the amplitude x = s H, in nats.
///
/// u(x) = v - penalty max(0, v_min - v) with v(x) = ln(1 + x^2). The sum over users times B/K / ln
/// 2 is the objective in bit/s. u is convex below x = 1 and concave above, with a kink at
/// `threshold`.
#[derive(Clone, Debug, Default)]
pub(super) struct Utility {
    /// Minimum rate of each user in nats.
    min_nats: Vec<f64>,
    /// Amplitude at which each user's minimum rate is met; 0 without a penalty.
    threshold: Vec<f64>,
    penalty: f64,
    /// Factor from nats to bit/s.
    bps_per_nat: f64,
}

/// Derivative of a utility by amplitude; below the minimum rate, the slope of the line to the
/// utility at `threshold`.
///
/// The derivative itself is 0 at amplitude 0, where the penalty would have no effect.
#[inline]
pub(crate) fn slope(min_nats: f64, threshold: f64, penalty: f64, amplitude: f64) -> f64 {
    let short = threshold - amplitude;
    if short > 1e-9 {
        return (1.0 + penalty) * (min_nats - Utility::nats(amplitude)) / short;
    }
    2.0 * amplitude / (1.0 + amplitude * amplitude)
}

impl Utility {
    pub(super) fn new(users: usize) -> Self {
        Self { min_nats: vec![0.0; users], threshold: vec![0.0; users], penalty: 0.0, bps_per_nat: 0.0 }
    }

    /// Changes the number of users.
    pub(super) fn resize(&mut self, users: usize) {
        self.min_nats.resize(users, 0.0);
        self.threshold.resize(users, 0.0);
    }

    /// Loads scales and minimum rates.
    pub(super) fn load(&mut self, problem: &Problem) {
        self.bps_per_nat = problem.rate_scale_bps * std::f64::consts::LOG2_E;
        self.penalty = if problem.qos_penalty > 0.0 { problem.qos_penalty } else { 0.0 };
        for (k, (min_nats, threshold)) in self.min_nats.iter_mut().zip(&mut self.threshold).enumerate() {
            let min_rate_bps = problem.min_rate_bps.get(k).copied().unwrap_or(0.0);
            let penalised = self.penalty > 0.0 && min_rate_bps > 0.0;
            *min_nats = if penalised { min_rate_bps / self.bps_per_nat } else { 0.0 };
            *threshold = min_nats.exp_m1().sqrt();
        }
    }

    /// Rate at an amplitude in nats, without penalty.
    fn nats(amplitude: f64) -> f64 {
        (amplitude * amplitude).ln_1p()
    }

    /// Utility of user k in nats.
    pub(super) fn value(&self, k: usize, amplitude: f64) -> f64 {
        let nats = Self::nats(amplitude);
        nats - self.penalty * (self.min_nats[k] - nats).max(0.0)
    }

    /// Ratio of the slopes of utility and rate of user k.
    #[inline]
    pub(super) fn steepness(&self, k: usize, amplitude: f64) -> f64 {
        if amplitude < self.threshold[k] { 1.0 + self.penalty } else { 1.0 }
    }

    /// Derivative of the utility of user k by amplitude: see [`slope`].
    #[inline]
    pub(super) fn slope(&self, k: usize, amplitude: f64) -> f64 {
        slope(self.min_nats[k], self.threshold[k], self.penalty, amplitude)
    }

    /// exp of the change in the utility of user k from one amplitude to another, given 1 / (1 +
    /// from^2).
    ///
    /// While the minimum rate is met, this is a quotient without logarithms.
    #[inline]
    pub(super) fn factor(&self, k: usize, from: f64, inverse: f64, to: f64) -> f64 {
        if from.min(to) >= self.threshold[k] {
            return (1.0 + to * to) * inverse;
        }
        self.factor_across(k, from, to)
    }

    fn factor_across(&self, k: usize, from: f64, to: f64) -> f64 {
        let at_threshold = 1.0 + self.threshold[k] * self.threshold[k];
        let (before, after) = (1.0 + from * from, 1.0 + to * to);
        let below = after.min(at_threshold) / before.min(at_threshold);
        let above = after.max(at_threshold) / before.max(at_threshold);
        power(below, 1.0 + self.penalty) * above
    }

    /// exp of a concave substitute for the utility, for the greedy fill.
    ///
    /// 1 + x^2 from x = 2 on, and 5 x^2 / 4 below, with a logarithm of unbounded slope at 0. The
    /// true utility is flat at 0, so a greedy fill by it would never serve a user without a
    /// line-of-sight path.
    #[inline]
    pub(super) fn fill_utility(&self, k: usize, amplitude: f64) -> f64 {
        let squared = amplitude * amplitude;
        let value = if amplitude < 2.0 { 1.25 * squared.max(0.0025) } else { 1.0 + squared };
        if amplitude < self.threshold[k] { value * self.shortfall(k, amplitude) } else { value }
    }

    fn shortfall(&self, k: usize, amplitude: f64) -> f64 {
        // At most 200 nats, so that the power stays far from underflow.
        let penalty = self.penalty.min((200.0 / self.min_nats[k]).floor());
        power((1.0 + amplitude * amplitude) / (1.0 + self.threshold[k] * self.threshold[k]), penalty)
    }

    /// Sum of utilities in nats.
    pub(super) fn total(&self, amplitude: &[f64]) -> f64 {
        amplitude.iter().enumerate().map(|(k, &x)| self.value(k, x)).sum()
    }

    /// Sum of utilities in bit/s.
    pub(super) fn objective_bps(&self, amplitude: &[f64]) -> f64 {
        self.total(amplitude) * self.bps_per_nat
    }

    /// Sum of rates in bit/s, without penalties.
    pub(super) fn sum_rate_bps(&self, amplitude: &[f64]) -> f64 {
        amplitude.iter().map(|&x| Self::nats(x)).sum::<f64>() * self.bps_per_nat
    }

    /// Whether any minimum rate is penalised.
    pub(super) fn penalised(&self) -> bool {
        self.threshold.iter().any(|&threshold| threshold > 0.0)
    }
}

/// base^exponent, by multiplications for a small integer exponent, which a penalty usually is.
#[inline]
fn power(base: f64, exponent: f64) -> f64 {
    let integer = exponent as i32;
    if f64::from(integer) == exponent && integer <= 64 { base.powi(integer) } else { base.powf(exponent) }
}

/// Gains times the amplitude scale, by mirror and by user.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    pub(super) users: usize,
    pub(super) mirrors: usize,
    /// Line-of-sight amplitude of each user.
    pub(super) los_amplitude: Vec<f64>,
    /// `[m * users + k]`, for moves of one mirror.
    pub(super) by_mirror: Vec<f64>,
    /// `[k * mirrors + m]`, for the sums of a complete assignment.
    pub(super) by_user: Vec<f64>,
    /// Mirrors that reach at least one user; the others cannot change a rate.
    pub(super) useful: Vec<usize>,
    /// Largest gain to each user, over all aims.
    pub(super) largest: Vec<f64>,
    /// Gains to users at whom a mirror is not aimed.
    pub(super) spill: SpillTable,
}

impl Table {
    pub(super) fn new(users: usize, mirrors: usize) -> Self {
        Self {
            users,
            mirrors,
            los_amplitude: vec![0.0; users],
            by_mirror: vec![0.0; users * mirrors],
            by_user: vec![0.0; users * mirrors],
            useful: Vec::with_capacity(mirrors),
            largest: vec![0.0; users],
            spill: SpillTable::new(users, mirrors),
        }
    }

    /// Writes w_k = 1 / sum_m a_km: weights that do not prefer users with large gains.
    pub(super) fn neutral_weights(&self, weights: &mut [f64]) {
        for (weight, line) in weights.iter_mut().zip(self.by_user.chunks_exact(self.mirrors)) {
            let sum: f64 = line.iter().sum();
            *weight = if sum > 0.0 { 1.0 / sum } else { 0.0 };
        }
    }

    /// Changes the number of users; the entries are undefined until the next load.
    pub(super) fn resize(&mut self, users: usize) {
        self.users = users;
        self.los_amplitude.resize(users, 0.0);
        self.largest.resize(users, 0.0);
        self.by_mirror.resize(users * self.mirrors, 0.0);
        self.by_user.resize(users * self.mirrors, 0.0);
    }

    /// Loads the gains of the problem; a gain that is negative or not finite counts as 0.
    pub(super) fn load(&mut self, problem: &Problem) {
        let scale = problem.amplitude_scale;
        for (los_amplitude, &gain) in self.los_amplitude.iter_mut().zip(problem.los_gain) {
            *los_amplitude = amplitude(gain, scale);
        }
        for (k, (line, source)) in self
            .by_user
            .chunks_exact_mut(self.mirrors)
            .zip(problem.steering_gain.chunks_exact(self.mirrors))
            .enumerate()
        {
            let mut largest = 0.0_f64;
            for (m, (cell, &gain)) in line.iter_mut().zip(source).enumerate() {
                *cell = amplitude(gain, scale);
                largest = largest.max(*cell);
                self.by_mirror[m * self.users + k] = *cell;
            }
            self.largest[k] = largest;
        }
        self.spill.load(problem.spill, (self.users, self.mirrors), |gain| amplitude(gain, scale));
        for &(k, spilled) in self.spill.entries() {
            self.largest[k] = self.largest[k].max(spilled);
        }
        self.useful.clear();
        let lines = self.by_mirror.chunks_exact(self.users).enumerate();
        self.useful.extend(lines.filter(|(_, line)| line.iter().any(|&gain| gain > 0.0)).map(|(m, _)| m));
    }

    /// Amplitudes of mirror m, one per user.
    #[inline]
    pub(super) fn line(&self, m: usize) -> &[f64] {
        &self.by_mirror[m * self.users..(m + 1) * self.users]
    }

    /// Amplitude of user k by mirror m at an aim.
    #[inline]
    pub(super) fn gain_of_aim(&self, m: usize, aim: usize, k: usize) -> f64 {
        if aim == k {
            return self.line(m)[k];
        }
        self.spill.of(aim, m).iter().find(|(user, _)| *user == k).map_or(0.0, |(_, gain)| *gain)
    }

    /// The users that mirror m reaches at an aim, and their amplitudes; first the user that is the
    /// aim.
    #[inline]
    pub(super) fn aim(&self, m: usize, aim: usize) -> impl Iterator<Item = (usize, f64)> {
        let own = (aim < self.users).then(|| (aim, self.line(m)[aim]));
        own.into_iter().chain(self.spill.of(aim, m).iter().copied())
    }

    /// All aims of mirror m that reach a user: users, then midpoints.
    #[inline]
    pub(super) fn aims(&self, m: usize) -> impl Iterator<Item = usize> {
        let users = (0..self.users).filter(move |k| self.line(m)[*k] > 0.0 || !self.spill.of(*k, m).is_empty());
        users.chain(self.spill.midpoints_of(m).map(|(aim, _)| aim))
    }
}

fn amplitude(gain: f64, scale: f64) -> f64 {
    let amplitude = gain * scale;
    if amplitude > 0.0 && amplitude.is_finite() { amplitude.min(AMPLITUDE_MAX) } else { 0.0 }
}
