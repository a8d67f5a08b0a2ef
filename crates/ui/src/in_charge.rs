//! What the mirrors of a room follow: the policy, or what commands or holds them in its place.

use heliostat_proto::gauges::CalibrationProgress;
use heliostat_proto::{ArrayState, NodeKind};
use heliostat_service::printable::printable;
use serde::Serialize;

use crate::causes::NO_REPORT;
use crate::controllers::Role;
use crate::notes::REPORTING;
use crate::view::Received;

/// The name while arrays follow commands, and none of a policy.
const NO_POLICY: &str = "no policy";
const CALIBRATION: &str = "calibration";

/// What the mirrors follow.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct InCharge {
    /// The policy, `calibration`, `no policy`, or the state of the arrays; empty while the policy is unknown.
    pub name: String,
    /// Why it is not the policy, in a sentence; empty while it is.
    pub idle: String,
}

impl InCharge {
    fn idle(name: &str, why: impl Into<String>) -> Self {
        Self { name: name.to_owned(), idle: why.into() }
    }
}

impl Received {
    /// What the mirrors follow at this instant.
    pub(crate) fn in_charge(&self) -> InCharge {
        if self.is_calibrated() {
            return InCharge::idle(CALIBRATION, "A calibration commands the mirrors.");
        }
        let reports = self.arrays.at().is_some_and(|at| at.elapsed() < REPORTING);
        let state = self.arrays.state().filter(|_| reports);
        let name = state.map_or(NO_REPORT, ArrayState::name);
        if !matches!(state, Some(ArrayState::Following | ArrayState::Holding)) {
            return InCharge::idle(name, format!("The mirrors do not follow the policy: {name}."));
        }
        if let Some(why) = self.why_not_the_policy() {
            let name = if state == Some(ArrayState::Following) { NO_POLICY } else { name };
            return InCharge::idle(name, why);
        }
        let policy =
            self.fresh_status(NodeKind::Controller.name()).map(|status| printable(&status.policy).into_owned());
        InCharge { name: policy.unwrap_or_default(), idle: String::new() }
    }

    /// Why arrays that accept commands do not follow the policy of the displayed controller, if they do not.
    fn why_not_the_policy(&self) -> Option<&'static str> {
        if self.is_controller_unseen() {
            return Some(
                "Another controller or a calibration commands the mirrors, but its messages do not reach this viewer.",
            );
        }
        if !self.is_controller_alive() {
            return Some("No controller commands the mirrors.");
        }
        // The leader is the first one. Without it, a controller is about to take over.
        let first = self.present_controllers().into_iter().next();
        first.filter(|one| one.role == Role::StandsBy).map(|_| "Each controller that reports stands by.")
    }

    /// Whether a calibration commands the mirrors in place of a controller. It may compute while all arrays are
    /// stopped.
    fn is_calibrated(&self) -> bool {
        let status = self.fresh_status(NodeKind::Controller.name());
        let states = self.arrays.states();
        let is_stopped = !states.is_empty() && states.iter().all(|(_, state)| *state == ArrayState::Stopped);
        status.and_then(CalibrationProgress::of).is_some() && self.is_controller_alive() && !is_stopped
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use heliostat_proto::{MirrorTelemetry, NodeStatus, Stamp};

    use super::*;

    /// A room with arrays of these states, and a controller that runs a policy.
    fn room(states: &[ArrayState], policy: &str) -> Received {
        let mut received = Received::default();
        received.alive.insert((NodeKind::Controller.name(), 1));
        for (array, state) in states.iter().enumerate() {
            received.arrays.note(array, MirrorTelemetry { state: *state, ..MirrorTelemetry::default() });
        }
        take(&mut received, NodeStatus { policy: policy.into(), ..NodeStatus::default() });
        received
    }

    fn take(received: &mut Received, status: NodeStatus) {
        let status = NodeStatus { stamp: Stamp { source: 1, ..Stamp::default() }, ..status };
        received.controllers.take(&status);
        received.statuses.insert(NodeKind::Controller.name().into(), (Instant::now(), status));
    }

    fn calibrating() -> NodeStatus {
        let gauges = CalibrationProgress::default().gauges().map(|(name, value)| (name.to_owned(), value)).to_vec();
        NodeStatus { gauges, ..NodeStatus::default() }
    }

    fn found(received: &Received) -> (String, bool) {
        let InCharge { name, idle } = received.in_charge();
        (name, !idle.is_empty())
    }

    fn expected(name: &str, is_idle: bool) -> (String, bool) {
        (name.to_owned(), is_idle)
    }

    #[test]
    fn the_mirrors_follow_the_policy_while_the_arrays_follow_or_hold_and_else_their_state() {
        use ArrayState::{Fault, Following, Holding, Parked, Stopped};
        for (state, name, is_idle) in [
            (Following, "greedy", false),
            (Holding, "greedy", false),
            (Parked, "parked", true),
            (Stopped, "stopped", true),
            (Fault, "fault", true),
        ] {
            assert_eq!(found(&room(&[state], "greedy")), expected(name, is_idle));
        }
        assert_eq!(found(&room(&[Following, Stopped], "greedy")), expected("stopped", true), "the most serious state");
        assert_eq!(found(&room(&[], "greedy")), expected("no report", true));
        let mut silent = room(&[Following], "greedy");
        silent.arrays.age(REPORTING);
        assert_eq!(found(&silent), expected("no report", true));
        assert_eq!(found(&room(&[Following], "")), expected("", false), "the policy is unknown");
    }

    #[test]
    fn without_a_controller_that_leads_the_mirrors_follow_no_policy() {
        let mut received = room(&[ArrayState::Following], "greedy");
        let counters = vec![("standby".to_owned(), 1)];
        take(&mut received, NodeStatus { policy: "greedy".into(), counters, ..NodeStatus::default() });
        assert_eq!(found(&received), expected("no policy", true), "it stands by");
        received.alive.clear();
        assert_eq!(found(&received), expected("no policy", true), "commands of a controller that has left");
        assert_eq!(received.in_charge().idle, "No controller commands the mirrors.");
    }

    #[test]
    fn a_calibration_commands_the_mirrors_unless_all_arrays_are_stopped() {
        use ArrayState::{Parked, Stopped};
        let both = vec![Stopped, Parked];
        for (states, name) in [(vec![Parked], "calibration"), (vec![Stopped], "stopped"), (both, "calibration")] {
            let mut received = room(&states, "");
            take(&mut received, calibrating());
            assert_eq!(found(&received), expected(name, true));
        }
    }
}
