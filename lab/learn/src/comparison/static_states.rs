//! Static comparison: the same held-out states for all policies, observed without error.

use std::time::Instant;

use heliostat_channel::MirrorAngles;
use heliostat_channel::solver::Solver;
use heliostat_core::observation::Observation;
use heliostat_core::policy::Policy;
use heliostat_core::safety::{Limits, check_finite};
use heliostat_environment::held_out::held_out_state;
use heliostat_environment::score::{Evaluator, Sample};
use indicatif::ProgressBar;

use super::Compared;
use super::episode_row::{self, of_states};
use super::evaluated_policy::EvaluatedPolicy;
use super::row::rows;
use super::run::{Run, of_policies};
use super::settings::{RANDOM_DRAWS, Settings};
use crate::environment::room::observe;
use crate::evaluation::held_out::{best_angles, held_out_world};
use crate::threads::parts;

/// Decisions before the timed ones, so that buffers have their size and caches are warm.
const WARM_UP: usize = 8;

/// Compares on `states` states of each seed.
pub(super) fn compare(settings: &Settings, bar: &ProgressBar) -> anyhow::Result<Compared> {
    let scenario = &settings.scenario;
    let evaluator = Evaluator::new(scenario.channel_model()?, scenario.min_rate_bps());
    let states = states(settings, bar, &evaluator)?;
    let oracle = solve(settings, &states, bar, &evaluator)?;
    let runs = of_policies(settings, bar, |one| run(settings, one, &states, &evaluator))?;
    let each = episode_row::rows(settings, &of_states(settings), &runs, &oracle);
    Ok((rows(settings, &runs, &oracle), each))
}

fn states(settings: &Settings, bar: &ProgressBar, evaluator: &Evaluator) -> anyhow::Result<Vec<Observation>> {
    let scenario = &settings.scenario;
    let count = settings.seeds * settings.states;
    bar.set_length(count as u64);
    bar.set_message("rooms drawn");
    let draw = |(): &mut (), index: usize| {
        let (set, index) = held_out_state(scenario.seed, settings.states, index);
        let world = held_out_world(scenario, None, set, index)?;
        let mut seen = Observation::new(evaluator.model(), scenario.users.count);
        seen.min_rate_bps.copy_from_slice(world.min_rate_bps());
        observe(&world, &mut seen);
        bar.inc(1);
        Ok(seen)
    };
    parts(true, count, || (), draw)
}

/// The oracle's sample in each state.
fn solve(
    settings: &Settings,
    states: &[Observation],
    bar: &ProgressBar,
    evaluator: &Evaluator,
) -> anyhow::Result<Vec<Vec<Sample>>> {
    bar.reset();
    bar.set_message("states solved by the oracle");
    let dark = settings.dark_angles();
    let begin = || (evaluator.clone(), None);
    let solve = |(evaluator, solver): &mut (Evaluator, Option<Solver>), index: usize| {
        let seen = &states[index];
        if let Some(angles) = &dark {
            return Ok(vec![evaluator.evaluate(&seen.scene, angles)]);
        }
        // The oracle does not depend on the states that its solver solved before.
        let solver = solver.get_or_insert_with(|| Solver::new(seen.users(), seen.mirrors()));
        let angles = best_angles(solver, evaluator.model(), &seen.scene, &seen.min_rate_bps);
        bar.inc(1);
        Ok(vec![evaluator.evaluate(&seen.scene, &angles)])
    };
    parts(true, states.len(), begin, solve)
}

fn run(
    settings: &Settings,
    evaluated: &EvaluatedPolicy,
    states: &[Observation],
    evaluator: &Evaluator,
) -> anyhow::Result<Run> {
    let scenario = &settings.scenario;
    let draws = if evaluated.is_random() { RANDOM_DRAWS } else { 1 };
    // A policy may continue from its last angles, so that one thread runs it in all states.
    let once = |evaluator: &mut Evaluator, draw: usize| {
        let mut policy = evaluated.build(scenario, scenario.seed.wrapping_add(draw as u64))?;
        run_once(settings, (evaluated, policy.as_mut()), states, evaluator)
            .map_err(|error| error.context(format!("policy {}", evaluated.name())))
    };
    Ok(Run::mean(parts(evaluated.is_parallel(scenario), draws, || evaluator.clone(), once)?))
}

fn run_once(
    settings: &Settings,
    (evaluated, policy): (&EvaluatedPolicy, &mut dyn Policy),
    states: &[Observation],
    evaluator: &mut Evaluator,
) -> anyhow::Result<Run> {
    let limits = Limits::new(&settings.scenario.control);
    let dark = settings.dark_angles();
    let mut angles = MirrorAngles::flat(evaluator.model().mirrors.len());
    for seen in states.iter().take(WARM_UP) {
        policy.act(evaluator.model(), seen, &mut angles)?;
    }
    let mut run = Run::default();
    for seen in states {
        evaluated.begin_episode()?;
        let begun = Instant::now();
        policy.act(evaluator.model(), seen, &mut angles)?;
        run.decisions_us.push(begun.elapsed().as_secs_f64() * 1e6);
        check_finite(&angles)?;
        // The users do not move, so the mirrors have unlimited time to turn.
        limits.bound(&seen.angles, f64::INFINITY, &mut angles);
        run.groups.push(vec![evaluator.evaluate(&seen.scene, dark.as_ref().unwrap_or(&angles))]);
    }
    Ok(run)
}
