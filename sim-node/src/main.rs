//! The simulated room as a program of its own.

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use heliostat_sim_node::cli;

/// Run the simulated room: users, obstacles, mirrors, reports.
#[derive(Debug, Parser)]
#[command(name = "heliostat-sim-node", version)]
struct Command {
    #[command(flatten)]
    args: cli::Args,
}

fn main() -> ExitCode {
    match cli::run(Command::parse().args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            drop(writeln!(std::io::stderr(), "heliostat-sim-node: {error:#}"));
            ExitCode::FAILURE
        }
    }
}
