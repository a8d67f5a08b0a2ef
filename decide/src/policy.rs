//! From an observation to mirror angles: one trait, many ways.
//!
//! A policy proposes; it neither limits nor checks its angles, which is the duty of [`crate::safety`]. It does not log, and reads no clock
//! save where a time budget is its definition. After the first few calls it does not allocate in our own code.

mod actor;
pub mod actor_file;
mod exhaustive;
mod fixed;
mod metaheuristic;
mod model_based;
mod nearest;
mod network;
mod pso;
mod registry;
mod sine_cosine;

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles, solver::SolverError};
use thiserror::Error;

pub use actor::Actor;
pub use exhaustive::Exhaustive;
pub use fixed::{Fixed, Hold};
pub use model_based::ModelBased;
pub use nearest::Nearest;
pub use network::{Engine, Network};
pub use pso::Pso;
pub use registry::{BuildError, PolicyKind, Resources, build, build_fallback};
pub use sine_cosine::SineCosine;

use crate::{
    observation::{EncodeError, Observation},
    safety::NotFinite,
};

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

    /// Does what [`act`](Self::act) does, so that its code and data stay in the caches, and leaves behind nothing on which a later answer
    /// depends; `out` then holds nothing of use. A policy that remembers, and cannot undo it, does nothing here.
    fn rehearse(&mut self, _: &ChannelModel, _: &Observation, _out: &mut MirrorAngles) {}
}

/// Why a policy gave no angles.
#[derive(Debug, Error)]
pub enum PolicyError {
    /// The observation does not fit the network's input.
    #[error(transparent)]
    Observation(#[from] EncodeError),
    /// An angle is not a number, or infinite.
    #[error(transparent)]
    NotFinite(#[from] NotFinite),
    /// The search does not fit the room.
    #[error(transparent)]
    Search(#[from] SolverError),
    /// The inference engine failed.
    #[error("the inference engine failed: {message}")]
    Inference {
        /// The engine's own words.
        message: String,
    },
}

/// Monotonic time in ns, from any beginning.
pub type TimeSource = fn() -> u64;
