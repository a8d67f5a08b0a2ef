//! Differences between two comparisons of the same episodes, such as two values of a sweep.

use heliostat_environment::statistics::Spread;

use super::Report;
use super::episode_row::Group;
use super::row::{bounded, difference};

/// A figure in each episode minus that in the same episode of another comparison.
///
/// `figure` is its name in JSON. `own` and `other` have its values, one list for each actor with a value for each
/// episode; NaN is a missing value. `states` has the number of states of each episode, which weights it in the mean.
/// The interval comes from the episodes, and includes the spread over actors. `None` where the numbers of actors or
/// episodes differ, or where no episode has both values.
pub fn paired(figure: &str, own: &[Vec<f64>], other: &[Vec<f64>], states: &[usize]) -> Option<Spread> {
    if own.len() != other.len() || !fits(own, states) || !fits(other, states) {
        return None;
    }
    let differences = |(own, other): (&Vec<f64>, &Vec<f64>)| -> Vec<Vec<f64>> {
        let pairs = own.iter().zip(other).zip(states);
        pairs.map(|((own, other), states)| vec![own - other; *states]).collect()
    };
    let spread = Spread::of(&own.iter().zip(other).map(differences).collect::<Vec<_>>());
    (!spread.mean.is_nan()).then(|| bounded(figure, spread))
}

/// A figure of one policy in each episode minus the mean over the actors of another policy, in the same episodes.
///
/// Arguments as for [`paired`], with any numbers of actors. The interval comes from the episodes, and includes the spread
/// over the actors of both. `None` where the numbers of episodes differ, or where no episode has both values.
pub fn paired_with_mean(own: &[Vec<f64>], other: &[Vec<f64>], states: &[usize]) -> Option<Spread> {
    if own.is_empty() || other.is_empty() || !fits(own, states) || !fits(other, states) {
        return None;
    }
    let in_states = |runs: &[Vec<f64>]| -> Vec<Vec<Vec<f64>>> {
        let of_run = |run: &Vec<f64>| run.iter().zip(states).map(|(value, states)| vec![*value; *states]).collect();
        runs.iter().map(of_run).collect()
    };
    let spread = difference(&in_states(own), &in_states(other));
    (!spread.mean.is_nan()).then_some(spread)
}

/// Whether each actor has a value for each episode.
fn fits(runs: &[Vec<f64>], states: &[usize]) -> bool {
    runs.iter().all(|run| run.len() == states.len())
}

impl Report {
    /// The rooms of the episodes with their numbers of states.
    pub fn rooms(&self) -> impl Iterator<Item = (Group, usize)> {
        self.each.iter().filter(|row| row.policy.is_none()).map(|row| (row.group, row.states))
    }

    /// A figure in each episode, one list for each actor: of a policy, or of the oracle (`None`). NaN is a missing
    /// value.
    pub fn in_episodes(&self, policy: Option<&str>, figure: &str) -> Vec<Vec<f64>> {
        let mut runs: Vec<(Option<usize>, Vec<f64>)> = Vec::new();
        for row in self.each.iter().filter(|row| row.policy.as_deref() == policy) {
            let value = row.figure(figure);
            match runs.last_mut() {
                Some((actor, values)) if *actor == row.actor => values.push(value),
                _ => runs.push((row.actor, vec![value])),
            }
        }
        runs.into_iter().map(|(_, values)| values).collect()
    }

    /// A figure of a policy, or of the oracle (`None`), minus that in another comparison, as [`paired`]; `None`
    /// also where the episodes have other rooms.
    pub fn minus(&self, other: &Self, policy: Option<&str>, figure: &str) -> Option<Spread> {
        if !self.rooms().eq(other.rooms()) {
            return None;
        }
        let states: Vec<usize> = self.rooms().map(|(_, states)| states).collect();
        let [own, other] = [self, other].map(|report| report.in_episodes(policy, figure));
        paired(figure, &own, &other, &states)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 97.5 % quantile of Student's t with one degree of freedom.
    const T_1: f64 = 12.706204736174694;

    #[test]
    fn what_both_comparisons_of_an_episode_share_is_not_in_the_interval() {
        let of = |own: &[f64], other: &[f64]| paired("ratio_to_oracle", &[own.to_vec()], &[other.to_vec()], &[20, 20]);
        let same = of(&[0.9, 0.5], &[0.75, 0.25]).expect("the same episodes");
        // The differences are 0.15 and 0.25: a standard error of 0.05.
        assert!((same.mean - 0.2).abs() < 1e-12 && (same.ci95 - 0.05 * T_1).abs() < 1e-9, "{same:?}");
        let gap = of(&[0.9, f64::NAN], &[0.75, 0.25]).expect("one episode has both");
        assert!((gap.mean - 0.15).abs() < 1e-12 && gap.ci95.is_nan(), "{gap:?}");
        assert_eq!(of(&[f64::NAN; 2], &[0.75, 0.25]), None);
    }

    #[test]
    fn an_episode_counts_by_its_states_and_shares_have_bounds() {
        let of = |figure: &str| paired(figure, &[vec![1.0, 0.4]], &[vec![0.2, 0.4]], &[3, 1]).expect("a difference");
        let (rate, share) = (of("sum_rate_mbps"), of("qos_met"));
        assert!((rate.mean - 0.6).abs() < 1e-12 && !rate.crosses_bound, "{rate:?}");
        assert!(share.crosses_bound && share.mean == rate.mean, "{share:?}");
    }

    #[test]
    fn the_actors_of_the_other_policy_are_averaged_and_widen_the_interval() {
        let own = [vec![0.75, 0.5]];
        let of = |other: &[Vec<f64>]| paired_with_mean(&own, other, &[20, 20]).expect("the same episodes");
        let (one, two) = (of(&[vec![0.5, 0.25]]), of(&[vec![0.25, 0.0], vec![0.75, 0.5]]));
        assert!(one.mean == 0.25 && two.mean == 0.25, "{one:?} {two:?}");
        // Two actors, 0.5 apart: a standard error of 0.25.
        assert!(one.ci95 < 1e-9 && (two.ci95 - 0.25 * T_1).abs() < 1e-9, "{one:?} {two:?}");
        assert_eq!(paired_with_mean(&own, &[], &[20, 20]), None, "a policy that the comparison does not have");
        assert_eq!(paired_with_mean(&own, &[vec![0.5]], &[20, 20]), None);
    }

    #[test]
    fn other_numbers_of_actors_or_episodes_do_not_pair() {
        let one = [vec![1.0, 2.0]];
        assert_eq!(paired("jain", &one, &[vec![1.0, 2.0], vec![1.0, 2.0]], &[1, 1]), None);
        assert_eq!(paired("jain", &one, &[vec![1.0]], &[1, 1]), None);
        assert_eq!(paired("jain", &[], &[], &[1, 1]), None, "a policy that no comparison has");
    }
}
