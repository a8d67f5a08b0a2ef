//! The programs of the project as processes that print one JSON object.

use std::path::PathBuf;
use std::process::Stdio;

use anyhow::{Context, Result, bail};
use heliostat::programs::process;
use serde_json::Value;

/// Runs a program, and returns the JSON object on its standard output.
///
/// # Errors
/// A process that does not start, that fails, or that prints something else. The error has what it
/// printed on standard error, unless `errors` passes that on.
pub fn json(program: PathBuf, arguments: &[String], errors: Stdio) -> Result<Value> {
    let output = process(program, arguments).stderr(errors).output().context("cannot start the command")?;
    if !output.status.success() {
        bail!("{}\n{}", output.status, String::from_utf8_lossy(&output.stderr).trim_end());
    }
    serde_json::from_slice(&output.stdout).context("the command printed no JSON object")
}
