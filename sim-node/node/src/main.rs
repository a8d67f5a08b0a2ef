//! The simulated room as a program of its own.

use std::process::ExitCode;

use clap::Parser;
use heliostat_service::exit;
use heliostat_service::process::allow_files;
use heliostat_sim_node::cli;

/// Run the simulated room: users, obstacles, mirrors, reports.
#[derive(Debug, Parser)]
#[command(name = "heliostat-sim-node", version)]
struct Command {
    #[command(flatten)]
    args: cli::Args,
}

fn main() -> ExitCode {
    exit::run("heliostat-sim-node", || {
        let Command { args } = Command::parse();
        allow_files()?;
        cli::run(args)
    })
}
