//! `heliostat bench`: figures of speed, each beside a reference measured in the same run.

mod env;

use anyhow::Result;

/// Measure speed, each figure beside a reference measured in the same run.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Environment steps a second on one core, beside a straightforward scalar implementation
    Env(env::Args),
}

/// Runs the benchmark.
pub fn run(args: Args) -> Result<()> {
    match args.what {
        What::Env(args) => env::run(&args),
    }
}
