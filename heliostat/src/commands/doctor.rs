//! `heliostat doctor`: checks before a run, with what was found and what to do.

mod machine;
mod system;

use std::fmt;
use std::path::PathBuf;

use anyhow::{Result, bail};
use heliostat_decide::policy::PolicyKind;
use heliostat_scenario::ScenarioArgs;
use serde::Serialize;

use crate::output::outln;

/// Check what a run needs: scenario, policy, driver, ports, clock, permissions, processors.
///
/// Each line holds ok, warn or fail, what was found, and what to do. The exit status is 1 if a
/// check fails. A warning concerns speed or accuracy; a run is still possible.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Policy of the planned run
    #[arg(long, value_enum, default_value_t = PolicyKind::Ddpg)]
    policy: PolicyKind,
    /// ONNX file of a learned policy, instead of the built-in one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Name of the room
    #[arg(long, value_name = "NAME", default_value = "demo")]
    room: String,
    /// Endpoint of a driver or simulator whose capabilities are checked (repeatable)
    #[arg(long, value_name = "ENDPOINT")]
    connect: Vec<String>,
    /// Port of 127.0.0.1 that must be free (repeatable)
    #[arg(long, value_name = "PORT", default_values_t = [7447], value_parser = clap::value_parser!(u16).range(1..))]
    port: Vec<u16>,
    /// Print the checks as one JSON object
    #[arg(long)]
    json: bool,
}

/// Result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Verdict {
    Ok,
    Warn,
    Fail,
}

impl fmt::Display for Verdict {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(match self {
            Self::Ok => "ok",
            Self::Warn => "warn",
            Self::Fail => "fail",
        })
    }
}

/// One check and its result.
#[derive(Clone, Debug, Serialize)]
struct Check {
    name: &'static str,
    verdict: Verdict,
    found: String,
    /// What to do; empty if nothing.
    advice: String,
}

impl Check {
    fn ok(name: &'static str, found: impl Into<String>) -> Self {
        Self { name, verdict: Verdict::Ok, found: found.into(), advice: String::new() }
    }

    fn warn(name: &'static str, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { name, verdict: Verdict::Warn, found: found.into(), advice: advice.into() }
    }

    fn fail(name: &'static str, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { name, verdict: Verdict::Fail, found: found.into(), advice: advice.into() }
    }
}

/// Runs the command.
pub fn run(args: Args) -> Result<()> {
    let mut checks = system::checks(&args);
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
        1 => bail!("1 check failed"),
        _ => bail!("{failures} checks failed"),
    }
}
