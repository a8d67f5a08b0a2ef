//! Whether each array has a driver or a simulator that receives the commands.

use std::collections::BTreeSet;

use heliostat_proto::{Nanos, Stamp, keys::parse_array_alive};

use crate::core::Controller;

/// Time without telemetry and without a liveliness token after which the driver is absent. A
/// driver publishes telemetry at least 10 times a second.
const ABSENT_AFTER_NS: Nanos = 2_000_000_000;

/// The array of a driver, and its source; a simulator drives every array of its room.
type Token = (Option<usize>, u64);

/// The liveliness tokens of drivers and simulators, and the telemetry of each array.
pub(super) struct Drivers {
    tokens: BTreeSet<Token>,
    /// One for each array.
    detectors: Vec<AbsenceDetector>,
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
        Self { tokens: BTreeSet::new(), detectors: vec![AbsenceDetector::default(); arrays] }
    }

    /// A liveliness token appeared or ended.
    pub fn handle_token(&mut self, key: &str, is_alive: bool) {
        let Some(token) = parse_array_alive(key) else { return };
        if is_alive {
            self.tokens.insert(token);
        } else {
            self.tokens.remove(&token);
        }
    }

    /// The arrays without a driver that receives the commands of a controller, by index. A controller expects one once
    /// it has seen one or has sent commands, and where it was started to stand by.
    pub fn absent(&mut self, now: Nanos, controller: &Controller) -> Vec<usize> {
        let tokens = &self.tokens;
        let is_absent = |(array, detector): (usize, &mut AbsenceDetector)| {
            let telemetry = controller.inbox().telemetry(array).map(|telemetry| telemetry.stamp);
            let is_due = controller.counters().commands > 0 || controller.tenure(array).is_reserve;
            detector.is_absent(now, drives(tokens, array), telemetry, is_due).then_some(array)
        };
        self.detectors.iter_mut().enumerate().filter_map(is_absent).collect()
    }
}

/// Whether a process with one of these tokens drives an array.
fn drives(tokens: &BTreeSet<Token>, array: usize) -> bool {
    tokens.iter().any(|(driven, _)| driven.is_none_or(|driven| driven == array))
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
    use heliostat_proto::{NodeKind, Room};

    use super::*;

    fn stamp(sequence: u64) -> Option<Stamp> {
        Some(Stamp { sequence, ..Stamp::default() })
    }

    #[test]
    fn a_driver_drives_its_array_and_a_simulator_every_one() {
        let room = Room::new("lab").expect("a valid name");
        let of = |key: String| parse_array_alive(&key).into_iter().collect::<BTreeSet<Token>>();
        let driven = |tokens: &BTreeSet<Token>| [0, 1, 2].map(|array| drives(tokens, array));
        assert_eq!(driven(&of(room.alive(NodeKind::Driver, 7))), [true, false, false]);
        assert_eq!(driven(&of(room.array(1).driver_alive(7))), [false, true, false]);
        assert_eq!(driven(&of(room.alive(NodeKind::SimNode, 7))), [true; 3]);
        assert_eq!(driven(&of(room.alive(NodeKind::Viewer, 7))), [false; 3]);
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
