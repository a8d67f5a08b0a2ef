//! Why an actor's file cannot be read, or a policy cannot be built.

use std::path::PathBuf;

use heliostat_core::policy::{self, PolicyKind};
use thiserror::Error;

/// Why the file of an actor cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SourceError {
    /// The file does not exist.
    #[error(
        "no actor at {}, expected an ONNX file: train one with `heliostat-lab train`, give another file, \
         or choose the policy fixed-point, which needs no file", path.display()
    )]
    Missing {
        /// The path.
        path: PathBuf,
    },
    /// No actor is built in for this array and mode.
    #[error(
        "no actor is built in for {policy} with {room} (it would be {expected}); built in: {available}. \
         Train one with `heliostat-lab train {policy}` for this scenario and give its file, or choose the policy fixed-point, \
         which needs no file"
    )]
    NotShipped {
        /// The learned policy's name.
        policy: String,
        /// The array and the mode of the room.
        room: String,
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
