//! `heliostat-lab eval`: policies on the same states, compared with the oracle.

mod cells;
mod csv_files;
mod differences;
mod html;
mod interruption;
mod notes;
mod origin;
mod output;
mod paths;
mod point_tables;
mod sweep;

use std::convert::Infallible;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, anyhow, ensure};
use clap::ValueEnum;
use heliostat_core::policy::PolicyKind;
use heliostat_environment::episodes::INSTANTS;
use heliostat_environment::exact_states;
use heliostat_environment::thread_count::THREADS_MAX;
use heliostat_learn::comparison::{EvaluatedPolicy, Known, Loop, Report, Settings};
use heliostat_learn::threads::on_threads;
use heliostat_models::ActorSource;
use heliostat_scenario::{Belief, Scenario, ScenarioArgs, override_keys};
use heliostat_service::duration::seconds;
use serde_json::json;

use heliostat_service::exit::{self, UnusableInput};
use heliostat_service::outln;
use heliostat_service::whole_file;
use interruption::Interruption;
use sweep::{Change, Grid, Sweep};

/// The default policies; the first only if an actor is built in for the room.
const DEFAULT_POLICIES: [&str; 7] = ["ddpg", "greedy", "fixed-point", "nearest", "random", "flat", "no-irs"];

/// Why a policy can have a larger sum rate than the oracle.
pub const ABOVE_ONE: &str = "a ratio can exceed 1: the oracle gives up sum rate to meet minimum rates, and a policy may leave users \
     below them. The oracle is a local optimum, no upper bound";

/// Marks the name of a policy that is not told apart from the best one.
pub const NEAR_BEST: &str = "~";

/// What the mark [`NEAR_BEST`] means.
pub const NEAR_BEST_NOTE: &str = "not distinguishable from the best: the interval of the paired difference to the largest ratio \
     includes 0";

/// What a marked interval means.
pub const CROSSES_NOTE: &str = "the interval reaches beyond what the figure can be, such as below 0";

/// The name of the oracle's row.
pub const ORACLE: &str = "(oracle)";

/// The key for which `--blocked` is short.
const FORCED_USERS: &str = "blockage.forced_users";

/// What serves instead of an array without rows or columns, which no scenario describes.
const WITHOUT_MIRRORS: &str = "for a room without mirrors choose the policy no-irs, or --sweep mirrors.rows=0";

/// Whether a ratio exceeds 1 in the digits of a table.
pub fn exceeds_one(ratio: f64) -> bool {
    ratio >= 1.0005
}

/// Compare policies with the oracle on the same states.
///
/// The oracle is the best local optimum that the solver finds from the true state. It penalises
/// rates below the minimum. By default each policy observes exact held-out states, and its mirrors
/// move instantly. With --closed-loop, reports and mirrors have the rate, delay, noise and dynamics
/// of the scenario. The oracle still knows the true state and moves its mirrors instantly. The
/// decision time is that of the policy; in closed loop it includes belief and observation.
///
/// A learned policy is evaluated once per training seed: the shipped actor has seed 1, the others are
/// in the folder lab/actors. The confidence interval includes the variation across training seeds.
///
/// Tables and files follow the last comparison. Ctrl-C ends the command without them, and reports the
/// progress.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Policies by name, paths of ONNX actors (FILE.onnx), or functions in Python (FILE.py:FUNCTION),
    /// separated by commas [default: ddpg if an actor fits, greedy, fixed-point, nearest, random, flat,
    /// no-irs]
    #[arg(long, value_name = "A,B,C", value_delimiter = ',', value_parser = trimmed)]
    policies: Vec<String>,
    /// Leave out policies that have no actor for the room, instead of an error
    #[arg(long)]
    fitting: bool,
    /// ONNX file of the policy ddpg, instead of the built-in ones
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Use the actor of this training seed only, instead of all
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    training_seed: Option<u32>,
    /// States for each seed
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    states: u32,
    /// Episodes for each seed, in place of --states: 20 states each in closed loop, one state each
    /// otherwise. Intervals come from episodes, so use at least 10 of all seeds together
    #[arg(long, value_name = "N", conflicts_with = "states", value_parser = clap::value_parser!(u32).range(1..=50_000))]
    episodes: Option<u32>,
    /// Number of seeds, counted up from the scenario's. Each episode, or state of a static comparison, is a
    /// room with a seed of its own
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
    /// Add a row for each policy that observes users, which ignores which mirrors are unusable
    #[arg(long, requires = "closed_loop")]
    unaware: bool,
    /// Repeat the comparison for each value of a scenario key: table.key=FIRST..LAST or
    /// table.key=A,B,C; given twice, for each combination of two keys. A value may be a list, as in
    /// `led.positions_m=[[0,0,3]],[[1,0,3],[-1,0,3]]`. mirrors.rows=0 is a room without mirrors
    #[arg(long, value_name = "KEY=VALUES")]
    sweep: Vec<Sweep>,
    /// Threads that evaluate at the same time; the figures are the same for any number, decision times excepted: those
    /// of 1 are undisturbed [default: RAYON_NUM_THREADS, or one for each processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(THREADS_MAX)))]
    threads: Option<u16>,
    /// Also write the figures to a CSV file, one line for each policy
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Also write the figures of each episode to a CSV file, one line for each policy and episode
    #[arg(long, value_name = "FILE")]
    csv_episodes: Option<PathBuf>,
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
    /// The room, with further overrides.
    fn scenario(&self, change: Vec<String>) -> Result<Scenario> {
        let mut scenario = self.scenario.clone();
        scenario.overrides.extend(self.blocked.map(|blocked| format!("{FORCED_USERS}={blocked}")));
        scenario.overrides.extend(change);
        let mut changed = scenario.overrides.iter().filter_map(|text| text.split_once('='));
        let is_without = changed.any(|(key, value)| sweep::is_without_mirrors(key.trim(), value.trim()));
        let loaded = scenario.load_arrays().map_err(|error| match is_without {
            true => anyhow!("{error}; {WITHOUT_MIRRORS}"),
            false => error.into(),
        })?;
        if !self.closed_loop {
            exact_states::check_overrides(&scenario.overrides)?;
        }
        Ok(loaded)
    }

    /// Refuses a key that two flags fix, or that a sweep varies and another flag fixes.
    fn check_keys(&self) -> Result<()> {
        let set: Vec<String> = self.scenario.overrides.iter().flat_map(|text| override_keys(text)).collect();
        ensure!(
            self.blocked.is_none() || set.iter().all(|key| key != FORCED_USERS),
            "--blocked and --set both fix {FORCED_USERS}: expected one of the two"
        );
        let of_set = set.iter().map(|key| ("--set", key.as_str()));
        let of_blocked = self.blocked.map(|_| ("--blocked", FORCED_USERS));
        let of_seed = self.scenario.seed.map(|_| ("--seed", "seed"));
        for (flag, key) in of_set.chain(of_blocked).chain(of_seed) {
            // A value of a swept table replaces the keys of the table.
            let varies = |sweep: &Sweep| {
                key.strip_prefix(sweep.key()).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
            };
            ensure!(
                !self.sweep.iter().any(varies),
                "{flag} fixes {key}, which --sweep varies: expected one of the two"
            );
        }
        Ok(())
    }

    /// Refuses files that cannot be written, and one file for two flags.
    fn check_files(&self) -> Result<()> {
        let files = [
            ("--csv", self.csv.as_ref()),
            ("--csv-episodes", self.csv_episodes.as_ref()),
            ("--html", self.html.as_ref()),
            ("--paths", self.paths.as_ref()),
        ];
        whole_file::check_distinct(files)?;
        files.into_iter().filter_map(|(_, file)| file).try_for_each(|file| whole_file::check_writable(file))
    }

    /// The number of states for each seed.
    fn states(&self) -> usize {
        let each = if self.closed_loop { INSTANTS } else { 1 };
        self.episodes.map_or(self.states as usize, |episodes| episodes as usize * each)
    }

    /// The settings of a comparison, at a point of a sweep if there is one.
    fn settings(&self, change: Option<Change>) -> Result<Settings> {
        let Change { overrides, without_mirrors } =
            change.unwrap_or(Change { overrides: Vec::new(), without_mirrors: false });
        let scenario = self.scenario(overrides)?;
        let actor = ActorSource::from(self.model.clone());
        ensure!(
            self.model.is_none()
                || self.policies.is_empty()
                || self.policies.iter().any(|name| PolicyKind::from_str(name, false) == Ok(PolicyKind::Ddpg)),
            "--model gives the actor of ddpg, but --policies does not include ddpg; give the file in --policies instead: --policies greedy,FILE.onnx"
        );
        for (index, belief) in self.beliefs.iter().enumerate() {
            ensure!(!self.beliefs[..index].contains(belief), "--beliefs names {belief} twice");
        }
        let mut policies = Vec::new();
        for (index, name) in self.policies.iter().enumerate() {
            ensure!(!self.policies[..index].contains(name), "--policies names {name} twice");
            policies.push(EvaluatedPolicy::parse(name, &actor)?);
        }
        if self.policies.is_empty() {
            policies = DEFAULT_POLICIES
                .map(|name| EvaluatedPolicy::parse(name, &actor))
                .into_iter()
                .collect::<Result<_, _>>()?;
            policies.retain(|evaluated| self.model.is_some() || evaluated.fits(&scenario));
        }
        // Before the work starts, and before one that does not fit is left out.
        policies.iter().try_for_each(EvaluatedPolicy::check_file)?;
        if self.fitting {
            policies.retain(|evaluated| evaluated.fits(&scenario));
            ensure!(!policies.is_empty(), "--fitting: no policy of --policies fits the room of {}", scenario.name);
        }
        let known = [Known::Present, Known::Future];
        let ceilings = policies.iter().map(|first| known.map(|known| first.knowing(known)));
        let ceilings = ceilings.filter(|_| self.ceilings).find_map(|[present, future]| present.zip(future));
        let policies = policies.into_iter().flat_map(|evaluated| {
            let mut believing: Vec<_> =
                self.beliefs.iter().filter_map(|belief| evaluated.with_belief(*belief)).collect();
            let unaware = evaluated.unaware().filter(|_| self.unaware);
            if believing.is_empty() {
                believing.push(evaluated);
            }
            believing.into_iter().chain(unaware)
        });
        let policies = policies.chain(ceilings.into_iter().flat_map(|(present, future)| [present, future]));
        Ok(Settings {
            scenario,
            policies: policies.map(|one| if without_mirrors { one.without_mirrors() } else { one }).collect(),
            without_mirrors,
            states: self.states(),
            seeds: self.seeds as usize,
            mode: if self.closed_loop { Loop::ClosedLoop } else { Loop::Static },
            warm: self.warm,
            training_seed: self.training_seed,
        })
    }
}

/// Names the keys of a sweep that change no figure, such as one that another key makes useless.
fn note_without_effect(grid: &Grid, reports: &[Report]) {
    let figures: Vec<Vec<u64>> = reports.iter().map(output::figures).collect();
    for key in grid.without_effect(&figures) {
        let reason = "no effect: the figures are equal for all of its values";
        heliostat_service::output::note(format_args!("--sweep {key}: {reason}"));
    }
}

/// Names the point of a sweep that begins, where no progress bar is shown.
fn note_point(grid: Option<&Grid>, index: usize) {
    if let Some(grid) = grid.filter(|_| !std::io::stderr().is_terminal()) {
        let points = grid.points();
        let (number, of, name) = (index + 1, points.len(), grid.name(&points[index]));
        heliostat_service::output::note(format_args!("eval: {number} of {of}: {name}"));
    }
}

/// Runs the command.
pub fn run(args: Args) -> Result<()> {
    let grid = Grid::new(&args.sweep).map_err(UnusableInput::new)?;
    let grid = grid.as_ref();
    args.check_keys().map_err(exit::unusable)?;
    let settings: Vec<Settings> = match grid {
        None => vec![args.settings(None).map_err(exit::unusable)?],
        // An invalid value is refused before the work starts.
        Some(grid) => {
            let points = grid.points().iter().zip(grid.changes());
            let of_point = |(point, change): (&Vec<&str>, Change)| {
                args.settings(Some(change)).with_context(|| format!("--sweep at {}", grid.name(point)))
            };
            points.map(of_point).collect::<Result<_>>().map_err(exit::unusable)?
        }
    };
    if let (Some(grid), Some(first)) = (grid, settings.first()) {
        grid.check_noise(&first.scenario).map_err(UnusableInput::new)?;
    }
    args.check_files()?;
    let interruption = Interruption::watch(settings.len())?;
    let compared = || {
        let points = settings.iter().enumerate().map(|(index, one)| {
            note_point(grid, index);
            interruption.compare(one)
        });
        points.collect::<Result<Vec<_>>>()
    };
    let reports = on_threads(args.threads.map_or(0, usize::from), compared)??;
    if let Some(grid) = grid {
        note_without_effect(grid, &reports);
    }
    if let Some(file) = &args.paths {
        let drawn = paths::draw(&settings[0].scenario, &reports[0].tracked)?;
        whole_file::write(file, origin::in_svg(&drawn, &reports[0]).as_bytes())?;
    }
    if let Some(file) = &args.csv {
        whole_file::write(file, &csv_files::by_policy(grid, &reports)?)?;
    }
    if let Some(file) = &args.csv_episodes {
        whole_file::write(file, &csv_files::by_episode(grid, &reports)?)?;
    }
    if let Some(file) = &args.html {
        html::write(file, &settings[0].scenario, grid, &reports)?;
    }
    match grid {
        None if args.json => outln!("{}", origin::in_json(&reports[0])?)?,
        None => output::print_table(&reports[0])?,
        Some(grid) if args.json => {
            let bases = grid.bases();
            let of_points = grid.points().iter().zip(&reports).enumerate().map(|(index, (point, report))| {
                let report = origin::in_json(report)?;
                let mut entry = json!({ "values": point, "report": report });
                for bases in &bases {
                    let Some(differences) = differences::to_base(&reports, bases, index) else { continue };
                    match bases.key {
                        None => entry[differences::TO_FIRST] = differences,
                        Some(key) => entry[differences::ALONG][key] = differences,
                    }
                }
                Ok(entry)
            });
            let reports = of_points.collect::<Result<Vec<_>>>()?;
            let keys: Vec<&str> = grid.keys().collect();
            outln!("{}", json!({ "keys": keys, "reports": reports }))?;
        }
        Some(grid) => output::print_sweep(grid, &reports)?,
    }
    Ok(())
}

/// A name without the spaces around it, as after a comma in quotation marks.
fn trimmed(text: &str) -> Result<String, Infallible> {
    Ok(text.trim().to_owned())
}
