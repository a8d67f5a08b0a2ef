//! Messages about an array other than its telemetry, and this controller's standing towards it.

use heliostat_proto::reported_stops::STOPS_WITHIN;
use heliostat_proto::stop_hold::{HeldStop, unknown_stops};
use heliostat_proto::{
    Capabilities, EmergencyStop, LatchedStopReport, Nanos, NodeKind, SafetyReport, StopReport, ValidityClock,
};

use super::{
    Controller,
    array_output::{ABSENT_AFTER_NS, ArrayOutput},
};
use crate::output::{capabilities::Unfit, tenure::Tenure};

/// An array that publishes stop reports has published one after this time of telemetry.
const STOPS_WITHIN_NS: Nanos = STOPS_WITHIN.as_nanos() as Nanos;

impl Controller {
    /// Number of arrays of the room.
    pub fn arrays(&self) -> usize {
        self.arrays.len()
    }

    /// Whether an announcement of this source concerns the array that is followed; one that does not
    /// is counted. Before the first telemetry those of every source do.
    pub fn admit_array(&mut self, array: usize, source: u64) -> bool {
        let is_followed = self.inbox.array_source(array).is_none_or(|followed| followed == source);
        if !is_followed {
            self.counters.foreign_arrays += 1;
            self.counters.last_foreign_array = Some((array, source));
        }
        is_followed
    }

    /// Applies the capabilities of an array that fits the scenario; an array that does not fit
    /// receives no commands until it announces others. False for an array that is not followed.
    pub fn handle_capabilities(
        &mut self,
        array: usize,
        capabilities: &Capabilities,
        verdict: Result<(), Unfit>,
    ) -> bool {
        if !self.admit_array(array, capabilities.stamp.source) {
            return false;
        }
        self.inbox.set_clock(array, capabilities.validity_clock == ValidityClock::SourceTime);
        let is_fit = verdict.is_ok();
        let output = &mut self.arrays[array];
        output.guard.verdict = verdict;
        if is_fit {
            output.limits.narrow(&capabilities.roll, &capabilities.yaw);
            output.settling_s = f64::from(capabilities.roll.settling_s.max(capabilities.yaw.settling_s));
            // Users are predicted for the slowest array.
            self.observer.set_settling(self.arrays.iter().map(|array| array.settling_s).fold(0.0, f64::max));
        }
        true
    }

    /// Applies the bounds and the stop that an array reports, if it is followed.
    pub fn handle_safety(&mut self, array: usize, report: &SafetyReport) {
        if !self.admit_array(array, report.stamp.source) {
            return;
        }
        let unknown = self.unknown_stops(report.stop().as_slice());
        if self.arrays[array].guard.handle_safety(report) {
            self.learn_stops(&unknown);
        }
        let validities_ms = self.arrays.iter().map(|array| array.guard.validity_ms());
        self.command.validity_ms = validities_ms.min().unwrap_or_default();
    }

    /// Gives no commands while a node in this room does not fit, independently of its capabilities.
    pub fn handle_unfit_node(&mut self, unfit: Option<Unfit>) {
        self.arrays.iter_mut().for_each(|array| array.guard.unfit_node.clone_from(&unfit));
    }

    /// Holds an operator's stop that arrived at `now`. It concerns all arrays.
    pub fn handle_stop_order(&mut self, now: Nanos, order: &EmergencyStop) {
        self.arrays.iter_mut().for_each(|array| array.guard.stops.order(now, order));
    }

    /// Applies the stops that an array reports, if it is followed; one that was not known concerns all arrays.
    pub fn handle_stops(&mut self, array: usize, report: &StopReport) {
        if !self.admit_array(array, report.stamp.source) {
            return;
        }
        let unknown = self.unknown_stops(&report.stops);
        if self.arrays[array].guard.stops.handle_stops(report) {
            self.learn_stops(&unknown);
        }
    }

    fn unknown_stops(&self, reported: &[LatchedStopReport]) -> Vec<LatchedStopReport> {
        unknown_stops(reported, self.arrays.iter().map(|array| &array.guard.stops))
    }

    fn learn_stops(&mut self, unknown: &[LatchedStopReport]) {
        for stop in unknown {
            self.arrays.iter_mut().for_each(|array| array.guard.stops.learn(stop));
        }
    }

    /// The stops that are held for an array.
    pub fn stops(&self, array: usize) -> &[HeldStop] {
        self.arrays[array].guard.stops.stops()
    }

    /// Whether an array understands repetitions of stops. One that is present without stop reports
    /// does not, when they would have come.
    pub fn understands_repetitions(&self, now: Nanos, array: usize) -> bool {
        let ArrayOutput { heard_ns, first_heard_ns, guard, .. } = &self.arrays[array];
        let is_heard = heard_ns.is_some_and(|heard_ns| now.abs_diff(heard_ns) < ABSENT_AFTER_NS);
        let is_settled = first_heard_ns.is_some_and(|first_ns| now.abs_diff(first_ns) > STOPS_WITHIN_NS);
        guard.stops.has_stop_reports() || !is_heard || !is_settled || self.inbox.telemetry(array).is_none()
    }

    /// The stops that an array has not reported; the caller repeats them.
    pub fn unreported_stops(&self, array: usize) -> impl Iterator<Item = &HeldStop> {
        self.arrays[array].guard.stops.unreported()
    }

    /// In a replay: the next decision gives no command to the arrays whose bits are set, whatever
    /// their state.
    pub fn repeat_withheld(&mut self, withheld: u64) {
        self.repeated = Some(withheld);
    }

    /// The epoch of the commands to the first array; 0 before the first in a live room.
    pub fn epoch(&self) -> u64 {
        self.tenure(0).epoch()
    }

    /// Whether this controller commands an array or stands by.
    pub fn tenure(&self, array: usize) -> &Tenure {
        &self.arrays[array].guard.tenure
    }

    /// Notes that another controller is in the room or has left it.
    pub(super) fn note_controller(&mut self, node: NodeKind, source: u64, is_present: bool) {
        if node == NodeKind::Controller {
            let tenures = self.arrays.iter_mut().map(|array| &mut array.guard.tenure);
            let events = tenures.filter_map(|tenure| tenure.handle_controller(source, is_present));
            events.for_each(|event| self.counters.count_tenure(event));
        }
    }

    /// Whether the last decision gave a command to an array, unless it gave none at all.
    pub fn is_commanded(&self, array: usize) -> bool {
        self.arrays[array].permit.is_ok()
    }

    /// Why the first array that does not fit the scenario receives no commands.
    pub fn unfit(&self) -> Option<&Unfit> {
        (0..self.arrays()).find_map(|array| self.unfit_of(array))
    }

    /// Why an array receives no commands, if it does not fit the scenario.
    pub fn unfit_of(&self, array: usize) -> Option<&Unfit> {
        self.arrays[array].guard.unfit()
    }

    /// Decides which arrays get the command that is due at `now`, for a report or for the absence of
    /// reports.
    pub(super) fn update_permits(&mut self, now: Nanos, is_report: bool) {
        let repeated = self.repeated.take();
        for (index, array) in self.arrays.iter_mut().enumerate() {
            match repeated {
                Some(withheld) => array.repeat_permit(withheld >> index & 1 == 0),
                None => array.update_permit((now, is_report), self.inbox.telemetry(index), &mut self.counters),
            }
        }
    }

    /// Whether there is a last command: of this controller, or of another one that an array follows.
    pub(super) fn has_command(&self) -> bool {
        self.command.time_ns > 0 || self.arrays.iter().any(|array| array.commanded_ns.is_some())
    }
}
