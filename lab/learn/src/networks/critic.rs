//! The critics of learners with one weight per user: the value of actions in a state.

use candle_core::{Result, Tensor};
use rand::Rng;
use serde::{Deserialize, Serialize};

use super::actor::{ACTOR_INPUTS, States};
use super::layers::{Encoder, Network, Shape};
use crate::environment::features::Layout;

/// The quantity that the critic predicts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Value {
    /// The total reward, as in the paper.
    Total,
    /// Each user's part of the reward; for [`Encoder::PerUser`].
    EachUser,
}

/// The critic's inputs that depend on the action, in addition to the action itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sight {
    /// None.
    #[serde(rename = "logits")]
    Actions,
    /// The amplitude that each user gets under the actions, by the smooth decoder.
    Decoded,
}

/// Widths of the hidden layers, as in the paper.
const HIDDEN: [usize; 2] = [256, 128];

/// A critic: its network, and what it reads and predicts.
#[derive(Clone, Debug)]
pub struct Critic {
    /// Its network.
    pub network: Network,
    value: Value,
    sight: Sight,
    /// The constant c of the decoder weights.
    range: f32,
}

impl Critic {
    /// A critic with newly drawn parameters; `range` is the constant c of the decoder weights.
    ///
    /// # Errors
    /// A value for each user without a network for each user, or errors of candle.
    pub fn new(
        layout: Layout,
        encoder: Encoder,
        (value, sight, range): (Value, Sight, f32),
        rng: &mut impl Rng,
    ) -> anyhow::Result<Self> {
        anyhow::ensure!(
            value == Value::Total || encoder == Encoder::PerUser,
            "value = \"each-user\" needs encoder = \"per-user\": expected that, or value = \"total\""
        );
        let shape = Shape { encoder, slots: layout.slots(), inputs: ACTOR_INPUTS, hidden: HIDDEN, outputs: 1 };
        Ok(Self { network: Network::new(shape, rng)?, value, sight, range })
    }

    /// A copy with its own network.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn copy(&self) -> Result<Self> {
        Ok(Self { network: self.network.copy()?, ..*self })
    }

    /// The same critic without gradients of its parameters.
    pub fn frozen(&self) -> Self {
        Self { network: self.network.frozen(), ..*self }
    }

    /// Its prediction: (batch, slots), zero in empty slots, or (batch).
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn value(&self, states: &States, actions: &Tensor) -> Result<Tensor> {
        let present = &states.present;
        let amplitude = match self.sight {
            Sight::Actions => states.balanced()?,
            Sight::Decoded => states.amplitude(actions, self.range)?,
        };
        let encoder = self.network.shape().encoder;
        let actions = match encoder {
            Encoder::PerUser => actions.broadcast_sub(&states.mean_present(actions)?.unsqueeze(1)?)?.mul(present)?,
            Encoder::Mlp => actions.clone(),
        };
        let output = self.network.forward(&states.with_columns(&[&actions, &amplitude.mul(present)?])?)?;
        match encoder {
            Encoder::PerUser => self.reduce(states, &output),
            Encoder::Mlp => output.squeeze(1),
        }
    }

    /// Its prediction, averaged over the present users: (batch).
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn mean_value(&self, states: &States, actions: &Tensor) -> Result<Tensor> {
        over_users(states, self.value(states, actions)?)
    }

    /// Each user's part of the reward (batch, slots) in the form that the critic predicts.
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn reduce(&self, states: &States, parts: &Tensor) -> Result<Tensor> {
        match self.value {
            Value::EachUser => parts.mul(&states.present),
            Value::Total => states.mean_present(parts),
        }
    }
}

/// The mean over the present users of values (batch, slots); values (batch) unchanged.
fn over_users(states: &States, values: Tensor) -> Result<Tensor> {
    if values.rank() == 2 { states.mean_present(&values) } else { Ok(values) }
}
