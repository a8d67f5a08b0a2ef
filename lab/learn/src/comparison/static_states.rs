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
use super::run::Run;
use super::settings::{RANDOM_DRAWS, Settings};
use crate::environment::room::observe;
use crate::evaluation::held_out::{best_angles, held_out_world};

/// Decisions before the timed ones, so that buffers have their size and caches are warm.
const WARM_UP: usize = 8;

/// Compares on `states` states of each seed.
pub(super) fn compare(settings: &Settings, bar: &ProgressBar) -> anyhow::Result<Compared> {
    let scenario = &settings.scenario;
    let mut evaluator = Evaluator::new(scenario.channel_model()?, scenario.min_rate_bps());
    let states = states(settings, bar, &evaluator)?;
    let oracle: Vec<Vec<Sample>> = solve(settings, &states, bar, &mut evaluator);
    let mut runs = Vec::new();
    bar.reset();
    bar.set_length(settings.policies.len() as u64);
    for evaluated in &settings.policies {
        bar.set_message(format!("policies: {}", evaluated.name()));
        let trainings = evaluated.trainings(scenario, settings.training_seed).into_iter();
        let of_policy: Vec<Run> =
            trainings.map(|one| run(settings, &one, &states, &mut evaluator)).collect::<anyhow::Result<_>>()?;
        runs.push(of_policy);
        bar.inc(1);
    }
    let each = episode_row::rows(settings, &of_states(settings), &runs, &oracle);
    Ok((rows(settings, &runs, &oracle), each))
}

fn states(settings: &Settings, bar: &ProgressBar, evaluator: &Evaluator) -> anyhow::Result<Vec<Observation>> {
    let scenario = &settings.scenario;
    bar.set_length((settings.seeds * settings.states) as u64);
    bar.set_message("rooms drawn");
    let mut states = Vec::new();
    for index in 0..settings.seeds * settings.states {
        let (set, index) = held_out_state(scenario.seed, settings.states, index);
        let world = held_out_world(scenario, None, set, index)?;
        let mut seen = Observation::new(evaluator.model(), scenario.users.count);
        seen.min_rate_bps.copy_from_slice(world.min_rate_bps());
        observe(&world, &mut seen);
        states.push(seen);
        bar.inc(1);
    }
    Ok(states)
}

/// The oracle's sample in each state.
fn solve(
    settings: &Settings,
    states: &[Observation],
    bar: &ProgressBar,
    evaluator: &mut Evaluator,
) -> Vec<Vec<Sample>> {
    bar.reset();
    bar.set_message("states solved by the oracle");
    let mut solver: Option<Solver> = None;
    let dark = settings.dark_angles();
    let solve = |seen: &Observation| {
        if let Some(angles) = &dark {
            return vec![evaluator.evaluate(&seen.scene, angles)];
        }
        let solver = solver.get_or_insert_with(|| Solver::new(seen.users(), seen.mirrors()));
        let angles = best_angles(solver, evaluator.model(), &seen.scene, &seen.min_rate_bps);
        bar.inc(1);
        vec![evaluator.evaluate(&seen.scene, &angles)]
    };
    states.iter().map(solve).collect()
}

fn run(
    settings: &Settings,
    evaluated: &EvaluatedPolicy,
    states: &[Observation],
    evaluator: &mut Evaluator,
) -> anyhow::Result<Run> {
    let draws = if evaluated.is_random() { RANDOM_DRAWS } else { 1 };
    let runs = (0..draws as u64).map(|draw| {
        let mut policy = evaluated.build(&settings.scenario, settings.scenario.seed.wrapping_add(draw))?;
        run_once(settings, (evaluated, policy.as_mut()), states, evaluator)
            .map_err(|error| error.context(format!("policy {}", evaluated.name())))
    });
    Ok(Run::mean(runs.collect::<anyhow::Result<_>>()?))
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
