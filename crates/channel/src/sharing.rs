//! A smooth approximation of decoder and solver, in which the users share each mirror.
//!
//! [`decode`](crate::decode::decode) assigns mirror m to user argmax_k w_k a_km. The soft assignment
//! here is (w_k a_km)^8 / sum_j (w_j a_jm)^8: the fraction of the mirror's light that user k
//! receives. It is continuous in the weights. A few steps of [`balance`] give a policy the
//! approximate weights of an optimum.
//!
//! ```
//! use heliostat_channel::sharing;
//!
//! // One mirror with equal gain for both users: equal weights give each user half of it.
//! let (steering, direct) = ([2.0, 2.0], [0.0, 1.0]);
//! let mut amplitudes = [0.0; 2];
//! sharing::amplitudes(&steering, &direct, &[1.0, 1.0], &mut amplitudes);
//! assert!((amplitudes[0] - 1.0).abs() < 1e-6 && (amplitudes[1] - 2.0).abs() < 1e-6);
//! ```

use crate::simd::with_widest_simd;
use crate::solver::slope;
use crate::trig::BLOCK;

/// Exponent of the weighted gain in a soft assignment.
pub const EXPONENT: u32 = 8;

/// Step sizes c of [`balance`].
pub const STEPS: [f32; 4] = [0.4, 0.4 / 1.5, 0.2, 0.16];

/// Lambda of the utility whose derivatives are the target weights.
pub const QOS_PENALTY: f64 = 10.0;

/// Lower bound of an amplitude in the derivative, since at amplitude 0 the derivative of the rate
/// is 0.
pub const AMPLITUDE_MIN: f32 = 1e-3;

/// Amplitude of each user: the line-of-sight amplitude plus the softly assigned amplitudes of all
/// mirrors.
///
/// x_k = l_k + sum_m a_km (w_k a_km)^8 / sum_j (w_j a_jm)^8. A mirror with a_jm = 0 for all users
/// adds nothing.
///
/// `steering`: a_km, the amplitude of user k when mirror m is aimed at it. Shape: K * M, index k *
/// M + m. `direct`: l_k. `weights`: w_k, positive. `out`: x_k. Shape of these three: K. All are
/// dimensionless; the square of an amplitude is an SINR times e/(2 pi).
///
/// # Panics
/// When the slices differ in their number of users.
pub fn amplitudes(steering: &[f32], direct: &[f32], weights: &[f32], out: &mut [f32]) {
    assert_eq!([weights.len(), out.len()], [direct.len(); 2], "one weight and one amplitude per user");
    out.copy_from_slice(direct);
    if direct.is_empty() {
        return;
    }
    assert_eq!(steering.len() % direct.len(), 0, "one amplitude per user and mirror");
    with_widest_simd(
        #[inline(always)]
        || {
            let mirrors = steering.len() / direct.len();
            let rest = mirrors - mirrors % BLOCK;
            for first in (0..rest).step_by(BLOCK) {
                share_block(
                    weights,
                    out,
                    #[inline(always)]
                    |user| *steering[user * mirrors + first..].first_chunk().expect("a full block"),
                );
            }
            if rest < mirrors {
                share_block(
                    weights,
                    out,
                    #[inline(always)]
                    |user| {
                        let mut block = [0.0; BLOCK];
                        block[..mirrors - rest].copy_from_slice(&steering[user * mirrors + rest..][..mirrors - rest]);
                        block
                    },
                );
            }
        },
    );
}

/// Adds the amplitudes of a block of mirrors; `steering` returns a user's amplitudes for the block.
#[inline(always)]
fn share_block(weights: &[f32], out: &mut [f32], steering: impl Fn(usize) -> [f32; BLOCK]) {
    // Avoids a division by zero for a mirror that reaches no user.
    let mut largest = [f32::MIN_POSITIVE; BLOCK];
    for (user, weight) in weights.iter().enumerate() {
        let block = steering(user);
        for lane in 0..BLOCK {
            let weighted = weight * block[lane];
            largest[lane] = if weighted > largest[lane] { weighted } else { largest[lane] };
        }
    }
    // Relative to the largest weighted gain, so that the powers neither underflow nor overflow.
    let scale = largest.map(|largest| 1.0 / largest);
    let mut all = [f32::MIN_POSITIVE; BLOCK];
    for (user, weight) in weights.iter().enumerate() {
        let block = steering(user);
        for lane in 0..BLOCK {
            all[lane] += power(weight * block[lane] * scale[lane]);
        }
    }
    let share = all.map(|all| 1.0 / all);
    for (user, (weight, out)) in weights.iter().zip(out).enumerate() {
        let block = steering(user);
        let mut given = [0.0; BLOCK];
        for lane in 0..BLOCK {
            given[lane] = block[lane] * power(weight * block[lane] * scale[lane]) * share[lane];
        }
        *out += given.iter().sum::<f32>();
    }
}

#[inline(always)]
fn power(base: f32) -> f32 {
    let mut power = base;
    for _ in 0..EXPONENT.ilog2() {
        power *= power;
    }
    power
}

/// Moves weights towards the condition of an optimum: each weight equals the derivative of its
/// user's utility.
///
/// w <- w^(1 - c) u'(x)^c, four times, with c from 0.4 to 0.16 and the utility u of
/// [`crate::solver`] with lambda = 10. With a larger lambda the weights oscillate.
///
/// `min_rates`: minimum rates in bit/s per Hz of a user's band. `amplitudes`: those of `weights`,
/// on entry and on return. Shape of both: K. The other arguments are those of [`amplitudes`].
///
/// # Panics
/// When the slices differ in their number of users.
pub fn balance(steering: &[f32], direct: &[f32], min_rates: &[f32], weights: &mut [f32], amplitudes: &mut [f32]) {
    assert_eq!(min_rates.len(), direct.len(), "one minimum rate per user");
    for step in STEPS {
        for ((weight, amplitude), min_rate) in weights.iter_mut().zip(&*amplitudes).zip(min_rates) {
            let min_nats = f64::from(*min_rate) * std::f64::consts::LN_2;
            let target =
                slope(min_nats, min_nats.exp_m1().sqrt(), QOS_PENALTY, f64::from(amplitude.max(AMPLITUDE_MIN)));
            *weight = weight.powf(1.0 - step) * (target as f32).powf(step);
        }
        self::amplitudes(steering, direct, weights, amplitudes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mirror_is_shared_by_the_eighth_power_of_the_weighted_gains() {
        // Two users: equal gains of the first mirror, twice the gain for the second user of the
        // second, none of the third.
        let steering = [1.0, 1.0, 0.0, 1.0, 2.0, 0.0];
        let mut out = [0.0; 2];
        amplitudes(&steering, &[10.0, 20.0], &[3.0, 3.0], &mut out);
        let expected = [10.0 + 0.5 + 1.0 / 257.0, 20.0 + 0.5 + 2.0 * 256.0 / 257.0];
        for (found, expected) in out.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-5, "{found}, {expected}");
        }
        // Twice the weight has the effect of twice the gain.
        amplitudes(&steering[..1].repeat(2), &[0.0; 2], &[2.0, 1.0], &mut out);
        assert!((out[0] - 256.0 / 257.0).abs() < 1e-6, "{out:?}");
    }

    #[test]
    fn weights_of_any_magnitude_are_shared() {
        for size in [1e-30, 1e-8, 1e8, 1e25] {
            let mut out = [0.0; 2];
            amplitudes(&[1.0; 40], &[0.0; 2], &[size, size], &mut out);
            assert!(out.iter().all(|amplitude| (amplitude - 10.0).abs() < 1e-4), "weights of {size}: {out:?}");
        }
    }

    /// Two users at the ends of an array of 64 mirrors; the gains of the second are about one
    /// thirtieth of the first's.
    fn steering() -> Vec<f32> {
        let near = |m: usize| 1.0 + 0.05 * m as f32;
        (0..64).map(near).chain((0..64).map(|m| 0.03 * near(63 - m))).collect()
    }

    /// Weights of equal shares and their amplitudes, before and after balancing for these minimum
    /// rates.
    fn balanced(min_rates: [f32; 2]) -> [([f32; 2], [f32; 2]); 2] {
        let (steering, direct) = (steering(), [0.0; 2]);
        let (mut weights, mut found) = ([1.0, 1.0 / 0.03], [0.0; 2]);
        amplitudes(&steering, &direct, &weights, &mut found);
        let before = (weights, found);
        balance(&steering, &direct, &min_rates, &mut weights, &mut found);
        let mut again = [0.0; 2];
        amplitudes(&steering, &direct, &weights, &mut again);
        assert_eq!(found, again, "the amplitudes are those of the weights");
        [before, (weights, found)]
    }

    #[test]
    fn without_minimum_rates_balanced_weights_are_nearly_derivatives_of_the_rate() {
        let imbalance = |(weights, amplitudes): ([f32; 2], [f32; 2])| {
            let target = amplitudes.map(|amplitude| slope(0.0, 0.0, QOS_PENALTY, f64::from(amplitude)));
            (f64::from(weights[0] / weights[1]).ln() - (target[0] / target[1]).ln()).abs()
        };
        let [before, after] = balanced([0.0; 2]).map(imbalance);
        assert!(after < 0.3 * before, "{after} for {before}");
    }

    #[test]
    fn a_user_below_its_minimum_rate_gets_more() {
        let [(_, before), (_, after)] = balanced([0.0, 4.5]);
        assert!(
            (before[1] * before[1]).ln_1p() < 4.5 * std::f32::consts::LN_2,
            "below the minimum rate before: {before:?}"
        );
        assert!(after[1] > 1.05 * before[1] && after[0] < before[0], "{after:?} for {before:?}");
    }
}
