//! `heliostat eval --suite`: policies on a fixed list of tasks.
//!
//! A task is one `heliostat eval` command ([`tasks`]), which runs in a process of its own with the
//! policies that fit its room. [`standing`] sums up the tasks, and [`page`] writes the leaderboard.

mod page;
mod standing;
mod tasks;

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Result, bail, ensure};
use heliostat_learn::comparison::EvaluatedPolicy;
use heliostat_models::ActorSource;
use heliostat_scenario::Scenario;

use crate::commands::results::archive::{self, Archive};
use crate::commands::results::pages::Section;
use crate::commands::results::steps::{self, Step};
use crate::commands::whole_file;
use crate::output::outln;
use tasks::{POLICIES, REFERENCE, TASKS};

/// Stands for every policy of the suite in `--policies`.
const ALL: &str = "all";

/// The flags of the suite.
#[derive(Debug, clap::Args)]
pub struct SuiteArgs {
    /// Compare policies on the fixed tasks of the suite, each with its own room, seeds and states. A
    /// policy takes part in the tasks whose rooms it fits. `all` in --policies stands for all policies
    /// of the suite, for example --policies all,own.onnx
    #[arg(long, conflicts_with_all = [
        "scenario", "overrides", "seed", "model", "engine", "training_seed", "states", "seeds", "blocked",
        "closed_loop", "beliefs", "warm", "ceilings", "unaware", "sweep", "csv", "html",
    ])]
    suite: bool,
    /// Fewer states and seeds: checks that every task works; the figures mean little
    #[arg(long, requires = "suite")]
    quick: bool,
    /// Run only these tasks of the suite, by their names
    #[arg(long, requires = "suite", value_name = "TASK,..", value_delimiter = ',')]
    tasks: Vec<String>,
    /// Write the leaderboard to this Markdown file, with a JSON file of the same name beside it, again
    /// after each finished task [default: print it]
    #[arg(long, requires = "suite", value_name = "FILE")]
    out: Option<PathBuf>,
    /// Keep the tasks of --out that the same command finished at the same commit
    #[arg(long, requires = "out")]
    resume: bool,
}

impl SuiteArgs {
    /// Whether the suite is to run.
    pub fn is_chosen(&self) -> bool {
        self.suite
    }
}

/// Reads the room of a task from the arguments of its command.
pub type RoomOf<'a> = &'a dyn Fn(&[String]) -> Result<Scenario>;

/// Runs the suite.
///
/// # Errors
/// An unknown task or policy, a named policy that fits no task, a file that cannot be written, or a task that
/// fails.
pub fn run(args: &SuiteArgs, policies: &[String], json: bool, room_of: RoomOf) -> Result<()> {
    let steps = steps_of(args, policies, room_of)?;
    let mut archive = Archive::new(&page::archive_name(), args.quick);
    let kept = args.out.as_ref().map(|out| Ok::<_, anyhow::Error>((out, archive::beside(out)?))).transpose()?;
    if let Some((_, kept)) = kept.as_ref().filter(|_| args.resume) {
        archive = steps::resumed(kept, &page::archive_name(), args.quick)?;
    }
    steps::run(&steps, &mut archive, |archive| {
        let Some((out, kept)) = &kept else { return Ok(()) };
        archive.write(kept)?;
        whole_file::write(out, page::markdown(archive)?.as_bytes())
    })?;
    match &kept {
        _ if json => outln!("{}", page::json(&archive)?)?,
        Some((out, kept)) => outln!("written: {} and {}", out.display(), kept.display())?,
        None => outln!("{}", page::markdown(&archive)?.trim_end())?,
    }
    Ok(())
}

/// The policies to compare, the reference first.
fn compared(named: &[String]) -> Result<Vec<(String, EvaluatedPolicy)>> {
    let all = [ALL.to_owned()];
    let named = if named.is_empty() { &all } else { named };
    let expanded = named.iter().flat_map(|name| if name == ALL { POLICIES.to_vec() } else { vec![name.as_str()] });
    let mut names = vec![REFERENCE];
    let mut named_reference = false;
    for name in expanded {
        let is_first_reference = name == REFERENCE && !std::mem::replace(&mut named_reference, true);
        ensure!(is_first_reference || !names.contains(&name), "--policies names {name} twice");
        if !is_first_reference {
            names.push(name);
        }
    }
    let parse = |name: &str| Ok((name.to_owned(), EvaluatedPolicy::parse(name, &ActorSource::Shipped)?));
    names.into_iter().map(parse).collect()
}

/// The tasks to run, each with the policies that fit its room. A learned policy without a built-in actor
/// fits none, which is an error only if it was named.
fn steps_of(args: &SuiteArgs, named: &[String], room_of: RoomOf) -> Result<Vec<Step<'static>>> {
    let policies = compared(named)?;
    policies.iter().try_for_each(|(_, policy)| policy.check_file())?;
    let names: Vec<&str> = TASKS.iter().map(|task| task.name).collect();
    for name in &args.tasks {
        ensure!(names.contains(&name.as_str()), "--tasks {name}: expected one of {}", names.join(", "));
    }
    let chosen = TASKS.iter().filter(|task| args.tasks.is_empty() || args.tasks.iter().any(|name| name == task.name));
    let (mut steps, mut fitting, mut refusals) = (Vec::new(), Vec::new(), BTreeMap::new());
    for task in chosen {
        let mut arguments = task.arguments(args.quick);
        let scenario = room_of(&arguments)?;
        let mut fit = Vec::new();
        for (name, policy) in &policies {
            match policy.check_fits(&scenario) {
                Ok(()) => fit.push(name.as_str()),
                Err(refusal) => drop(refusals.insert(name.as_str(), (task.name, refusal))),
            }
        }
        arguments.extend(["--policies".into(), fit.join(",")]);
        fitting.extend(fit);
        steps.push((task as &Section, arguments));
    }
    let mut unfit = named.iter().filter(|name| !fitting.contains(&name.as_str()));
    if let Some((name, (task, refusal))) = unfit.find_map(|name| refusals.remove_entry(name.as_str())) {
        bail!("policy {name} fits none of the chosen rooms, and not that of {task}: {refusal:#}");
    }
    Ok(steps)
}

#[cfg(test)]
mod tests {
    use super::super::room_of;
    use super::*;

    fn names(named: &[&str]) -> Result<Vec<String>> {
        let named: Vec<String> = named.iter().map(|name| (*name).to_owned()).collect();
        Ok(compared(&named)?.into_iter().map(|(name, _)| name).collect())
    }

    #[test]
    fn the_reference_comes_first_and_all_stands_for_the_suite() {
        assert_eq!(names(&["flat", "greedy"]).unwrap(), ["greedy", "flat"]);
        assert_eq!(names(&["flat"]).unwrap(), ["greedy", "flat"]);
        assert_eq!(names(&[]).unwrap(), POLICIES);
        assert_eq!(names(&["all", "own.onnx"]).unwrap()[POLICIES.len()..], ["own.onnx"]);
        for twice in [&["flat", "flat"][..], &["all", "flat"], &["greedy", "greedy"]] {
            assert!(names(twice).unwrap_err().to_string().contains("twice"), "{twice:?}");
        }
        assert!(names(&["gredy"]).unwrap_err().to_string().contains("unknown policy"));
    }

    #[test]
    fn policies_take_part_in_the_tasks_whose_rooms_they_fit() {
        let args = SuiteArgs { suite: true, quick: true, tasks: Vec::new(), out: None, resume: false };
        let named = ["ddpg", "flat"].map(String::from);
        for (task, arguments) in steps_of(&args, &named, &room_of).unwrap() {
            let learned = !["two-arrays", "office", "atrium", "corridor", "lab"].contains(&task.name);
            let expected = if learned { "greedy,ddpg,flat" } else { "greedy,flat" };
            assert_eq!(arguments.last().map(String::as_str), Some(expected), "{}", task.name);
        }
        let only = SuiteArgs { tasks: vec!["office".into()], ..args };
        let refusal = steps_of(&only, &named, &room_of).unwrap_err().to_string();
        assert!(refusal.contains("policy ddpg fits none"), "{refusal}");
        let all = steps_of(&only, &[], &room_of).unwrap().swap_remove(0).1.pop().unwrap();
        assert!(all.starts_with("greedy,oracle,") && !all.contains("ddpg"), "{all}");
    }
}
