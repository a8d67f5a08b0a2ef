//! The controller as a separate program, for deployment.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use heliostat_controller::cli;
use heliostat_models::library::LibraryArgs;
use heliostat_service::exit::{self, UnusableInput};
use heliostat_service::process::allow_files;

#[derive(Parser)]
#[command(name = "heliostat-controller", version)]
struct Program {
    #[command(flatten)]
    library: LibraryArgs,
    #[command(flatten)]
    args: cli::Args,
    /// An array in the same process, which `heliostat controller` alone has
    #[arg(long, value_name = "FILE", hide = true)]
    driver: Option<PathBuf>,
}

fn main() -> ExitCode {
    exit::run("heliostat-controller", || {
        let Program { library, args, driver } = Program::parse();
        if driver.is_some() {
            let advice = "this program drives no array: use `heliostat controller --driver FILE`, or `heliostat driver run --config FILE` beside it";
            return Err(UnusableInput::new(advice).into());
        }
        allow_files()?;
        library.apply();
        cli::run(args)
    })
}
