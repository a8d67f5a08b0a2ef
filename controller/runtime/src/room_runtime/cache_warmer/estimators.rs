//! Estimators for the cache warmer: the mean of durations, and the arrival of the next report.

use std::time::{Duration, Instant};

/// Share of the newest value in a mean, and of its deviation in the mean deviation: alpha of RFC
/// 6298, section 2.
const NEWEST_SHARE: f64 = 0.125;

/// Exponentially weighted mean of durations; zero while none is known.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MeanDuration(Duration);

impl MeanDuration {
    pub fn add(&mut self, newest: Duration) {
        self.0 = match self.is_known() {
            true => self.0.mul_f64(1.0 - NEWEST_SHARE) + newest.mul_f64(NEWEST_SHARE),
            false => newest,
        };
    }

    pub fn mean(&self) -> Duration {
        self.0
    }

    pub fn is_known(&self) -> bool {
        !self.0.is_zero()
    }
}

/// Estimates when the next report arrives, from the mean and mean deviation of the intervals
/// between reports.
///
/// It follows the round-trip time estimator of RFC 6298, section 2. It skips long intervals, in
/// which a report was lost.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ArrivalEstimator {
    last: Option<Instant>,
    intervals: u32,
    /// Long intervals in a row.
    outliers: u32,
    mean_s: f64,
    deviation_s: f64,
}

impl ArrivalEstimator {
    /// After an interval of this length the estimate starts again. It is far longer than the
    /// intervals of reports for which warm-ups pay.
    const PAUSE: Duration = Duration::from_secs(2);
    /// Intervals before the first estimate, and long intervals in a row after which the estimate
    /// starts again.
    const ENOUGH: u32 = 4;
    /// An interval longer than this number of means is an outlier: a lost report makes it 2.
    const OUTLIER: f64 = 1.5;
    /// Mean deviations between the mean and the earliest or latest arrival; RFC 6298 uses 4 for a
    /// timeout that must rarely expire.
    const DEVIATIONS: f64 = 2.0;

    pub fn on_report(&mut self, at: Instant) {
        let interval = self.last.replace(at).map(|last| at.saturating_duration_since(last));
        let Some(interval) = interval.filter(|interval| *interval < Self::PAUSE) else {
            *self = Self { last: self.last, ..Self::default() };
            return;
        };
        let interval_s = interval.as_secs_f64();
        let is_outlier = self.intervals >= Self::ENOUGH && interval_s > Self::OUTLIER * self.mean_s;
        self.outliers = if is_outlier { self.outliers + 1 } else { 0 };
        if self.outliers > Self::ENOUGH {
            *self = Self { last: self.last, ..Self::default() };
        } else if is_outlier {
            return;
        }
        if self.intervals == 0 {
            self.mean_s = interval_s;
        }
        let error_s = interval_s - self.mean_s;
        self.mean_s += NEWEST_SHARE * error_s;
        self.deviation_s += NEWEST_SHARE * (error_s.abs() - self.deviation_s);
        self.intervals = self.intervals.saturating_add(1);
    }

    /// The earliest likely arrival of the next report; none before enough intervals.
    pub fn earliest(&self) -> Option<Instant> {
        self.after(self.mean_s - Self::DEVIATIONS * self.deviation_s)
    }

    /// The latest likely arrival of the next report; none before enough intervals.
    pub fn latest(&self) -> Option<Instant> {
        self.after(self.mean_s + Self::DEVIATIONS * self.deviation_s)
    }

    fn after(&self, ahead_s: f64) -> Option<Instant> {
        let ahead = Duration::from_secs_f64(ahead_s.max(0.0));
        self.last.filter(|_| self.intervals >= Self::ENOUGH).map(|last| last + ahead)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: Duration = Duration::from_millis(10);

    /// The estimate after reports this many ms after the start.
    fn estimate(start: Instant, at_ms: &[f64]) -> ArrivalEstimator {
        let mut estimator = ArrivalEstimator::default();
        at_ms.iter().for_each(|ms| estimator.on_report(start + Duration::from_secs_f64(ms * 1e-3)));
        estimator
    }

    #[test]
    fn the_next_of_regular_reports_is_expected_after_the_same_interval() {
        let start = Instant::now();
        let estimator = estimate(start, &[0.0, 10.0, 20.0, 30.0, 40.0, 50.0]);
        let error = estimator.earliest().unwrap().duration_since(start).abs_diff(6 * TICK);
        assert!(error < Duration::from_micros(1), "{error:?}");
    }

    #[test]
    fn irregular_reports_are_expected_within_a_wider_window() {
        let start = Instant::now();
        let estimator = estimate(start, &[0.0, 11.0, 20.0, 31.0, 40.0, 51.0, 60.0, 71.0, 80.0]);
        let ahead = estimator.earliest().unwrap().duration_since(start + 8 * TICK);
        assert!(ahead < TICK - Duration::from_millis(1) && ahead > TICK / 2, "{ahead:?}");
        let ahead = estimator.latest().unwrap().duration_since(start + 8 * TICK);
        assert!(ahead > TICK + Duration::from_millis(1) && ahead < 3 * TICK / 2, "{ahead:?}");
    }

    #[test]
    fn a_lost_report_and_a_short_pause_do_not_change_the_interval() {
        let start = Instant::now();
        let estimator = estimate(start, &[0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 70.0, 80.0, 580.0]);
        let error = estimator.earliest().unwrap().duration_since(start).abs_diff(59 * TICK);
        assert!(error < Duration::from_micros(1), "{error:?}");
    }

    #[test]
    fn a_slower_report_rate_is_estimated_again() {
        let start = Instant::now();
        let slower = (1..=10).map(|tick| 40.0 + 50.0 * f64::from(tick));
        let times: Vec<f64> = [0.0, 10.0, 20.0, 30.0, 40.0].into_iter().chain(slower).collect();
        assert!(estimate(start, &times[..7]).earliest().unwrap() < start + 16 * TICK, "not yet");
        let error = estimate(start, &times).earliest().unwrap().duration_since(start).abs_diff(59 * TICK);
        assert!(error < Duration::from_micros(1), "{error:?}");
    }

    #[test]
    fn without_enough_intervals_no_report_is_expected() {
        let start = Instant::now();
        assert_eq!((ArrivalEstimator::default().earliest(), ArrivalEstimator::default().latest()), (None, None));
        assert_eq!(estimate(start, &[0.0, 10.0, 20.0]).earliest(), None, "too few");
        assert_eq!(
            estimate(start, &[0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 5000.0, 5010.0]).earliest(),
            None,
            "after a pause"
        );
        let after_pause = estimate(start, &[0.0, 50.0, 100.0, 150.0, 200.0, 5000.0, 5010.0, 5020.0, 5030.0, 5040.0]);
        let error = after_pause.earliest().unwrap().duration_since(start).abs_diff(Duration::from_millis(5050));
        assert!(error < Duration::from_micros(1), "the new interval: {error:?}");
    }
}
