//! Whether each array has a driver or a simulator that receives the commands, and which of them have left.

use std::collections::{BTreeMap, BTreeSet};

use heliostat_proto::{LostDriver, MirrorTelemetry, Nanos, PresentDriver, Stamp, StopReport, keys::parse_array_alive};

use crate::core::Controller;

/// Time without telemetry and without a liveliness token after which the driver is absent. A
/// driver publishes telemetry at least 10 times a second.
const ABSENT_AFTER_NS: Nanos = 2_000_000_000;

/// Most drivers of which it is remembered that they have left.
const LOST_MAX: usize = 16;

/// The array of a driver, and its source; a simulator drives every array of its room.
type Token = (Option<usize>, u64);

/// The liveliness tokens of drivers and simulators, and the telemetry of each array.
pub(super) struct Drivers {
    tokens: BTreeMap<Token, PresentDriver>,
    /// Array and source of those whose device has executed a stop, by their last stop report.
    stopped: BTreeSet<(usize, u64)>,
    /// Oldest first.
    lost: Vec<Lost>,
    /// Whether a stop is held for any array.
    is_stopped: bool,
    /// One for each array.
    detectors: Vec<AbsenceDetector>,
}

/// A driver that has left.
struct Lost {
    driver: LostDriver,
    /// Whether another driver served the array then. If not, a driver that appears later takes its place.
    had_other: bool,
}

/// Detects that a driver is expected and gives no sign for a while.
#[derive(Clone, Debug, Default)]
struct AbsenceDetector {
    telemetry: Option<Stamp>,
    /// Whether a driver was seen, or had to be there.
    is_expected: bool,
    /// Since when there is no sign of an expected driver.
    since_ns: Option<Nanos>,
}

impl Drivers {
    /// No driver, for so many arrays.
    pub fn new(arrays: usize) -> Self {
        Self {
            tokens: BTreeMap::new(),
            stopped: BTreeSet::new(),
            lost: Vec::new(),
            is_stopped: false,
            detectors: vec![AbsenceDetector::default(); arrays],
        }
    }

    /// A liveliness token appeared or ended.
    pub fn handle_token(&mut self, now: Nanos, key: &str, is_alive: bool) {
        let Some(token @ (driven, source)) = parse_array_alive(key) else { return };
        let served = driven.map_or(0..self.detectors.len(), |array| array..array + 1);
        if is_alive {
            self.tokens.entry(token).or_insert(PresentDriver::new(now));
            let is_over = |lost: &Lost| !lost.had_other || lost.driver.source == source;
            self.lost.retain(|lost| !(served.contains(&lost.driver.array) && is_over(lost)));
        } else if let Some(left) = self.tokens.remove(&token) {
            for array in served {
                // A device that has executed a stop stands.
                if !self.stopped.remove(&(array, source)) && !left.has_yielded(now, source, self.sources_of(array)) {
                    let driver = LostDriver { array, source, since_ns: now };
                    self.lost.push(Lost { driver, had_other: drives(self.tokens.keys(), array) });
                }
            }
            let oldest = self.lost.len().saturating_sub(LOST_MAX);
            self.lost.drain(..oldest);
        }
    }

    /// The sources of the drivers of an array that are in the room.
    fn sources_of(&self, array: usize) -> impl Iterator<Item = u64> {
        self.tokens.keys().filter(move |token| serves(token, array)).map(|(_, source)| *source)
    }

    /// A driver of an array has published telemetry. Does not allocate.
    pub fn handle_telemetry(&mut self, array: usize, report: &MirrorTelemetry) {
        for token in [Some(array), None].map(|of| (of, report.stamp.source)) {
            self.tokens.get_mut(&token).into_iter().for_each(|driver| driver.handle_telemetry(report));
        }
    }

    /// A driver of an array has reported its stops.
    pub fn handle_stops(&mut self, array: usize, report: &StopReport) {
        let driver = (array, report.stamp.source);
        if !report.device_stopped {
            self.stopped.remove(&driver);
        } else if self.tokens.keys().any(|token| token.1 == driver.1 && serves(token, array)) {
            self.stopped.insert(driver);
        }
    }

    /// A stop is held for an array, or none is: after a release no driver that has left is of concern any longer.
    pub fn set_stopped(&mut self, is_stopped: bool) {
        if std::mem::replace(&mut self.is_stopped, is_stopped) && !is_stopped {
            self.lost.clear();
        }
    }

    /// The drivers that have left since the last release of a stop, and have neither returned nor been replaced; of each
    /// whether another driver served its array then.
    pub fn lost(&self) -> impl Iterator<Item = (LostDriver, bool)> + '_ {
        self.lost.iter().map(|lost| (lost.driver, lost.had_other))
    }

    /// The arrays without a driver that receives the commands of a controller, by index. A controller expects one once
    /// it has seen one or has sent commands, and where it was started to stand by.
    pub fn absent(&mut self, now: Nanos, controller: &Controller) -> Vec<usize> {
        let tokens = &self.tokens;
        let is_absent = |(array, detector): (usize, &mut AbsenceDetector)| {
            let telemetry = controller.inbox().telemetry(array).map(|telemetry| telemetry.stamp);
            let is_due = controller.counters().commands > 0 || controller.tenure(array).is_reserve;
            detector.is_absent(now, drives(tokens.keys(), array), telemetry, is_due).then_some(array)
        };
        self.detectors.iter_mut().enumerate().filter_map(is_absent).collect()
    }
}

/// Whether a process with one of these tokens drives an array.
fn drives<'a>(mut tokens: impl Iterator<Item = &'a Token>, array: usize) -> bool {
    tokens.any(|token| serves(token, array))
}

fn serves((driven, _): &Token, array: usize) -> bool {
    driven.is_none_or(|driven| driven == array)
}

impl AbsenceDetector {
    /// `telemetry` is the stamp of the latest one; `is_due` whether a driver has to be there, although none was seen. A
    /// clock that steps back begins again.
    fn is_absent(&mut self, now: Nanos, has_token: bool, telemetry: Option<Stamp>, is_due: bool) -> bool {
        let has_news = std::mem::replace(&mut self.telemetry, telemetry) != telemetry;
        self.is_expected |= has_token || has_news || is_due;
        if has_token || has_news || !self.is_expected {
            self.since_ns = None;
            return false;
        }
        let since_ns = self.since_ns.get_or_insert(now);
        *since_ns = now.min(*since_ns);
        now - *since_ns >= ABSENT_AFTER_NS
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{Counters, NodeKind, Room, START_WINDOW_NS};

    use super::*;

    fn stamp(sequence: u64) -> Option<Stamp> {
        Some(Stamp { sequence, ..Stamp::default() })
    }

    #[test]
    fn a_driver_that_has_left_is_lost_until_it_returns_is_replaced_or_a_stop_is_released() {
        let room = Room::new("lab").expect("a valid name");
        let mut drivers = Drivers::new(2);
        let token = |source| room.array(1).driver_alive(source);
        let lost = |drivers: &Drivers| drivers.lost().map(|(lost, _)| (lost.array, lost.source)).collect::<Vec<_>>();
        drivers.handle_token(1, &token(7), true);
        drivers.handle_token(2, &token(7), false);
        let only = (LostDriver { array: 1, source: 7, since_ns: 2 }, false);
        assert_eq!(drivers.lost().collect::<Vec<_>>(), [only], "it was the only one");
        drivers.handle_token(3, &token(8), true);
        assert_eq!(lost(&drivers), [], "it has the mirrors of the only one");
        drivers.handle_token(4, &token(7), true);
        drivers.handle_token(5, &token(8), false);
        drivers.handle_token(6, &token(9), true);
        assert_eq!(lost(&drivers), [(1, 8)], "the new one may be a third one");
        assert!(drivers.lost().all(|(_, had_other)| had_other));
        drivers.handle_token(7, &token(8), true);
        assert_eq!(lost(&drivers), [], "it is back");
        drivers.handle_token(8, &token(8), false);
        drivers.set_stopped(true);
        assert_eq!(lost(&drivers), [(1, 8)]);
        drivers.set_stopped(false);
        assert_eq!(lost(&drivers), []);
        drivers.handle_token(9, &room.alive(NodeKind::SimNode, 6), true);
        drivers.handle_token(10, &room.alive(NodeKind::SimNode, 6), false);
        assert_eq!(lost(&drivers), [(0, 6), (1, 6)], "a simulator drives every array");
        drivers.handle_token(10, &room.array(0).driver_alive(6), true);
        assert_eq!(lost(&drivers), [(1, 6)], "its other array has no driver yet");
        (20..99).for_each(|source| {
            [true, false].iter().for_each(|is_alive| drivers.handle_token(11, &token(source), *is_alive))
        });
        assert_eq!((drivers.lost().count(), drivers.lost().last().map(|(lost, _)| lost.source)), (LOST_MAX, Some(98)));
    }

    #[test]
    fn a_driver_that_has_left_with_a_stopped_device_is_not_lost() {
        let token = Room::new("lab").expect("a valid name").alive(NodeKind::Driver, 7);
        let lost = |reported: &[bool]| {
            let mut drivers = Drivers::new(1);
            drivers.handle_token(1, &token, true);
            for device_stopped in reported {
                let stamp = Stamp { source: 7, ..Stamp::default() };
                drivers
                    .handle_stops(0, &StopReport { stamp, device_stopped: *device_stopped, ..StopReport::default() });
            }
            drivers.handle_token(2, &token, false);
            drivers.lost().count()
        };
        assert_eq!((lost(&[]), lost(&[true]), lost(&[true, false])), (1, 0, 1));
    }

    #[test]
    fn a_driver_that_ends_at_its_start_for_another_one_before_it_accepted_a_command_is_not_lost() {
        let room = Room::new("lab").expect("a valid name");
        let lost = |source: u64, accepted: &[u64], end: Nanos| {
            let mut drivers = Drivers::new(1);
            [5, source].iter().for_each(|source| drivers.handle_token(1, &room.alive(NodeKind::Driver, *source), true));
            for accepted in accepted {
                let (stamp, counters) =
                    (Stamp { source, ..Stamp::default() }, Counters { accepted: *accepted, ..Counters::default() });
                drivers.handle_telemetry(0, &MirrorTelemetry { stamp, counters, ..MirrorTelemetry::default() });
            }
            drivers.handle_token(end, &room.alive(NodeKind::Driver, source), false);
            drivers.lost().count()
        };
        let end = 1 + START_WINDOW_NS;
        assert_eq!(lost(7, &[0], end), 0);
        assert_eq!(lost(7, &[0, 1, 0], end), 1, "it has moved mirrors");
        assert_eq!(lost(7, &[], end), 1, "nothing shows that it moved none");
        assert_eq!(lost(7, &[0], end + 1), 1, "it ends for another reason");
        assert_eq!(lost(3, &[0], end), 1, "the other one had to end");
    }

    #[test]
    fn a_driver_with_telemetry_or_a_controller_that_expects_no_driver_lacks_nothing() {
        let (mut detector, start) = (AbsenceDetector::default(), 7);
        for step in 0..10 {
            assert!(!detector.is_absent(start + step * ABSENT_AFTER_NS, false, stamp(step), true));
        }
        let last = start + 10 * ABSENT_AFTER_NS;
        assert!(!detector.is_absent(last, false, stamp(9), true));
        assert!(detector.is_absent(last + ABSENT_AFTER_NS, false, stamp(9), true), "the telemetry ended");
        let mut idle = AbsenceDetector::default();
        assert!(!idle.is_absent(start, false, None, false) && !idle.is_absent(last, false, None, false));
    }

    #[test]
    fn a_controller_without_commands_misses_a_driver_that_it_has_seen() {
        for (has_token, telemetry) in [(true, None), (false, stamp(1))] {
            let mut detector = AbsenceDetector::default();
            assert!(!detector.is_absent(7, has_token, telemetry, false));
            assert!(!detector.is_absent(8, false, telemetry, false));
            assert!(detector.is_absent(8 + ABSENT_AFTER_NS, false, telemetry, false));
            assert!(!detector.is_absent(9 + ABSENT_AFTER_NS, true, telemetry, false), "it is back");
        }
    }

    #[test]
    fn a_clock_that_steps_back_makes_no_driver_absent() {
        let mut detector = AbsenceDetector::default();
        assert!(!detector.is_absent(9 * ABSENT_AFTER_NS, false, None, true));
        assert!(!detector.is_absent(ABSENT_AFTER_NS, false, None, true));
        assert!(detector.is_absent(2 * ABSENT_AFTER_NS, false, None, true));
    }
}
