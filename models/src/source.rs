//! Where the file of a learned policy comes from.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use heliostat_core::policy::{PolicyKind, actor_file::ActorFile};
use heliostat_scenario::Scenario;

pub use crate::error::{BuildError, SourceError};
use crate::shipped;

/// Longest file of an actor in bytes: 64 million weights.
const BYTES_MAX: u64 = 256 << 20;

/// Where the file of a learned policy comes from.
#[derive(Clone, Debug, Default)]
pub enum ActorSource {
    /// The built-in actor for the scenario's mode and array, of training seed 1.
    #[default]
    Shipped,
    /// The built-in actor of a training seed.
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
    let mut bytes = Vec::new();
    let unreadable = |message| Err(SourceError::Unreadable { path: path.into(), message });
    match File::open(path).and_then(|file| file.take(BYTES_MAX + 1).read_to_end(&mut bytes)) {
        Ok(length) if length as u64 > BYTES_MAX => {
            unreadable(format!("it is longer than {} MiB, expected a shorter ONNX file", BYTES_MAX >> 20))
        }
        Ok(_) => Ok(ActorFile { origin: path.display().to_string(), bytes: bytes.into() }),
        Err(error) if error.kind() == ErrorKind::NotFound => Err(SourceError::Missing { path: path.into() }),
        Err(error) => unreadable(error.to_string()),
    }
}
