//! The driver as a program of its own; `heliostat driver` is the same.

use std::process::ExitCode;

use clap::Parser;
use heliostat_driver::cli;
use heliostat_service::exit;
use heliostat_service::process::allow_files;

/// Drive real mirrors, or check a driver against the contract.
#[derive(Debug, Parser)]
#[command(name = "heliostat-driver", version)]
struct Program {
    #[command(flatten)]
    args: cli::Args,
}

fn main() -> ExitCode {
    exit::run("heliostat-driver", || {
        let Program { args } = Program::parse();
        allow_files()?;
        cli::run(args)
    })
}
