//! The programs of the project as processes that print one JSON object.

use std::path::PathBuf;
use std::process::Stdio;

use anyhow::{Context, Result, bail};
use heliostat::programs::process;
use heliostat_service::exit::Interrupted;
use heliostat_service::signals;
use serde_json::Value;

/// Runs a program, and returns the JSON object on its standard output.
///
/// # Errors
/// A process that does not start, that fails, or that prints something else. The error has what it
/// printed on standard error, unless `errors` passes that on. [`Interrupted`] where a signal has ended it.
pub fn json(program: PathBuf, arguments: &[String], errors: Stdio) -> Result<Value> {
    let mut process = process(program, arguments);
    signals::part(&mut process);
    let output = process.stderr(errors).output().context("cannot start the command")?;
    if signals::has_interrupted(output.status) {
        return Err(Interrupted.into());
    }
    if !output.status.success() {
        bail!("{}\n{}", output.status, String::from_utf8_lossy(&output.stderr).trim_end());
    }
    serde_json::from_slice(&output.stdout).context("the command printed no JSON object")
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_process_that_a_signal_ends_is_interrupted_and_one_that_fails_is_not() {
        for (script, is_interrupted) in [("exit 130", true), ("kill -TERM $$", true), ("exit 1", false)] {
            let shell = || json("/bin/sh".into(), &["-c".to_owned(), script.to_owned()], Stdio::piped());
            assert_eq!(shell().expect_err("a failure").is::<Interrupted>(), is_interrupted, "{script}");
        }
        let part = json("/bin/sh".into(), &["-c".to_owned(), "echo $HELIOSTAT_PART".to_owned()], Stdio::piped());
        assert_eq!(part.expect("its variable as JSON"), 1, "it leaves the note to this process");
    }
}
