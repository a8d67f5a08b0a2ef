//! The command line of the laboratory.

use std::process::ExitCode;

mod cli;
mod commands;

fn main() -> ExitCode {
    heliostat::arguments::run::<cli::Cli>(heliostat::programs::LAB, cli::run)
}
