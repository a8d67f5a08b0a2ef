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

/// Detects that commands are sent for a while without any sign of a driver.
#[derive(Clone, Debug, Default)]
struct AbsenceDetector {
    telemetry: Option<Stamp>,
    /// Since when there is no sign of a driver although commands were sent.
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

    /// The arrays without a driver that receives the commands of a controller, by index.
    pub fn absent(&mut self, now: Nanos, controller: &Controller) -> Vec<usize> {
        let commands = controller.counters().commands;
        let tokens = &self.tokens;
        let is_absent = |(array, detector): (usize, &mut AbsenceDetector)| {
            let telemetry = controller.inbox().telemetry(array).map(|telemetry| telemetry.stamp);
            detector.is_absent(now, drives(tokens, array), telemetry, commands).then_some(array)
        };
        self.detectors.iter_mut().enumerate().filter_map(is_absent).collect()
    }
}

/// Whether a process with one of these tokens drives an array.
fn drives(tokens: &BTreeSet<Token>, array: usize) -> bool {
    tokens.iter().any(|(driven, _)| driven.is_none_or(|driven| driven == array))
}

impl AbsenceDetector {
    /// `telemetry` is the stamp of the latest one, `commands` the number of commands so far. A clock
    /// that steps back begins again.
    fn is_absent(&mut self, now: Nanos, has_token: bool, telemetry: Option<Stamp>, commands: u64) -> bool {
        let has_news = std::mem::replace(&mut self.telemetry, telemetry) != telemetry;
        if has_token || has_news || commands == 0 {
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
    fn a_driver_with_telemetry_or_a_controller_without_commands_lacks_nothing() {
        let (mut detector, start) = (AbsenceDetector::default(), 7);
        for step in 0..10 {
            assert!(!detector.is_absent(start + step * ABSENT_AFTER_NS, false, stamp(step), 5));
        }
        let last = start + 10 * ABSENT_AFTER_NS;
        assert!(!detector.is_absent(last, false, stamp(9), 5));
        assert!(detector.is_absent(last + ABSENT_AFTER_NS, false, stamp(9), 5), "the telemetry ended");
        let mut idle = AbsenceDetector::default();
        assert!(!idle.is_absent(start, false, None, 0) && !idle.is_absent(last, false, None, 0));
    }

    #[test]
    fn a_clock_that_steps_back_makes_no_driver_absent() {
        let mut detector = AbsenceDetector::default();
        assert!(!detector.is_absent(9 * ABSENT_AFTER_NS, false, None, 1));
        assert!(!detector.is_absent(ABSENT_AFTER_NS, false, None, 1));
        assert!(detector.is_absent(2 * ABSENT_AFTER_NS, false, None, 1));
    }
}
