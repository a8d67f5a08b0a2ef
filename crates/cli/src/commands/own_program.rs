//! This program as a process of its own.

use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use serde_json::Value;

/// A process of this program without standard input, not started yet.
///
/// # Errors
/// This program's own file cannot be found.
pub fn process(arguments: &[String]) -> Result<Command> {
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    let mut process = Command::new(program);
    process.args(arguments).stdin(Stdio::null());
    Ok(process)
}

/// Runs this program, and returns the JSON object on its standard output.
///
/// # Errors
/// A process that does not start, that fails, or that prints something else. The error has what it
/// printed on standard error, unless `errors` passes that on.
pub fn json(arguments: &[String], errors: Stdio) -> Result<Value> {
    let output = process(arguments)?.stderr(errors).output().context("cannot start the command")?;
    if !output.status.success() {
        bail!("{}\n{}", output.status, String::from_utf8_lossy(&output.stderr).trim_end());
    }
    serde_json::from_slice(&output.stdout).context("the command printed no JSON object")
}
