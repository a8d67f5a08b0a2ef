//! The controller as a program of its own, for deployment.

use std::process::ExitCode;

use clap::Parser;
use heliostat_controller::cli;
use heliostat_service::exit;

#[derive(Parser)]
#[command(name = "heliostat-controller", version)]
struct Program {
    #[command(flatten)]
    args: cli::Args,
}

fn main() -> ExitCode {
    exit::run("heliostat-controller", || cli::run(Program::parse().args))
}
