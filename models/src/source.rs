//! Where the file of a learned policy comes from.

use std::io::ErrorKind;
use std::path::{Component, Path, PathBuf};

use heliostat_core::policy::{PolicyKind, actor_file::ActorFile};
use heliostat_files::read_bytes;
use heliostat_onnx::{ModelProto, external};
use heliostat_scenario::Scenario;
use prost::Message;

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

impl From<Option<PathBuf>> for ActorSource {
    /// The file that a user names, or else the built-in actor.
    fn from(file: Option<PathBuf>) -> Self {
        file.map_or(Self::Shipped, Self::Path)
    }
}

/// The flags of every command that runs a controller, or plans a run of one.
#[derive(Clone, Debug, clap::Args)]
pub struct PolicyArgs {
    /// Policy of the controller [default: fixed-point, or ddpg with --model]
    #[arg(long, value_enum)]
    pub policy: Option<PolicyKind>,
    /// ONNX file of a learned policy, instead of the built-in one
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
}

impl PolicyArgs {
    /// The named policy, or else `ddpg` with a file of a learned policy, and
    /// [`PolicyKind::DEFAULT`] without.
    pub fn kind(&self) -> PolicyKind {
        self.policy.unwrap_or(if self.model.is_some() { PolicyKind::Ddpg } else { PolicyKind::DEFAULT })
    }

    /// Where its actor comes from.
    pub fn actor(&self) -> ActorSource {
        self.model.clone().into()
    }
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

/// Reads the file of an actor. Weights in a second file beside it become part of the bytes.
///
/// # Errors
/// [`SourceError::Missing`], [`SourceError::Unreadable`], or [`SourceError::Weights`] where the
/// second file is missing.
pub fn read(path: &Path) -> Result<ActorFile, SourceError> {
    let bytes = match read_bytes(path, BYTES_MAX) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == ErrorKind::NotFound => return Err(SourceError::Missing { path: path.into() }),
        Err(error) => return Err(SourceError::Unreadable { path: path.into(), message: error.to_string() }),
    };
    let origin = path.display().to_string();
    // A file that is no model is refused with what it is.
    let Ok(mut model) = ModelProto::decode(&bytes[..]) else { return Ok(ActorFile { origin, bytes: bytes.into() }) };
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut beside = |name: &str| {
        if !Path::new(name).components().all(|part| matches!(part, Component::Normal(_))) {
            return Err(format!(
                "the weights are in {name}, expected a file in the folder of the actor; export again, or with \
                 external_data=False"
            ));
        }
        read_bytes(&folder.join(name), BYTES_MAX).map_err(|error| {
            format!("the weights are in {name} ({error}): copy it too, or export with external_data=False")
        })
    };
    match external::inline(&mut model, &mut beside) {
        Ok(false) => Ok(ActorFile { origin, bytes: bytes.into() }),
        Ok(true) => Ok(ActorFile { origin, bytes: model.encode_to_vec().into() }),
        Err(message) => Err(SourceError::Weights { path: path.into(), message }),
    }
}
