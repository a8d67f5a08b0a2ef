//! The forms of an action, and the one map from an action to mirror angles.
//!
//! - **Angles**: roll of each mirror, then yaw of each, as a share of the range of an axis: 2 M
//!   values in [-1, 1].
//! - **Weights**: u_k in [-1, 1] for each slot of the observation. The decoder weight is
//!   w_k = b_k exp(c u_k), and the controller's own [`Head`] turns weights into angles.

use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::observation::ObservationEncoder;
pub use heliostat_core::policy::weights::{BaselineWeight, Head, Seen};

use crate::error::EnvironmentError;

/// The form of an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionForm {
    /// The angles of all mirrors over the range of an axis.
    Angles,
    /// One weight per slot, by [`Head::BALANCED`].
    Weights,
}

/// Turns actions into angles; its buffers are reused.
#[derive(Clone, Debug)]
pub struct ActionDecoder {
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
    #[expect(clippy::len_without_is_empty, reason = "an action has components")]
    pub fn len(&self) -> usize {
        match self.form {
            ActionForm::Angles => 2 * self.encoder.mirrors(),
            ActionForm::Weights => self.encoder.users_max(),
        }
    }

    /// Decodes an action into angles in rad. Components beyond [-1, 1] count as the nearest bound.
    ///
    /// # Errors
    /// As [`check`](Self::check).
    pub fn decode(
        &mut self,
        model: &ChannelModel,
        seen: Seen<'_>,
        action: &[f32],
        out: &mut MirrorAngles,
    ) -> Result<(), EnvironmentError> {
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
                if seen.observation.users() > 0 {
                    Head::BALANCED.decode(model, seen, &self.bounded, &mut self.weights, out);
                }
            }
        }
        Ok(())
    }

    /// Checks the length, and that all components are finite.
    ///
    /// # Errors
    /// [`EnvironmentError::ActionLength`] and [`EnvironmentError::NotFinite`].
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
