//! The exit codes of every program and command.
//!
//! | code | meaning |
//! | --- | --- |
//! | 0 | the command did what it was asked, or the reader of its output closed the pipe |
//! | 1 | it failed, or it checked something and found it wrong; a scenario, a policy or an endpoint that cannot be used is a failure |
//! | 2 | the command line cannot be read, or another input file cannot be used |
//! | 130 | a second Ctrl-C or SIGTERM ended it before its orderly end, or one that a computation outlasted, or one where nothing is saved, also in a process that it started |

use std::fmt;
use std::io;
use std::process::ExitCode;

use crate::output;
use crate::process::allow_files;

/// The command failed, or it checked something and found it wrong.
pub const FAILURE: u8 = 1;
/// The command line cannot be read, or an input file cannot be used. The argument parser exits with the same code.
pub const USAGE: u8 = 2;
/// A signal ended the process before its orderly end: 128 + SIGINT, as in a shell.
pub const INTERRUPTED: u8 = 130;

/// Context of an error that an input file caused: the exit code is then [`USAGE`].
#[derive(Clone, Debug)]
pub struct UnusableInput(String);

impl UnusableInput {
    /// A message that names the file and what it cannot be used for.
    pub fn new(message: impl Into<String>) -> Self {
        Self(message.into())
    }
}

impl fmt::Display for UnusableInput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for UnusableInput {}

/// A signal has ended a process that the command started: the exit code is then [`INTERRUPTED`].
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;

/// Runs a command with enough open files, prints its error to standard error, and gives the exit code of the program.
pub fn run(program: &str, command: impl FnOnce() -> anyhow::Result<()>) -> ExitCode {
    match allow_files().and_then(|()| command()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if is_closed_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            output::note(format_args!("{program}: {error:#}"));
            ExitCode::from(code(&error))
        }
    }
}

fn code(error: &anyhow::Error) -> u8 {
    if error.is::<UnusableInput>() {
        USAGE
    } else if error.is::<Interrupted>() {
        INTERRUPTED
    } else {
        FAILURE
    }
}

/// Whether the reader of standard output, such as `head`, has closed it.
fn is_closed_pipe(error: &anyhow::Error) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

#[cfg(test)]
mod tests {
    use anyhow::{Context, anyhow};

    use super::*;

    #[test]
    fn an_unusable_input_is_told_from_a_failure() {
        assert_eq!(code(&anyhow!("no room")), FAILURE);
        let unusable = Err::<(), _>(anyhow!("no index")).context(UnusableInput::new("a.mcap cannot be replayed"));
        let error = unusable.context("in a batch").unwrap_err();
        assert_eq!(code(&error), USAGE);
        assert_eq!(format!("{error:#}"), "in a batch: a.mcap cannot be replayed: no index");
    }

    #[test]
    fn the_interruption_of_a_started_process_is_that_of_the_command() {
        let error = anyhow::Error::from(Interrupted).context("eval --sweep").context("section a did not finish");
        assert_eq!(code(&error), INTERRUPTED);
    }

    #[test]
    fn a_closed_pipe_is_no_failure() {
        assert!(is_closed_pipe(&io::Error::from(io::ErrorKind::BrokenPipe).into()));
        assert!(!is_closed_pipe(&io::Error::from(io::ErrorKind::NotFound).into()));
    }
}
