//! The stops and re-arms of the check, and those of others, which it never releases.

use anyhow::{Context, Result, bail, ensure};
use heliostat_proto::{
    ArrayState, EmergencyStop, LatchedStopReport, MirrorTelemetry, Nanos, NodeKind, Rearm, Stamp, StopAction,
    StopRepetition, StopReport,
};
use heliostat_service::clock::utc_ns;

use super::{ANSWER_TIMEOUT, TestSession, bytes};
use crate::check::received::Received;

/// Operator of the orders of the check.
const OPERATOR: &str = "driver check";

/// The senders of the check: their sources differ from that of the session in the lowest bits.
const SENDERS: u64 = 1 << 16;

impl TestSession {
    /// Re-arms an array that started stopped, or that an earlier check has stopped; any other stop stays in force.
    pub(super) fn release_start(&mut self) -> Result<()> {
        let stop = self.safety.clone().filter(|safety| safety.stopped);
        let stop = stop.context("the array is stopped: re-arm it before the check, with heliostat ui")?;
        let name = (stop.stop_source, stop.stop_sequence);
        ensure!(
            name == (0, 0) || stop.operator == OPERATOR,
            "the array is stopped by {:?}: {:?}; re-arm it before the check, with heliostat rearm",
            stop.operator,
            stop.reason
        );
        // A check that was killed can have left several.
        let names = |report: &StopReport| -> Vec<(u64, u64)> {
            report.stops.iter().map(|stop| (stop.source, stop.sequence)).collect()
        };
        let listed = self.wait(ANSWER_TIMEOUT, |received| received.stops.last().map(names));
        let is_full = |received: &Received| received.stops.last().is_some_and(StopReport::stands_for_unlisted);
        ensure!(
            !self.inspect(is_full),
            "the array holds more stops than it lists, and one can be an operator's: release them before the check, with \
             heliostat rearm --all"
        );
        let from = self.count();
        let names = listed.filter(|listed| !listed.is_empty()).unwrap_or_else(|| vec![name]);
        for (index, (source, sequence)) in names.into_iter().enumerate() {
            let sent = self.send_rearm(source, sequence);
            if sent.is_err() && index > 0 {
                // An earlier re-arm has released what the array was stopped by.
                self.send_stop(StopAction::Stop, utc_ns())?;
            }
            sent?;
        }
        let released = self.telemetry(from, |telemetry| telemetry.state != ArrayState::Stopped);
        if released.is_none() {
            // It can still take effect.
            self.send_stop(StopAction::Stop, utc_ns())?;
            bail!("the array is stopped, and a re-arm of each stop that it reports does not release it");
        }
        self.was_stopped = true;
        Ok(())
    }

    /// Stops an array again that was stopped before the check; whether it then reports this, `None` for any other array.
    pub fn stop_again(&self) -> Option<bool> {
        let reports_stop = || {
            let from = self.count();
            self.send_stop(StopAction::Stop, utc_ns()).ok()?;
            self.telemetry(from, |telemetry| telemetry.state == ArrayState::Stopped)
        };
        self.was_stopped.then(|| reports_stop().is_some())
    }

    /// Ends the check where another sender has stopped an array: no re-arm of the check may release that stop. The room
    /// gets this stop again, because a re-arm that was on its way may have released it.
    pub fn expect_no_other_stop(&self) -> Result<()> {
        let of_check = |source: u64| (source ^ self.source) < SENDERS;
        let is_own = |stop: &LatchedStopReport| stop.operator == OPERATOR || of_check(stop.source);
        let Some(stop) = self.inspect(|received| received.other_stop(is_own)) else { return Ok(()) };
        // As a new order: it reaches every array, also one that has just released this stop.
        let stamp = Stamp { source: stop.source, sequence: stop.sequence, time_ns: utc_ns() };
        let (operator, reason) = (stop.operator.clone(), stop.reason.clone());
        self.stops.put(&bytes(&EmergencyStop { stamp, action: StopAction::Stop, operator, reason })?)?;
        bail!(
            "{:?} has stopped an array of this room ({:?}): the check ends, and that stop stays in force; heliostat \
             status names each stop",
            stop.operator,
            stop.reason
        )
    }

    /// Publishes a stop or a re-arm of kind 9 with this time; returns source and sequence of it.
    ///
    /// # Errors
    /// Of a re-arm as [`expect_no_other_stop`](Self::expect_no_other_stop).
    pub fn send_stop(&self, action: StopAction, time_ns: Nanos) -> Result<(u64, u64)> {
        if action == StopAction::Rearm {
            self.expect_no_other_stop()?;
        }
        let stamp = self.stop_stamp(self.source, time_ns);
        self.stops.put(&stop_message(stamp, action)?)?;
        Ok((stamp.source, stamp.sequence))
    }

    /// Publishes a stop of another sender, who is not there; returns source and sequence of it.
    pub fn send_stop_of(&self, sender: u64) -> Result<(u64, u64)> {
        let stamp = self.stop_stamp(self.source ^ sender, utc_ns());
        self.stops.put(&stop_message(stamp, StopAction::Stop)?)?;
        Ok((stamp.source, stamp.sequence))
    }

    /// Publishes a re-arm that names a stop.
    ///
    /// # Errors
    /// As [`expect_no_other_stop`](Self::expect_no_other_stop).
    pub fn send_rearm(&self, stop_source: u64, stop_sequence: u64) -> Result<()> {
        self.expect_no_other_stop()?;
        let stamp = self.stop_stamp(self.source, utc_ns());
        let (operator, reason) = texts();
        Ok(self.rearms.put(&bytes(&Rearm { stamp, stop_source, stop_sequence, operator, reason })?)?)
    }

    /// The name of a stop that the array has never had: its sender is not there.
    pub fn unknown_stop(&self) -> (u64, u64) {
        (self.source ^ 2, 1)
    }

    /// Publishes a repetition of a stop of the check, as a controller does for an array that has not reported it.
    pub fn send_repetition(&self, (stop_source, stop_sequence): (u64, u64)) -> Result<()> {
        let (operator, reason) = texts();
        let stamp = self.stop_stamp(self.source, utc_ns());
        Ok(self.repetitions.put(&bytes(&StopRepetition { stamp, stop_source, stop_sequence, operator, reason })?)?)
    }

    fn stop_stamp(&self, source: u64, time_ns: Nanos) -> Stamp {
        self.stops_sent.set(self.stops_sent.get() + 1);
        Stamp { source, sequence: self.stops_sent.get(), time_ns }
    }

    /// Publishes a stop with this time as another process, whose liveliness token disappears once the driver shows the
    /// effect; returns source and sequence of it, `None` where the driver does not show it.
    pub fn send_stop_and_leave(
        &self,
        time_ns: Nanos,
        shows: impl Fn(&MirrorTelemetry) -> bool,
    ) -> Result<Option<(u64, u64)>> {
        let source = self.source ^ 3;
        let token = self.bus.announce(&self.bus.room().alive(NodeKind::Viewer, source))?;
        let (from, stamp) = (self.count(), self.stop_stamp(source, time_ns));
        self.stops.put(&stop_message(stamp, StopAction::Stop)?)?;
        let received = self.telemetry(from, shows).is_some();
        drop(token);
        Ok(received.then_some((stamp.source, stamp.sequence)))
    }
}

fn stop_message(stamp: Stamp, action: StopAction) -> Result<Vec<u8>> {
    let (operator, reason) = texts();
    bytes(&EmergencyStop { stamp, action, operator, reason })
}

/// Operator and reason of the orders of the check.
fn texts() -> (String, String) {
    (OPERATOR.into(), "conformance check".into())
}
