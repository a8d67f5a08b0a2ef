//! The driver as a program of its own; `heliostat driver` is the same.

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use heliostat_driver::cli;

/// Drive real mirrors, or check a driver against the contract.
#[derive(Debug, Parser)]
#[command(name = "heliostat-driver", version)]
struct Program {
    #[command(flatten)]
    args: cli::Args,
}

fn main() -> ExitCode {
    match cli::run(Program::parse().args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            drop(writeln!(std::io::stderr(), "heliostat-driver: {error:#}"));
            ExitCode::FAILURE
        }
    }
}
