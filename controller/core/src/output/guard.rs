//! Whether a command may be given, and under which epoch: the array's fit, the operator's stop, and
//! the tenure of this controller.

use heliostat_proto::{ArrayState, EmergencyStop, MirrorTelemetry, Nanos, Rearm, SafetyReport, StopAction};

use serde::{Deserialize, Serialize};

use crate::output::{
    capabilities::Unfit,
    outcome::{Counters, DegradedMode},
    tenure::{Evidence, Tenure},
};

/// A safety report without a stop, sampled this long after a stop arrived, shows that the array is
/// not stopped. It covers the difference of the clocks and the time that the order needs.
const STOP_REPORTED_WITHIN_NS: Nanos = 1_000_000_000;

/// The flags that a decision reads before it gives a command.
#[derive(Clone, Debug)]
pub(crate) struct Guard {
    unfit: Option<Unfit>,
    /// A node whose mirrors must not receive the scenario's angles.
    unfit_node: Option<Unfit>,
    stop: StopLatch,
    pub tenure: Tenure,
    /// Validity of a command by the scenario, in ms.
    own_validity_ms: u32,
    /// The longest validity that the array accepts, in ms.
    validity_max_ms: u32,
}

/// The state of a guard, as a recording holds it: without tenure and fit.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct GuardMemory {
    stop: StopLatch,
    validity_max_ms: u32,
}

impl Guard {
    pub fn new(tenure: Tenure, own_validity_ms: u32) -> Self {
        Self {
            unfit: None,
            unfit_node: None,
            stop: StopLatch::default(),
            tenure,
            own_validity_ms,
            validity_max_ms: u32::MAX,
        }
    }

    pub fn memory(&self) -> GuardMemory {
        GuardMemory { stop: self.stop, validity_max_ms: self.validity_max_ms }
    }

    pub fn restore(&mut self, memory: &GuardMemory) {
        (self.stop, self.validity_max_ms) = (memory.stop, memory.validity_max_ms);
    }

    /// Stores the result of an examination of the array.
    pub fn set_verdict(&mut self, verdict: Result<(), Unfit>) {
        self.unfit = verdict.err();
    }

    /// Withholds all commands while a node does not fit, independently of its capabilities.
    pub fn set_unfit_node(&mut self, unfit: Option<Unfit>) {
        self.unfit_node = unfit;
    }

    /// Why the array does not fit the scenario, if it does not.
    pub fn unfit(&self) -> Option<&Unfit> {
        self.unfit_node.as_ref().or(self.unfit.as_ref())
    }

    /// Validity of a command in ms, within the array's bound.
    pub fn validity_ms(&self) -> u32 {
        self.own_validity_ms.min(self.validity_max_ms)
    }

    /// The epoch of a command that is due at `now`. Without one, the mode that is counted.
    pub fn permit(
        &mut self,
        now: Nanos,
        telemetry: Option<&MirrorTelemetry>,
        counters: &mut Counters,
    ) -> Result<u64, DegradedMode> {
        self.stop.handle_time(now);
        let is_stopped = telemetry.is_some_and(|report| report.state == ArrayState::Stopped);
        if self.unfit().is_some() || self.stop.is_stopped() || is_stopped {
            return Err(DegradedMode::Withheld);
        }
        let (epoch, event) = self.tenure.permit(now);
        event.into_iter().for_each(|event| counters.count_tenure(event));
        epoch.ok_or(DegradedMode::Standby)
    }

    /// Compares the tenure with telemetry.
    pub fn handle_telemetry(&mut self, now: Nanos, telemetry: &MirrorTelemetry, counters: &mut Counters) {
        let event = self.tenure.handle_telemetry(now, Evidence::from(telemetry));
        event.into_iter().for_each(|event| counters.count_tenure(event));
    }

    /// Applies a stop or re-arm order that arrived at `now`.
    pub fn handle_stop_order(&mut self, now: Nanos, order: &EmergencyStop) {
        self.stop.handle_order(now, order);
    }

    /// Applies a re-arm that names its stop.
    pub fn handle_rearm(&mut self, rearm: &Rearm) {
        self.stop.handle_rearm(rearm);
    }

    /// Applies the bounds and the stop that the array reports.
    pub fn handle_safety(&mut self, report: &SafetyReport) {
        self.stop.handle_safety(report);
        self.tenure.handle_announced_epoch(report.epoch);
        // A bound of 0 would forbid every command, so it is not one.
        if report.validity_max_ms > 0 {
            self.validity_max_ms = report.validity_max_ms;
        }
    }
}

/// The latch of the emergency stop, by the rules of a driver.
///
/// A re-arm releases it that names the latched stop, or that is later than it. A safety report of
/// the array without a stop releases it too, for the array is the authority.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct StopLatch {
    stopped: bool,
    /// Source and sequence of the latched stop.
    name: (u64, u64),
    /// Time of the last stop, at most the time of its arrival.
    stopped_ns: Nanos,
    /// When the last stop arrived.
    arrived_ns: Nanos,
}

impl StopLatch {
    /// Whether a stop is latched.
    pub fn is_stopped(&self) -> bool {
        self.stopped
    }

    /// Applies a stop or re-arm order that arrived at `now`.
    pub fn handle_order(&mut self, now: Nanos, order: &EmergencyStop) {
        let stamp = &order.stamp;
        match order.action {
            StopAction::Stop => {
                self.stopped = true;
                self.name = (stamp.source, stamp.sequence);
                // A stop from a clock that is ahead must not outlast every re-arm.
                self.stopped_ns = self.stopped_ns.max(stamp.time_ns.min(now));
                self.arrived_ns = now;
            }
            StopAction::Rearm => self.stopped &= stamp.time_ns <= self.stopped_ns,
        }
    }

    /// Bounds the times of the latch by `now`: a clock that was ahead and is corrected must not
    /// keep the stop in force until the time that it showed.
    pub fn handle_time(&mut self, now: Nanos) {
        self.stopped_ns = self.stopped_ns.min(now);
        self.arrived_ns = self.arrived_ns.min(now);
    }

    /// Applies a re-arm that names its stop.
    pub fn handle_rearm(&mut self, rearm: &Rearm) {
        self.stopped &= (rearm.stop_source, rearm.stop_sequence) != self.name;
    }

    /// Applies a safety report of the array.
    pub fn handle_safety(&mut self, report: &SafetyReport) {
        let is_later = report.stamp.time_ns > self.arrived_ns.saturating_add(STOP_REPORTED_WITHIN_NS);
        self.stopped &= report.stopped || !is_later;
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Stamp;

    use super::*;

    const S: Nanos = 1_000_000_000;

    fn order(action: StopAction, time_ns: Nanos) -> EmergencyStop {
        EmergencyStop { stamp: Stamp { source: 3, sequence: 4, time_ns }, action, ..EmergencyStop::default() }
    }

    /// A latch that was stopped at 10 s by a clock that shows `time_ns`.
    fn stopped(time_ns: Nanos) -> StopLatch {
        let mut latch = StopLatch::default();
        latch.handle_order(10 * S, &order(StopAction::Stop, time_ns));
        assert!(latch.is_stopped());
        latch
    }

    #[test]
    fn a_stop_is_latched_and_a_stopped_array_receives_no_commands() {
        let mut guard = Guard::new(Tenure::fixed(7), 200);
        let mut counters = Counters::default();
        let mut permit =
            |guard: &mut Guard, telemetry: Option<&MirrorTelemetry>| guard.permit(S, telemetry, &mut counters);
        assert_eq!(permit(&mut guard, None), Ok(7));
        guard.handle_stop_order(10, &order(StopAction::Stop, 10));
        guard.handle_stop_order(10, &order(StopAction::Rearm, 10));
        assert_eq!(permit(&mut guard, None), Err(DegradedMode::Withheld));
        guard.handle_stop_order(11, &order(StopAction::Rearm, 11));
        assert_eq!(permit(&mut guard, None), Ok(7));
        let stopped = MirrorTelemetry { state: ArrayState::Stopped, ..MirrorTelemetry::default() };
        assert_eq!(permit(&mut guard, Some(&stopped)), Err(DegradedMode::Withheld));
    }

    #[test]
    fn a_stop_from_a_clock_that_is_ahead_is_released_by_a_later_re_arm() {
        let mut latch = stopped(3600 * S);
        latch.handle_order(20 * S, &order(StopAction::Rearm, 20 * S));
        assert!(!latch.is_stopped());
    }

    #[test]
    fn a_clock_that_is_set_back_does_not_keep_a_stop_in_force() {
        let report = SafetyReport { stamp: Stamp { time_ns: 3 * S, ..Stamp::default() }, ..SafetyReport::default() };
        let mut latch = stopped(10 * S);
        latch.handle_safety(&report);
        assert!(latch.is_stopped(), "the report is older than the stop");
        latch.handle_time(S);
        latch.handle_safety(&report);
        assert!(!latch.is_stopped());
    }

    #[test]
    fn a_re_arm_releases_the_stop_that_it_names_and_no_other() {
        let mut latch = stopped(10 * S);
        latch.handle_rearm(&Rearm { stop_source: 3, stop_sequence: 5, ..Rearm::default() });
        assert!(latch.is_stopped());
        latch.handle_rearm(&Rearm { stop_source: 3, stop_sequence: 4, ..Rearm::default() });
        assert!(!latch.is_stopped());
    }

    #[test]
    fn the_array_releases_a_latch_that_it_does_not_share() {
        let report = |stopped, time_ns| SafetyReport {
            stamp: Stamp { time_ns, ..Stamp::default() },
            stopped,
            ..SafetyReport::default()
        };
        let mut latch = stopped(10 * S);
        latch.handle_safety(&report(false, 10 * S + 1));
        latch.handle_safety(&report(true, 13 * S));
        assert!(latch.is_stopped(), "a report from before the stop, and one of the stop");
        latch.handle_safety(&report(false, 12 * S));
        assert!(!latch.is_stopped());
    }

    #[test]
    fn the_validity_of_a_command_is_within_the_bound_of_the_array() {
        let mut guard = Guard::new(Tenure::fixed(7), 200);
        for (announced, expected) in [(10_000, 200), (50, 50), (0, 50), (500, 200)] {
            guard.handle_safety(&SafetyReport { validity_max_ms: announced, ..SafetyReport::default() });
            assert_eq!(guard.validity_ms(), expected);
        }
    }
}
