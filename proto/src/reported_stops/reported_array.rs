//! What one array of a room reported about the emergency stops, and its standing by that.

use std::collections::BTreeMap;
use std::time::Duration;

use super::{STOPS_WITHIN, Standing};
use crate::enumerations::ArrayState;
use crate::limits::UNLISTED_STOPS;
use crate::messages::StopReport;
use crate::stop_hold::{HeldStop, StopHold};
use crate::structures::StopName;

/// A stop report is published each second, and at each change. An array without one for this time does
/// not answer.
pub(super) const REPORT_AGE_MAX: Duration = Duration::from_millis(2500);

/// Telemetry is published ten times a second.
pub(super) const TELEMETRY_AGE_MAX: Duration = Duration::from_millis(1500);

/// What an array reported last, with arrival times.
#[derive(Clone, Debug, Default)]
pub(super) struct ReportedArray {
    /// Arrival of its first report.
    pub first: Option<Duration>,
    pub state: Option<(Duration, ArrayState)>,
    /// Arrival of the last telemetry of a stopped device, and its source.
    pub device_stopped: Option<(Duration, u64)>,
    pub has_safety: bool,
    pub stops: Option<(Duration, StopReport)>,
    /// Whether its stop without sender has stood for others since it reported that stop first.
    pub had_unlisted: bool,
    /// The last stop report of each of its drivers, and recent ones of others: an array can have two by mistake.
    pub by_source: BTreeMap<u64, (Duration, StopReport)>,
    pub hold: StopHold,
    /// The stops of this process that it has reported, the last of each sender.
    pub reported: Vec<StopName>,
}

impl ReportedArray {
    /// What the array with these drivers does about its stops, with reports that arrived after `since` only.
    pub fn standing(&self, drivers: &[u64], now: Duration, since: Option<Duration>) -> Standing {
        if !self.hold.is_stopped() {
            return Standing::Free;
        }
        if let Some(shared) = self.shared(drivers, now) {
            return shared;
        }
        let mut held = self.hold.stops().iter().map(|held| held.name);
        let is_recent = |at: Duration, age_max: Duration| now.saturating_sub(at) < age_max;
        let counts = |at: Duration, age_max| is_recent(at, age_max) && since.is_none_or(|since| at >= since);
        // A report from before `since` counts if telemetry has confirmed it meanwhile.
        let is_confirmed = |report: &StopReport| {
            let telemetry = self.device_stopped.filter(|(_, source)| *source == report.stamp.source);
            report.device_stopped && telemetry.is_some_and(|(at, _)| counts(at, TELEMETRY_AGE_MAX))
        };
        let is_fresh = |(at, report): &&(Duration, StopReport)| {
            counts(*at, REPORT_AGE_MAX) || (is_recent(*at, REPORT_AGE_MAX) && is_confirmed(report))
        };
        if let Some((_, report)) = self.stops.as_ref().filter(is_fresh) {
            return match (held.all(|name| report.is_latched(name)), report.device_stopped) {
                (false, _) => Standing::Moving,
                (true, true) => Standing::Stopped,
                (true, false) => Standing::Latched { problem: report.problem.clone() },
            };
        }
        let is_older = self.stops.is_none() && self.is_settled(now);
        match self.state.filter(|(at, _)| counts(*at, TELEMETRY_AGE_MAX)) {
            Some((_, ArrayState::Stopped)) if is_older => Standing::Unknown,
            Some(_) => Standing::Moving,
            None => Standing::Silent,
        }
    }

    /// Its standing if it has several drivers, and the own recent reports of any do not confirm its stops.
    fn shared(&self, drivers: &[u64], now: Duration) -> Option<Standing> {
        let open: Vec<u64> = drivers.iter().copied().filter(|source| !self.has_stopped(*source, now)).collect();
        let reports = open.iter().filter_map(|source| self.recent_report(*source, now));
        let problems = reports.map(|report| report.problem.as_str());
        let problem = problems.filter(|problem| !problem.is_empty()).collect::<Vec<_>>().join("; ");
        let is_shared = drivers.len() > 1 && !open.is_empty();
        is_shared.then_some(Standing::Shared { drivers: drivers.len(), open, problem })
    }

    /// The last stop report of a source, unless it is old.
    fn recent_report(&self, source: u64, now: Duration) -> Option<&StopReport> {
        let recent = self.by_source.get(&source).filter(|(at, _)| now.saturating_sub(*at) < REPORT_AGE_MAX);
        recent.map(|(_, report)| report)
    }

    /// Whether the own recent report of a driver confirms its stops.
    pub fn has_stopped(&self, source: u64, now: Duration) -> bool {
        self.recent_report(source, now).is_some_and(|report| self.is_confirmed_by(report))
    }

    /// Whether a driver has not confirmed its stops, by its last report of any age.
    pub fn is_unanswered(&self, source: u64) -> bool {
        let is_answered = self.by_source.get(&source).is_some_and(|(_, report)| self.is_confirmed_by(report));
        self.hold.is_stopped() && !is_answered
    }

    /// Whether a report shows that a device has executed every stop that is held.
    fn is_confirmed_by(&self, report: &StopReport) -> bool {
        report.device_stopped && self.hold.stops().iter().all(|held| report.is_latched(held.name))
    }

    /// Whether stop reports of its driver would have arrived.
    pub fn is_settled(&self, now: Duration) -> bool {
        self.first.is_some_and(|first| now.saturating_sub(first) > STOPS_WITHIN)
    }

    pub fn is_silent(&self, now: Duration) -> bool {
        self.state.is_none_or(|(at, _)| now.saturating_sub(at) >= TELEMETRY_AGE_MAX)
    }

    /// Whether a stop of this name, which is held for it, stands for stops that it could not list. Its reason states it
    /// also to a process that has seen no full list of the array.
    pub fn stands_for_unlisted(&self, HeldStop { name, reason, .. }: &HeldStop) -> bool {
        *name == StopName::default() && (self.had_unlisted || reason.contains(UNLISTED_STOPS))
    }

    /// Whether its driver is present and has published no stop reports.
    pub fn lacks_stop_reports(&self, now: Duration) -> bool {
        !self.is_silent(now) && !self.hold.has_stop_reports()
    }
}
