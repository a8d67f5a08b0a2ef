//! The figures of each policy in each episode, from which a reader can compute other statistics.

use heliostat_environment::episodes::HeldOutEpisode;
use heliostat_environment::held_out::{held_out_seed, held_out_state};
use heliostat_environment::outage::Outages;
use heliostat_environment::score::{Figure, Sample};
use heliostat_environment::statistics::{mean, present};

use super::run::Run;
use super::settings::{Loop, Settings};

/// The figure that weights `blocked_rate_mbps`: the number of states with a user without a direct path.
pub(super) const BLOCKED_STATES: &str = "blocked_states";

/// The figure that weights `ratio_to_oracle`: the number of states in which the oracle serves a user.
const RATIO_STATES: &str = "ratio_states";

/// The figure that weights `jain`: the number of states in which a user has a rate.
const JAIN_STATES: &str = "jain_states";

/// A room of a comparison with its states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Group {
    /// The seed of the comparison, counted up from the scenario's.
    pub set: u64,
    /// The seed of the room itself.
    pub room: u64,
}

/// The figures of one policy in one episode, or in one state of a static comparison.
#[derive(Clone, Debug)]
pub struct EpisodeRow {
    /// The policy; `None` for the oracle.
    pub policy: Option<String>,
    /// Index among the actors of a learned policy, from 1.
    pub actor: Option<usize>,
    /// The room.
    pub group: Group,
    /// Number of its states.
    pub states: usize,
    /// Figures by name; NaN is a missing value.
    pub figures: Vec<(&'static str, f64)>,
    /// The users' time in minutes, which weights `outages_per_user_minute`; NaN where that is missing.
    pub user_minutes: f64,
}

impl EpisodeRow {
    /// A figure by its name; NaN where it is missing.
    pub(super) fn figure(&self, name: &str) -> f64 {
        self.figures.iter().find(|(of, _)| *of == name).map_or(f64::NAN, |(_, value)| *value)
    }
}

/// The rooms of a comparison in closed loop.
pub(super) fn of_episodes(settings: &Settings, episodes: &[HeldOutEpisode]) -> Vec<Group> {
    let first = settings.scenario.seed;
    episodes.iter().map(|episode| Group { set: first.wrapping_add(episode.set), room: episode.seed }).collect()
}

/// The rooms of a static comparison, one for each state.
pub(super) fn of_states(settings: &Settings) -> Vec<Group> {
    let of_state = |index| {
        let (set, index) = held_out_state(settings.scenario.seed, settings.states, index);
        Group { set, room: held_out_seed(set, index) }
    };
    (0..settings.seeds * settings.states).map(of_state).collect()
}

/// The figures of the oracle, then those of each policy.
pub(super) fn rows(
    settings: &Settings,
    groups: &[Group],
    runs: &[Vec<Run>],
    oracle: &[Vec<Sample>],
) -> Vec<EpisodeRow> {
    let mut rows = Vec::new();
    let mut push = |of: (Option<&str>, Option<usize>), samples: &[Vec<Sample>], outages: &[Option<Outages>]| {
        for (index, (group, own)) in groups.iter().zip(samples).enumerate() {
            let outages = outages.get(index).copied().flatten();
            let figures = figures(settings.mode, (own, &oracle[index]), outages);
            let user_minutes = outages.map_or(f64::NAN, |outages| outages.user_minutes);
            let (policy, actor) = (of.0.map(String::from), of.1);
            rows.push(EpisodeRow { policy, actor, group: *group, states: own.len(), figures, user_minutes });
        }
    };
    push((None, None), oracle, &[]);
    for (evaluated, runs) in settings.policies.iter().zip(runs) {
        for (index, run) in runs.iter().enumerate() {
            let actor = evaluated.is_learned().then_some(index + 1);
            // The draws of a random policy have outages of their own, and one row together.
            let is_one = run.outages.len() == run.groups.len();
            let outages = run.outages.iter().filter(|_| is_one).map(|log| Outages::of(std::iter::once(log)));
            push((Some(evaluated.name()), actor), &run.groups, &outages.collect::<Vec<_>>());
        }
    }
    rows
}

fn figures(mode: Loop, (own, oracle): (&[Sample], &[Sample]), outages: Option<Outages>) -> Vec<(&'static str, f64)> {
    let values =
        |figure: Figure| present(&own.iter().zip(oracle).map(|(own, best)| (figure.of)(own, best)).collect::<Vec<_>>());
    let of = |figure: Figure| (figure.name, mean(&values(figure)));
    let mut figures = vec![
        of(Figure::SUM_RATE),
        of(Figure::RATIO),
        (RATIO_STATES, values(Figure::RATIO).len() as f64),
        of(Figure::QOS_MET),
        of(Figure::JAIN),
        (JAIN_STATES, values(Figure::JAIN).len() as f64),
        of(Figure::BLOCKED_RATE),
        (BLOCKED_STATES, values(Figure::BLOCKED_RATE).len() as f64),
        of(Figure::BER),
    ];
    if mode == Loop::ClosedLoop {
        figures.push(of(Figure::OUTAGE_TIME));
        let outage = |value: fn(&Outages) -> f64| outages.as_ref().map_or(f64::NAN, value);
        figures.push(("outages_per_user_minute", outage(|outages| outages.per_user_minute)));
        figures.push(("outage_p95_s", outage(|outages| outages.p95_s)));
    }
    figures
}

#[cfg(test)]
mod tests {
    use heliostat_environment::statistics::Spread;

    use super::*;

    #[test]
    fn the_mean_rate_of_blocked_users_follows_from_the_episodes_and_their_weights() {
        let sample =
            |blocked_rate_mbps| Sample { sum_rate_mbps: 9.0, met: 1.0, jain: 1.0, blocked_rate_mbps, ber: 0.0 };
        let rates = vec![vec![1.0, f64::NAN], vec![4.0, 7.0], vec![f64::NAN, f64::NAN]];
        let (mut sum, mut weights) = (0.0, 0.0);
        for group in &rates {
            let own: Vec<Sample> = group.iter().map(|rate| sample(*rate)).collect();
            let figures = figures(Loop::Static, (&own, &own), None);
            let group = Group { set: 1, room: 2 };
            let (states, user_minutes) = (own.len(), f64::NAN);
            let row = EpisodeRow { policy: None, actor: None, group, states, figures, user_minutes };
            if row.figure(BLOCKED_STATES) > 0.0 {
                sum += row.figure("blocked_rate_mbps") * row.figure(BLOCKED_STATES);
                weights += row.figure(BLOCKED_STATES);
            }
        }
        assert_eq!((sum / weights, weights), (Spread::of(&[rates]).mean, 3.0));
    }

    #[test]
    fn the_ratio_is_weighted_by_the_states_in_which_the_oracle_serves_a_user() {
        let sample =
            |sum_rate_mbps| Sample { sum_rate_mbps, met: 1.0, jain: 1.0, blocked_rate_mbps: f64::NAN, ber: 0.0 };
        let (own, oracle) = ([4.0, 0.0, 9.0].map(sample), [8.0, 0.0, 9.0].map(sample));
        let figures = figures(Loop::Static, (&own, &oracle), None);
        let (group, user_minutes) = (Group { set: 1, room: 2 }, f64::NAN);
        let row = EpisodeRow { policy: None, actor: None, group, states: 3, figures, user_minutes };
        assert_eq!((row.figure("ratio_to_oracle"), row.figure(RATIO_STATES)), (0.75, 2.0));
    }

    #[test]
    fn jains_index_is_weighted_by_the_states_in_which_a_user_has_a_rate() {
        let sample = |jain| Sample { sum_rate_mbps: 1.0, met: 1.0, jain, blocked_rate_mbps: f64::NAN, ber: 0.0 };
        let own = [1.0, f64::NAN, 0.5].map(sample);
        let figures = figures(Loop::Static, (&own, &own), None);
        let (group, user_minutes) = (Group { set: 1, room: 2 }, f64::NAN);
        let row = EpisodeRow { policy: None, actor: None, group, states: 3, figures, user_minutes };
        assert_eq!((row.figure("jain"), row.figure(JAIN_STATES)), (0.75, 2.0));
    }
}
