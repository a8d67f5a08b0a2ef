//! What users get when each mirror is shared among them, and the weights that balance them: a smooth stand-in for decoder and solver.
//!
//! [`decode`](crate::decode::decode) gives mirror m to the user with the largest w_k a_km. Here user k has the share (w_k a_km)^8 / sum_j (w_j a_jm)^8 of it, which
//! is nearly the same and has no jumps: what a few such steps find says to a policy where an optimum lies, though not what it is.

use crate::solver::slope;
use crate::trig::BLOCK;
use crate::wide::widest;

/// The exponent of a claim.
pub const EXPONENT: u32 = 8;

/// Steps of [`balance`]; each brings weights as much nearer to their aim as this says.
const STEPS: [f32; 4] = [0.4, 0.4 / 1.5, 0.2, 0.16];

/// Lambda of the utility whose derivative weights are to be.
const QOS_PENALTY: f64 = 10.0;

/// A user with less amplitude pulls as if it were this much: at zero the rate has no slope, and nobody would leave the dark.
const FAINT: f32 = 1e-3;

/// Amplitude of each user: that of the direct path and the user's shares of all mirrors.
///
/// `steering`: what each mirror gives each user when it is aimed there, a_km. Shape: K * M, index k * M + m. `weights`: w_k, positive. `direct`, `out`: K.
/// All are dimensionless, amplitudes such that their square is an SNR. Nobody has a share of a mirror that reaches nobody.
///
/// # Panics
/// When the slices differ in their number of users.
pub fn amplitudes(steering: &[f32], direct: &[f32], weights: &[f32], out: &mut [f32]) {
    assert_eq!([weights.len(), out.len()], [direct.len(); 2], "one weight and one amplitude a user");
    out.copy_from_slice(direct);
    if direct.is_empty() {
        return;
    }
    assert_eq!(steering.len() % direct.len(), 0, "one amplitude a user and mirror");
    widest(
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

/// Adds the shares of a block of mirrors, of which `steering` gives what they can do for a user.
#[inline(always)]
fn share_block(weights: &[f32], out: &mut [f32], steering: impl Fn(usize) -> [f32; BLOCK]) {
    // So that no mirror divides by zero that reaches nobody.
    let mut largest = [f32::MIN_POSITIVE; BLOCK];
    for (user, weight) in weights.iter().enumerate() {
        let block = steering(user);
        for lane in 0..BLOCK {
            let claim = weight * block[lane];
            largest[lane] = if claim > largest[lane] { claim } else { largest[lane] };
        }
    }
    // Claims relative to the largest, so that their powers neither vanish together nor overflow.
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
fn power(claim: f32) -> f32 {
    let mut power = claim;
    for _ in 0..EXPONENT.ilog2() {
        power *= power;
    }
    power
}

/// Brings weights nearer to the condition of an optimum, that each be the derivative of its user's utility by the user's amplitude:
/// w <- w^(1 - c) u'(x)^c, four times, with c from 0.4 to 0.16.
///
/// The utility is that of [`crate::solver`], with lambda 10; a larger one throws weights to and fro. `needs`: minimum rates in bit/s/Hz of a user's band. Shape: K, as of
/// `amplitudes`, which are those of the weights, before and after. The rest: see [`amplitudes`].
///
/// # Panics
/// When the slices differ in their number of users.
pub fn balance(steering: &[f32], direct: &[f32], needs: &[f32], weights: &mut [f32], amplitudes: &mut [f32]) {
    assert_eq!(needs.len(), direct.len(), "one need a user");
    for step in STEPS {
        for ((weight, amplitude), need) in weights.iter_mut().zip(&*amplitudes).zip(needs) {
            let need = f64::from(*need) * std::f64::consts::LN_2;
            let aim = slope(need, need.exp_m1().sqrt(), QOS_PENALTY, f64::from(amplitude.max(FAINT)));
            *weight = weight.powf(1.0 - step) * (aim as f32).powf(step);
        }
        self::amplitudes(steering, direct, weights, amplitudes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mirror_is_shared_by_the_eighth_power_of_what_is_claimed() {
        // Two users; the first mirror is worth as much to both, the second twice as much to the second, the third nothing to anybody.
        let steering = [1.0, 1.0, 0.0, 1.0, 2.0, 0.0];
        let mut out = [0.0; 2];
        amplitudes(&steering, &[10.0, 20.0], &[3.0, 3.0], &mut out);
        let wanted = [10.0 + 0.5 + 1.0 / 257.0, 20.0 + 0.5 + 2.0 * 256.0 / 257.0];
        out.iter().zip(wanted).for_each(|(found, wanted)| assert!((found - wanted).abs() < 1e-5, "{found}, {wanted}"));
        // Twice the weight claims as much as twice the light.
        amplitudes(&steering[..1].repeat(2), &[0.0; 2], &[2.0, 1.0], &mut out);
        assert!((out[0] - 256.0 / 257.0).abs() < 1e-6, "{out:?}");
    }

    #[test]
    fn claims_of_any_size_are_shared() {
        for size in [1e-30, 1e-8, 1e8, 1e25] {
            let mut out = [0.0; 2];
            amplitudes(&[1.0; 40], &[0.0; 2], &[size, size], &mut out);
            assert!(out.iter().all(|amplitude| (amplitude - 10.0).abs() < 1e-4), "weights of {size}: {out:?}");
        }
    }

    /// Two users at the ends of an array of 64 mirrors, the second of whom gets a thirtieth of what the first gets.
    fn steering() -> Vec<f32> {
        let near = |m: usize| 1.0 + 0.05 * m as f32;
        (0..64).map(near).chain((0..64).map(|m| 0.03 * near(63 - m))).collect()
    }

    /// Weights of equal shares, what they give, and the same after balancing for these needs.
    fn balanced(needs: [f32; 2]) -> [([f32; 2], [f32; 2]); 2] {
        let (steering, direct) = (steering(), [0.0; 2]);
        let (mut weights, mut found) = ([1.0, 1.0 / 0.03], [0.0; 2]);
        amplitudes(&steering, &direct, &weights, &mut found);
        let before = (weights, found);
        balance(&steering, &direct, &needs, &mut weights, &mut found);
        let mut again = [0.0; 2];
        amplitudes(&steering, &direct, &weights, &mut again);
        assert_eq!(found, again, "they are the amplitudes of the weights");
        [before, (weights, found)]
    }

    #[test]
    fn without_needs_balanced_weights_are_nearly_derivatives_of_the_rate() {
        let unrest = |(weights, amplitudes): ([f32; 2], [f32; 2])| {
            let aim = amplitudes.map(|amplitude| slope(0.0, 0.0, QOS_PENALTY, f64::from(amplitude)));
            (f64::from(weights[0] / weights[1]).ln() - (aim[0] / aim[1]).ln()).abs()
        };
        let [before, after] = balanced([0.0; 2]).map(unrest);
        assert!(after < 0.3 * before, "{after} for {before}");
    }

    #[test]
    fn who_is_short_of_a_need_is_given_more() {
        let [(_, before), (_, after)] = balanced([0.0, 4.5]);
        assert!((before[1] * before[1]).ln_1p() < 4.5 * std::f32::consts::LN_2, "short before: {before:?}");
        assert!(after[1] > 1.05 * before[1] && after[0] < before[0], "{after:?} for {before:?}");
    }
}
