//! `heliostat-lab train`: trains a policy, shows its progress, and writes an actor with its card.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use heliostat_channel::ChannelError;
use heliostat_core::belief::conditions::Condition;
use heliostat_core::observation::USERS_CAPACITY;
use heliostat_core::policy::actor_file::{key, room_entries};
use heliostat_environment::exact_states;
use heliostat_files::{UnusableInput, shell_word, write_whole};
use heliostat_models::shipped;
use heliostat_scenario::{STUDY_SCENARIO, Scenario, ScenarioArgs};
use indicatif::{ProgressBar, ProgressStyle};

use crate::evaluation::{HeldOut, Score};
use crate::networks::on_one_thread;
use crate::training::card::{Card, ScoreRow, hardware};
use crate::training::checkpoint;
use crate::training::curve::Curve;
use crate::training::pace::{Pace, rounded};
use crate::training::{Algorithm, Preset, Training};

/// Train a policy for a scenario and export it as an ONNX actor.
///
/// Ctrl-C ends the run after the current episode: it saves a checkpoint and prints the command that
/// resumes. A resumed run gives the same actor as an uninterrupted one.
#[derive(Clone, Debug, clap::Args)]
#[command(mut_arg("scenario", |argument| argument.default_value(STUDY_SCENARIO)))]
pub struct TrainArgs {
    /// Algorithm
    #[arg(value_enum)]
    algorithm: Algorithm,
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Set of default hyperparameters
    #[arg(long, value_enum, default_value_t = Preset::Tuned)]
    preset: Preset,
    /// Number of episodes, which overrides the preset
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    episodes: Option<u32>,
    /// Steps in an episode, which overrides the preset
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    steps: Option<u32>,
    /// Override one hyperparameter, for example exploration.start=0.2 (repeatable); an unknown key
    /// lists all keys
    #[arg(long = "option", value_name = "KEY=VALUE")]
    options: Vec<String>,
    /// Folder for the actor, its card, the learning curve and the checkpoint
    #[arg(long, value_name = "DIR", default_value = "training")]
    out: PathBuf,
    /// Resume from the checkpoint in the folder
    #[arg(long)]
    resume: bool,
    /// Episodes between two checkpoints with an evaluation each; the default is a tenth of all, at
    /// most 100
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    every: Option<u32>,
    /// Held-out states for each row of the final scores
    #[arg(long, default_value_t = STATES, value_parser = clap::value_parser!(u32).range(2..=100_000))]
    states: u32,
    /// Print one JSON object at the end instead of the progress
    #[arg(long)]
    json: bool,
}

/// Held-out states for each row of the final scores, unless the command states another number.
const STATES: u32 = 200;

/// Held-out states for each forced-blockage count during training.
const TRAINING_STATES: usize = 24;

/// Forced-blockage counts of the scores; a room with fewer users has all of them forced.
const FORCED: [usize; 3] = [0, 2, 5];

/// User counts of the final scores, in addition to the scenario's own.
const USERS: [usize; 2] = [3, 8];

/// Whether the run has to end, as Ctrl-C requests.
type StopRequested<'a> = &'a (dyn Fn() -> bool + Sync);

/// Runs the command, and returns its output: the card of the actor and its files, or one JSON object. Where
/// `stop_requested` returns true, it saves the run and returns an error with the command that resumes.
///
/// # Errors
/// [`UnusableInput`] where the scenario, an option or the folder cannot be used; a file that cannot be written, or an
/// interruption.
pub fn run_train(args: TrainArgs, stop_requested: StopRequested<'_>) -> anyhow::Result<String> {
    on_one_thread(|| train(&args, stop_requested))?
}

fn train(args: &TrainArgs, stop_requested: StopRequested<'_>) -> anyhow::Result<String> {
    let checkpoint = args.out.join("checkpoint.safetensors");
    // Scenario, options and folder: all of it is what the user typed.
    let begun = begin(args, &checkpoint);
    let mut training = begun.map_err(|error| UnusableInput::new(format!("{error:#}")))?;
    let resumed = training.episodes_done() > 0;
    let start = Instant::now();
    learn(&mut training, args, &checkpoint, stop_requested)?;
    if stop_requested() {
        bail!(interrupted(&mut training, args, &checkpoint)?);
    }
    let duration = (!resumed).then(|| start.elapsed());
    match final_scores(&training, args.states as usize, stop_requested)? {
        Some(scores) => finish(&training, args, duration, &scores),
        None => bail!(interrupted(&mut training, args, &checkpoint)?),
    }
}

/// The run before its next episode, in its folder.
fn begin(args: &TrainArgs, checkpoint: &Path) -> anyhow::Result<Training> {
    let scenario = args.scenario.load_arrays()?;
    exact_states::check_training(&args.scenario.overrides)?;
    for condition in conditions(&scenario)? {
        // A full or closed standard error does not end a training.
        drop(writeln!(std::io::stderr(), "condition: {condition}"));
    }
    let mut training = args.algorithm.begin(scenario, args.preset, &args.changes())?;
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    if args.resume {
        checkpoint::load(&mut training, checkpoint)?;
    } else {
        anyhow::ensure!(
            !checkpoint.exists(),
            "{} already holds a training run: resume it with --resume, or give another folder with --out",
            args.out.display()
        );
    }
    Ok(training)
}

/// What a scenario describes and training leaves out, and places out of the range of the controller.
fn conditions(scenario: &Scenario) -> Result<Vec<Condition>, ChannelError> {
    exact_states::conditions(scenario, "training", "measure the actor with heliostat-lab eval --closed-loop")
}

/// Saves the run, and returns the message that says how to resume it.
fn interrupted(training: &mut Training, args: &TrainArgs, checkpoint: &Path) -> anyhow::Result<String> {
    checkpoint::save(training, checkpoint)?;
    Ok(format!(
        "interrupted after {} of {} episodes; saved: {}\nresume with: {}",
        training.episodes_done(),
        training.run().episodes,
        checkpoint.display(),
        args.resuming_command(training.run().seed)
    ))
}

impl TrainArgs {
    /// All overrides of the preset.
    fn changes(&self) -> Vec<String> {
        let mut changes = self.options.clone();
        changes.extend(self.episodes.map(|count| format!("episodes={count}")));
        changes.extend(self.steps.map(|count| format!("steps={count}")));
        changes
    }

    /// The command that repeats the run, in canonical form.
    fn command(&self, seed: u64) -> String {
        let preset = if self.preset == Preset::Paper { " --preset paper" } else { "" };
        let (algorithm, scenario) = (self.algorithm.name, &self.scenario.scenario);
        let scenario = shell_word(scenario);
        let mut command = format!("heliostat-lab train {algorithm} --scenario {scenario} --seed {seed}{preset}");
        let mut add = |flag: &str, value: &str| command.extend([" ", flag, " ", &shell_word(value)]);
        self.scenario.overrides.iter().for_each(|text| add("--set", text));
        self.options.iter().for_each(|text| add("--option", text));
        self.episodes.iter().for_each(|count| add("--episodes", &count.to_string()));
        self.steps.iter().for_each(|count| add("--steps", &count.to_string()));
        self.every.iter().for_each(|count| add("--every", &count.to_string()));
        if self.states != STATES {
            add("--states", &self.states.to_string());
        }
        command
    }

    /// The command that resumes the run in its folder.
    fn resuming_command(&self, seed: u64) -> String {
        let mut command = self.command(seed);
        command.push_str(&format!(" --out {}", shell_word(&self.out.to_string_lossy())));
        if self.json {
            command.push_str(" --json");
        }
        command + " --resume"
    }
}

/// Trains until the last episode, or until a stop is requested.
fn learn(
    training: &mut Training,
    args: &TrainArgs,
    checkpoint: &Path,
    stop_requested: StopRequested<'_>,
) -> anyhow::Result<()> {
    let episodes = training.run().episodes;
    let every = args.every.map_or((episodes / 10).clamp(1, 100), |every| every as usize);
    let mut curve = Curve::open(&args.out.join("curve.csv"), training.episodes_done())?;
    let bar = if args.json { ProgressBar::hidden() } else { ProgressBar::new(episodes as u64) };
    bar.set_style(ProgressStyle::with_template("{bar:32} {pos}/{len} episodes  {msg}")?);
    bar.set_message("solving held-out states");
    bar.set_position(training.episodes_done() as u64);
    let mut states = training_states(training.scenario())?;
    let (mut pace, mut quality) = (Pace::default(), String::new());
    while training.episodes_done() < episodes && !stop_requested() {
        let begun = Instant::now();
        let episode = training.run_episode()?;
        pace.add_episode(begun.elapsed());
        let due = episode.number % every == 0 || episode.number == episodes;
        let begun = Instant::now();
        let score = if due { Some(states.score(|room| training.act(room))?) } else { None };
        curve.add(&episode, score.as_ref())?;
        bar.inc(1);
        if let Some(score) = score {
            checkpoint::save(training, checkpoint)?;
            pace.add_evaluation(begun.elapsed());
            let (ratio, met) = (score.ratio_to_oracle.mean, score.qos_met);
            quality = format!(", {ratio:.3} of the oracle, minimum rates met {met:.3}");
        }
        let left = episodes - episode.number;
        let remaining = pace.remaining(left, left.div_ceil(every)).map_or("unknown".into(), rounded);
        bar.set_message(format!("{remaining} left{quality}"));
    }
    if training.episodes_done() < episodes {
        bar.abandon()
    } else {
        bar.finish()
    }
    Ok(())
}

/// The held-out states of the scores during training: rooms of the scenario with several blockage
/// counts.
fn training_states(scenario: &Scenario) -> anyhow::Result<HeldOut> {
    let mut all = HeldOut::default();
    for forced in forced_counts(scenario.users.count) {
        all.add(&room(scenario, scenario.users.count, forced), TRAINING_STATES)?;
    }
    Ok(all)
}

/// [`FORCED`], limited to the number of users and without repetition.
fn forced_counts(users: usize) -> Vec<usize> {
    let mut counts = FORCED.map(|forced| forced.min(users)).to_vec();
    counts.dedup();
    counts
}

fn room(scenario: &Scenario, users: usize, forced: usize) -> Scenario {
    let mut room = scenario.clone();
    if users != scenario.users.count {
        let min_rate_mbps = scenario.min_rate_bps().iter().copied().fold(0.0, f64::max) * 1e-6;
        room.users.min_rate_mbps = heliostat_scenario::MinRate::All(min_rate_mbps);
    }
    (room.users.count, room.blockage.forced_users) = (users, forced);
    room
}

/// Writes the trained actor with its card, and returns the output of the command.
fn finish(
    training: &Training,
    args: &TrainArgs,
    duration: Option<Duration>,
    scores: &[ScoreRow],
) -> anyhow::Result<String> {
    let (algorithm, seed) = (args.algorithm, training.run().seed);
    let command = args.command(seed);
    let bytes = onnx_file(training, &command, scores)?;
    let file = shipped::file_name(algorithm.policy, training.scenario(), seed);
    let path = args.out.join(&file);
    let write = |path: &Path, bytes: &[u8]| {
        write_whole(path, |part| std::fs::write(part, bytes))
            .with_context(|| format!("cannot write {}", path.display()))
    };
    write(&path, &bytes)?;
    let card = Card { file: &file, command: &command, algorithm, training, duration, scores };
    let card_path = path.with_extension("md");
    write(&card_path, card.markdown().as_bytes())?;
    Ok(match args.json {
        true => report((&path, &command), training, duration, scores)?.to_string(),
        false => format!("{}\nactor: {}\ncard:  {}", card.markdown(), path.display(), card_path.display()),
    })
}

/// The scores of the trained actor; `None` where a stop is requested before the last.
fn final_scores(
    training: &Training,
    states: usize,
    stop_requested: StopRequested<'_>,
) -> anyhow::Result<Option<Vec<ScoreRow>>> {
    let mut users = USERS.to_vec();
    users.push(training.scenario().users.count);
    users.sort_unstable();
    users.dedup();
    let mut rows = Vec::new();
    for &users in &users {
        for forced in forced_counts(users) {
            if stop_requested() {
                return Ok(None);
            }
            let mut held_out = HeldOut::default();
            held_out.add(&room(training.scenario(), users, forced), states)?;
            let upper_bound = held_out
                .upper_bound(|room| training.learner().best_action(room))?
                .map(|best| (best.ratio_to_oracle, best.qos_met));
            rows.push(ScoreRow {
                users,
                forced,
                states,
                score: held_out.score(|room| training.act(room))?,
                upper_bound,
            });
        }
    }
    Ok(Some(rows))
}

/// The trained actor as an ONNX file with its metadata.
fn onnx_file(training: &Training, command: &str, scores: &[ScoreRow]) -> anyhow::Result<Vec<u8>> {
    let scenario = training.scenario();
    let score = |row: &ScoreRow| {
        let Score { ratio_to_oracle: ratio, qos_met, .. } = row.score;
        format!(
            "K={} b={}: {:.4} +- {:.4}, minimum rates met {qos_met:.3}",
            row.users, row.forced, ratio.mean, ratio.ci95
        )
    };
    let mut metadata = room_entries(scenario, USERS_CAPACITY);
    let of_training = [
        (key::TRAINING_COMMAND, command.into()),
        (key::SEED, training.run().seed.to_string()),
        (key::SCENARIO, format!("{} {}", scenario.name, scenario.hash())),
        (key::SCORES, scores.iter().map(score).collect::<Vec<_>>().join("; ")),
        (key::LICENCE, env!("CARGO_PKG_LICENSE").into()),
    ];
    metadata.extend(of_training.map(|(key, value)| (key.to_owned(), value)));
    training.export(&metadata)
}

fn report(
    (path, command): (&Path, &str),
    training: &Training,
    duration: Option<Duration>,
    scores: &[ScoreRow],
) -> Result<serde_json::Value, ChannelError> {
    let notes: std::collections::BTreeMap<_, _> = training.learner().notes().into_iter().collect();
    let conditions = conditions(training.scenario())?;
    Ok(serde_json::json!({
        "actor": path.display().to_string(),
        "command": command,
        "notes": notes,
        "conditions": conditions,
        "duration_s": duration.map(|duration| duration.as_secs_f64()),
        "hardware": hardware(),
        "scores": scores,
    }))
}
