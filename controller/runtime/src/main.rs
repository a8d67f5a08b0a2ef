//! The controller as a separate program, for deployment.

use std::process::ExitCode;

use clap::Parser;
use heliostat_controller::cli;
use heliostat_models::library::LibraryArgs;
use heliostat_service::exit;

#[derive(Parser)]
#[command(name = "heliostat-controller", version)]
struct Program {
    #[command(flatten)]
    library: LibraryArgs,
    #[command(flatten)]
    args: cli::Args,
}

fn main() -> ExitCode {
    exit::run("heliostat-controller", || {
        let Program { library, args } = Program::parse();
        library.apply();
        cli::run(args)
    })
}
