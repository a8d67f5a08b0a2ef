//! What a policy did in all states of a comparison.

use heliostat_environment::outage::OutageLog;
use heliostat_environment::score::Sample;
use indicatif::ProgressBar;

use super::belief_log::Errors;
use super::evaluated_policy::EvaluatedPolicy;
use super::settings::Settings;
use super::tracked_user::TrackedUser;
use crate::threads::parts;

/// The runs of each policy, one for each training seed, by the function that makes one.
pub(super) fn of_policies(
    settings: &Settings,
    bar: &ProgressBar,
    run: impl Fn(&EvaluatedPolicy) -> anyhow::Result<Run> + Send + Sync,
) -> anyhow::Result<Vec<Vec<Run>>> {
    bar.reset();
    bar.set_length(settings.policies.len() as u64);
    let mut runs = Vec::new();
    for evaluated in &settings.policies {
        bar.set_message(format!("policies: {}", evaluated.name()));
        let trainings = evaluated.trainings(&settings.scenario, settings.training_seed);
        let is_parallel = evaluated.is_parallel(&settings.scenario);
        runs.push(parts(is_parallel, trainings.len(), || (), |(), index| run(&trainings[index]))?);
        bar.inc(1);
    }
    Ok(runs)
}

/// A policy's samples in all states, group by group, and the time of each decision in us.
#[derive(Default)]
pub(super) struct Run {
    pub groups: Vec<Vec<Sample>>,
    pub decisions_us: Vec<f64>,
    /// In closed loop, the outages of each episode.
    pub outages: Vec<OutageLog>,
    /// In closed loop, the errors of the belief in each episode.
    pub belief: Vec<Errors>,
    /// In closed loop, the users of the first episode as a filter believes them to be.
    pub tracked: Vec<TrackedUser>,
}

impl Run {
    /// One run from runs of its parts, in order.
    pub fn joined(parts: impl IntoIterator<Item = Self>) -> Self {
        let mut run = Self::default();
        for part in parts {
            run.groups.extend(part.groups);
            run.decisions_us.extend(part.decisions_us);
            run.outages.extend(part.outages);
            run.belief.extend(part.belief);
            if run.tracked.is_empty() {
                run.tracked = part.tracked;
            }
        }
        run
    }

    /// One run whose samples are the means over several runs on the same states.
    pub fn mean(mut runs: Vec<Self>) -> Self {
        let decisions_us = runs.iter_mut().flat_map(|run| std::mem::take(&mut run.decisions_us)).collect();
        let outages = runs.iter_mut().flat_map(|run| std::mem::take(&mut run.outages)).collect();
        let belief = runs.iter_mut().flat_map(|run| std::mem::take(&mut run.belief)).collect();
        let tracked = runs.first_mut().map(|run| std::mem::take(&mut run.tracked)).unwrap_or_default();
        let same = |group: usize, state: usize| {
            Sample::mean(&runs.iter().map(|run| run.groups[group][state]).collect::<Vec<_>>())
        };
        let groups = runs.first().map_or(&[][..], |run| &run.groups);
        let groups = groups.iter().enumerate();
        Self {
            groups: groups.map(|(group, states)| (0..states.len()).map(|state| same(group, state)).collect()).collect(),
            decisions_us,
            outages,
            belief,
            tracked,
        }
    }
}
