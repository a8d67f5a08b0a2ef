//! What a policy did in all states of a comparison.

use heliostat_environment::outage::OutageLog;
use heliostat_environment::score::Sample;

use super::belief_log::Errors;
use super::tracked_user::TrackedUser;

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
