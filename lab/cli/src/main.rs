//! The command line of the laboratory.

use std::process::ExitCode;

use heliostat_service::exit;

mod cli;
mod commands;

fn main() -> ExitCode {
    exit::run(heliostat::programs::LAB, cli::run)
}
