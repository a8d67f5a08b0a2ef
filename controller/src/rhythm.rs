//! When the next report is expected, from when the last ones came.
//!
//! It reads no clock: time comes in.

use std::time::{Duration, Instant};

/// Share of the newest interval in the mean, and of its deviation in the mean deviation.
const NEWEST_SHARE: f64 = 0.125;

/// Reports further apart than this are not part of one rhythm.
const PAUSE: Duration = Duration::from_secs(2);

/// Intervals after which an expectation is worth acting on.
const ENOUGH: u32 = 4;

/// An interval of so many means is none of the rhythm's.
const STRAY: f64 = 1.5;

/// Mean deviations by which a report is expected to come early or late at most.
const DEVIATIONS: f64 = 2.0;

/// Mean and mean deviation of the intervals between reports.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rhythm {
    last: Option<Instant>,
    intervals: u32,
    /// Intervals in a row that were none of the rhythm's.
    strays: u32,
    mean_s: f64,
    deviation_s: f64,
}

impl Rhythm {
    /// A report came.
    pub fn heard(&mut self, at: Instant) {
        let interval = self.last.replace(at).map(|last| at.saturating_duration_since(last));
        let Some(interval) = interval.filter(|interval| *interval < PAUSE) else {
            *self = Self { last: self.last, ..Self::default() };
            return;
        };
        let interval_s = interval.as_secs_f64();
        // One was lost, or the reports paused: the rhythm is the same, unless it goes on so.
        let strays = self.intervals >= ENOUGH && interval_s > STRAY * self.mean_s;
        self.strays = if strays { self.strays + 1 } else { 0 };
        if self.strays > ENOUGH {
            *self = Self { last: self.last, ..Self::default() };
        } else if strays {
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

    /// The earliest at which the next report is likely to come; none while there is no rhythm.
    pub fn earliest(&self) -> Option<Instant> {
        self.after(self.mean_s - DEVIATIONS * self.deviation_s)
    }

    /// The latest, likewise.
    pub fn latest(&self) -> Option<Instant> {
        self.after(self.mean_s + DEVIATIONS * self.deviation_s)
    }

    fn after(&self, ahead_s: f64) -> Option<Instant> {
        let ahead = Duration::from_secs_f64(ahead_s.max(0.0));
        self.last.filter(|_| self.intervals >= ENOUGH).map(|last| last + ahead)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: Duration = Duration::from_millis(10);

    /// A rhythm of reports this many ms after the start.
    fn heard(start: Instant, at_ms: &[f64]) -> Rhythm {
        let mut rhythm = Rhythm::default();
        at_ms.iter().for_each(|ms| rhythm.heard(start + Duration::from_secs_f64(ms * 1e-3)));
        rhythm
    }

    #[test]
    fn a_steady_rhythm_goes_on() {
        let start = Instant::now();
        let rhythm = heard(start, &[0.0, 10.0, 20.0, 30.0, 40.0, 50.0]);
        let error = rhythm.earliest().unwrap().duration_since(start).abs_diff(6 * TICK);
        assert!(error < Duration::from_micros(1), "{error:?}");
    }

    #[test]
    fn what_comes_irregularly_is_expected_earlier_and_later() {
        let start = Instant::now();
        let rhythm = heard(start, &[0.0, 11.0, 20.0, 31.0, 40.0, 51.0, 60.0, 71.0, 80.0]);
        let ahead = rhythm.earliest().unwrap().duration_since(start + 8 * TICK);
        assert!(ahead < TICK - Duration::from_millis(1) && ahead > TICK / 2, "{ahead:?}");
        let ahead = rhythm.latest().unwrap().duration_since(start + 8 * TICK);
        assert!(ahead > TICK + Duration::from_millis(1) && ahead < 3 * TICK / 2, "{ahead:?}");
    }

    #[test]
    fn a_lost_report_and_a_pause_leave_the_rhythm_as_it_was() {
        let start = Instant::now();
        let rhythm = heard(start, &[0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 70.0, 80.0, 580.0]);
        let error = rhythm.earliest().unwrap().duration_since(start).abs_diff(59 * TICK);
        assert!(error < Duration::from_micros(1), "{error:?}");
    }

    #[test]
    fn a_slower_rhythm_is_learned_anew() {
        let start = Instant::now();
        let slower = (1..=10).map(|tick| 40.0 + 50.0 * f64::from(tick));
        let times: Vec<f64> = [0.0, 10.0, 20.0, 30.0, 40.0].into_iter().chain(slower).collect();
        assert!(heard(start, &times[..7]).earliest().unwrap() < start + 16 * TICK, "not yet");
        let error = heard(start, &times).earliest().unwrap().duration_since(start).abs_diff(59 * TICK);
        assert!(error < Duration::from_micros(1), "{error:?}");
    }

    #[test]
    fn without_a_rhythm_nothing_is_expected() {
        let start = Instant::now();
        assert_eq!((Rhythm::default().earliest(), Rhythm::default().latest()), (None, None));
        assert_eq!(heard(start, &[0.0, 10.0, 20.0]).earliest(), None, "too few");
        assert_eq!(
            heard(start, &[0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 5000.0, 5010.0]).earliest(),
            None,
            "a new beginning"
        );
        let after_pause = heard(start, &[0.0, 50.0, 100.0, 150.0, 200.0, 5000.0, 5010.0, 5020.0, 5030.0, 5040.0]);
        let error = after_pause.earliest().unwrap().duration_since(start).abs_diff(Duration::from_millis(5050));
        assert!(error < Duration::from_micros(1), "the new rhythm: {error:?}");
    }
}
