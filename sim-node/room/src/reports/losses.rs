//! Which reports of a stream are lost: independently, or in bursts.

use crate::random::{self, Purpose, RoomRng};

/// The losses of one stream.
///
/// A Markov chain of two states, of which one loses every report. With the share p of lost reports
/// and the mean length L of a burst, a burst ends after each report with the probability 1 / L, and
/// begins with p / ((1 - p) L). Independent losses have L = 1 / (1 - p).
///
/// Source: Gilbert, Bell System Technical Journal 39, 1960, with an error-free good state and h =
/// 0; Elliott, Bell System Technical Journal 42, 1963.
#[derive(Clone, Debug)]
pub struct Losses {
    /// Probability that the report after one that arrived is lost.
    begin: f64,
    /// Probability that the report after one that was lost is lost too.
    remain: f64,
    is_lost: bool,
    rng: RoomRng,
}

impl Losses {
    /// Losses of this share; `burst_reports` is the mean length of a burst, and 0 for independent
    /// losses.
    pub fn new(share: f64, burst_reports: f64, seed: u64, purpose: Purpose) -> Self {
        let mut rng = random::stream(seed, purpose, 0);
        let (begin, remain) = if burst_reports > 0.0 {
            (share / ((1.0 - share) * burst_reports), 1.0 - 1.0 / burst_reports)
        } else {
            (share, share)
        };
        // The state before the first report has the stationary distribution.
        let is_lost = random::uniform(&mut rng) < share;
        Self { begin, remain, is_lost, rng }
    }

    /// Whether the next report is lost.
    pub fn next_is_lost(&mut self) -> bool {
        let probability = if self.is_lost { self.remain } else { self.begin };
        self.is_lost = random::uniform(&mut self.rng) < probability;
        self.is_lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The share of lost reports, and the mean number of them in a row.
    fn figures(share: f64, burst_reports: f64) -> (f64, f64) {
        let mut losses = Losses::new(share, burst_reports, 1, Purpose::ChannelLoss);
        let (mut lost, mut bursts, mut before) = (0, 0, false);
        for _ in 0..200_000 {
            let now = losses.next_is_lost();
            lost += u32::from(now);
            bursts += u32::from(now && !before);
            before = now;
        }
        (f64::from(lost) / 200_000.0, f64::from(lost) / f64::from(bursts))
    }

    #[test]
    fn losses_have_their_share_and_their_mean_length() {
        for (share, burst_reports, mean) in [(0.2, 0.0, 1.25), (0.2, 5.0, 5.0), (0.5, 1.0, 1.0), (0.05, 20.0, 20.0)] {
            let (lost, length) = figures(share, burst_reports);
            assert!((lost / share - 1.0).abs() < 0.06 && (length / mean - 1.0).abs() < 0.06, "{lost} {length}");
        }
    }

    #[test]
    fn nothing_is_lost_at_a_share_of_zero() {
        for burst_reports in [0.0, 4.0] {
            let mut losses = Losses::new(0.0, burst_reports, 1, Purpose::ChannelLoss);
            assert!((0..1000).all(|_| !losses.next_is_lost()));
        }
    }
}
