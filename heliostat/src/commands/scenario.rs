//! `heliostat scenario`: checks a scenario file, writes a commented one, prints the effective one.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, Result};
use heliostat_scenario::{BUILTIN_NAMES, Scenario, ScenarioArgs};
use heliostat_sim::World;

use crate::output::outln;

/// Check, write or print a scenario.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Check a scenario file, and report errors with their line
    Check {
        /// The file
        file: String,
        /// Print the result as one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Write a commented scenario file to start from
    New {
        /// The file to create; an existing file is not overwritten
        file: PathBuf,
        /// The built-in scenario to start from
        #[arg(long, default_value = BUILTIN_NAMES[0], value_parser = BUILTIN_NAMES)]
        from: String,
    },
    /// Print the effective scenario as TOML, with every key
    Show {
        #[command(flatten)]
        scenario: ScenarioArgs,
    },
}

/// Runs the subcommand.
pub fn run(args: Args) -> Result<()> {
    match args.action {
        Action::Check { file, json } => check(file, json),
        Action::New { file, from } => {
            let mut out = OpenOptions::new().write(true).create_new(true).open(&file).with_context(|| {
                format!(
                    "cannot write {}: expected a file that does not exist yet, in a folder that exists",
                    file.display()
                )
            })?;
            out.write_all(Scenario::builtin_text(&from)?.as_bytes())?;
            outln!("wrote {}; check it with: heliostat scenario check {}", file.display(), file.display())?;
            Ok(())
        }
        Action::Show { scenario } => {
            outln!("{}", scenario.load()?.to_toml().trim_end())?;
            Ok(())
        }
    }
}

fn check(file: String, json: bool) -> Result<()> {
    let args = ScenarioArgs { scenario: file, ..ScenarioArgs::default() };
    let verdict = args.load().map_err(anyhow::Error::from).and_then(|scenario| {
        // Building the world finds further errors, such as an unreadable recording of users.
        World::new(&scenario, scenario.read_trace()?.as_deref(), scenario.seed)?;
        Ok(scenario)
    });
    if json {
        let problem = verdict.as_ref().err().map(|error| format!("{error:#}"));
        outln!("{}", serde_json::json!({ "file": args.scenario, "valid": verdict.is_ok(), "problem": problem }))?;
    } else if let Ok(scenario) = &verdict {
        outln!(
            "{}: valid: {} mode, {} users, {} x {} mirrors, configuration {}",
            args.scenario,
            scenario.channel.mode.name(),
            scenario.users.count,
            scenario.mirrors.rows,
            scenario.mirrors.columns,
            scenario.hash()
        )?;
    }
    verdict.map(|_| ()).with_context(|| format!("{} cannot be used", args.scenario))
}
