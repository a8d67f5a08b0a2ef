//! Outages: for how long the rate of a user stays below the minimum rate.
//!
//! The rates are sampled every 20 ms. An outage is a run of samples of one user below the minimum
//! rate. It ends when the user leaves or the episode ends, so the longest outages are cut off at
//! the length of an episode.

use serde::Serialize;

use crate::episodes::OUTAGE_STEP_NS;
use crate::statistics::quantile;

/// Lengths in s for which [`Outages`] states the time in longer outages.
pub const OUTAGE_LENGTHS_S: [f64; 3] = [0.1, 0.5, 2.0];

/// The outages of one episode.
#[derive(Clone, Debug, Default)]
pub struct OutageLog {
    /// Users whose outage lasts, with its number of samples.
    open: Vec<(u32, u64)>,
    /// The number of samples of each outage that has ended.
    ended: Vec<u64>,
    /// Number of samples, over all users.
    samples: u64,
}

impl OutageLog {
    /// Takes one sample: the users, and whether each is below the minimum rate.
    pub fn handle(&mut self, users: impl Iterator<Item = (u32, bool)> + Clone) {
        let Self { open, ended, samples } = self;
        let is_below = |id: u32| users.clone().any(|(user, below)| user == id && below);
        open.retain(|(id, length)| {
            let lasts = is_below(*id);
            if !lasts {
                ended.push(*length);
            }
            lasts
        });
        for (id, below) in users.clone() {
            *samples += 1;
            if below {
                match open.iter_mut().find(|(user, _)| *user == id) {
                    Some((_, length)) => *length += 1,
                    None => open.push((id, 1)),
                }
            }
        }
    }
}

/// The distribution of the outages of a policy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Outages {
    /// Outages per minute of a user's time.
    pub per_user_minute: f64,
    /// The users' time in minutes, the weight of [`Outages::per_user_minute`] in a mean over episodes.
    pub user_minutes: f64,
    /// Median length in s.
    pub p50_s: f64,
    /// 95th percentile of the length in s.
    pub p95_s: f64,
    /// Share of the users' time in outages that are longer than each of [`OUTAGE_LENGTHS_S`].
    pub time_in_longer: [f64; OUTAGE_LENGTHS_S.len()],
}

impl Outages {
    /// The distribution over episodes; `None` without a sample.
    pub fn of<'a>(logs: impl Iterator<Item = &'a OutageLog>) -> Option<Self> {
        let step_s = OUTAGE_STEP_NS as f64 * 1e-9;
        let (mut lengths_s, mut samples) = (Vec::new(), 0);
        for log in logs {
            let lengths = log.ended.iter().chain(log.open.iter().map(|(_, length)| length));
            lengths_s.extend(lengths.map(|length| *length as f64 * step_s));
            samples += log.samples;
        }
        lengths_s.sort_by(f64::total_cmp);
        let user_s = samples as f64 * step_s;
        (samples > 0).then(|| Self {
            per_user_minute: lengths_s.len() as f64 / (user_s / 60.0),
            user_minutes: user_s / 60.0,
            p50_s: quantile(&lengths_s, 0.5),
            p95_s: quantile(&lengths_s, 0.95),
            time_in_longer: OUTAGE_LENGTHS_S.map(|least_s| {
                // Half a sample separates equal lengths from longer ones.
                let longer = lengths_s.iter().filter(|length_s| **length_s > least_s + 0.5 * step_s);
                // The sum of no length is -0.
                longer.sum::<f64>().abs() / user_s
            }),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_samples_below_the_minimum_rate_are_outages() {
        let mut log = OutageLog::default();
        // User 1 is below for two samples and for one; user 2 for the last two; user 3 leaves.
        let samples: [&[(u32, bool)]; 5] = [
            &[(1, true), (2, false), (3, true)],
            &[(1, true), (2, false)],
            &[(1, false), (2, false)],
            &[(2, true), (1, true)],
            &[(2, true), (1, false)],
        ];
        samples.iter().for_each(|users| log.handle(users.iter().copied()));
        let outages = Outages::of([&log, &OutageLog::default()].into_iter()).expect("samples");
        assert!((outages.per_user_minute - 4.0 / (11.0 * 0.02 / 60.0)).abs() < 1e-9);
        assert!((outages.p50_s - 0.03).abs() < 1e-12 && (outages.p95_s - 0.04).abs() < 1e-12);
        assert_eq!(outages.time_in_longer, [0.0; 3]);
        assert_eq!(Outages::of([&OutageLog::default()].into_iter()), None);
    }

    #[test]
    fn the_time_in_long_outages_leaves_out_shorter_ones() {
        let mut log = OutageLog::default();
        // User 1 is below for 0.1 s, user 2 for 0.6 s, of 1 s each.
        (0..50).for_each(|sample| log.handle([(1, sample < 5), (2, sample < 30)].into_iter()));
        let [tenth, half, two] = Outages::of(std::iter::once(&log)).expect("samples").time_in_longer;
        assert!((tenth - 0.3).abs() < 1e-12 && (half - 0.3).abs() < 1e-12 && two == 0.0, "{tenth} {half} {two}");
    }

    #[test]
    fn the_rate_of_several_episodes_is_the_mean_weighted_by_the_time_of_the_users() {
        let mut logs = [OutageLog::default(), OutageLog::default()];
        logs[0].handle([(1, true), (2, false)].into_iter());
        (0..6).for_each(|sample| logs[1].handle([(1, sample % 2 == 0)].into_iter()));
        let all = Outages::of(logs.iter()).expect("samples");
        let each = logs.map(|log| Outages::of(std::iter::once(&log)).expect("samples"));
        let minutes: f64 = each.iter().map(|one| one.user_minutes).sum();
        let outages: f64 = each.iter().map(|one| one.per_user_minute * one.user_minutes).sum();
        assert!((each[0].user_minutes - 2.0 * 0.02 / 60.0).abs() < 1e-12, "{each:?}");
        assert!((all.user_minutes - minutes).abs() < 1e-12, "{all:?} {each:?}");
        assert!((all.per_user_minute - outages / minutes).abs() < 1e-9, "{all:?} {each:?}");
    }

    #[test]
    fn a_policy_without_outages_has_none() {
        let mut log = OutageLog::default();
        log.handle([(1, false)].into_iter());
        let outages = Outages::of(std::iter::once(&log)).expect("a sample");
        assert!(outages.time_in_longer.iter().all(|share| share.is_sign_positive()), "{outages:?}");
        assert!(outages.per_user_minute == 0.0 && outages.p50_s.is_nan(), "{outages:?}");
    }
}
