//! The controller as a separate program, for deployment.

use std::process::ExitCode;

use clap::Parser;
use heliostat_controller::cli;
use heliostat_models::library::LibraryArgs;
use heliostat_service::exit;
use heliostat_service::process::allow_files;

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
        allow_files()?;
        library.apply();
        cli::run(args)
    })
}
