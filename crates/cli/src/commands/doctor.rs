//! `heliostat doctor`: checks before a run, with what was found and what to do.

mod args;
mod calibration;
mod certificate;
mod check;
mod controller;
mod geometry;
mod machine;
mod system;

use anyhow::{Result, bail};

use heliostat_service::counted::counted;

pub use args::Args;
use check::{Check, Verdict};
use heliostat_service::outln;

/// Runs the command.
pub fn run(args: Args) -> Result<()> {
    let mut checks = system::checks(&args);
    checks.extend(certificate::check(&args));
    checks.extend(machine::checks());
    let count = |verdict| checks.iter().filter(|check| check.verdict == verdict).count();
    let (warnings, failures) = (count(Verdict::Warn), count(Verdict::Fail));
    if args.json {
        outln!("{}", serde_json::json!({ "checks": checks, "warnings": warnings, "failures": failures }))?;
    } else {
        for Check { name, verdict, found, advice } in &checks {
            outln!("{verdict:<5} {name:<16} {found}")?;
            if !advice.is_empty() {
                outln!("{:<22} -> {advice}", "")?;
            }
        }
    }
    match failures {
        0 => Ok(()),
        _ => bail!("{} failed", counted(failures, "check")),
    }
}
