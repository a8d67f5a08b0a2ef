//! The text of the recorded walk that a scenario names.

use thiserror::Error;

use crate::Scenario;

/// Why the file of a recorded walk cannot be read.
#[derive(Debug, Error)]
#[error("users.trace: cannot read {path}: {reason}")]
pub struct TraceFileError {
    /// The file.
    pub path: String,
    /// The operating system's message.
    pub reason: std::io::Error,
}

impl Scenario {
    /// Reads the file `users.trace`; `None` where the scenario names none.
    ///
    /// # Errors
    /// [`TraceFileError`] where the file cannot be read.
    pub fn read_trace(&self) -> Result<Option<String>, TraceFileError> {
        let read = |path: &String| {
            std::fs::read_to_string(path).map_err(|reason| TraceFileError { path: path.clone(), reason })
        };
        self.users.trace.as_ref().map(read).transpose()
    }
}
