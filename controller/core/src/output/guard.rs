//! Whether a command may be given, and under which epoch: the array's fit, the operator's stop, and
//! the tenure of this controller.

use heliostat_proto::stop_hold::StopHold;
use heliostat_proto::{ArrayState, EmergencyStop, MirrorTelemetry, Nanos, SafetyReport, Stamp, StopAction, StopName};

use serde::{Deserialize, Serialize};

use crate::output::{
    capabilities::Unfit,
    outcome::{Counters, DegradedMode},
    tenure::{Evidence, Tenure},
};

/// The flags that a decision reads before it gives a command.
#[derive(Clone, Debug)]
pub(crate) struct Guard {
    /// The result of the last examination of the array.
    pub verdict: Result<(), Unfit>,
    /// A node whose mirrors must not receive the scenario's angles, independently of its capabilities.
    pub unfit_node: Option<Unfit>,
    /// The stops that are held. A re-arm changes nothing: the array has to report it.
    pub stops: StopHold,
    pub tenure: Tenure,
    /// Validity of a command by the scenario, in ms.
    own_validity_ms: u32,
    /// The longest validity that the array accepts, in ms.
    validity_max_ms: u32,
}

/// The state of a guard, as a recording holds it: without tenure and fit.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct GuardMemory {
    /// Source, sequence number and arrival of a held stop. A replay repeats the recorded decisions, so
    /// one stop is enough.
    stop: Option<(u64, u64, Nanos)>,
    validity_max_ms: u32,
}

impl Guard {
    pub fn new(tenure: Tenure, own_validity_ms: u32) -> Self {
        Self {
            verdict: Ok(()),
            unfit_node: None,
            stops: StopHold::default(),
            tenure,
            own_validity_ms,
            validity_max_ms: u32::MAX,
        }
    }

    pub fn memory(&self) -> GuardMemory {
        let held = self.stops.stops().first();
        let stop = held.map(|held| (held.name.source, held.name.sequence, held.since_ns));
        GuardMemory { stop, validity_max_ms: self.validity_max_ms }
    }

    pub fn restore(&mut self, memory: &GuardMemory) {
        self.validity_max_ms = memory.validity_max_ms;
        self.stops = StopHold::default();
        if let Some((source, sequence, since_ns)) = memory.stop {
            let stamp = Stamp { source, sequence, time_ns: since_ns };
            self.stops.order(since_ns, &EmergencyStop { stamp, action: StopAction::Stop, ..EmergencyStop::default() });
        }
    }

    /// Why the array does not fit the scenario, if it does not.
    pub fn unfit(&self) -> Option<&Unfit> {
        self.unfit_node.as_ref().or(self.verdict.as_ref().err())
    }

    /// Validity of a command in ms, within the array's bound.
    pub fn validity_ms(&self) -> u32 {
        self.own_validity_ms.min(self.validity_max_ms)
    }

    /// The epoch of a command that is due at `now`, for a report or for the absence of reports. Without
    /// one, the mode that is counted.
    pub fn permit(
        &mut self,
        (now, is_report): (Nanos, bool),
        telemetry: Option<&MirrorTelemetry>,
        counters: &mut Counters,
    ) -> Result<u64, DegradedMode> {
        let is_stopped = telemetry.is_some_and(|report| report.state == ArrayState::Stopped);
        if self.unfit().is_some() || self.stops.is_stopped() || is_stopped {
            if is_report {
                self.tenure.note_report(now);
            }
            return Err(DegradedMode::Withheld);
        }
        let tenure = &mut self.tenure;
        let (epoch, event) = if is_report { tenure.permit(now) } else { tenure.permit_in_silence(now) };
        event.into_iter().for_each(|event| counters.count_tenure(event));
        epoch.ok_or(DegradedMode::Standby)
    }

    /// Compares the tenure with telemetry.
    pub fn handle_telemetry(&mut self, now: Nanos, telemetry: &MirrorTelemetry, counters: &mut Counters) {
        self.stops.handle_state(telemetry.stamp.source, telemetry.state == ArrayState::Stopped);
        let event = self.tenure.handle_telemetry(now, Evidence::from(telemetry));
        event.into_iter().for_each(|event| counters.count_tenure(event));
    }

    /// Applies the bounds and the stop that the array reports; false where its stop reports count.
    pub fn handle_safety(&mut self, report: &SafetyReport) -> bool {
        let is_newer = self.stops.handle_safety(report);
        self.tenure.handle_announced_epoch(report.epoch);
        // A bound of 0 would forbid every command, so it is not one.
        if report.validity_max_ms > 0 {
            self.validity_max_ms = report.validity_max_ms;
        }
        is_newer
    }
}

/// The name of a stop in a message about the stop itself.
pub fn describe_stop(name: StopName, operator: &str, reason: &str) -> String {
    match (name == StopName::default(), operator.is_empty()) {
        (true, _) => format!("a stop without sender ({reason:?})"),
        (false, true) => format!("the stop {name} ({reason:?})"),
        (false, false) => format!("the stop of {operator} ({reason:?})"),
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::EPOCH_SLOTS;

    use super::*;

    const MS: Nanos = 1_000_000;
    const S: Nanos = 1000 * MS;

    #[test]
    fn a_stop_is_no_loss_of_the_link_of_a_standby() {
        let mut guard = Guard::new(Tenure::live(600, 10 * MS), 200);
        let mut counters = Counters::default();
        let stopped = MirrorTelemetry { state: ArrayState::Stopped, ..MirrorTelemetry::default() };
        let led = Evidence { epoch: EPOCH_SLOTS + 1, following: true, ..Evidence::default() };
        let mut permit = |guard: &mut Guard, tick: u64, telemetry: Option<&MirrorTelemetry>| {
            guard.permit((S + 10 * tick * MS, true), telemetry, &mut counters)
        };
        guard.tenure.handle_controller(1, true);
        guard.tenure.handle_telemetry(S, led);
        for tick in 0..2 {
            assert_eq!(permit(&mut guard, tick, None), Err(DegradedMode::Standby));
        }
        for tick in 2..300 {
            assert_eq!(permit(&mut guard, tick, Some(&stopped)), Err(DegradedMode::Withheld));
        }
        guard.tenure.handle_controller(1, false);
        guard.tenure.handle_telemetry(4 * S, led);
        assert_eq!(permit(&mut guard, 301, None), Err(DegradedMode::Standby));
        assert!(permit(&mut guard, 302, None).is_ok(), "the leader has ended");
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
