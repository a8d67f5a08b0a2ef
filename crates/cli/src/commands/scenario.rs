//! `heliostat scenario`: checks a scenario file, writes a commented one, prints the effective one.

use std::path::PathBuf;

use anyhow::{Result, bail};
use heliostat_core::belief::conditions::conditions;
use heliostat_files::shell_word;
use heliostat_room::World;
use heliostat_scenario::{BUILTIN_NAMES, Scenario, ScenarioArgs};

use heliostat_service::counted::counted;
use heliostat_service::{outln, whole_file};

/// Check, write or print a scenario.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Check a scenario file and its recorded walk. Lists every problem with its line, and the methods of
    /// the controller's belief that do not apply to the room
    Check {
        /// The file, or the name of a built-in one
        file: String,
        /// Override any key of the scenario, for example --set blockage.forced_users=2 (repeatable)
        #[arg(long = "set", value_name = "TABLE.KEY=VALUE")]
        overrides: Vec<String>,
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
    /// Print the effective scenario as TOML, with defaults and overrides
    Show {
        /// The file, or the name of a built-in one: the same as --scenario
        #[arg(conflicts_with = "scenario")]
        file: Option<String>,
        #[command(flatten)]
        scenario: ScenarioArgs,
    },
}

/// Runs the subcommand.
pub fn run(args: Args) -> Result<()> {
    match args.action {
        Action::Check { file, overrides, json } => check(file, overrides, json),
        Action::New { file, from } => {
            whole_file::write_new(&file, Scenario::builtin_text(&from)?.as_bytes())?;
            outln!(
                "wrote {}; check it with: heliostat scenario check {}",
                file.display(),
                shell_word(&file.to_string_lossy())
            )?;
            Ok(())
        }
        Action::Show { file, scenario } => {
            let scenario = ScenarioArgs { scenario: file.unwrap_or(scenario.scenario), ..scenario };
            outln!("{}", scenario.load_arrays()?.to_toml().trim_end())?;
            Ok(())
        }
    }
}

fn check(file: String, overrides: Vec<String>, json: bool) -> Result<()> {
    let args = ScenarioArgs { scenario: file, overrides, ..ScenarioArgs::default() };
    let (scenario, problems) = problems(&args)?;
    let valid = problems.is_empty();
    let conditions = match &scenario {
        Some(scenario) if valid => conditions(scenario, &scenario.channel_model()?),
        _ => Vec::new(),
    };
    if json {
        let first = problems.first();
        outln!(
            "{}",
            serde_json::json!({
                "file": args.scenario, "valid": valid, "problem": first, "problems": problems, "conditions": conditions
            })
        )?;
    } else if let Some(scenario) = scenario.filter(|_| valid) {
        outln!(
            "{}: valid: {} mode, {}, {} mirrors, configuration {}",
            args.scenario,
            scenario.channel.mode.name(),
            counted(scenario.users.count, "user"),
            scenario.mirrors,
            scenario.hash()
        )?;
        conditions.iter().try_for_each(|condition| outln!("condition: {condition}"))?;
    }
    match problems.as_slice() {
        [] => Ok(()),
        [problem] => bail!("{} cannot be used: {problem}", args.scenario),
        several => bail!("{} cannot be used: {} problems\n{}", args.scenario, several.len(), several.join("\n")),
    }
}

/// The scenario, with defaults in place of refused keys, and all problems of the file and of its
/// recorded walk.
fn problems(args: &ScenarioArgs) -> Result<(Option<Scenario>, Vec<String>)> {
    let text = match args.text() {
        Ok(text) => text,
        Err(error) => return Ok((None, vec![error.to_string()])),
    };
    let checked = Scenario::check_all_with(&text, &args.overrides);
    let mut problems: Vec<String> = checked.problems.iter().map(ToString::to_string).collect();
    let Some(mut scenario) = checked.scenario else { return Ok((None, problems)) };
    args.find_trace(&mut scenario);
    let trace = match scenario.read_trace() {
        Ok(trace) => trace,
        Err(error) => {
            problems.push(error.to_string());
            return Ok((Some(scenario), problems));
        }
    };
    // With the default of a refused key, lines of the walk could be refused without a reason.
    let is_certain = !checked.refused_tables.iter().any(|table| table == "users" || table == "room");
    if let (Some(text), Some(path), true) = (&trace, &scenario.users.trace, is_certain) {
        let of_trace = World::trace_problems(&scenario, text);
        problems.extend(of_trace.iter().map(|problem| format!("users.trace: {path}: {problem}")));
    }
    if problems.is_empty()
        && let Err(error) = World::new(&scenario, trace.as_deref(), scenario.seed)
    {
        // Values that do not fit together, such as an LED behind the wall of the array.
        problems.push(error.to_string());
    }
    Ok((Some(scenario), problems))
}
