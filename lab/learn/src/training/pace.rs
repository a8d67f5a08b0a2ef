//! The remaining time of a training run, from its recent episodes.
//!
//! The first episodes only fill the replay and are much shorter than later ones, so the mean of all
//! would be too small.

use std::collections::VecDeque;
use std::time::Duration;

/// Episodes whose mean duration is that of the next ones.
const RECENT: usize = 10;

/// Durations of the recent episodes and of the last evaluation.
#[derive(Debug, Default)]
pub struct Pace {
    recent: VecDeque<Duration>,
    evaluation: Duration,
}

impl Pace {
    /// Adds an episode.
    pub fn add_episode(&mut self, duration: Duration) {
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back(duration);
    }

    /// Adds an evaluation on held-out states.
    pub fn add_evaluation(&mut self, duration: Duration) {
        self.evaluation = duration;
    }

    /// The time for these numbers of episodes and evaluations; `None` before the first episode.
    pub fn remaining(&self, episodes: usize, evaluations: usize) -> Option<Duration> {
        let count = u32::try_from(self.recent.len()).ok().filter(|count| *count > 0)?;
        let mean = self.recent.iter().sum::<Duration>() / count;
        Some(mean.mul_f64(episodes as f64) + self.evaluation.mul_f64(evaluations as f64))
    }
}

/// A duration as "45 s", "12 min" or "3 h 20 min".
pub fn rounded(duration: Duration) -> String {
    let seconds = duration.as_secs_f64().round() as u64;
    let minutes = (seconds + 30) / 60;
    match (seconds, minutes) {
        (0..90, _) => format!("{seconds} s"),
        (_, 0..90) => format!("{minutes} min"),
        _ => format!("{} h {} min", minutes / 60, minutes % 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_remaining_time_follows_the_recent_episodes_and_not_the_mean_of_all() {
        let mut pace = Pace::default();
        assert_eq!(pace.remaining(10, 1), None);
        (0..1000).for_each(|_| pace.add_episode(Duration::from_millis(1)));
        (0..RECENT).for_each(|_| pace.add_episode(Duration::from_secs(2)));
        assert_eq!(pace.remaining(30, 0), Some(Duration::from_secs(60)));
        pace.add_evaluation(Duration::from_secs(5));
        assert_eq!(pace.remaining(30, 3), Some(Duration::from_secs(75)));
    }

    #[test]
    fn durations_are_rounded_to_their_size() {
        let texts = [4, 89, 125, 3600, 12_000].map(|seconds| rounded(Duration::from_secs(seconds)));
        assert_eq!(texts, ["4 s", "89 s", "2 min", "60 min", "3 h 20 min"]);
    }
}
