//! `heliostat-lab bench`: times and rates, each beside a reference measured in the same run.
//!
//! `heliostat bench` has the decision and the loop; the variants here measure with its code.

mod belief;
mod demo;
mod env;
mod moving;
mod oracle;
mod room;

use anyhow::Result;
use heliostat::commands::bench::{decide, wire};

/// Measure times and rates, each beside a reference of the same run.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Environment steps a second on one core, beside a straightforward scalar implementation
    Env(env::Args),
    /// Time of one solution of the oracle, without and with minimum rates, beside the model-based
    /// policies
    Oracle(oracle::Args),
    /// The belief for each report and the observation, beside one evaluation of the channel model
    Belief(belief::Args),
    /// The decision with 49 to 4096 mirrors
    Mirrors(decide::Args),
    /// The decision with 1 to 50 users
    Users(decide::Args),
    /// From report to command with 1 to 64 rooms on one controller process, beside an echo
    Rooms(wire::Args),
    /// The decision of every policy, beside the inference engine alone
    Policies(decide::Args),
    /// Decisions over 0.5 ms of the demo, beside those of the policy hold, on a quiet and on a busy
    /// machine
    Demo(demo::Args),
}

/// Runs the benchmark.
pub fn run(args: Args) -> Result<()> {
    match args.what {
        What::Env(args) => env::run(&args),
        What::Oracle(args) => oracle::run(&args),
        What::Belief(args) => belief::run(&args),
        What::Mirrors(args) => decide::mirrors(&args),
        What::Users(args) => decide::users(&args),
        What::Rooms(args) => wire::run_rooms(&args),
        What::Policies(args) => decide::policies(&args),
        What::Demo(args) => demo::run(&args),
    }
}
