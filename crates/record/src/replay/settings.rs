//! What a replay is asked to do.

use std::path::{Path, PathBuf};

use heliostat_core::policy::PolicyKind;
use heliostat_service::exit::UnusableInput;

/// Decisions that are not compared when earlier inputs of the controller are unknown: two seconds
/// of reports at 100 Hz.
pub const SETTLE: u64 = 200;

/// What to replay, and how to replay it.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The recording.
    pub file: PathBuf,
    /// The policy, instead of the recorded one.
    pub policy: Option<PolicyKind>,
    /// The actor's file, instead of the built-in one.
    pub model: Option<PathBuf>,
    /// Decisions at the start of each epoch that are not compared, instead of none or [`SETTLE`].
    pub settle: Option<u64>,
}

/// The context of an error that the recording itself causes; a replay that differs is another error.
pub(crate) fn unusable(file: &Path) -> UnusableInput {
    UnusableInput::new(format!("{} cannot be replayed", file.display()))
}
