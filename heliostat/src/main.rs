//! The command line of Heliostat.

use std::process::ExitCode;

mod cli;
mod commands;
mod output;

fn main() -> ExitCode {
    match cli::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if output::closed(&error) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("heliostat: {error:#}");
            ExitCode::FAILURE
        }
    }
}
