//! The critics of learners with one weight per user: the value of actions in a state.

use candle_core::{Result, Tensor};
use rand::Rng;
use serde::{Deserialize, Serialize};

use super::actor::{ACTOR_INPUTS, States};
use super::adam::Adam;
use super::layers::{Encoder, Network, Shape, soft_update};
use crate::environment::features::Layout;
use crate::training::learner::{Part, part};

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

/// Two critics with their targets, of which the smaller prediction counts: clipped double
/// Q-learning (Fujimoto and others, 2018, section 4.2), which TD3 and SAC have.
pub struct TwinCritics {
    critics: [Critic; 2],
    targets: [Critic; 2],
    adams: [Adam; 2],
}

impl TwinCritics {
    /// Two critics of each user's part of the reward, which read the decoded actions.
    ///
    /// # Errors
    /// As [`Critic::new`].
    pub fn new(layout: Layout, range: f32, rng: &mut impl Rng) -> anyhow::Result<Self> {
        let mut critic = || Critic::new(layout, Encoder::PerUser, (Value::EachUser, Sight::Decoded, range), rng);
        let critics = [critic()?, critic()?];
        let targets = [critics[0].copy()?, critics[1].copy()?];
        let adams = [Adam::new(&critics[0].network), Adam::new(&critics[1].network)];
        Ok(Self { critics, targets, adams })
    }

    /// The first critic, without gradients of its parameters.
    pub fn first(&self) -> Critic {
        self.critics[0].frozen()
    }

    /// The smaller mean prediction of both critics without gradients of their parameters: (batch).
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn least_mean(&self, states: &States, actions: &Tensor) -> Result<Tensor> {
        let [one, other] = &self.critics;
        one.frozen().mean_value(states, actions)?.minimum(&other.frozen().mean_value(states, actions)?)
    }

    /// The smaller prediction of both targets for each user, without gradients: (batch, slots).
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn target(&self, next: &States, actions: &Tensor) -> Result<Tensor> {
        let [one, other] = &self.targets;
        Ok(one.value(next, actions)?.minimum(&other.value(next, actions)?)?.detach())
    }

    /// One step of both critics towards `target` (batch, slots), by the mean squared error.
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn update(&mut self, states: &States, actions: &Tensor, target: &Tensor, rate: f64) -> Result<()> {
        for (critic, adam) in self.critics.iter().zip(&mut self.adams) {
            let error = (critic.value(states, actions)? - target)?;
            adam.step(&critic.network, &error.sqr()?.mean_all()?.backward()?, rate)?;
        }
        Ok(())
    }

    /// Moves both targets towards their critics.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn follow(&self, tau: f64) -> Result<()> {
        for (target, critic) in self.targets.iter().zip(&self.critics) {
            soft_update(&target.network, &critic.network, tau)?;
        }
        Ok(())
    }

    /// Its state, for a checkpoint.
    pub fn state(&mut self) -> Vec<Part<'_>> {
        let mut parts = Vec::new();
        let all = self.critics.iter_mut().zip(&mut self.targets).zip(&mut self.adams);
        for (index, ((critic, target), adam)) in all.enumerate() {
            parts.push(part(&format!("critic.{index}"), &mut critic.network));
            parts.push(part(&format!("critic_target.{index}"), &mut target.network));
            parts.push(part(&format!("critic.{index}"), adam));
        }
        parts
    }
}
