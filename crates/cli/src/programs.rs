//! The programs `heliostat` and `heliostat-lab` as processes.

use std::env::consts::EXE_SUFFIX;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};

/// The system: demo, controller, simulator, drivers, recorder, page.
pub const HELIOSTAT: &str = "heliostat";
/// The laboratory: training, evaluation, reproduction, reports.
pub const LAB: &str = "heliostat-lab";

/// The file of `heliostat`: that of this process, or the one beside it if this process is the
/// laboratory.
///
/// # Errors
/// The laboratory has no `heliostat` beside it.
pub fn heliostat() -> Result<PathBuf> {
    let own = own_file()?;
    if own.file_stem().is_none_or(|name| name != LAB) {
        return Ok(own);
    }
    let beside = own.with_file_name(format!("{HELIOSTAT}{EXE_SUFFIX}"));
    ensure!(
        beside.is_file(),
        "there is no {}; expected {HELIOSTAT} beside {LAB}: build it with `cargo build --release -p {HELIOSTAT}`",
        beside.display()
    );
    Ok(beside)
}

/// The file of this process.
///
/// # Errors
/// The system does not name it.
pub fn own_file() -> Result<PathBuf> {
    std::env::current_exe().context("cannot find this program's own file")
}

/// A process of a program without standard input, not started yet.
pub fn process(program: PathBuf, arguments: &[String]) -> Command {
    let mut process = Command::new(program);
    process.args(arguments).stdin(Stdio::null());
    process
}
