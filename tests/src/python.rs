//! The examples in Python.

use std::process::{Child, Command};

use crate::process::workspace;

/// A Python interpreter with the package of `python/` and its extra `zenoh`; `None` if it is missing and not required.
///
/// # Panics
/// When it is missing and HELIOSTAT_REQUIRE_PYTHON is set.
pub fn python() -> Option<String> {
    let python = std::env::var("HELIOSTAT_PYTHON").unwrap_or_else(|_| "python3".into());
    let found = Command::new(&python).args(["-c", "import heliostat.driver, heliostat.tracker"]).output();
    if found.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    assert!(
        std::env::var_os("HELIOSTAT_REQUIRE_PYTHON").is_none(),
        "{python} cannot import heliostat.driver, which is required where HELIOSTAT_REQUIRE_PYTHON is set"
    );
    println!(
        "skipped: {python} cannot import heliostat.driver (pip install \"./python[zenoh]\"; HELIOSTAT_PYTHON names another)"
    );
    None
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
