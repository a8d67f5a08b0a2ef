//! From a report to the time for which its users are predicted.

use heliostat_proto::Nanos;
use serde::{Deserialize, Serialize};

/// Weight of a new interval in the mean time between reports.
const INTERVAL_WEIGHT: f64 = 0.1;

/// A longer interval counts as this many mean ones, so that a pause changes the mean little.
const PAUSE: f64 = 3.0;

/// A settling time or an interval in a recorded state above this, in s, is of no room.
const TIME_MAX_S: f64 = 1e6;

/// How far ahead users are predicted.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Lead {
    /// Settling time of the mirrors in s.
    pub settling_s: f64,
    /// Mean time between reports in s: that of the scenario until reports show another.
    interval_s: f64,
    /// Time of the last report; 0 without one.
    last_ns: Nanos,
}

impl Lead {
    /// With this time between reports in s, and mirrors that settle at once.
    pub fn new(interval_s: f64) -> Self {
        Self { settling_s: 0.0, interval_s, last_ns: 0 }
    }

    /// From the sampling of a report of this age to the middle of the command's time in force, in
    /// s.
    pub fn ahead_s(&self, age_s: f64) -> f64 {
        age_s + 0.5 * self.interval_s + self.settling_s
    }

    /// Learns the time between reports.
    pub fn handle_users(&mut self, time_ns: Nanos) {
        let interval_s = time_ns.saturating_sub(self.last_ns) as f64 * 1e-9;
        if self.last_ns > 0 {
            self.interval_s += INTERVAL_WEIGHT * (interval_s.min(PAUSE * self.interval_s) - self.interval_s);
        }
        self.last_ns = time_ns;
    }

    /// Another source reports from now on: the time since its predecessor's last report is no interval
    /// between reports.
    pub fn forget(&mut self) {
        self.last_ns = 0;
    }

    /// Whether a room can have these times.
    pub fn is_sound(&self) -> bool {
        [self.settling_s, self.interval_s].iter().all(|time_s| (0.0..=TIME_MAX_S).contains(time_s))
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{Stamp, UserReport};
    use heliostat_scenario::Scenario;

    use super::*;
    use crate::observe::observer::Observer;

    #[test]
    fn the_lead_follows_the_rate_of_the_reports_and_not_their_pauses() {
        let mut lead = Lead::new(0.1);
        assert!((lead.ahead_s(0.1) - 0.15).abs() < 1e-12, "10 reports a second");
        for report in 1..=100_u64 {
            lead.handle_users(report * 400_000_000);
        }
        assert!((lead.ahead_s(0.1) - 0.3).abs() < 1e-3, "{}", lead.ahead_s(0.1));
        lead.handle_users(60_000_000_000);
        assert!(lead.ahead_s(0.1) < 0.35, "one pause: {}", lead.ahead_s(0.1));
    }

    #[test]
    fn the_time_between_the_reports_of_two_sources_is_no_interval() {
        let scenario = Scenario::builtin("hall").expect("a built-in scenario");
        let model = scenario.channel_model().expect("a valid channel");
        let mut observer = Observer::new(&scenario, &model);
        let report = |time_ns| UserReport { stamp: Stamp { time_ns, ..Stamp::default() }, ..UserReport::default() };
        observer.handle_users(&report(1_000_000_000));
        observer.forget();
        observer.handle_users(&report(9_000_000_000));
        assert_eq!(observer.lead_s(), 0.05, "half of the interval that the scenario states");
    }
}
