//! What the session of the check has received.

use heliostat_proto::{
    Capabilities, CodecError, EmergencyStop, LatchedStopReport, MirrorTelemetry, NodeKind, NodeStatus, SafetyReport,
    StopAction, StopName, StopReport,
};

/// All messages received.
#[derive(Default)]
pub struct Received {
    /// Telemetry in the order of its arrival.
    pub telemetry: Vec<MirrorTelemetry>,
    /// Telemetry that could not be decoded.
    pub undecodable: Vec<CodecError>,
    /// Published capabilities.
    pub capabilities: Vec<Capabilities>,
    /// Published safety reports.
    pub safety: Vec<SafetyReport>,
    /// Published stop reports.
    pub stops: Vec<StopReport>,
    /// Stop reports of the other arrays of the room: its stops and re-arms are theirs too.
    pub stops_elsewhere: Vec<StopReport>,
    /// Stops and re-arms of kind 9, from any sender.
    pub orders: Vec<EmergencyStop>,
    /// Statuses of drivers and simulators, with the kind of node that their key names.
    pub statuses: Vec<(NodeKind, Result<NodeStatus, CodecError>)>,
}

impl Received {
    /// Number of telemetry messages, decodable or not.
    pub fn telemetry_count(&self) -> usize {
        self.telemetry.len() + self.undecodable.len()
    }

    /// A stop that an array has reported or a sender has ordered, and that is not the check's own; one without sender is none
    /// of an operator.
    ///
    /// An order is found at once: an array reports it later, and where its list is full, without its name.
    pub fn other_stop(&self, is_own: impl Fn(&LatchedStopReport) -> bool) -> Option<LatchedStopReport> {
        let latest = self.safety.iter().filter_map(SafetyReport::stop);
        let listed = self.stops.iter().chain(&self.stops_elsewhere).flat_map(|report| report.stops.iter().cloned());
        let stops = self.orders.iter().filter(|order| order.action == StopAction::Stop);
        let mut all = latest.chain(listed).chain(stops.map(as_reported));
        all.find(|stop| stop.name() != StopName::default() && !is_own(stop))
    }
}

/// A stop as an array lists it.
fn as_reported(order: &EmergencyStop) -> LatchedStopReport {
    let StopName { source, sequence } = order.name();
    let (operator, reason) = (order.operator.clone(), order.reason.clone());
    LatchedStopReport { source, sequence, arrived_ns: order.stamp.time_ns, operator, reason }
}

/// The latest problem of a device in the statuses of its driver.
///
/// The other problems there are refusals, such as those of the commands of the check. A driver that counts
/// no absent devices does not tell them apart. One that was absent between two statuses was connected again.
pub fn problem_of_device<'a>(statuses: impl Iterator<Item = &'a NodeStatus>) -> Option<&'a str> {
    let is_absent = |status: &NodeStatus| status.counter("device_absent").is_some_and(|count| count > 0);
    let (mut latest, mut before): (Option<&str>, Option<&NodeStatus>) = (None, None);
    for status in statuses {
        let connections = before.filter(|before| !is_absent(before)).and_then(|before| before.counter("connections"));
        let was_absent = connections.is_some_and(|before| status.counter("connections") > Some(before));
        if (is_absent(status) || was_absent) && !status.last_problem.is_empty() {
            latest = Some(&status.last_problem);
        }
        before = Some(status);
    }
    latest
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{Stamp, decode};

    use super::*;

    fn status(absent: u64, problem: &str) -> NodeStatus {
        let counters = vec![("device_absent".to_owned(), absent)];
        NodeStatus { counters, last_problem: problem.to_owned(), ..NodeStatus::default() }
    }

    #[test]
    fn telemetry_that_cannot_be_decoded_is_no_silence() {
        let undecodable = vec![decode::<MirrorTelemetry>(&[]).expect_err("no message")];
        assert_eq!(Received { undecodable, ..Received::default() }.telemetry_count(), 1);
    }

    #[test]
    fn the_stop_of_an_operator_is_found_in_each_report_that_names_it() {
        let is_own = |stop: &LatchedStopReport| stop.operator == "check";
        let listed = |source, operator: &str| LatchedStopReport {
            source,
            sequence: 1,
            operator: operator.to_owned(),
            ..LatchedStopReport::default()
        };
        let found = |received: &Received| received.other_stop(is_own).map(|stop| stop.operator);
        let start = SafetyReport { stopped: true, ..SafetyReport::default() };
        let mut received = Received { safety: vec![SafetyReport::default(), start], ..Received::default() };
        received.stops.push(StopReport { stops: vec![listed(3, "check")], ..StopReport::default() });
        assert_eq!(found(&received), None);
        let beside = vec![listed(3, "check"), listed(7, "ann")];
        received.stops.push(StopReport { stops: beside, ..StopReport::default() });
        assert_eq!(found(&received).as_deref(), Some("ann"));
        let last = SafetyReport { stop_source: 7, operator: "bob".to_owned(), ..received.safety[1].clone() };
        received.safety.push(last);
        assert_eq!(found(&received).as_deref(), Some("bob"));
        let elsewhere = StopReport { stops: vec![listed(7, "cho")], ..StopReport::default() };
        let elsewhere = Received { stops_elsewhere: vec![elsewhere], ..Received::default() };
        assert_eq!(found(&elsewhere).as_deref(), Some("cho"), "of another array");
    }

    #[test]
    fn the_stop_of_an_operator_is_found_by_its_order_before_an_array_names_it() {
        let order = |action, operator: &str| EmergencyStop {
            stamp: Stamp { source: 7, sequence: 1, time_ns: 5 },
            action,
            operator: operator.to_owned(),
            ..EmergencyStop::default()
        };
        let mut received = Received::default();
        received.orders.push(order(StopAction::Stop, "check"));
        received.orders.push(order(StopAction::Rearm, "ann"));
        let found = |received: &Received| received.other_stop(|stop| stop.operator == "check");
        assert_eq!(found(&received), None, "neither its own stop nor a re-arm");
        received.orders.push(order(StopAction::Stop, "ann"));
        let stop = found(&received).expect("the stop of ann");
        assert_eq!((stop.source, stop.sequence, stop.operator.as_str()), (7, 1, "ann"));
    }

    #[test]
    fn a_refused_command_of_the_check_is_no_problem_of_the_device() {
        let refused = status(0, "command: a command with a validity of 4294967295 ms");
        let statuses = [status(1, "mirrors: roll of mirror 0 is not finite"), refused.clone()];
        assert_eq!(problem_of_device(statuses.iter()), Some("mirrors: roll of mirror 0 is not finite"));
        assert_eq!(problem_of_device([refused].iter()), None);
    }

    #[test]
    fn the_problem_of_a_device_that_was_lost_between_two_statuses_is_the_one_of_its_next_connection() {
        let connected = |absent, connections, problem| {
            let mut status = status(absent, problem);
            status.counters.push(("connections".to_owned(), connections));
            status
        };
        let reset =
            [connected(0, 1, "command: expired"), connected(0, 2, "port: a reset"), connected(0, 2, "rearm: late")];
        assert_eq!(problem_of_device(reset.iter()), Some("port: a reset"));
        let returned = [connected(1, 1, "port: no answer"), connected(0, 2, "command: expired")];
        assert_eq!(problem_of_device(returned.iter()), Some("port: no answer"), "it was seen as absent");
    }
}
