//! The calls of the device: movements, stops, and the connection between them.

use heliostat_proto::ArrayState;

use super::{Kit, Link};
use crate::device::{Device, DeviceError};
use crate::moment::Moment;

/// First pause before a reconnection in ns; it doubles with each failure of a device that has not
/// worked for [`STEADY_NS`] since it was connected.
const PAUSE_MIN_NS: u64 = 100_000_000;

/// Longest pause before a reconnection in ns.
const PAUSE_MAX_NS: u64 = 5_000_000_000;

/// The same while the array is stopped.
const PAUSE_MAX_STOPPED_NS: u64 = 500_000_000;

/// After a device has worked for this time since it was connected, the pauses begin again.
const STEADY_NS: u64 = 1_000_000_000;

impl<D: Device> Kit<D> {
    /// Applies the corrected target of the present time to the device if it is connected and no stop waits.
    pub(super) fn apply_target(&mut self, earliest: Moment) {
        let now = self.present(earliest);
        if now != earliest {
            self.array.advance(now.local_ns);
        }
        self.correction.apply(self.array.target(), &mut self.corrected);
        self.is_movement_due = self.link == Link::Up && self.is_held_back();
        if self.link == Link::Up && !self.is_movement_due {
            match self.device.apply(now, &self.corrected) {
                Ok(()) => self.applied = now,
                Err(problem) => self.lost(now, problem),
            }
        }
    }

    /// Applies the target if the last stop was released.
    pub(super) fn apply_release(&mut self, now: Moment) {
        if self.array.state() != ArrayState::Stopped {
            self.device_stopped = false;
            self.apply_target(now);
        }
    }

    /// A stop was latched that the device has not executed yet.
    pub(super) fn await_device(&mut self) {
        self.device_stopped = false;
        if self.link == Link::Up {
            self.stop_problem = None;
        }
    }

    /// Stops the device, also one that does not answer; that one is connected at the next step.
    pub(super) fn halt(&mut self, now: Moment) {
        self.is_movement_due = false;
        match (self.device.stop(now), &mut self.link) {
            (Ok(()), Link::Up) => self.update_device_stopped(now),
            (Err(problem), Link::Up) => self.lost(now, problem),
            (_, Link::Down { retry_at_ns }) => *retry_at_ns = (*retry_at_ns).min(now.local_ns),
        }
    }

    /// Learns whether the device of a stopped array has stopped; the angles at which the mirrors came
    /// to rest then become the target.
    pub(super) fn update_device_stopped(&mut self, now: Moment) {
        if self.array.state() != ArrayState::Stopped || self.link != Link::Up {
            self.device_stopped = false;
            return;
        }
        let before = self.device_stopped;
        self.device_stopped = self.device.has_stopped().unwrap_or_else(|problem| {
            self.stop_problem = Some(problem.clone());
            self.note_problem(problem);
            false
        });
        if !before {
            self.rest(now);
        }
    }

    /// The angles at which the mirrors of a device that has stopped rest become the target.
    pub(super) fn rest(&mut self, now: Moment) {
        if self.device_stopped && self.device.measure(now, &mut self.measured) == Ok(true) {
            self.correction.undo(&mut self.measured);
            self.array.set_target(&self.measured);
        }
    }

    pub(super) fn connected(&mut self, earliest: Moment) {
        let now = self.present(earliest);
        self.link = Link::Up;
        self.connected_ns = now.local_ns;
        self.connections += 1;
        if self.array.state() == ArrayState::Stopped {
            self.halt(now);
        } else {
            // What is due by now: the connection may have taken long.
            self.apply_target(earliest);
        }
    }

    pub(super) fn lost(&mut self, earliest: Moment, problem: DeviceError) {
        let now = self.present(earliest);
        let has_worked = self.link == Link::Up && now.local_ns.saturating_sub(self.connected_ns) >= STEADY_NS;
        let is_stopped = self.array.state() == ArrayState::Stopped;
        let longest_ns = if is_stopped { PAUSE_MAX_STOPPED_NS } else { PAUSE_MAX_NS };
        self.pause_ns = if has_worked { PAUSE_MIN_NS } else { (2 * self.pause_ns).clamp(PAUSE_MIN_NS, longest_ns) };
        self.device_stopped = false;
        self.link = Link::Down { retry_at_ns: now.local_ns.saturating_add(self.pause_ns) };
        self.follow_check.pause();
        self.stop_problem = Some(problem.clone());
        self.note_problem(problem);
    }

    pub(super) fn note_problem(&mut self, problem: DeviceError) {
        self.problems += 1;
        self.last_problem = Some(problem);
    }
}
