//! `heliostat bench`: times and rates, each beside a reference measured in the same run.
//!
//! `heliostat-lab bench` has the other benchmarks, some of which measure with the modules here.

mod board;
pub mod decide;
mod echo;
mod one_process;
pub mod pace;
pub mod rows;
mod usage;
mod walkers;
pub mod wire;

use anyhow::Result;

/// Measure times and rates, each beside a reference of the same run.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// The decision without transport at several rates, beside the inference engine alone
    Decide(decide::Args),
    /// From report to command between two processes, beside an echo over the same transport
    Loop(wire::LoopArgs),
    /// The controller with an array in one process, which loop --driver starts
    #[command(hide = true)]
    OneProcess(one_process::Args),
    /// The echo process, which loop and rooms start
    #[command(hide = true)]
    Echo(echo::Args),
}

/// Runs the benchmark.
pub fn run(args: Args) -> Result<()> {
    match args.what {
        What::Decide(args) => decide::decide(&args),
        What::Loop(args) => wire::run_loop(&args),
        What::OneProcess(args) => one_process::run(args),
        What::Echo(args) => echo::run(&args),
    }
}
