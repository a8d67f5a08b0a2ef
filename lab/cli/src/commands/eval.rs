//! `heliostat-lab eval`: policies on the same states, compared with the oracle.

mod html;
mod output;
mod paths;
mod sweep;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Result, ensure};
use heliostat_learn::comparison::{EvaluatedPolicy, Known, Loop, Settings, compare};
use heliostat_models::{ActorSource, EngineChoice};
use heliostat_scenario::{Belief, Scenario, ScenarioArgs};
use heliostat_service::duration::seconds;

use super::whole_file;
use heliostat_service::outln;
use html::Destination;
use sweep::Sweep;

/// The default policies; the first only if an actor is built in for the room.
const DEFAULT_POLICIES: [&str; 7] = ["ddpg", "greedy", "fixed-point", "nearest", "random", "flat", "no-irs"];

/// Compare policies with the oracle on the same states.
///
/// The oracle is the best local optimum that the solver finds from the true state. It penalises
/// rates below the minimum. A learned policy is evaluated once per built-in actor; actors differ in
/// their training seed. The confidence interval includes the variation across training seeds. By
/// default each policy observes exact held-out states, and its mirrors move instantly. With
/// --closed-loop, reports and mirrors have the rate, delay, noise and dynamics of the scenario. The
/// oracle still knows the true state and moves its mirrors instantly. The decision time is that of
/// the policy; in closed loop it includes belief and observation.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Policies by name, or paths of ONNX actors (FILE.onnx), separated by commas [default: ddpg if
    /// an actor fits, greedy, fixed-point, nearest, random, flat, no-irs]
    #[arg(long, value_name = "A,B,C", value_delimiter = ',')]
    policies: Vec<String>,
    /// Leave out policies that have no actor for the room, instead of an error
    #[arg(long)]
    fitting: bool,
    /// ONNX file of the policy ddpg, instead of the built-in ones
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Engine of learned policies: `auto` (dense for graphs of dense layers, otherwise the embedded
    /// one), `dense`, or the embedded one by its name (`tract`, or `ort` in builds with ONNX Runtime)
    #[arg(long, default_value_t = EngineChoice::Auto)]
    engine: EngineChoice,
    /// Use the built-in actor of this training seed only, instead of all
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    training_seed: Option<u32>,
    /// States for each room seed
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    states: u32,
    /// Number of room seeds, counted up from the scenario's
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    seeds: u32,
    /// Users whose direct path is blocked: short for --set blockage.forced_users=B
    #[arg(long, value_name = "B")]
    blocked: Option<usize>,
    /// Simulate reports, delays, noise and mirror dynamics, instead of using held-out states
    #[arg(long)]
    closed_loop: bool,
    /// Evaluate each policy with these beliefs about the users, instead of the scenario's
    #[arg(long, requires = "closed_loop", value_name = "A,B,C", value_delimiter = ',', value_enum)]
    beliefs: Vec<Belief>,
    /// Time in s from the controller's start to the first measured instant of an episode, at least 0.01
    #[arg(long, requires = "closed_loop", value_name = "SECONDS", default_value = "1", value_parser = seconds, allow_negative_numbers = true)]
    warm: Duration,
    /// Add two rows: the first policy that observes users, with the true room in place of reports, now
    /// and in the middle of the command's time in force
    #[arg(long, requires = "closed_loop")]
    ceilings: bool,
    /// Add a row for each policy that ignores which mirrors are unusable
    #[arg(long, requires = "closed_loop")]
    unaware: bool,
    /// Repeat the comparison for each value of a scenario key: table.key=FIRST..LAST or
    /// table.key=A,B,C
    #[arg(long, value_name = "KEY=VALUES")]
    sweep: Option<Sweep>,
    /// Also write the figures to a CSV file, one line for each policy
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Also write a report with tables and plots to one HTML file that needs no other file
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Also draw the users of the first episode, true and as the first policy's filter predicts them, as
    /// an SVG file
    #[arg(long, requires = "closed_loop", conflicts_with = "sweep", value_name = "FILE")]
    paths: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Args {
    /// The room, with one more override if given.
    fn scenario(&self, change: Option<String>) -> Result<Scenario> {
        let mut scenario = self.scenario.clone();
        scenario.overrides.extend(self.blocked.map(|blocked| format!("blockage.forced_users={blocked}")));
        scenario.overrides.extend(change);
        Ok(scenario.load_arrays()?)
    }

    /// The settings of a comparison, with one more override of the scenario if given.
    fn settings(&self, change: Option<String>) -> Result<Settings> {
        let scenario = self.scenario(change)?;
        let actor = self.model.clone().map_or(ActorSource::Shipped, ActorSource::Path);
        ensure!(
            self.model.is_none()
                || self.policies.is_empty()
                || self.policies.iter().any(|name| name == "ddpg" || name == "actor"),
            "--model gives the actor of ddpg, but --policies does not include ddpg; give the file in --policies instead: --policies greedy,FILE.onnx"
        );
        let mut policies = Vec::new();
        for (index, name) in self.policies.iter().enumerate() {
            ensure!(!self.policies[..index].contains(name), "--policies names {name} twice");
            policies.push(EvaluatedPolicy::parse(name, &actor)?.on(self.engine));
        }
        if self.fitting {
            policies.iter().try_for_each(EvaluatedPolicy::check_file)?;
            policies.retain(|evaluated| evaluated.fits(&scenario));
            ensure!(!policies.is_empty(), "--fitting: no policy of --policies fits the room of {}", scenario.name);
        }
        if self.policies.is_empty() {
            policies = DEFAULT_POLICIES
                .map(|name| EvaluatedPolicy::parse(name, &actor).map(|policy| policy.on(self.engine)))
                .into_iter()
                .collect::<Result<_, _>>()?;
            policies.retain(|evaluated| self.model.is_some() || evaluated.fits(&scenario));
        }
        let known = [Known::Present, Known::Future];
        let ceilings = policies.iter().map(|first| known.map(|known| first.knowing(known)));
        let ceilings = ceilings.filter(|_| self.ceilings).find_map(|[present, future]| present.zip(future));
        let policies = policies.into_iter().flat_map(|evaluated| {
            let mut believing: Vec<_> =
                self.beliefs.iter().filter_map(|belief| evaluated.with_belief(*belief)).collect();
            let unaware = self.unaware.then(|| evaluated.unaware());
            if believing.is_empty() {
                believing.push(evaluated);
            }
            believing.into_iter().chain(unaware)
        });
        Ok(Settings {
            scenario,
            policies: policies.chain(ceilings.into_iter().flat_map(|(present, future)| [present, future])).collect(),
            states: self.states as usize,
            seeds: self.seeds as usize,
            mode: if self.closed_loop { Loop::ClosedLoop } else { Loop::Static },
            warm: self.warm,
            training_seed: self.training_seed,
        })
    }
}

/// Runs the command.
pub fn run(args: Args) -> Result<()> {
    let sweep = args.sweep.as_ref();
    let settings: Vec<Settings> = match sweep {
        None => vec![args.settings(None)?],
        // An invalid value is refused before the work starts.
        Some(sweep) => sweep.overrides().map(|change| args.settings(Some(change))).collect::<Result<_>>()?,
    };
    if let Some(file) = &args.csv {
        whole_file::check_writable(file)?;
    }
    if let Some(file) = &args.paths {
        whole_file::check_writable(file)?;
    }
    let html = args.html.as_deref().map(Destination::new).transpose()?;
    let reports = settings.iter().map(compare).collect::<Result<Vec<_>>>()?;
    if let Some(file) = &args.paths {
        whole_file::write(file, paths::draw(&settings[0].scenario, &reports[0].tracked)?.as_bytes())?;
    }
    if let Some(file) = &args.csv {
        whole_file::write(file, &output::csv(sweep, &reports)?)?;
    }
    if let Some(html) = html {
        html.write(&settings[0].scenario, sweep, &reports)?;
    }
    match sweep {
        None if args.json => outln!("{}", serde_json::to_string(&reports[0])?)?,
        None => output::print_table(&reports[0])?,
        Some(sweep) if args.json => {
            let of_values = sweep.values().iter().zip(&reports);
            let of_values = of_values.map(|(value, report)| serde_json::json!({ "value": value, "report": report }));
            let all: Vec<_> = of_values.collect();
            outln!("{}", serde_json::json!({ "sweep": sweep.key(), "reports": all }))?;
        }
        Some(sweep) => output::print_sweep(sweep, &reports)?,
    }
    Ok(())
}
