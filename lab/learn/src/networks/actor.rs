//! The actor of the learners with one weight per user: from the state of a room to one action u_k
//! in [-1, 1] per user.
//!
//! The network reads three inputs per user: the features, an action and an amplitude. The action is
//! zero, and the amplitude is that of the balanced weights. The critic reads the same inputs with
//! the actions of the actor.
//!
//! The amplitude comes from a smooth decoder. Its soft assignment of mirror m to user k is
//! proportional to (w_k a_km)^8; the true decoder assigns the mirror to the user with the largest
//! w_k a_km. The smooth decoder has a gradient, and rounding cannot move a mirror from one user to
//! another. [`crate::environment::features`] defines the terms.

use candle_core::{Device, Result, Tensor};
use heliostat_channel::{MirrorAngles, sharing};
use heliostat_core::policy::weights::Seen;
use rand::Rng;

use super::layers::{Encoder, Network, Shape};
use crate::environment::features::{
    BaselineWeight, FEATURES, Head, LOG_BALANCED, LOG_DIRECT, LOG_WEIGHT, Layout, WEIGHT_SCALE,
};
use crate::environment::room::Environment;

/// Inputs of the actor's network per user: the features, the action of the round before, and ln(1 +
/// amplitude).
pub const ACTOR_INPUTS: usize = FEATURES + 2;

/// Widths of the hidden layers, as in the paper.
pub const HIDDEN: [usize; 2] = [128, 64];

/// Number of squarings that raise b_k a_km to the power [`EXPONENT`].
pub const SQUARINGS: u32 = sharing::EXPONENT.ilog2();

/// The exponent of the smooth decoder.
pub const EXPONENT: f32 = sharing::EXPONENT as f32;

/// Added to sums over users, so that quotients and logarithms stay finite for mirrors that reach no
/// user; far below the values of mirrors that do.
pub const POWER_FLOOR: f32 = 1e-20;

/// States of rooms, as tensors.
#[derive(Clone, Debug)]
pub struct States {
    /// (batch, slots, [`FEATURES`])
    pub features: Tensor,
    /// 1 for a present user, 0 in an empty slot; (batch, slots).
    pub present: Tensor,
    /// Direct amplitude, (batch, slots, 1).
    direct: Tensor,
    /// (b_k a_km / sum_j b_j a_jm)^8 with the baseline weights b, (batch, slots, mirrors).
    powers: Tensor,
    /// The powers times a_km.
    gains: Tensor,
}

impl States {
    /// Length of the row of one state: features of all slots, then steering amplitudes of all
    /// slots.
    pub fn width(layout: Layout) -> usize {
        layout.slots() * (FEATURES + layout.encoder.mirrors())
    }

    /// The row of the state that an observation vector describes.
    pub fn row(layout: Layout, vector: &[f32]) -> Vec<f32> {
        let mut row = vec![0.0; Self::width(layout)];
        let (features, steering) = row.split_at_mut(layout.slots() * FEATURES);
        layout.features(vector, features);
        steering.copy_from_slice(&vector[layout.encoder.steering_amplitude()]);
        row
    }

    /// States from rows.
    ///
    /// # Errors
    /// Errors of candle, when the length is not `batch` rows.
    pub fn new(rows: Vec<f32>, batch: usize, layout: Layout, baseline_weight: BaselineWeight) -> Result<Self> {
        let (slots, mirrors) = (layout.slots(), layout.encoder.mirrors());
        let rows = Tensor::from_vec(rows, (batch, Self::width(layout)), &Device::Cpu)?;
        let features = rows.narrow(1, 0, slots * FEATURES)?.reshape((batch, slots, FEATURES))?;
        let steering = rows.narrow(1, slots * FEATURES, slots * mirrors)?.reshape((batch, slots, mirrors))?;
        let column = |index| features.narrow(2, index, 1)?.contiguous();
        let weighted = match baseline_weight {
            BaselineWeight::Uniform => steering.clone(),
            BaselineWeight::Balanced => {
                steering.broadcast_mul(&(column(LOG_WEIGHT)? / f64::from(WEIGHT_SCALE))?.exp()?)?
            }
        };
        let mut powers = weighted.broadcast_div(&(weighted.sum_keepdim(1)? + f64::from(POWER_FLOOR))?)?;
        for _ in 0..SQUARINGS {
            powers = powers.sqr()?;
        }
        Ok(Self {
            present: column(0)?.squeeze(2)?,
            direct: (column(LOG_DIRECT)?.exp()? - 1.0)?,
            gains: (&powers * &steering)?,
            powers,
            features,
        })
    }

    /// ln(1 + amplitude) of each user with the balanced weights, (batch, slots).
    ///
    /// # Errors
    /// Errors of candle.
    pub fn balanced(&self) -> Result<Tensor> {
        self.features.narrow(2, LOG_BALANCED, 1)?.squeeze(2)
    }

    /// The features with further columns of (batch, slots) each: a network's input of (batch,
    /// slots, [`FEATURES`] + columns).
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn with_columns(&self, columns: &[&Tensor]) -> Result<Tensor> {
        let mut parts = vec![self.features.clone()];
        for column in columns {
            parts.push(column.unsqueeze(2)?);
        }
        Tensor::cat(&parts, 2)
    }

    /// The input of the first round, [`ACTOR_INPUTS`] values per user.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn first_round(&self) -> Result<Tensor> {
        self.with_columns(&[&self.present.zeros_like()?, &self.balanced()?])
    }

    /// The mean of values over the present users: (batch, slots) to (batch).
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn mean_present(&self, values: &Tensor) -> Result<Tensor> {
        mean_present(values, &self.present)
    }

    /// ln(1 + amplitude) of each user under these actions by the smooth decoder, (batch, slots).
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn amplitude(&self, actions: &Tensor, range: f32) -> Result<Tensor> {
        let weight = (actions * f64::from(EXPONENT * range))?.exp()?.mul(&self.present)?;
        // (w_k a_km)^8 is the product of exp(8 c u_k) and the power with the baseline weight. The
        // large table of powers is computed once for all actions.
        let total = (weight.unsqueeze(1)?.matmul(&self.powers)? + f64::from(POWER_FLOOR))?;
        // Through the logarithm: the gradient of a quotient squares its divisor, which underflows
        // in f32.
        let inverse = total.log()?.neg()?.exp()?.transpose(1, 2)?.contiguous()?;
        let given = self.gains.matmul(&inverse)?.mul(&weight.unsqueeze(2)?)?;
        ((&self.direct + given)? + 1.0)?.log()?.squeeze(2)
    }
}

/// An actor's network with the constants of the decoder.
#[derive(Clone, Debug)]
pub struct Actor {
    /// Its network.
    pub network: Network,
    /// The layout of its observation vector.
    pub layout: Layout,
    /// The map from its actions to decoder weights.
    pub head: Head,
}

impl Actor {
    /// An actor with newly drawn parameters, of the paper's hidden widths.
    ///
    /// # Errors
    /// Errors of candle, when memory runs out.
    pub fn new(layout: Layout, encoder: Encoder, head: Head, rng: &mut impl Rng) -> Result<Self> {
        let slots = layout.slots();
        let shape = Shape { encoder, slots, inputs: ACTOR_INPUTS, hidden: HIDDEN, outputs: slots };
        Ok(Self { network: Network::new(shape, rng)?, layout, head })
    }

    /// Actions in [-1, 1], (batch, slots); zero in empty slots.
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn forward(&self, states: &States) -> Result<Tensor> {
        self.raw(states)?.tanh()?.mul(&states.present)
    }

    /// Outputs before tanh, (batch, slots), without meaning in empty slots.
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn raw(&self, states: &States) -> Result<Tensor> {
        self.network.forward(&states.first_round()?)
    }

    /// One action per slot, from the row of one state.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn actions(&self, state: &[f32]) -> Result<Vec<f32>> {
        let states = States::new(state.to_vec(), 1, self.layout, self.head.baseline_weight)?;
        self.forward(&states)?.squeeze(0)?.to_vec1()
    }

    /// The mirror angles for the present observation of a room.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn act(&self, environment: &Environment) -> anyhow::Result<MirrorAngles> {
        let actions = self.actions(&States::row(self.layout, environment.vector()))?;
        Ok(self.decode(environment, &actions))
    }

    /// The mirror angles that the decoder gives for these actions in a room.
    pub fn decode(&self, environment: &Environment, actions: &[f32]) -> MirrorAngles {
        let observation = environment.observation();
        let chosen: Vec<usize> = (0..observation.users()).collect();
        let (encoder, vector) = (self.layout.encoder, environment.vector());
        let seen = Seen { observation, chosen: &chosen, encoder, vector };
        let mut angles = MirrorAngles::flat(observation.mirrors());
        self.head.decode(environment.model(), seen, actions, &mut Vec::new(), &mut angles);
        angles
    }

    /// A copy with its own network.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn copy(&self) -> Result<Self> {
        Ok(Self { network: self.network.copy()?, ..self.clone() })
    }
}

/// The mean of values over the present users: (batch, slots) to (batch). `present` is 1 for a
/// present user, and else 0.
///
/// # Errors
/// Errors of candle, when shapes differ.
pub fn mean_present(values: &Tensor, present: &Tensor) -> Result<Tensor> {
    values.mul(present)?.sum(1)?.div(&present.sum(1)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Var;
    use heliostat_core::observation::ObservationEncoder;

    /// Logarithms of the balanced weights of the three users.
    const LOG_WEIGHTS: [f64; 3] = [0.5, 0.25, 2.75];

    /// Three users, the last slot empty, and four mirrors of which the last reaches no user.
    fn states() -> States {
        let layout = Layout { encoder: ObservationEncoder::new(4, 4), half_room_m: [2.5, 2.5] };
        let mut row = vec![0.0; States::width(layout)];
        for slot in 0..3 {
            row[slot * FEATURES] = 1.0;
            row[slot * FEATURES + LOG_DIRECT] = 0.5 * slot as f32;
            row[slot * FEATURES + LOG_WEIGHT] = WEIGHT_SCALE * LOG_WEIGHTS[slot] as f32;
        }
        let steering = [[0.30, 0.20, 0.10, 0.0], [0.21, 0.33, 0.25, 0.0], [0.02, 0.015, 0.03, 0.0]];
        row[4 * FEATURES..][..12].copy_from_slice(steering.as_flattened());
        States::new(row, 1, layout, BaselineWeight::Balanced).expect("a state")
    }

    #[test]
    fn a_user_without_steering_amplitude_takes_nothing_from_the_others() {
        let layout = Layout { encoder: ObservationEncoder::new(2, 1), half_room_m: [2.5, 2.5] };
        let mut row = vec![0.0; States::width(layout)];
        (row[0], row[FEATURES]) = (1.0, 1.0);
        for faint in [0.0, 1e-5] {
            row[2 * FEATURES..].copy_from_slice(&[0.4, faint]);
            let states = States::new(row.clone(), 1, layout, BaselineWeight::Uniform).expect("a state");
            let actions = Tensor::from_slice(&[-1.0_f32, 1.0], (1, 2), &Device::Cpu).expect("actions");
            let found = states.amplitude(&actions, 0.5).and_then(|found| found.to_vec2::<f32>()).expect("amplitudes");
            assert!((found[0][0] - 1.4_f32.ln()).abs() < 1e-6, "{found:?}");
        }
    }

    /// The amplitude by its definition, in f64.
    fn expected(actions: [f64; 3]) -> [f64; 3] {
        let steering = [[0.30_f64, 0.20, 0.10], [0.21, 0.33, 0.25], [0.02, 0.015, 0.03]];
        let weight = |user: usize| (2.0 * actions[user] + LOG_WEIGHTS[user]).exp();
        let power = |user: usize, mirror: usize| (weight(user) * steering[user][mirror]).powi(8);
        [0, 1, 2].map(|user| {
            let given = |mirror| {
                let total: f64 = (0..3).map(|other| power(other, mirror)).sum();
                steering[user][mirror] * power(user, mirror) / total
            };
            let direct = (0.5 * user as f64).exp() - 1.0;
            (1.0 + direct + (0..3).map(given).sum::<f64>()).ln()
        })
    }

    #[test]
    fn the_smooth_decoder_matches_its_definition() {
        let actions = [0.1_f32, -0.2, 0.3, 0.0];
        let tensor = Tensor::from_slice(&actions, (1, 4), &Device::Cpu).expect("actions");
        let found = states().amplitude(&tensor, 2.0).and_then(|found| found.squeeze(0)?.to_vec1::<f32>());
        let found = found.expect("amplitudes");
        for (user, expected) in expected([0.1, -0.2, 0.3]).into_iter().enumerate() {
            assert!((f64::from(found[user]) - expected).abs() < 1e-5, "user {user}: {} for {expected}", found[user]);
        }
        assert_eq!(found[3], 0.0);
    }

    #[test]
    fn the_gradient_matches_finite_differences_of_the_definition() {
        let actions = [0.1_f64, -0.2, 0.3];
        let variable = Var::from_slice(&[0.1_f32, -0.2, 0.3, 0.0], (1, 4), &Device::Cpu).expect("actions");
        let amplitude = states().amplitude(&variable, 2.0).expect("amplitudes");
        for user in 0..3 {
            let one = amplitude.narrow(1, user, 1).and_then(|one| one.sum_all()).expect("one amplitude");
            let gradients = one.backward().expect("gradients");
            let found = gradients.get(&variable).expect("its gradient").to_vec2::<f32>().expect("a matrix");
            for other in 0..3 {
                let moved = |by: f64| {
                    let mut moved = actions;
                    moved[other] += by;
                    expected(moved)[user]
                };
                let expected = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                let found = f64::from(found[0][other]);
                assert!((found - expected).abs() < 1e-4, "user {user} by action {other}: {found} for {expected}");
            }
        }
    }
}
