//! The emergency stops that a process holds for one array.
//!
//! Each process that holds a stop uses this type: the controller, the page and the command line. A
//! stop is held until the array has reported its name and then dropped it. Until the first of these
//! reports the process repeats the stop, by its name.
//!
//! ```text
//!                 report with its name            report without its name, or that names it as
//! stop ordered --> Ordered -----------> Reported --------------------> dropped      released
//!                     ^                    |
//!                     +--------------------+  the array restarts: its reports have another source
//! ```
//!
//! Sequence numbers, names and sources decide; times of two hosts are never compared.
//!
//! A stop concerns every array of a room. A process that learns of one from the report of an array,
//! because it started later, holds it for the other arrays too: see [`unknown_stops`].
//!
//! | the array publishes | a stop is reported by | and dropped by |
//! | --- | --- | --- |
//! | stop reports | its name in the list | a later report without it, or with it among the released ones |
//! | safety reports only | its name as the latest stop | a later report without any stop |
//! | telemetry only | the state *stopped* | a later other state |

use crate::enumerations::StopAction;
use crate::limits::Nanos;
use crate::messages::{EmergencyStop, SafetyReport, StopRepetition, StopReport};
use crate::structures::{LatchedStopReport, Stamp, StopName};

/// Time between two repetitions of a stop in ns.
pub const STOP_REPEAT_NS: Nanos = 200_000_000;

/// Largest number of stops that are held for one array; the room is stopped by any of them.
const HELD_MAX: usize = 64;

/// A report is delayed when its sequence number is behind the latest by less than this. One that is
/// further behind counts: a forged number must not exclude all genuine reports.
const DELAYED_MAX: u64 = 64;

/// A stop that is held for one array.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct HeldStop {
    /// Its name.
    pub name: StopName,
    /// Name of the operator who sent it.
    pub operator: String,
    /// Reason for it.
    pub reason: String,
    /// When it arrived here, or at the array if the array reported it first, in ns.
    pub since_ns: Nanos,
    /// The source of the array's reports that named it.
    reported_by: Option<u64>,
    /// The array was in state *stopped* while it was held.
    seen_stopped: bool,
}

impl HeldStop {
    /// The repetition of the stop by another process, with the stamp of that process.
    pub fn repetition(&self, stamp: Stamp) -> StopRepetition {
        let StopName { source: stop_source, sequence: stop_sequence } = self.name;
        let (operator, reason) = (self.operator.clone(), self.reason.clone());
        StopRepetition { stamp, stop_source, stop_sequence, operator, reason }
    }

    /// The stop itself, for an array that understands no repetition.
    pub fn order(&self) -> EmergencyStop {
        let stamp = Stamp { source: self.name.source, sequence: self.name.sequence, time_ns: self.since_ns };
        let (operator, reason) = (self.operator.clone(), self.reason.clone());
        EmergencyStop { stamp, action: StopAction::Stop, operator, reason }
    }
}

/// The most precise reports of the array about its stops.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Detail {
    #[default]
    Telemetry,
    Safety,
    Stops,
}

/// The stops that are held for one array.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct StopHold {
    stops: Vec<HeldStop>,
    detail: Detail,
    /// Source and sequence number of the latest report of that detail.
    latest: (u64, u64),
    /// The names that the latest stop report lists as released.
    released: Vec<StopName>,
}

/// The stops of a report that are held for no array: each array has to [`learn`](StopHold::learn) them.
pub fn unknown_stops<'a>(
    reported: &[LatchedStopReport],
    holds: impl Iterator<Item = &'a StopHold> + Clone,
) -> Vec<LatchedStopReport> {
    let is_held = |name: StopName| holds.clone().any(|hold| hold.stops.iter().any(|held| held.name == name));
    // A stop without sender belongs to the process that started with it.
    let is_unknown = |stop: &&LatchedStopReport| stop.name() != StopName::default() && !is_held(stop.name());
    reported.iter().filter(is_unknown).cloned().collect()
}

impl StopHold {
    /// Holds a stop that was ordered at `now`; a re-arm of kind 9 changes nothing.
    pub fn order(&mut self, now: Nanos, order: &EmergencyStop) {
        if order.action == StopAction::Stop {
            self.hold(now, order.name(), &order.operator, &order.reason);
        }
    }

    /// Holds a stop no longer, because another holder has taken it over.
    pub fn forget(&mut self, name: StopName) {
        self.stops.retain(|held| held.name != name);
    }

    /// Holds a stop that another array reports, unless this array has released it, or a later one of its
    /// sender.
    pub fn learn(&mut self, stop: &LatchedStopReport) {
        if !self.has_released(stop.name()) {
            self.hold(stop.arrived_ns, stop.name(), &stop.operator, &stop.reason);
        }
    }

    /// Applies a stop report of the array; false for one that is older than the latest.
    pub fn handle_stops(&mut self, report: &StopReport) -> bool {
        if !self.is_newer(Detail::Stops, &report.stamp) {
            return false;
        }
        let source = report.stamp.source;
        self.released.clone_from(&report.released);
        let latched = |name: &StopName| report.stops.iter().any(|stop| stop.name() == *name);
        // A sender's later stop replaces its earlier one.
        let superseded = |name: &StopName| report.stops.iter().any(|stop| stop.name().replaces(*name));
        self.stops.retain_mut(|held| {
            if latched(&held.name) {
                held.reported_by = Some(source);
                return true;
            }
            let is_dropped = report.released.iter().any(|released| released.replaces(held.name))
                || held.reported_by == Some(source)
                || superseded(&held.name)
                // A stop without sender belongs to the process that started with it.
                || held.name == StopName::default();
            held.reported_by = None;
            !is_dropped
        });
        for stop in &report.stops {
            self.hold(stop.arrived_ns, stop.name(), &stop.operator, &stop.reason);
            self.mark(stop.name(), source);
        }
        let place = |held: &HeldStop| report.stops.iter().position(|stop| stop.name() == held.name);
        self.stops.sort_by_key(|held| place(held).unwrap_or(usize::MAX));
        true
    }

    /// Applies a safety report; false for one that is older than the latest, or of an array that
    /// publishes stop reports.
    pub fn handle_safety(&mut self, report: &SafetyReport) -> bool {
        if !self.is_newer(Detail::Safety, &report.stamp) {
            return false;
        }
        let source = report.stamp.source;
        match report.name() {
            Some(name) => {
                self.hold(report.stopped_ns, name, &report.operator, &report.reason);
                self.mark(name, source);
            }
            None => self.stops.retain(|held| held.reported_by != Some(source) && held.name != StopName::default()),
        }
        true
    }

    /// Applies the state in telemetry; that of an array that publishes more changes nothing.
    pub fn handle_state(&mut self, source: u64, is_stopped: bool) {
        if self.detail != Detail::Telemetry && self.latest.0 == source {
            return;
        }
        if !is_stopped && self.detail == Detail::Telemetry {
            self.stops.retain(|held| !held.seen_stopped);
        }
        self.stops.iter_mut().for_each(|held| held.seen_stopped |= is_stopped);
    }

    /// Whether a stop is held.
    pub fn is_stopped(&self) -> bool {
        !self.stops.is_empty()
    }

    /// The stops, in the order of their arrival.
    pub fn stops(&self) -> &[HeldStop] {
        &self.stops
    }

    /// The stops that the array has not reported: they are due for repetition.
    pub fn unreported(&self) -> impl Iterator<Item = &HeldStop> {
        self.stops.iter().filter(|held| !self.is_reported(held))
    }

    /// Whether a stop is held that the array has reported.
    pub fn has_reported(&self, name: StopName) -> bool {
        self.stops.iter().any(|held| held.name == name && self.is_reported(held))
    }

    /// Whether the array lists a stop, or a later one of its sender, as released.
    pub fn has_released(&self, name: StopName) -> bool {
        self.released.iter().any(|released| released.replaces(name))
    }

    /// Whether the array publishes stop reports, and so understands repetitions.
    pub fn has_stop_reports(&self) -> bool {
        self.detail == Detail::Stops
    }

    fn is_reported(&self, held: &HeldStop) -> bool {
        held.reported_by.is_some() || (self.detail == Detail::Telemetry && held.seen_stopped)
    }

    /// Notes a report; false for one that is older than the latest, or less precise.
    fn is_newer(&mut self, detail: Detail, stamp: &Stamp) -> bool {
        let (source, sequence) = self.latest;
        let is_delayed = sequence.checked_sub(stamp.sequence).is_some_and(|behind| behind < DELAYED_MAX);
        if source == stamp.source && (detail < self.detail || (detail == self.detail && is_delayed)) {
            return false;
        }
        (self.detail, self.latest) = (detail, (stamp.source, stamp.sequence));
        true
    }

    fn hold(&mut self, since_ns: Nanos, name: StopName, operator: &str, reason: &str) {
        let (operator, reason) = (operator.to_owned(), reason.to_owned());
        if let Some(held) = self.stops.iter_mut().find(|held| held.name == name) {
            // Without sender: the array's own reason takes the place of another one's.
            if name == StopName::default() {
                (held.operator, held.reason) = (operator, reason);
            }
        } else if self.stops.len() < HELD_MAX {
            self.stops.push(HeldStop { name, operator, reason, since_ns, reported_by: None, seen_stopped: false });
        }
    }

    fn mark(&mut self, name: StopName, source: u64) {
        self.stops.iter_mut().filter(|held| held.name == name).for_each(|held| held.reported_by = Some(source));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STOP: StopName = StopName { source: 3, sequence: 4 };
    const OTHER: StopName = StopName { source: 5, sequence: 1 };

    fn ordered(name: StopName) -> StopHold {
        let mut hold = StopHold::default();
        order(&mut hold, name);
        hold
    }

    fn order(hold: &mut StopHold, name: StopName) {
        let stamp = Stamp { source: name.source, sequence: name.sequence, time_ns: 0 };
        hold.order(1, &EmergencyStop { stamp, ..EmergencyStop::default() });
    }

    fn stops(source: u64, sequence: u64, names: &[StopName], released: &[StopName]) -> StopReport {
        let latched = |name: &StopName| LatchedStopReport {
            source: name.source,
            sequence: name.sequence,
            ..LatchedStopReport::default()
        };
        StopReport {
            stamp: Stamp { source, sequence, time_ns: 0 },
            stops: names.iter().map(latched).collect(),
            released: released.to_vec(),
            ..StopReport::default()
        }
    }

    fn safety(sequence: u64, name: Option<StopName>) -> SafetyReport {
        let StopName { source, sequence: of_stop } = name.unwrap_or_default();
        SafetyReport {
            stamp: Stamp { source: 9, sequence, time_ns: 0 },
            stopped: name.is_some(),
            stop_source: source,
            stop_sequence: of_stop,
            ..SafetyReport::default()
        }
    }

    #[test]
    fn a_stop_is_held_until_the_array_has_reported_and_dropped_it() {
        let mut hold = ordered(STOP);
        hold.handle_stops(&stops(9, 1, &[], &[]));
        assert_eq!(hold.unreported().count(), 1, "the array does not know of it");
        hold.handle_stops(&stops(9, 2, &[OTHER, STOP], &[]));
        assert_eq!((hold.stops().len(), hold.unreported().count()), (2, 0), "the array has another one too");
        hold.handle_stops(&stops(9, 2, &[], &[]));
        assert_eq!(hold.stops().len(), 2, "a report that arrives twice");
        hold.handle_stops(&stops(9, 3, &[OTHER], &[]));
        assert_eq!(hold.stops()[0].name, OTHER);
        hold.handle_stops(&stops(9, 4, &[], &[]));
        assert!(!hold.is_stopped());
    }

    #[test]
    fn a_forged_sequence_number_excludes_no_genuine_report() {
        let mut hold = ordered(STOP);
        hold.handle_stops(&stops(9, u64::MAX, &[STOP], &[]));
        hold.handle_stops(&stops(9, u64::MAX - 1, &[], &[]));
        assert!(hold.is_stopped(), "a delayed report");
        hold.handle_stops(&stops(9, 5, &[], &[]));
        assert!(!hold.is_stopped());
    }

    #[test]
    fn a_release_that_was_not_seen_is_learned_from_the_released_names() {
        let mut hold = ordered(STOP);
        hold.handle_stops(&stops(9, 7, &[], &[OTHER]));
        assert!(hold.is_stopped());
        hold.handle_stops(&stops(9, 8, &[], &[OTHER, STOP]));
        assert!(!hold.is_stopped());
    }

    #[test]
    fn the_release_of_a_stop_ends_the_earlier_ones_of_its_sender() {
        let later = StopName { sequence: STOP.sequence + 1, ..STOP };
        let mut hold = ordered(STOP);
        hold.handle_stops(&stops(9, 1, &[], &[later]));
        assert!(!hold.is_stopped());
        let report = stops(10, 1, &[STOP, OTHER], &[]);
        report.stops.iter().for_each(|stop| hold.learn(stop));
        assert_eq!(hold.unreported().map(|held| held.name).collect::<Vec<_>>(), [OTHER]);
    }

    #[test]
    fn an_array_that_restarts_without_the_stop_gets_it_again() {
        let mut hold = ordered(STOP);
        hold.handle_stops(&stops(9, 1, &[STOP, StopName::default()], &[]));
        assert_eq!(hold.unreported().count(), 0);
        hold.handle_stops(&stops(10, 1, &[], &[]));
        assert_eq!(hold.unreported().map(|held| held.name).collect::<Vec<_>>(), [STOP], "but no stop without sender");
    }

    #[test]
    fn a_stop_that_one_array_reports_is_learned_for_each_array_that_has_not_released_it() {
        let (mut first, mut second) = (StopHold::default(), StopHold::default());
        let report = stops(9, 1, &[STOP, StopName::default()], &[]);
        let unknown = unknown_stops(&report.stops, [&first, &second].into_iter());
        assert_eq!(unknown.iter().map(|stop| stop.name()).collect::<Vec<_>>(), [STOP]);
        first.handle_stops(&report);
        second.learn(&unknown[0]);
        assert_eq!(second.unreported().count(), 1);
        assert!(unknown_stops(&report.stops, [&first, &second].into_iter()).is_empty(), "it is known");
        let mut released = StopHold::default();
        released.handle_stops(&stops(10, 1, &[], &[STOP]));
        released.learn(&unknown[0]);
        assert!(!released.is_stopped(), "the array has released it");
    }

    #[test]
    fn a_later_stop_of_the_same_sender_replaces_the_earlier_one() {
        let later = StopName { sequence: STOP.sequence + 1, ..STOP };
        let mut hold = ordered(STOP);
        order(&mut hold, later);
        hold.handle_stops(&stops(9, 1, &[later], &[]));
        assert_eq!(hold.stops().iter().map(|held| held.name).collect::<Vec<_>>(), [later]);
    }

    #[test]
    fn safety_reports_and_telemetry_count_where_there_are_no_stop_reports() {
        let mut hold = ordered(STOP);
        hold.handle_state(9, false);
        assert_eq!(hold.unreported().count(), 1);
        hold.handle_state(9, true);
        assert_eq!(hold.unreported().count(), 0, "an array without any report");
        hold.handle_safety(&safety(1, None));
        assert_eq!(hold.unreported().count(), 1, "its report does not name the stop");
        hold.handle_safety(&safety(2, Some(STOP)));
        hold.handle_state(9, false);
        assert!(hold.is_stopped(), "the report counts");
        hold.handle_stops(&stops(9, 1, &[STOP], &[]));
        hold.handle_safety(&safety(3, None));
        assert!(hold.is_stopped(), "the stop report counts");
        let mut hold = ordered(STOP);
        hold.handle_state(9, true);
        hold.handle_state(9, false);
        assert!(!hold.is_stopped());
    }
}
