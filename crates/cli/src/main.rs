//! The command line of Heliostat.

use std::process::ExitCode;

use heliostat_service::exit;

mod cli;
mod commands;
mod output;

fn main() -> ExitCode {
    exit::run("heliostat", cli::run)
}
