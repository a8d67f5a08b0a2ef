//! The command line of Heliostat.

use std::io::Write;
use std::process::ExitCode;

mod cli;
mod commands;
mod output;

fn main() -> ExitCode {
    match cli::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if output::closed(&error) => ExitCode::SUCCESS,
        Err(error) => {
            drop(writeln!(std::io::stderr(), "heliostat: {error:#}"));
            // A recording that cannot be replayed has another status than one with differences.
            if error.is::<heliostat_record::replay::Unusable>() { ExitCode::from(2) } else { ExitCode::FAILURE }
        }
    }
}
