//! Messages about the array other than its telemetry, and this controller's standing towards it.

use heliostat_proto::{Capabilities, EmergencyStop, Nanos, Rearm, SafetyReport};

use super::Controller;
use crate::output::{capabilities::Unfit, tenure::Tenure};

impl Controller {
    /// Notes the epoch and sequence number of the last command sent.
    pub fn handle_sent(&mut self, epoch: u64, sequence: u64) {
        self.guard.tenure.handle_sent(epoch, sequence);
    }

    /// Whether announcements of this source concern the array that is followed. Before the first
    /// telemetry those of every source do.
    pub fn admits_array(&self, source: u64) -> bool {
        self.inbox.array_source().is_none_or(|followed| followed == source)
    }

    /// Counts an announcement of an array that is not followed.
    pub fn count_foreign_array(&mut self) {
        self.counters.foreign_arrays += 1;
    }

    /// Applies the capabilities of an array that fits the scenario; an array that does not fit
    /// receives no commands until it announces others. False for an array that is not followed.
    pub fn handle_capabilities(&mut self, capabilities: &Capabilities, verdict: Result<(), Unfit>) -> bool {
        if !self.admits_array(capabilities.stamp.source) {
            self.count_foreign_array();
            return false;
        }
        if verdict.is_ok() {
            self.limits.narrow(&capabilities.roll, &capabilities.yaw);
            self.observer.set_settling(f64::from(capabilities.roll.settling_s.max(capabilities.yaw.settling_s)));
        }
        self.guard.set_verdict(verdict);
        true
    }

    /// Applies the bounds and the stop that an array reports. False for an array that is not
    /// followed.
    pub fn handle_safety(&mut self, report: &SafetyReport) -> bool {
        if !self.admits_array(report.stamp.source) {
            self.count_foreign_array();
            return false;
        }
        self.guard.handle_safety(report);
        self.command.validity_ms = self.guard.validity_ms();
        true
    }

    /// Gives no commands while a node in this room does not fit, independently of its capabilities.
    pub fn handle_unfit_node(&mut self, unfit: Option<Unfit>) {
        self.guard.set_unfit_node(unfit);
    }

    /// Applies an operator's stop or re-arm order that arrived at `now`.
    pub fn handle_stop_order(&mut self, now: Nanos, order: &EmergencyStop) {
        self.guard.handle_stop_order(now, order);
    }

    /// Applies an operator's re-arm that names its stop.
    pub fn handle_rearm(&mut self, rearm: &Rearm) {
        self.guard.handle_rearm(rearm);
    }

    /// The epoch of the commands; 0 before the first in a live room.
    pub fn epoch(&self) -> u64 {
        self.guard.tenure.epoch()
    }

    /// Whether this controller commands or stands by.
    pub fn tenure(&self) -> &Tenure {
        &self.guard.tenure
    }

    /// Why the array receives no commands, if it does not fit the scenario.
    pub fn unfit(&self) -> Option<&Unfit> {
        self.guard.unfit()
    }
}
