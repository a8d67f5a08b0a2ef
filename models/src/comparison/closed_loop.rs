//! Closed loop in simulated time: the room's reports, the controller's core and the room's mirrors,
//! without transport.
//!
//! An episode is a separate room in which users have walked for a while. Its sampling times have
//! equal mean spacing, each at a random offset within its interval, so that they fall anywhere
//! between two reports. The controller decides in zero simulated time.
//! `streams.positions.latency_ms` gives the age of a report.
//!
//! A recorded walk begins at another time in each episode of a seed: the starts are spread over the
//! recording less the length of an episode, each at a random place of its part.
//!
//! With `users.arrivals` users come and go at times that depend on the seed alone: oracle and
//! policies have the same users at each sampling time, so that the comparison stays paired. A sum
//! rate is that of the users present. It counts as 0 at a time without users, which has no ratio and
//! no share of users.

use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use heliostat_array::moment::Moment;
use heliostat_channel::solver::Solver;
use heliostat_decide::core::{Controller, DegradedMode, Stage};
use heliostat_environment::ClosedLoop;
use heliostat_scenario::Scenario;
use heliostat_sim::SimulatedRoom;
use heliostat_sim::episode::{self, Event};
use heliostat_sim::world::{World, WorldError};
use indicatif::ProgressBar;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::belief_log::BeliefLog;
use super::belief_quality::{BeliefQuality, quality};
use super::ceiling::Ceiling;
use super::evaluated_policy::EvaluatedPolicy;
use super::evaluator::{Evaluator, Run, Sample};
use super::outage::{OutageLog, STEP_NS};
use super::row::{Rows, rows};
use super::settings::{RANDOM_DRAWS, Settings};
use super::tracked_user::TrackedUser;
use crate::evaluation::held_out::{SETTLE_S, best_angles, held_out_seed};

/// Sampling times of an episode.
const INSTANTS: usize = 20;

/// Separates the random place in a recorded walk from the other random choices of an episode.
const RECORDING_STREAM: u64 = 0x7ace_0000_0000_0000;

/// Mean time between two samples in ns.
const SPACING_NS: u64 = 250_000_000;

/// One room and its sampling times.
pub(super) struct Episode {
    pub seed: u64,
    /// Index of its seed among those compared.
    set: u64,
    pub instants_ns: Vec<u64>,
    /// The time in a recorded walk at time 0 of the episode, in s.
    recording_from_s: f64,
}

impl Episode {
    pub fn new(seed: u64, set: u64, instants: usize, warm: Duration) -> Self {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        let first_ns = start_ns() + warm.as_nanos() as u64;
        let share = |index: u64| first_ns + index * SPACING_NS + generator.random_range(0..SPACING_NS);
        Self { seed, set, instants_ns: (0..instants as u64).map(share).collect(), recording_from_s: 0.0 }
    }

    /// The same with a recorded walk of this length, of which it is the part `index` of `count`: the
    /// controller starts within this part of the walk. A walk that is shorter than an episode
    /// repeats.
    fn in_recording(self, recording_s: f64, index: usize, count: usize) -> Self {
        let last_ns = self.instants_ns.last().map_or(0, |last| last + SPACING_NS);
        let episode_s = last_ns.saturating_sub(start_ns()) as f64 * 1e-9;
        let spread_s = if recording_s > episode_s { recording_s - episode_s } else { recording_s };
        // Another stream than that of the instants, which stay those of a random walk.
        let place = ChaCha8Rng::seed_from_u64(self.seed ^ RECORDING_STREAM).random_range(0.0..1.0);
        let start_s = spread_s * (index as f64 + place) / count as f64;
        Self { recording_from_s: start_s - SETTLE_S, ..self }
    }

    /// The sampling times, and those at which outages are observed between the first and the last.
    fn looks_ns(&self) -> Vec<u64> {
        let [first, .., last] = self.instants_ns[..] else { return self.instants_ns.clone() };
        let mut looks: Vec<u64> = (first.next_multiple_of(STEP_NS)..last).step_by(STEP_NS as usize).collect();
        looks.extend(&self.instants_ns);
        looks.sort_unstable();
        looks.dedup();
        looks
    }

    /// The room of the episode at time 0.
    fn room(&self, scenario: &Scenario, trace: Option<&str>) -> Result<SimulatedRoom, WorldError> {
        let mut room = SimulatedRoom::new(scenario, trace, self.seed)?;
        room.world_mut().seek_recording(self.recording_from_s);
        Ok(room)
    }

    /// The room of the episode with its reports, at the controller's start.
    fn begun(&self, scenario: &Scenario, trace: Option<&str>) -> Result<episode::Episode, WorldError> {
        Ok(episode::Episode::of_room(self.room(scenario, trace)?, scenario, self.seed, start_ns()))
    }

    /// Users and obstacles of the episode at time 0.
    fn world(&self, scenario: &Scenario, trace: Option<&str>) -> Result<World, WorldError> {
        let mut world = World::new(scenario, trace, self.seed)?;
        world.seek_recording(self.recording_from_s);
        Ok(world)
    }
}

/// The controller's start, after the users have walked for [`SETTLE_S`].
fn start_ns() -> u64 {
    (SETTLE_S * 1e9) as u64
}

/// Compares at `states` sampling times of each seed.
pub(super) fn compare(settings: &Settings, bar: &ProgressBar) -> anyhow::Result<(Rows, Beliefs, Vec<TrackedUser>)> {
    let scenario = &settings.scenario;
    let trace = scenario.read_trace()?;
    let trace = trace.as_deref();
    let episodes = episodes(settings, trace)?;
    let mut evaluator = Evaluator::new(scenario.channel_model()?, scenario.min_rate_bps());
    bar.set_length(episodes.len() as u64);
    bar.set_message("episodes solved by the oracle");
    let mut oracle = Vec::new();
    for episode in &episodes {
        oracle.push(solve(scenario, trace, episode, &mut evaluator)?);
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
    let all = runs.iter().flatten();
    let tracked = all.map(|run| &run.tracked).find(|tracked| !tracked.is_empty()).cloned().unwrap_or_default();
    Ok((rows(settings, &runs, &oracle), beliefs(settings, &runs), tracked))
}

/// The quality of each belief, by its name.
pub(super) type Beliefs = Vec<(String, BeliefQuality)>;

/// The quality of each belief, with the first policy that has it.
fn beliefs(settings: &Settings, runs: &[Vec<Run>]) -> Beliefs {
    let mut beliefs = Beliefs::new();
    for (evaluated, runs) in settings.policies.iter().zip(runs) {
        let Some(name) = evaluated.belief(&settings.scenario).map(|belief| belief.to_string()) else { continue };
        if beliefs.iter().all(|(known, _)| *known != name) {
            beliefs.push((name, quality(&runs[0].belief)));
        }
    }
    beliefs
}

fn episodes(settings: &Settings, trace: Option<&str>) -> anyhow::Result<Vec<Episode>> {
    let scenario = &settings.scenario;
    let recording_s = World::new(scenario, trace, scenario.seed)?.recording_s();
    let count = settings.states.div_ceil(INSTANTS);
    let mut episodes = Vec::new();
    for set in 0..settings.seeds as u64 {
        for (index, first) in (0..settings.states).step_by(INSTANTS).enumerate() {
            let seed = held_out_seed(scenario.seed.wrapping_add(set), index as u64);
            let episode = Episode::new(seed, set, INSTANTS.min(settings.states - first), settings.warm);
            episodes.push(match recording_s {
                Some(recording_s) => episode.in_recording(recording_s, index, count),
                None => episode,
            });
        }
    }
    Ok(episodes)
}

/// The oracle's samples: it observes the true state, and its mirrors turn at once.
fn solve(
    scenario: &Scenario,
    trace: Option<&str>,
    episode: &Episode,
    evaluator: &mut Evaluator,
) -> anyhow::Result<Vec<Sample>> {
    let mut world = episode.world(scenario, trace)?;
    let mut solver = Solver::new(scenario.users.count, scenario.mirror_count());
    let mut now_ns = 0;
    let mut samples = Vec::new();
    for instant_ns in &episode.instants_ns {
        world.step((instant_ns - now_ns) as f64 * 1e-9);
        now_ns = *instant_ns;
        let angles = best_angles(&mut solver, world.model(), world.scene(), world.min_rate_bps());
        samples.push(evaluator.evaluate_world(&world, &angles));
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
    let trace = scenario.read_trace()?;
    // The draws are divided among the seeds.
    let draws = if evaluated.is_random() { RANDOM_DRAWS.div_ceil(settings.seeds) as u64 } else { 1 };
    let runs = (0..draws).map(|draw| {
        let mut run = Run::default();
        for episode in episodes {
            let seed = scenario.seed.wrapping_add(episode.set * draws + draw);
            let policy = evaluated.build(&scenario, seed)?;
            let (mut samples, mut outages) = (Vec::new(), OutageLog::default());
            let mut look = |now_ns: u64, room: &SimulatedRoom| {
                let world = room.world();
                let sample = evaluator.evaluate_world(world, room.angles());
                if episode.instants_ns.binary_search(&now_ns).is_ok() {
                    samples.push(sample);
                }
                if now_ns.is_multiple_of(STEP_NS) {
                    outages.handle(world.ids().iter().copied().zip(evaluator.below_minimum()));
                }
            };
            let failed = || format!("policy {}", evaluated.name());
            if let Some(known) = evaluated.known() {
                let room = episode.begun(&scenario, trace.as_deref())?;
                Ceiling::new(&scenario, room, policy, known)
                    .run(&episode.looks_ns(), &mut look)
                    .with_context(failed)?;
                run.groups.push(samples);
                run.outages.push(outages);
                continue;
            }
            let controller = Controller::new(&scenario, scenario.channel_model()?, policy, 1);
            let started = (controller, evaluated.is_aware());
            let mut lockstep = Lockstep::new(&scenario, trace.as_deref(), episode, started)?;
            lockstep.run(&episode.looks_ns(), &mut look).with_context(failed)?;
            run.groups.push(samples);
            run.outages.push(outages);
            run.decisions_us.append(&mut lockstep.decisions_us);
            if evaluated.belief(&scenario).is_some() {
                if run.belief.is_empty() {
                    run.tracked = lockstep.log.tracked(episode.world(&scenario, trace.as_deref())?, start_ns());
                }
                let measured_ns = start_ns() + settings.warm.as_nanos() as u64;
                run.belief.push(lockstep.log.errors(episode.world(&scenario, trace.as_deref())?, measured_ns));
            }
        }
        Ok(run)
    });
    Ok(Run::mean(runs.collect::<anyhow::Result<_>>()?))
}

/// A room and its controller in the same simulated time, with the times of the decisions.
pub(super) struct Lockstep {
    inner: ClosedLoop,
    /// Time of each decision, including the reports since the one before, from which the belief
    /// learns too.
    decisions_us: Vec<f64>,
    /// Time spent on reports since the last decision in us.
    reports_us: f64,
    log: BeliefLog,
}

impl Lockstep {
    /// The room of an episode, and its controller; `trace` is the text of the file `users.trace`.
    /// Telemetry names the mirrors that do not follow, if `names_unusable`.
    pub fn new(
        scenario: &Scenario,
        trace: Option<&str>,
        episode: &Episode,
        (controller, names_unusable): (Controller, bool),
    ) -> Result<Self, WorldError> {
        let inner = ClosedLoop::new(episode.begun(scenario, trace)?, controller).naming_unusable(names_unusable);
        Ok(Self { inner, decisions_us: Vec::new(), reports_us: 0.0, log: BeliefLog::default() })
    }

    /// Runs until the last of these times and calls `look` with each and with the room at it.
    pub fn run(&mut self, times_ns: &[u64], look: &mut dyn FnMut(u64, &SimulatedRoom)) -> anyhow::Result<()> {
        for instant_ns in times_ns {
            while let Some((now, event)) = self.inner.poll_event(*instant_ns) {
                self.deliver(now, event)?;
            }
            self.inner.advance(*instant_ns);
            look(*instant_ns, self.inner.room());
        }
        let controller = self.inner.controller();
        let failed = controller.counters().degraded(DegradedMode::PolicyFailed);
        let held = controller.counters().degraded(DegradedMode::Held);
        match controller.last_failure() {
            Some(failure) if failed + held > 0 => bail!("failed decisions: {failed}, the last because {failure}"),
            _ => Ok(()),
        }
    }

    /// Delivers a message and measures the time of its decision.
    fn deliver(&mut self, now: Moment, event: Event) -> anyhow::Result<()> {
        let arrived = Instant::now();
        let elapsed_us = || arrived.elapsed().as_secs_f64() * 1e6;
        let (decisions_us, reports_us) = (&mut self.decisions_us, self.reports_us);
        let mut mark = |stage| {
            if stage == Stage::Inferred {
                decisions_us.push(reports_us + elapsed_us());
            }
        };
        if self.inner.deliver(now, event, &mut mark)? {
            self.reports_us = 0.0;
            self.log.note(self.inner.controller(), now.room_ns);
        } else {
            self.reports_us += elapsed_us();
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn episodes_start_in_different_parts_of_a_recording_and_end_within_it() {
        let count = 10;
        let starts = |seed: u64, recording_s: f64| -> Vec<f64> {
            let episode = |index: usize| {
                Episode::new(held_out_seed(seed, index as u64), 0, INSTANTS, Settings::WARM).in_recording(
                    recording_s,
                    index,
                    count,
                )
            };
            (0..count).map(|index| episode(index).recording_from_s + SETTLE_S).collect()
        };
        let (warm_and_instants_s, recording_s) = (6.0, 106.0);
        let found = starts(3, recording_s);
        for (index, start_s) in found.iter().enumerate() {
            // An episode ends up to 0.25 s after its last instant.
            let part = 9.97 * index as f64..10.0 * (index + 1) as f64;
            assert!(part.contains(start_s), "episode {index} starts at {start_s} s");
            assert!(start_s + warm_and_instants_s <= recording_s, "episode {index} starts at {start_s} s");
        }
        assert_eq!(found, starts(3, recording_s));
        assert_ne!(found, starts(4, recording_s));
        // A recording that is shorter than an episode repeats; the starts differ all the same.
        assert!(starts(3, 2.0).windows(2).all(|pair| pair[0] < pair[1] && pair[1] < 2.0));
    }

    #[test]
    fn instants_do_not_depend_on_the_recording() {
        let episode = || Episode::new(7, 0, 5, Settings::WARM);
        assert_eq!(episode().instants_ns, episode().in_recording(60.0, 1, 2).instants_ns);
    }
}
