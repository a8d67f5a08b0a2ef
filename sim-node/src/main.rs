//! The simulated room as a program of its own.

use std::process::ExitCode;

use clap::Parser;
use heliostat_service::exit;
use heliostat_sim_node::cli;

/// A simulated room: walking users, obstacles, mirrors, measured rates.
#[derive(Debug, Parser)]
#[command(name = "heliostat-sim-node", version)]
struct Command {
    #[command(flatten)]
    args: cli::Args,
}

fn main() -> ExitCode {
    exit::run("heliostat-sim-node", || cli::run(Command::parse().args))
}
