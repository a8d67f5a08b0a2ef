//! Closed loop in simulated time: the room's reports, the controller's core and the room's mirrors,
//! without transport.
//!
//! An episode is a separate room in which users have walked for a while. Its sampling times have
//! equal mean spacing, each at a random offset within its interval, so that they fall anywhere
//! between two reports. The controller decides in zero simulated time.
//! `streams.positions.latency_ms` gives the age of a report.
//!
//! With `users.arrivals` users come and go at times that depend on the seed alone: oracle and
//! policies have the same users at each sampling time, so that the comparison stays paired. A sum
//! rate is that of the users present. It counts as 0 at a time without users, which has no ratio and
//! no share of users.

use std::time::{Duration, Instant};

use anyhow::{Context, bail, ensure};
use heliostat_array::moment::Moment;
use heliostat_channel::solver::Solver;
use heliostat_decide::core::{Controller, Decision, DegradedMode, Stage};
use heliostat_decide::inbox::Message;
use heliostat_scenario::Scenario;
use heliostat_sim::SimulatedRoom;
use heliostat_sim::episode::{self, Event};
use heliostat_sim::world::World;
use indicatif::ProgressBar;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::evaluated_policy::EvaluatedPolicy;
use super::evaluator::{Evaluator, Run, Sample};
use super::row::{Rows, rows};
use super::settings::{RANDOM_DRAWS, Settings};
use crate::evaluation::held_out::{SETTLE_S, best_angles, held_out_seed};

/// Sampling times of an episode.
const INSTANTS: usize = 20;

/// Mean time between two samples in ns.
const SPACING_NS: u64 = 250_000_000;

/// One room and its sampling times.
pub(super) struct Episode {
    pub seed: u64,
    /// Index of its seed among those compared.
    set: u64,
    pub instants_ns: Vec<u64>,
}

impl Episode {
    pub fn new(seed: u64, set: u64, instants: usize, warm: Duration) -> Self {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        let first_ns = start_ns() + warm.as_nanos() as u64;
        let share = |index: u64| first_ns + index * SPACING_NS + generator.random_range(0..SPACING_NS);
        Self { seed, set, instants_ns: (0..instants as u64).map(share).collect() }
    }
}

/// The controller's start, after the users have walked for [`SETTLE_S`].
fn start_ns() -> u64 {
    (SETTLE_S * 1e9) as u64
}

/// Compares at `states` sampling times of each seed.
pub(super) fn compare(settings: &Settings, bar: &ProgressBar) -> anyhow::Result<Rows> {
    let scenario = &settings.scenario;
    let episodes = episodes(settings);
    let mut evaluator = Evaluator::new(scenario.channel_model()?, scenario.min_rate_bps());
    bar.set_length(episodes.len() as u64);
    bar.set_message("episodes solved by the oracle");
    let mut oracle = Vec::new();
    for episode in &episodes {
        oracle.push(solve(scenario, episode, &mut evaluator)?);
        bar.inc(1);
    }
    bar.reset();
    bar.set_length(settings.policies.len() as u64);
    let mut runs = Vec::new();
    for evaluated in &settings.policies {
        bar.set_message(format!("policies: {}", evaluated.name()));
        let trainings = evaluated.trainings(scenario, settings.training_seed).into_iter();
        let of_policy: Vec<Run> =
            trainings.map(|one| run(settings, &one, &episodes, &mut evaluator)).collect::<anyhow::Result<_>>()?;
        runs.push(of_policy);
        bar.inc(1);
    }
    Ok(rows(settings, &runs, &oracle))
}

fn episodes(settings: &Settings) -> Vec<Episode> {
    let mut episodes = Vec::new();
    for set in 0..settings.seeds as u64 {
        for (index, first) in (0..settings.states).step_by(INSTANTS).enumerate() {
            let seed = held_out_seed(settings.scenario.seed.wrapping_add(set), index as u64);
            episodes.push(Episode::new(seed, set, INSTANTS.min(settings.states - first), settings.warm));
        }
    }
    episodes
}

/// The oracle's samples: it observes the true state, and its mirrors turn at once.
fn solve(scenario: &Scenario, episode: &Episode, evaluator: &mut Evaluator) -> anyhow::Result<Vec<Sample>> {
    let mut world = World::new(scenario, scenario.read_trace()?.as_deref(), episode.seed)?;
    let mut solver = Solver::new(scenario.users.count, scenario.mirror_count());
    let mut now_ns = 0;
    let mut samples = Vec::new();
    for instant_ns in &episode.instants_ns {
        world.step((instant_ns - now_ns) as f64 * 1e-9);
        now_ns = *instant_ns;
        let angles = best_angles(&mut solver, evaluator.model(), world.scene(), world.min_rate_bps());
        samples.push(evaluator.evaluate_users(world.scene(), world.min_rate_bps(), &angles));
    }
    Ok(samples)
}

fn run(
    settings: &Settings,
    evaluated: &EvaluatedPolicy,
    episodes: &[Episode],
    evaluator: &mut Evaluator,
) -> anyhow::Result<Run> {
    let scenario = evaluated.scenario(&settings.scenario);
    // The draws are divided among the seeds.
    let draws = if evaluated.is_random() { RANDOM_DRAWS.div_ceil(settings.seeds) as u64 } else { 1 };
    let runs = (0..draws).map(|draw| {
        let mut run = Run::default();
        for episode in episodes {
            let seed = scenario.seed.wrapping_add(episode.set * draws + draw);
            let policy = evaluated.build(&scenario, seed)?;
            let controller = Controller::new(&scenario, scenario.channel_model()?, policy, 1);
            let mut lockstep = Lockstep::new(&scenario, episode.seed, controller)?;
            lockstep.names_unusable = evaluated.is_aware();
            let mut samples = Vec::new();
            let mut look = |room: &SimulatedRoom| {
                let world = room.world();
                samples.push(evaluator.evaluate_users(world.scene(), world.min_rate_bps(), room.angles()));
            };
            let done = lockstep.run(&episode.instants_ns, &mut look);
            done.with_context(|| format!("policy {}", evaluated.name()))?;
            run.groups.push(samples);
            run.decisions_us.append(&mut lockstep.decisions_us);
        }
        Ok(run)
    });
    Ok(Run::mean(runs.collect::<anyhow::Result<_>>()?))
}

/// A room and its controller in the same simulated time.
pub(super) struct Lockstep {
    episode: episode::Episode,
    /// Telemetry names the mirrors that do not follow.
    names_unusable: bool,
    controller: Controller,
    /// Number of the last command.
    command_sequence: u64,
    decisions_us: Vec<f64>,
}

impl Lockstep {
    pub fn new(scenario: &Scenario, seed: u64, mut controller: Controller) -> anyhow::Result<Self> {
        controller.warm_up(0..2);
        let episode = episode::Episode::new(scenario, scenario.read_trace()?.as_deref(), seed, start_ns())?;
        controller.handle_capabilities(&episode.capabilities(), Ok(()));
        Ok(Self { episode, names_unusable: true, controller, command_sequence: 0, decisions_us: Vec::new() })
    }

    /// Runs until the last sampling time and calls `look` with the room at each.
    pub fn run(&mut self, instants_ns: &[u64], look: &mut dyn FnMut(&SimulatedRoom)) -> anyhow::Result<()> {
        for instant_ns in instants_ns {
            while let Some((now, event)) = self.episode.poll_event(*instant_ns) {
                self.deliver(now, event)?;
            }
            self.episode.advance(*instant_ns);
            look(self.episode.room());
        }
        let failed = self.controller.counters().degraded(DegradedMode::PolicyFailed);
        let held = self.controller.counters().degraded(DegradedMode::Held);
        match self.controller.last_failure() {
            Some(failure) if failed + held > 0 => bail!("failed decisions: {failed}, the last because {failure}"),
            _ => Ok(()),
        }
    }

    /// Gives a message to the controller, and its command to the array.
    fn deliver(&mut self, now: Moment, mut event: Event) -> anyhow::Result<()> {
        let message = match &mut event {
            Event::Telemetry(telemetry) => {
                if !self.names_unusable {
                    telemetry.unusable.clear();
                }
                Message::Telemetry(telemetry)
            }
            Event::Obstacles(report) => Message::Obstacles(report),
            Event::Channel(report) => Message::Channel(report),
            Event::Users(report) => Message::Users(report),
        };
        let arrived = Instant::now();
        let decisions_us = &mut self.decisions_us;
        let mut mark = |stage| {
            if stage == Stage::Inferred {
                decisions_us.push(arrived.elapsed().as_secs_f64() * 1e6);
            }
        };
        match self.controller.handle_and_poll(now.room_ns, message, &mut mark) {
            Some(Decision::Move { command, .. }) => {
                self.command_sequence += 1;
                command.sequence = self.command_sequence;
                self.episode.handle_command(now, command).context("the array refused a command")?;
            }
            Some(Decision::Hold(mode)) => {
                let late = mode == DegradedMode::StaleReport;
                ensure!(!late, "reports are older than control.report_age_max_ms when they arrive");
            }
            None => {}
        }
        Ok(())
    }
}
