//! The exit codes of every program and command.
//!
//! | code | meaning |
//! | --- | --- |
//! | 0 | the command did what it was asked, also where the reader of its output closed the pipe |
//! | 1 | it failed, or it checked something and found it wrong |
//! | 2 | what the user typed or named cannot be used: a flag, a scenario, a policy, an endpoint, keys or another file |
//! | 130 | a second Ctrl-C or SIGTERM ended it before its orderly end, or one that a computation outlasted, or one where nothing is saved, also in a process that it started |

use std::error::Error;
use std::process::ExitCode;

use heliostat_bus::{BusError, KeyError};
pub use heliostat_files::UnusableInput;
use heliostat_scenario::{ScenarioError, TraceFileError};

use crate::output;

/// The command failed, or it checked something and found it wrong.
pub const FAILURE: u8 = 1;
/// What the user typed or named cannot be used. The argument parser exits with the same code.
pub const USAGE: u8 = 2;
/// A signal ended the process before its orderly end: 128 + SIGINT, as in a shell.
pub const INTERRUPTED: u8 = 130;

/// The same error as one that an input of the user caused: the exit code is then [`USAGE`]. The errors of scenarios and of
/// the settings of a session need no such mark.
pub fn unusable(error: impl Into<anyhow::Error>) -> anyhow::Error {
    UnusableInput::new(format!("{:#}", error.into())).into()
}

/// A signal has ended a process that the command started: the exit code is then [`INTERRUPTED`].
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;

/// Runs a command, prints its error to standard error, and gives the exit code of the program.
pub fn run(program: &str, command: impl FnOnce() -> anyhow::Result<()>) -> ExitCode {
    match command() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::error(program, &format!("{error:#}"));
            ExitCode::from(code(&error))
        }
    }
}

fn code(error: &anyhow::Error) -> u8 {
    if error.is::<UnusableInput>() || error.chain().any(is_of_user) {
        USAGE
    } else if error.is::<Interrupted>() {
        INTERRUPTED
    } else {
        FAILURE
    }
}

/// Whether an error is about what the user typed or named, by its type.
fn is_of_user(error: &(dyn Error + 'static)) -> bool {
    error.is::<UnusableInput>()
        || error.is::<ScenarioError>()
        || error.is::<TraceFileError>()
        || error.downcast_ref::<BusError>().is_some_and(BusError::is_of_settings)
        || error.downcast_ref::<KeyError>().is_some_and(|keys| BusError::from(keys.clone()).is_of_settings())
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
    fn the_source_of_an_error_of_a_library_marks_it_too() {
        #[derive(Debug, thiserror::Error)]
        #[error("the token")]
        struct OfLibrary(#[source] UnusableInput);
        let error = anyhow::Error::from(OfLibrary(UnusableInput::new("no such file"))).context("in a page");
        assert_eq!((code(&error), format!("{error:#}").as_str()), (USAGE, "in a page: the token: no such file"));
    }

    #[test]
    fn a_scenario_and_an_endpoint_that_cannot_be_used_are_told_from_a_process_that_does_not_answer() {
        let scenario = ScenarioError::SeveralArrays { count: 2 };
        assert_eq!(code(&anyhow::Error::from(scenario).context("in a batch")), USAGE);
        assert_eq!(code(&BusError::NoEndpoint.into()), USAGE);
        let absent = BusError::CannotReach { endpoints: "tcp/127.0.0.1:1".into(), waited_ms: 5 };
        assert_eq!(code(&absent.into()), FAILURE);
        let policy = unusable(anyhow!("no file").context("nothing was started"));
        assert_eq!((code(&policy), format!("{policy:#}")), (USAGE, "nothing was started: no file".to_owned()));
    }

    #[test]
    fn the_interruption_of_a_started_process_is_that_of_the_command() {
        let error = anyhow::Error::from(Interrupted).context("eval --sweep").context("section a did not finish");
        assert_eq!(code(&error), INTERRUPTED);
    }

    #[test]
    fn a_file_or_socket_that_its_reader_closed_is_a_failure() {
        let closed = anyhow::Error::from(std::io::Error::from(std::io::ErrorKind::BrokenPipe));
        assert_eq!(code(&closed.context("cannot write figures.csv")), FAILURE);
    }
}
