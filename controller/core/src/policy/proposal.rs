//! The policy trait: from an observation to proposed mirror angles.
//!
//! A policy only proposes. [`crate::safety`] limits and checks its angles. A policy does not log,
//! and reads time only through a [`TimeSource`]. After the first few calls it does not allocate in
//! this project's code.

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles, solver::SolverError};
use heliostat_proto::MAX_USERS;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::{
    observe::observation::{EncodeError, Observation},
    output::safety::NotFinite,
};

/// A rule that turns observations into mirror angles.
pub trait Policy: Send {
    /// The name on the command line and in summaries.
    fn name(&self) -> &str;

    /// The name of the inference engine; `None` for a policy that is not learned.
    fn engine(&self) -> Option<&'static str> {
        None
    }

    /// The hash of the file of a learned policy ([`ActorFile::hash`](super::actor_file::ActorFile::hash)).
    fn file_hash(&self) -> Option<&str> {
        None
    }

    /// Writes the angles for an observation of at least one user; `out` has the size of the model's
    /// array. The users may differ from those of the last call.
    ///
    /// # Errors
    /// [`PolicyError`] where the policy gives no angles; the contents of `out` are then
    /// unspecified.
    fn act(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) -> PolicyResult;

    /// The largest number of users that it serves; it leaves out the others of an observation.
    fn users_max(&self) -> usize {
        MAX_USERS
    }

    /// Everything that later proposals depend on besides later observations; the default suits a
    /// policy without memory.
    fn memory(&self) -> PolicyMemory {
        PolicyMemory::default()
    }

    /// Replaces the state by one that [`memory`](Self::memory) of the same policy has returned.
    fn restore(&mut self, _: &PolicyMemory) {}
}

/// The state of a policy; each policy uses some of the fields.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PolicyMemory {
    /// Numbers of the users, slot by slot.
    pub users: Vec<u32>,
    /// Weights of these users in the last solution.
    pub weights: Vec<f64>,
    /// The aim of each mirror in the last solution.
    pub served: Vec<usize>,
    /// The two users of each midpoint among these aims.
    pub midpoints: Vec<[usize; 2]>,
    /// Position of the random generator, in words since its seed.
    pub words: u128,
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
    /// The function of a user failed.
    #[error("the function {name} failed: {message}")]
    Function {
        /// The function.
        name: String,
        /// What it raised, or what is wrong with its answer.
        message: String,
    },
    /// The inference engine failed.
    #[error("the inference engine failed: {message}")]
    Inference {
        /// The engine's own message.
        message: String,
    },
}

/// The result of a policy, or of a part of one.
pub type PolicyResult<T = ()> = Result<T, PolicyError>;

/// Monotonic time in ns, from any origin.
pub type TimeSource = fn() -> u64;
