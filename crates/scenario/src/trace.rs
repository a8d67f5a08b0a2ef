//! The text of the recorded walk that a scenario names.

use std::path::Path;

use thiserror::Error;

use crate::Scenario;
use heliostat_files::read_text;

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
        let read =
            |path: &String| read_text(Path::new(path)).map_err(|reason| TraceFileError { path: path.clone(), reason });
        self.users.trace.as_ref().map(read).transpose()
    }

    /// The name of the file `users.trace`, without its folder.
    pub(crate) fn trace_name(&self) -> Option<String> {
        let path = self.users.trace.as_deref()?;
        let name = Path::new(path).file_name();
        Some(name.map_or_else(|| path.to_owned(), |name| name.to_string_lossy().into_owned()))
    }
}
