//! The controller as a separate program, for deployment.

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use heliostat_controller::cli;

#[derive(Parser)]
#[command(name = "heliostat-controller", version)]
struct Program {
    #[command(flatten)]
    args: cli::Args,
}

fn main() -> ExitCode {
    match cli::run(Program::parse().args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            drop(writeln!(std::io::stderr(), "heliostat-controller: {error:#}"));
            ExitCode::FAILURE
        }
    }
}
