//! Where the file of a learned policy comes from.

use std::path::{Path, PathBuf};

use heliostat_decide::policy::{self, PolicyKind, actor_file::ActorFile};
use heliostat_scenario::Scenario;
use thiserror::Error;

use crate::shipped;

/// Why the file of an actor cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SourceError {
    /// The file does not exist.
    #[error(
        "no actor at {}, expected an ONNX file: train one with `heliostat train`, give another file, \
         or choose the policy fixed-point, which needs no file", path.display()
    )]
    Missing {
        /// The path.
        path: PathBuf,
    },
    /// No actor is built in for this array and mode.
    #[error(
        "no built-in actor {expected}; built in: {available}. Train one with `heliostat train {policy}` for this scenario and give \
         its file, or choose the policy fixed-point, which needs no file"
    )]
    NotShipped {
        /// The learned policy's name.
        policy: String,
        /// File name of the actor that fits.
        expected: String,
        /// The built-in ones.
        available: String,
    },
    /// The file exists but cannot be read.
    #[error("cannot read the actor {}: {message}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's message.
        message: String,
    },
}

/// Why a policy cannot be built for a room.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum BuildError {
    /// The file of the actor cannot be read.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The policy does not fit the room.
    #[error(transparent)]
    Policy(#[from] policy::BuildError),
    /// A file was given for a policy that reads none.
    #[error(
        "a file was given for the policy {policy}, which reads none: leave the file out, or choose a learned policy ({})",
        PolicyKind::learned_names()
    )]
    NoUseForModel {
        /// The policy's name.
        policy: String,
    },
}

/// Where the file of a learned policy comes from.
#[derive(Clone, Debug, Default)]
pub enum ActorSource {
    /// The built-in actor for the scenario's mode and array, of training seed 1.
    #[default]
    Shipped,
    /// The built-in actor of another training seed.
    ShippedSeed(u32),
    /// A file.
    Path(PathBuf),
    /// Bytes in memory.
    Bytes(ActorFile),
}

impl ActorSource {
    /// Fetches the bytes.
    ///
    /// # Errors
    /// [`SourceError`] where the actor does not exist or cannot be read.
    pub fn fetch(&self, policy: PolicyKind, scenario: &Scenario) -> Result<ActorFile, SourceError> {
        match self {
            Self::Shipped => shipped::find(policy, scenario, 1),
            Self::ShippedSeed(seed) => shipped::find(policy, scenario, *seed),
            Self::Path(path) => read(path),
            Self::Bytes(file) => Ok(file.clone()),
        }
    }

    /// Refuses a file for a policy that reads none.
    ///
    /// # Errors
    /// [`BuildError::NoUseForModel`].
    pub fn check_used_by(&self, policy: PolicyKind) -> Result<(), BuildError> {
        let unused = matches!(self, Self::Path(_)) && !policy.is_learned();
        if unused { Err(BuildError::NoUseForModel { policy: policy.name() }) } else { Ok(()) }
    }
}

/// Reads the file of an actor.
///
/// # Errors
/// [`SourceError::Missing`] or [`SourceError::Unreadable`].
pub fn read(path: &Path) -> Result<ActorFile, SourceError> {
    match std::fs::read(path) {
        Ok(bytes) => Ok(ActorFile { origin: path.display().to_string(), bytes: bytes.into() }),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Err(SourceError::Missing { path: path.into() }),
        Err(error) => Err(SourceError::Unreadable { path: path.into(), message: error.to_string() }),
    }
}
