//! From an observation to mirror angles: one trait, many ways.
//!
//! A policy proposes; it neither limits nor checks its angles, which is the duty of [`crate::safety`]. It reads no clock and
//! does not log. After the first few calls it does not allocate in our own code.

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};
use thiserror::Error;

use crate::observation::{EncodeError, Observation};

/// A way to turn the mirrors.
pub trait Policy: Send {
    /// The name on the command line and in summaries.
    fn name(&self) -> &str;

    /// Writes the angles for an observation; `out` has the size of the model's array.
    ///
    /// # Errors
    /// [`PolicyError`] where it cannot; `out` then holds nothing of use.
    fn act(
        &mut self,
        model: &ChannelModel,
        observation: &Observation,
        out: &mut MirrorAngles,
    ) -> Result<(), PolicyError>;
}

/// Why a policy gave no angles.
#[derive(Debug, Error)]
pub enum PolicyError {
    /// The observation does not fit the network's input.
    #[error(transparent)]
    Observation(#[from] EncodeError),
    /// The network gave a value that is not a number, or infinite.
    #[error("output {index} of the network is not a finite number")]
    NotFinite {
        /// Index into roll then yaw.
        index: usize,
    },
    /// The inference engine failed.
    #[error("the inference engine failed: {message}")]
    Inference {
        /// The engine's own words.
        message: String,
    },
}
