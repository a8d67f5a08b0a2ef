//! `heliostat-lab trace`: recorded walks from data sets and recordings, for `users.trace`.

mod export;
mod import;
mod report;
mod written;

use anyhow::Result;

/// Make a recorded walk (users.trace) from a data set or from a recording.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    Import(Box<import::ImportArgs>),
    Export(export::ExportArgs),
}

/// Runs the subcommand.
pub fn run(args: Args) -> Result<()> {
    match args.action {
        Action::Import(args) => import::run(&args),
        Action::Export(args) => export::run(&args),
    }
}
