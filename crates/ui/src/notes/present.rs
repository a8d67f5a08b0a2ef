//! Which processes of the room are seen.

use heliostat_proto::NodeKind;

use super::{REPORTING, arrival};
use crate::view::{EXPIRY, Received};

impl Received {
    /// Whether a process of the room is seen, other than viewers.
    pub(super) fn has_processes(&self) -> bool {
        self.alive.iter().any(|(node, _)| *node != NodeKind::Viewer.name())
    }

    /// Whether a live process of one of these kinds is seen.
    fn has_one_of(&self, kinds: &[NodeKind]) -> bool {
        self.alive.iter().any(|(node, _)| kinds.iter().any(|kind| kind.name() == *node))
    }

    /// Whether the room has an array: a live process of one, or telemetry.
    pub(crate) fn is_array_present(&self) -> bool {
        self.has_one_of(&[NodeKind::SimNode, NodeKind::Driver])
            || self.arrays.states().iter().any(|(at, _)| at.elapsed() < REPORTING)
    }

    /// Whether the simulator has not left, is the only source of positions and of telemetry, and gives neither: it hangs
    /// or is paused.
    pub(crate) fn has_silent_simulator(&self) -> bool {
        let messages = [self.arrays.at(), arrival(&self.truth), arrival(&self.users)];
        let is_recent = messages.iter().flatten().any(|at| at.elapsed() < EXPIRY);
        let is_alone = !self.has_one_of(&[NodeKind::Driver, NodeKind::Tracker]);
        self.has_one_of(&[NodeKind::SimNode]) && is_alone && !is_recent
    }

    /// Whether a controller is in the room.
    pub(crate) fn is_controller_alive(&self) -> bool {
        self.controller_sources().next().is_some()
    }

    /// The sources of the controllers that are in the room.
    pub(crate) fn controller_sources(&self) -> impl Iterator<Item = u64> + '_ {
        let is_controller = |(node, _): &&(&'static str, u64)| *node == NodeKind::Controller.name();
        self.alive.iter().filter(is_controller).map(|(_, source)| *source)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use heliostat_proto::UserReport;

    use super::*;

    #[test]
    fn a_simulator_that_has_not_left_and_gives_nothing_is_silent_unless_others_report() {
        let mut received = Received::default();
        assert!(!received.has_silent_simulator(), "there is none");
        received.alive.insert((NodeKind::SimNode.name(), 7));
        assert!(received.has_silent_simulator());
        received.alive.insert((NodeKind::Driver.name(), 8));
        assert!(!received.has_silent_simulator(), "the array is of another process");
        received.alive.remove(&(NodeKind::Driver.name(), 8));
        received.users = Some((Instant::now(), UserReport::default()));
        assert!(!received.has_silent_simulator(), "its reports arrive");
    }
}
