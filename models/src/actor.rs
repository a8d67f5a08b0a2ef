//! The actor: from the state of a room to one logit for each user, in one or several rounds.
//!
//! In each round the network reads what is known of every user, the logit of the round before, and the amplitude that the user would
//! get under those logits; the first round starts from logits of zero. The amplitude comes from a smooth copy of the decoder: each
//! mirror is shared among the users in proportion to (w_k a_km)^8, where the true decoder gives it to the largest. Smooth, so
//! that a gradient can pass and rounding cannot flip a mirror.

use candle_core::{Device, Result, Tensor};

use crate::features::{FEATURES, Head, LOG_DIRECT, Layout, Prior, TINY};
use crate::networks::Network;

/// Inputs of the actor's network for each user: the features, the logit of the round before, and ln(1 + amplitude).
pub const ACTOR_INPUTS: usize = FEATURES + 2;

/// How often a claim is squared: the exponent 8 of the smooth decoder.
pub const SQUARINGS: usize = 3;

/// Keeps quotients finite for mirrors that no user sees; below every claim that counts, above the smallest normal number.
pub const NO_CLAIM: f32 = 1e-30;

/// States of rooms, as tensors.
#[derive(Clone, Debug)]
pub struct States {
    /// (batch, slots, [`FEATURES`])
    pub features: Tensor,
    /// Who is there, (batch, slots).
    pub present: Tensor,
    /// Sum of the steering amplitudes, (batch, slots, 1).
    total: Tensor,
    /// Direct amplitude, (batch, slots, 1).
    direct: Tensor,
    /// (a_km / sum_j a_jm)^8, (batch, slots, mirrors).
    claims: Tensor,
    /// The same times a_km.
    gains: Tensor,
}

impl States {
    /// Length of one state as a row: features of all slots, then steering amplitudes of all slots.
    pub fn width(layout: Layout) -> usize {
        layout.slots() * (FEATURES + layout.encoder.mirrors())
    }

    /// States from rows.
    ///
    /// # Errors
    /// Those of candle, when the length is not `batch` rows.
    pub fn new(rows: Vec<f32>, batch: usize, layout: Layout) -> Result<Self> {
        let (slots, mirrors) = (layout.slots(), layout.encoder.mirrors());
        let rows = Tensor::from_vec(rows, (batch, Self::width(layout)), &Device::Cpu)?;
        let features = rows.narrow(1, 0, slots * FEATURES)?.reshape((batch, slots, FEATURES))?;
        let steering = rows.narrow(1, slots * FEATURES, slots * mirrors)?.reshape((batch, slots, mirrors))?;
        let column = |index| features.narrow(2, index, 1)?.contiguous();
        let mut claims = steering.broadcast_div(&(steering.sum_keepdim(1)? + f64::from(NO_CLAIM))?)?;
        for _ in 0..SQUARINGS {
            claims = claims.sqr()?;
        }
        Ok(Self {
            present: column(0)?.squeeze(2)?,
            direct: (column(LOG_DIRECT)?.exp()? - 1.0)?,
            total: steering.sum_keepdim(2)?,
            gains: (&claims * &steering)?,
            claims,
            features,
        })
    }

    /// ln(1 + amplitude) of each user under these logits by the smooth decoder, (batch, slots).
    ///
    /// # Errors
    /// Those of candle, when shapes do not fit.
    pub fn amplitude(&self, logits: &Tensor, head: Head) -> Result<Tensor> {
        let weight = (logits * f64::from(head.range))?.exp()?.mul(&self.present)?.unsqueeze(2)?;
        let weight = match head.prior {
            Prior::Uniform => weight,
            Prior::EqualShare => (weight / (&self.total + f64::from(TINY))?)?,
        };
        // A common factor of all users changes nothing, so no gradient has to pass through their sum.
        let mut weight = weight.broadcast_div(&weight.sum_keepdim(1)?.detach())?;
        for _ in 0..SQUARINGS {
            weight = weight.sqr()?;
        }
        // The power of w_k a_km is split, so that the large tables are raised to it once for all rounds.
        let all = (weight.transpose(1, 2)?.contiguous()?.matmul(&self.claims)? + f64::from(NO_CLAIM))?;
        // By way of the logarithm: the gradient of a quotient squares its divisor, which would vanish in f32.
        let inverse = all.log()?.neg()?.exp()?.transpose(1, 2)?.contiguous()?;
        let given = self.gains.matmul(&inverse)?.mul(&weight)?;
        ((&self.direct + given)? + 1.0)?.log()?.squeeze(2)
    }
}

/// A trained or learning actor, with all that decoding needs to know.
#[derive(Clone, Debug)]
pub struct Actor {
    /// Its network.
    pub network: Network,
    /// The layout of its observation vector.
    pub layout: Layout,
    /// From its logits to weights.
    pub head: Head,
    /// How often the network is applied.
    pub rounds: usize,
}

impl Actor {
    /// Logits in [-1, 1], (batch, slots); zero in absent slots.
    ///
    /// # Errors
    /// Those of candle, when shapes do not fit.
    pub fn forward(&self, states: &States) -> Result<Tensor> {
        let mut logits = states.present.zeros_like()?;
        for _ in 0..self.rounds {
            let amplitude = states.amplitude(&logits, self.head)?.mul(&states.present)?;
            let input = Tensor::cat(&[&states.features, &logits.unsqueeze(2)?, &amplitude.unsqueeze(2)?], 2)?;
            logits = self.network.forward(&input, &states.present)?.tanh()?.mul(&states.present)?;
        }
        Ok(logits)
    }

    /// One logit for each slot from the row of one state.
    ///
    /// # Errors
    /// Those of candle.
    pub fn logits(&self, state: &[f32]) -> Result<Vec<f32>> {
        let states = States::new(state.to_vec(), 1, self.layout)?;
        self.forward(&states)?.squeeze(0)?.to_vec1()
    }

    /// The same actor with a network of its own.
    ///
    /// # Errors
    /// Those of candle.
    pub fn copy(&self) -> Result<Self> {
        Ok(Self { network: self.network.copy()?, ..self.clone() })
    }
}
