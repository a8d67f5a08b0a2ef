//! The examples in Python.

use std::process::{Child, Command};

use heliostat_service::signals::restore_in_children;

use crate::process::workspace;

/// The Python interpreter of the tests that need `python-package`.
pub fn python() -> String {
    std::env::var("HELIOSTAT_PYTHON").unwrap_or_else(|_| "python3".into())
}

/// A running example; it is killed when dropped.
pub struct PythonExample {
    process: Child,
    _state: tempfile::TempDir,
}

impl PythonExample {
    /// Starts a file of examples/ with these arguments, and with a new folder for its state.
    ///
    /// # Panics
    /// When it does not start.
    pub fn start(python: &str, file: &str, arguments: &[&str]) -> Self {
        let state = tempfile::tempdir().expect("a folder");
        restore_in_children();
        let mut command = Command::new(python);
        command.arg(workspace().join("examples").join(file)).args(arguments).current_dir(workspace());
        command.env("STATE_DIRECTORY", state.path());
        Self { process: command.spawn().expect("python starts"), _state: state }
    }

    /// The running process.
    pub fn process(&mut self) -> &mut Child {
        &mut self.process
    }
}

impl Drop for PythonExample {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
