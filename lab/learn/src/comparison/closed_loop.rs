//! Closed loop in simulated time: the room's reports, the controller's core and the room's mirrors,
//! without transport.
//!
//! [`heliostat_environment::episodes`] has the rooms and their sampling times. The controller
//! decides in zero simulated time. `streams.positions.latency_ms` gives the age of a report.
//!
//! With `users.arrivals` users come and go at times that depend on the seed alone: oracle and
//! policies have the same users at each sampling time, so that the comparison stays paired. A sum
//! rate is that of the users present. It counts as 0 at a time without users, which has no ratio
//! and no share of users.

use std::time::Instant;

use anyhow::{Context, bail};
use heliostat_array::moment::Moment;
use heliostat_core::core::{Controller, DegradedMode, Stage};
use heliostat_environment::ClosedLoop;
use heliostat_environment::episodes::{HeldOutEpisode, OUTAGE_STEP_NS, held_out_episodes, start_ns};
use heliostat_environment::outage::OutageLog;
use heliostat_environment::score::{Evaluator, Sample};
use heliostat_room::SimulatedRoom;
use heliostat_room::episode::Event;
use heliostat_room::world::WorldError;
use heliostat_scenario::Scenario;
use indicatif::ProgressBar;

use super::Compared;
use super::belief_log::BeliefLog;
use super::belief_quality::{BeliefQuality, quality};
use super::ceiling::Ceiling;
use super::episode_row::{self, of_episodes};
use super::evaluated_policy::EvaluatedPolicy;
use super::row::rows;
use super::run::{Run, of_policies};
use super::settings::{RANDOM_DRAWS, Settings};
use super::tracked_user::TrackedUser;
use crate::threads::parts;

/// Compares at `states` sampling times of each seed.
pub(super) fn compare(settings: &Settings, bar: &ProgressBar) -> anyhow::Result<(Compared, Beliefs, Vec<TrackedUser>)> {
    let scenario = &settings.scenario;
    let trace = scenario.read_trace()?;
    let trace = trace.as_deref();
    let episodes = held_out_episodes(scenario, trace, (settings.states, settings.seeds), settings.warm)?;
    let evaluator = Evaluator::new(scenario.channel_model()?, scenario.min_rate_bps());
    bar.set_length(episodes.len() as u64);
    bar.set_message("episodes solved by the oracle");
    let solve = |evaluator: &mut Evaluator, index: usize| {
        let samples = solve(settings, trace, &episodes[index], evaluator)?;
        bar.inc(1);
        Ok(samples)
    };
    let oracle = parts(true, episodes.len(), || evaluator.clone(), solve)?;
    let runs = of_policies(settings, bar, |one| run(settings, one, &episodes, &evaluator))?;
    let all = runs.iter().flatten();
    let tracked = all.map(|run| &run.tracked).find(|tracked| !tracked.is_empty()).cloned().unwrap_or_default();
    let each = episode_row::rows(settings, &of_episodes(settings, &episodes), &runs, &oracle);
    Ok(((rows(settings, &runs, &oracle), each), beliefs(settings, &runs), tracked))
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

/// The oracle's samples: it observes the true state, and its mirrors turn at once.
fn solve(
    settings: &Settings,
    trace: Option<&str>,
    episode: &HeldOutEpisode,
    evaluator: &mut Evaluator,
) -> anyhow::Result<Vec<Sample>> {
    let mut samples = Vec::new();
    let dark = settings.dark_angles();
    episode.solve(&settings.scenario, trace, |world, angles| {
        samples.push(evaluator.evaluate_world(world, dark.as_ref().unwrap_or(angles)));
    })?;
    Ok(samples)
}

fn run(
    settings: &Settings,
    evaluated: &EvaluatedPolicy,
    episodes: &[HeldOutEpisode],
    evaluator: &Evaluator,
) -> anyhow::Result<Run> {
    let scenario = evaluated.scenario(&settings.scenario);
    let trace = scenario.read_trace()?;
    let trace = trace.as_deref();
    let dark = settings.dark_angles();
    let has_belief = evaluated.belief(&scenario).is_some();
    let measured_ns = start_ns() + settings.warm.as_nanos() as u64;
    // The draws are divided among the seeds.
    let draws = if evaluated.is_random() { RANDOM_DRAWS.div_ceil(settings.seeds) } else { 1 };
    let of_episode = |evaluator: &mut Evaluator, index: usize| {
        let (draw, episode) = (index / episodes.len(), &episodes[index % episodes.len()]);
        let seed = scenario.seed.wrapping_add(episode.set * draws as u64 + draw as u64);
        let policy = evaluated.build(&scenario, seed)?;
        let (mut run, mut samples, mut outages) = (Run::default(), Vec::new(), OutageLog::default());
        let mut look = |now_ns: u64, room: &SimulatedRoom| {
            let world = room.world();
            let sample = evaluator.evaluate_world(world, dark.as_ref().unwrap_or(room.angles()));
            if episode.instants_ns.binary_search(&now_ns).is_ok() {
                samples.push(sample);
            }
            if now_ns.is_multiple_of(OUTAGE_STEP_NS) {
                outages.handle(world.ids().iter().copied().zip(evaluator.below_minimum()));
            }
        };
        let failed = || format!("policy {}", evaluated.name());
        if let Some(known) = evaluated.known() {
            let room = episode.begun(&scenario, trace)?;
            evaluated.begin_episode().with_context(failed)?;
            Ceiling::new(&scenario, room, policy, known).run(&episode.looks_ns(), &mut look).with_context(failed)?;
        } else {
            let controller = Controller::new(&scenario, scenario.channel_model()?, policy, 1);
            let mut lockstep = Lockstep::new(&scenario, trace, episode, (controller, evaluated.is_aware()))?;
            evaluated.begin_episode().with_context(failed)?;
            lockstep.run(&episode.looks_ns(), &mut look).with_context(failed)?;
            run.decisions_us = lockstep.decisions_us;
            if has_belief {
                run.belief.push(lockstep.log.errors(episode.world(&scenario, trace)?, measured_ns));
            }
            if has_belief && index == 0 {
                run.tracked = lockstep.log.tracked(episode.world(&scenario, trace)?, start_ns());
            }
        }
        run.groups.push(samples);
        run.outages.push(outages);
        Ok(run)
    };
    let count = draws * episodes.len();
    let mut ran = parts(evaluated.is_parallel(&scenario), count, || evaluator.clone(), of_episode)?.into_iter();
    Ok(Run::mean((0..draws).map(|_| Run::joined(ran.by_ref().take(episodes.len()))).collect()))
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
        episode: &HeldOutEpisode,
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
