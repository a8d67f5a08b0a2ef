//! The forms of an action, and the one map from an action to mirror angles.
//!
//! - **Angles**: roll of each mirror, then yaw of each, as a share of the range of an axis: 2 M
//!   values in [-1, 1].
//! - **Weights**: u_k in [-1, 1] for each slot of the observation. The decoder weight is
//!   w_k = b_k exp(c u_k), and [`decode`] turns weights into
//!   angles.

use heliostat_channel::decode::decode;
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::observation::{Observation, ObservationEncoder, Summary};
use serde::{Deserialize, Serialize};

use crate::error::EnvironmentError;

/// The baseline weight b_k, which is the decoder weight for an action of zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BaselineWeight {
    /// b_k = 1.
    Uniform,
    /// b_k = q_k, the balanced weight of [`Summary::LogWeight`].
    Balanced,
}

/// The map from actions u_k in [-1, 1] to decoder weights w_k = b_k exp(c u_k).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// The baseline weight b_k.
    #[serde(rename = "prior")]
    pub baseline_weight: BaselineWeight,
    /// The constant c.
    pub range: f32,
}

impl Head {
    /// The map of an environment with one weight per user: an action of zero is the balanced
    /// weight.
    pub const BALANCED: Self = Self { baseline_weight: BaselineWeight::Balanced, range: 2.0 };

    /// The decoder weights of all slots of an observation vector; zero in empty slots.
    pub fn weights(self, encoder: ObservationEncoder, vector: &[f32], actions: &[f32]) -> impl Iterator<Item = f32> {
        let column = |column: Summary| vector[encoder.column(column as usize)].iter();
        let slots = column(Summary::Present).zip(column(Summary::LogWeight));
        actions.iter().zip(slots).map(move |(action, (present, balanced))| {
            let log_baseline = match self.baseline_weight {
                BaselineWeight::Uniform => 0.0,
                BaselineWeight::Balanced => *balanced,
            };
            (self.range * action + log_baseline).exp() * present
        })
    }
}

/// The form of an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionForm {
    /// The angles of all mirrors over the range of an axis.
    Angles,
    /// One weight per slot, by [`Head::BALANCED`].
    Weights,
}

/// The observation in which an action was chosen.
#[derive(Clone, Copy)]
pub(crate) struct Seen<'a> {
    pub model: &'a ChannelModel,
    pub observation: &'a Observation,
    /// Index in the observation of each slot's user.
    pub chosen: &'a [usize],
    /// The observation as a vector.
    pub vector: &'a [f32],
}

/// Turns actions into angles; its buffers are reused.
#[derive(Clone, Debug)]
pub(crate) struct ActionDecoder {
    form: ActionForm,
    encoder: ObservationEncoder,
    range_rad: f32,
    /// Components within [-1, 1].
    bounded: Vec<f32>,
    weights: Vec<f64>,
}

impl ActionDecoder {
    /// For the vectors of an encoder and axes of this range in rad.
    pub fn new(form: ActionForm, encoder: ObservationEncoder, range_rad: f64) -> Self {
        Self { form, encoder, range_rad: range_rad as f32, bounded: Vec::new(), weights: Vec::new() }
    }

    /// Number of components of an action.
    pub fn len(&self) -> usize {
        match self.form {
            ActionForm::Angles => 2 * self.encoder.mirrors(),
            ActionForm::Weights => self.encoder.users_max(),
        }
    }

    /// Decodes an action into angles in rad. Components beyond [-1, 1] count as the nearest bound.
    pub fn decode(&mut self, seen: Seen<'_>, action: &[f32], out: &mut MirrorAngles) -> Result<(), EnvironmentError> {
        self.check(action)?;
        self.bounded.clear();
        self.bounded.extend(action.iter().map(|value| value.clamp(-1.0, 1.0)));
        match self.form {
            ActionForm::Angles => {
                let (roll, yaw) = self.bounded.split_at(self.encoder.mirrors());
                let scale = |from: &[f32], to: &mut [f64]| {
                    to.iter_mut().zip(from).for_each(|(angle, value)| *angle = f64::from(value * self.range_rad));
                };
                scale(roll, &mut out.roll);
                scale(yaw, &mut out.yaw);
            }
            ActionForm::Weights => {
                self.weights.clear();
                self.weights.resize(seen.observation.users(), 0.0);
                let weights = Head::BALANCED.weights(self.encoder, seen.vector, &self.bounded);
                for (user, weight) in seen.chosen.iter().zip(weights) {
                    self.weights[*user] = f64::from(weight);
                }
                if !self.weights.is_empty() {
                    decode(seen.model, &seen.observation.scene, &self.weights, out);
                }
            }
        }
        Ok(())
    }

    /// Checks the length, and that all components are finite.
    pub fn check(&self, action: &[f32]) -> Result<(), EnvironmentError> {
        if action.len() != self.len() {
            let meaning = match self.form {
                ActionForm::Angles => "roll of each mirror, then yaw of each, over the range of an axis",
                ActionForm::Weights => "one weight for each slot of the observation",
            };
            return Err(EnvironmentError::ActionLength { found: action.len(), expected: self.len(), meaning });
        }
        match action.iter().position(|value| !value.is_finite()) {
            Some(index) => Err(EnvironmentError::NotFinite { index, value: action[index] }),
            None => Ok(()),
        }
    }
}
