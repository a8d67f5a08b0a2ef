//! The simulated room as a program of its own.

use std::process::ExitCode;

use clap::Parser;
use heliostat_service::exit;
use heliostat_sim_node::cli;

/// Run the simulated room: users, obstacles, mirrors, reports.
#[derive(Debug, Parser)]
#[command(name = "heliostat-sim-node", version)]
struct Command {
    #[command(flatten)]
    args: cli::Args,
}

fn main() -> ExitCode {
    exit::run("heliostat-sim-node", || cli::run(Command::parse().args))
}
