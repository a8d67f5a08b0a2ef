//! `heliostat train`: trains a policy, shows how it goes, and leaves an actor with its card.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context;
use heliostat_decide::observation::{OBSERVATION_VERSION, USERS_CAPACITY};
use heliostat_decide::policy::actor_file::key;
use heliostat_engine::shipped;
use heliostat_scenario::{Scenario, ScenarioArgs};
use indicatif::{ProgressBar, ProgressStyle};

use crate::algorithm::{Algorithm, Preset};
use crate::card::{Card, ScoreRow, hardware};
use crate::checkpoint;
use crate::curve::Curve;
use crate::evaluate::{HeldOut, Score};
use crate::learner::Learner;
use crate::networks::on_one_thread;

/// Train a policy for a scenario and export it as an ONNX actor.
#[derive(Clone, Debug, clap::Args)]
pub struct TrainArgs {
    /// What to train
    #[arg(value_enum)]
    algorithm: Algorithm,
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Where the numbers of the run come from
    #[arg(long, value_enum, default_value_t = Preset::Tuned)]
    preset: Preset,
    /// Episodes, in place of the preset's
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    episodes: Option<u32>,
    /// Steps in an episode, in place of the preset's
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    steps: Option<u32>,
    /// Change a number of the preset, for example --option exploration.start=0.2 (repeatable); a wrong name lists all
    #[arg(long = "option", value_name = "KEY=VALUE")]
    options: Vec<String>,
    /// Folder for the actor, its card, the learning curve and the checkpoint
    #[arg(long, value_name = "DIR", default_value = "training")]
    out: PathBuf,
    /// Go on from the checkpoint in the folder
    #[arg(long)]
    resume: bool,
    /// Episodes between two checkpoints, and between two evaluations; a tenth of all, and at most 100, where it is not given
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    every: Option<u32>,
    /// Held-out states for each row of the final scores
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(2..=100_000))]
    states: u32,
    /// Print one JSON object at the end, and no progress
    #[arg(long)]
    json: bool,
}

/// States of each forced-blockage count that are watched while training goes on.
const WATCHED_STATES: usize = 24;

/// Forced-blockage counts that are watched and scored; 5 stands for all users where there are fewer.
const FORCED: [usize; 3] = [0, 2, 5];

/// User counts of the final scores, besides the scenario's own.
const USERS: [usize; 2] = [3, 8];

/// Runs the command.
///
/// # Errors
/// A scenario or option that makes no sense, or a file that cannot be read or written.
pub fn run_train(args: TrainArgs) -> anyhow::Result<()> {
    on_one_thread(|| train(&args))?
}

fn train(args: &TrainArgs) -> anyhow::Result<()> {
    let scenario = args.scenario.load()?;
    let mut learner = args.algorithm.begin(scenario, args.preset, &args.changes())?;
    let learner = learner.as_mut();
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    let checkpoint = args.out.join("checkpoint.safetensors");
    if args.resume {
        checkpoint::load(learner, &checkpoint)?;
    } else {
        anyhow::ensure!(
            !checkpoint.exists(),
            "{} holds a training run already: go on with it by --resume, or give another folder by --out",
            args.out.display()
        );
    }
    let resumed = learner.episodes_done() > 0;
    let start = Instant::now();
    learn(learner, args, &checkpoint)?;
    let duration = (!resumed).then(|| start.elapsed());
    finish(learner, args, duration)
}

impl TrainArgs {
    /// All changes to the preset.
    fn changes(&self) -> Vec<String> {
        let mut changes = self.options.clone();
        changes.extend(self.episodes.map(|count| format!("episodes={count}")));
        changes.extend(self.steps.map(|count| format!("steps={count}")));
        changes
    }

    /// The command that repeats the run, in canonical form.
    fn command(&self, seed: u64) -> String {
        let preset = if self.preset == Preset::Paper { " --preset paper" } else { "" };
        let (algorithm, scenario) = (self.algorithm.policy().name(), &self.scenario.scenario);
        let mut command = format!("heliostat train {algorithm} --scenario {scenario} --seed {seed}{preset}");
        let mut add = |flag: &str, value: &str| command.extend([" ", flag, " ", value]);
        self.scenario.overrides.iter().for_each(|text| add("--set", text));
        self.options.iter().for_each(|text| add("--option", text));
        self.episodes.iter().for_each(|count| add("--episodes", &count.to_string()));
        self.steps.iter().for_each(|count| add("--steps", &count.to_string()));
        command
    }
}

fn learn(learner: &mut dyn Learner, args: &TrainArgs, checkpoint: &Path) -> anyhow::Result<()> {
    let episodes = learner.run().episodes;
    let every = args.every.map_or((episodes / 10).clamp(1, 100), |every| every as usize);
    let mut curve = Curve::open(&args.out.join("curve.csv"), learner.episodes_done())?;
    let bar = if args.json { ProgressBar::hidden() } else { ProgressBar::new(episodes as u64) };
    bar.set_style(ProgressStyle::with_template("{bar:32} {pos}/{len} episodes, {eta} left  {msg}")?);
    bar.set_message("solving held-out states");
    bar.set_position(learner.episodes_done() as u64);
    let mut watched = watched(learner.scenario())?;
    while learner.episodes_done() < episodes {
        let episode = learner.run_episode()?;
        let due = episode.number % every == 0 || episode.number == episodes;
        let score = if due { Some(watched.score(learner)?) } else { None };
        curve.add(&episode, score.as_ref())?;
        bar.inc(1);
        if let Some(score) = score {
            checkpoint::save(learner, checkpoint)?;
            let (ratio, met) = (score.ratio_to_oracle.mean, score.qos_met);
            bar.set_message(format!("{ratio:.3} of the oracle, needs met {met:.3}"));
        }
    }
    bar.finish();
    Ok(())
}

/// A mixture of blockage counts in rooms of the scenario.
fn watched(scenario: &Scenario) -> anyhow::Result<HeldOut> {
    let mut all = HeldOut::default();
    for forced in forced_counts(scenario.users.count) {
        all.add(&room(scenario, scenario.users.count, forced), WATCHED_STATES)?;
    }
    Ok(all)
}

/// [`FORCED`], cut to the number of users and without repetition.
fn forced_counts(users: usize) -> Vec<usize> {
    let mut counts = FORCED.map(|forced| forced.min(users)).to_vec();
    counts.dedup();
    counts
}

fn room(scenario: &Scenario, users: usize, forced: usize) -> Scenario {
    let mut room = scenario.clone();
    if users != scenario.users.count {
        let need = scenario.min_rate_bps().iter().copied().fold(0.0, f64::max) * 1e-6;
        room.users.min_rate_mbps = heliostat_scenario::MinRate::All(need);
    }
    (room.users.count, room.blockage.forced_users) = (users, forced);
    room
}

/// Scores the finished actor and writes it with its card.
fn finish(learner: &dyn Learner, args: &TrainArgs, duration: Option<Duration>) -> anyhow::Result<()> {
    let (algorithm, seed) = (args.algorithm, learner.run().seed);
    let scores = final_scores(learner, args.states as usize)?;
    let command = args.command(seed);
    let bytes = onnx_file(learner, &command, &scores)?;
    let file = shipped::file_name(algorithm.policy(), learner.scenario(), seed);
    let path = args.out.join(&file);
    std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
    let card = Card { file: &file, command: &command, algorithm, learner, duration, scores: &scores };
    let card_path = path.with_extension("md");
    std::fs::write(&card_path, card.markdown()).with_context(|| format!("cannot write {}", card_path.display()))?;
    if args.json {
        println!("{}", report((&path, &command), learner, duration, &scores));
    } else {
        println!("{}", card.markdown());
        println!("actor: {}\ncard:  {}", path.display(), card_path.display());
    }
    Ok(())
}

fn final_scores(learner: &dyn Learner, states: usize) -> anyhow::Result<Vec<ScoreRow>> {
    let mut users = USERS.to_vec();
    users.push(learner.scenario().users.count);
    users.sort_unstable();
    users.dedup();
    let mut rows = Vec::new();
    for &users in &users {
        for forced in forced_counts(users) {
            let mut held_out = HeldOut::default();
            held_out.add(&room(learner.scenario(), users, forced), states)?;
            let ceiling = held_out.ceiling(learner)?.map(|best| (best.ratio_to_oracle, best.qos_met));
            rows.push(ScoreRow { users, forced, states, score: held_out.score(learner)?, ceiling });
        }
    }
    Ok(rows)
}

/// The trained actor as an ONNX file with its metadata.
fn onnx_file(learner: &dyn Learner, command: &str, scores: &[ScoreRow]) -> anyhow::Result<Vec<u8>> {
    let scenario = learner.scenario();
    let score = |row: &ScoreRow| {
        let Score { ratio_to_oracle: ratio, qos_met, .. } = row.score;
        format!("K={} b={}: {:.4} +- {:.4}, needs met {qos_met:.3}", row.users, row.forced, ratio.mean, ratio.ci95)
    };
    let metadata = [
        (key::OBSERVATION_VERSION, OBSERVATION_VERSION.to_string()),
        (key::USERS_MAX, USERS_CAPACITY.to_string()),
        (key::MIRRORS, scenario.mirror_count().to_string()),
        (key::MODE, scenario.channel.mode.name().into()),
        (key::GEOMETRY, scenario.geometry_hash()),
        (key::TRAINING_COMMAND, command.into()),
        (key::SEED, learner.run().seed.to_string()),
        (key::SCENARIO, format!("{} {}", scenario.name, scenario.hash())),
        (key::SCORES, scores.iter().map(score).collect::<Vec<_>>().join("; ")),
        (key::LICENCE, env!("CARGO_PKG_LICENSE").into()),
    ];
    let metadata = metadata.map(|(key, value)| (key.to_string(), value));
    learner.export(&metadata)
}

fn report(
    (path, command): (&Path, &str),
    learner: &dyn Learner,
    duration: Option<Duration>,
    scores: &[ScoreRow],
) -> serde_json::Value {
    let notes: std::collections::BTreeMap<_, _> = learner.notes().into_iter().collect();
    serde_json::json!({
        "actor": path.display().to_string(),
        "command": command,
        "notes": notes,
        "duration_s": duration.map(|duration| duration.as_secs_f64()),
        "hardware": hardware(),
        "scores": scores,
    })
}
