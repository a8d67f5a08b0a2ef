//! What is wrong in a room and lasts, in words: each note says what to do.

use std::time::Instant;

use heliostat_proto::array_keys::array_name;
use heliostat_proto::{NodeKind, NodeStatus};
use heliostat_service::printable::printable;

use crate::view::{Dated, EXPIRY, Received};

impl Received {
    /// The lasting faults of a room with so many arrays, the most serious first. `opened` is the start of
    /// the viewer: a process that has not answered yet is missing only some seconds later.
    pub(crate) fn notes(&self, arrays: usize, opened: Instant) -> Vec<String> {
        let is_settled = opened.elapsed() > EXPIRY;
        let others = self.alive.iter().filter(|(node, _)| *node != NodeKind::Viewer.name());
        if is_settled && others.count() == 0 && self.arrays.at().is_none() && self.users.is_none() {
            return vec![
                "no process of this room answers: start a driver or a simulator, and a controller, or check --connect and --room"
                    .into(),
            ];
        }
        let mut notes: Vec<String> = self.arrays.shared().into_iter().map(two_drivers).collect();
        if is_settled && !self.is_controller_alive() {
            notes.push(
                "no controller commands the mirrors: start one with heliostat controller; in a demo, press restart"
                    .into(),
            );
        }
        notes.extend(self.fresh_status(NodeKind::Controller.name()).and_then(|status| absent_drivers(status, arrays)));
        let is_old = |at: Option<Instant>| at.unwrap_or(opened).elapsed() > EXPIRY;
        if is_old(arrival(&self.truth)) && is_old(arrival(&self.users)) {
            notes.push("no process reports the positions of users: start the tracker or the simulator".into());
        }
        notes
    }

    /// Whether a controller is in the room.
    pub(crate) fn is_controller_alive(&self) -> bool {
        self.alive.iter().any(|(node, _)| *node == NodeKind::Controller.name())
    }
}

fn arrival<T>(message: &Dated<T>) -> Option<Instant> {
    message.as_ref().map(|(at, _)| *at)
}

/// The beginning of the note about two drivers, and what a controller reports because of them.
const TWO_DRIVERS: &str = "two drivers serve one array";
const OF_TWO_DRIVERS: [&str; 2] = ["a second source ", "an announcement of an array that is not followed "];

/// Whether a controller reports this problem because of what a note states.
pub(crate) fn follows_from(notes: &[String], problem: &str) -> bool {
    notes.iter().any(|note| note.starts_with(TWO_DRIVERS))
        && OF_TWO_DRIVERS.iter().any(|start| problem.starts_with(start))
}

fn two_drivers((array, [one, other]): (usize, [u64; 2])) -> String {
    format!(
        "{TWO_DRIVERS} ({}, sources {one:016x} and {other:016x}): stop one of them, because the controller follows only one",
        array_name(array)
    )
}

/// Which commands reach no driver, by the status of a controller of so many arrays.
fn absent_drivers(status: &NodeStatus, arrays: usize) -> Option<String> {
    let count = |(name, count): &(String, u64)| (name == "driver_absent").then_some(*count);
    let absent = status.counters.iter().find_map(count).filter(|count| *count > 0)?;
    let name = |(name, _): &(String, u64)| Some(name.strip_prefix("driver_absent:")?.to_owned());
    let names: Vec<String> = status.counters.iter().filter_map(name).collect();
    if names.is_empty() || absent == arrays as u64 {
        return Some("no driver receives the commands: start a driver or a simulator".into());
    }
    Some(format!("no driver receives the commands to {}: start its driver", printable(&names.join(" and "))))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use heliostat_proto::{MirrorTelemetry, Stamp, UserReport};

    use super::*;

    fn ago(seconds: u64) -> Instant {
        Instant::now() - Duration::from_secs(seconds)
    }

    fn telemetry(received: &mut Received, source: u64) {
        let stamp = Stamp { source, ..Stamp::default() };
        received.arrays.note(0, MirrorTelemetry { stamp, ..MirrorTelemetry::default() });
    }

    #[test]
    fn each_missing_process_is_named_with_what_to_start() {
        let mut received = Received::default();
        assert_eq!(received.notes(1, ago(0)), Vec::<String>::new(), "processes may answer yet");
        let empty = received.notes(1, ago(60));
        assert!(empty.len() == 1 && empty[0].starts_with("no process of this room answers"), "{empty:?}");
        received.alive.insert((NodeKind::Driver.name(), 4));
        let missing = received.notes(1, ago(60));
        assert!(missing[0].starts_with("no controller commands the mirrors: start one"), "{missing:?}");
        assert!(missing[1].starts_with("no process reports the positions of users: start"), "{missing:?}");
        received.alive.insert((NodeKind::Controller.name(), 5));
        received.users = Some((Instant::now(), UserReport::default()));
        assert_eq!(received.notes(1, ago(60)), Vec::<String>::new());
    }

    #[test]
    fn two_drivers_of_one_array_are_noted_and_a_restarted_driver_is_not() {
        let mut received = Received::default();
        received.alive.insert((NodeKind::Controller.name(), 5));
        for source in [7, 7, 8, 8] {
            telemetry(&mut received, source);
        }
        assert_eq!(received.notes(1, ago(0)), Vec::<String>::new(), "the second replaces the first");
        telemetry(&mut received, 7);
        let notes = received.notes(1, ago(0));
        let expected = "two drivers serve one array (mirrors, sources 0000000000000007 and 0000000000000008): stop one";
        assert!(notes.len() == 1 && notes[0].starts_with(expected), "{notes:?}");
    }
}
