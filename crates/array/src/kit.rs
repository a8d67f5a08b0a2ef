//! What every driver does with any device: rules, watchdog, emergency stop, calibration, telemetry,
//! reconnection.
//!
//! # Theory of Operation
//!
//! [`Kit`] puts the rules of [`crate::rules`] around a [`Device`]. It has no thread, no socket and
//! no clock: the caller passes messages and time to the `handle_*` methods, and the kit applies the
//! resulting angles to the device. Driver processes and the simulated room are such callers. The
//! calling order is:
//!
//! 1. [`Kit::handle`], or one of the specific `handle_*` methods, for each message, with its
//!    arrival time.
//! 2. [`Kit::advance`] at [`Kit::next_ns`] at the latest: it holds, parks and reconnects.
//! 3. [`Kit::telemetry`], [`Kit::capabilities`] and [`Kit::safety`] when these are due.
//!
//! A caller that keeps the latch over a restart calls [`Kit::stop`] before the first step, and
//! records [`Array::latch`] between the steps 1 and 3.
//!
//! The connection to the device has two states. A failed call leads to Down, and the array's rules
//! continue to run there; so after a reconnection the device receives the angles that apply by
//! then.
//!
//! ```text
//!            connect failed: the pause doubles, up to 5 s; it is
//!            reset when the device has worked for 1 s
//!                +------+
//!                |      v
//!             +------------+   connect succeeded: apply the    +------+
//! start ----->|    Down    |---------------------------------->|  Up  |
//!             +------------+   target, or stop the device      +------+
//!                    ^                                            |
//!                    +--------- a call of the device failed ------+
//! ```
//!
//! The fail-safe default is the park position: mirrors for which no command is valid are parked.
//! A stop goes to the device in both states, and again after each reconnection. A stop that is
//! latched is not yet a device that has stopped: [`Kit::device_stopped`] tells them apart.
//!
//! A call of the device can block. With a [`Watch`] the kit reads the time again before each movement, and orders none
//! while a stop waits: the caller handles that one first.

use heliostat_channel::MirrorAngles;
use heliostat_proto::{
    ArrayState, Calibration, Capabilities, EmergencyStop, MirrorCommand, Rearm, StopAction, StopRepetition,
};

use crate::calibration::{Correction, Unfit};
use crate::content::Content;
use crate::device::{Device, DeviceError};
use crate::follow_check::FollowCheck;
use crate::latch::LatchedStop;
use crate::moment::Moment;
use crate::refusal_counts::RefusalCounts;
use crate::rules::{Array, Limits, RearmRefusal, Refusal};
use crate::watch::Watch;

mod connection;
mod reports;

/// A leader learns of a stop or of its successor within this time in ns. Its commands until then were in flight.
const LEARNED_WITHIN_NS: u64 = 500_000_000;

/// The connection to the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Link {
    Up,
    Down { retry_at_ns: u64 },
}

/// A device with everything that the contract requires of a driver.
#[derive(Clone, Debug)]
pub struct Kit<D> {
    device: D,
    capabilities: Capabilities,
    array: Array,
    correction: Correction,
    calibration_refused: bool,
    unnamed_rearm_refused: bool,
    /// When the array was stopped, or began to follow another epoch, in local time.
    changed_ns: u64,
    follow_check: FollowCheck,
    link: Link,
    /// The last pause before a reconnection in ns; 0 before the first one.
    pause_ns: u64,
    /// When the device was connected last, in local time.
    connected_ns: u64,
    connections: u64,
    last_problem: Option<DeviceError>,
    /// Number of failures of the device so far.
    problems: u64,
    /// Whether the device, or all of its mirrors, did not answer when it was measured last.
    is_absent: bool,
    /// Whether the device has executed a stop since the last one was latched, and answers.
    device_stopped: bool,
    /// Why it has not; a problem from before the last stop counts only while the link is down.
    stop_problem: Option<DeviceError>,
    /// When angles were last applied to the device.
    applied: Moment,
    watch: Option<Watch>,
    /// The movement to the target waits for a stop that has arrived.
    is_movement_due: bool,
    corrected: MirrorAngles,
    measured: MirrorAngles,
}

impl<D: Device> Kit<D> {
    /// A kit for a device that is not connected yet; [`Kit::advance`] connects it.
    pub fn new(device: D) -> Self {
        let capabilities = device.capabilities();
        let array = Array::new(Limits::new(&capabilities));
        let flat = MirrorAngles::flat(capabilities.mirrors());
        Self {
            follow_check: FollowCheck::new(&capabilities),
            device,
            capabilities,
            array,
            correction: Correction::default(),
            calibration_refused: false,
            unnamed_rearm_refused: false,
            changed_ns: 0,
            link: Link::Down { retry_at_ns: 0 },
            pause_ns: 0,
            connected_ns: 0,
            connections: 0,
            last_problem: None,
            problems: 0,
            is_absent: false,
            device_stopped: false,
            stop_problem: None,
            applied: Moment::default(),
            watch: None,
            is_movement_due: false,
            corrected: flat.clone(),
            measured: flat,
        }
    }

    /// Asks this watch before each movement. Without one no stop waits, and a call of the device takes no time.
    pub fn set_watch(&mut self, watch: Watch) {
        self.watch = Some(watch);
    }

    /// The present time, at the earliest this one.
    pub fn present(&self, earliest: Moment) -> Moment {
        let now = self.watch.as_ref().map(Watch::now);
        now.filter(|now| now.local_ns > earliest.local_ns).unwrap_or(earliest)
    }

    /// Whether a stop has arrived that is not handled yet, and that stops this array.
    fn has_waiting_stop(&self) -> bool {
        let stops = |content: &Content| match content {
            Content::Repetition(Ok(order)) => self.array.is_new_stop(order.name()),
            _ => content.is_stop(),
        };
        self.watch.as_ref().is_some_and(|watch| watch.has_stop(&stops))
    }

    /// Advances to a time: the array holds or parks, and a lost device is connected when that is
    /// due.
    pub fn advance(&mut self, now: Moment) {
        if let Some(at_ns) = self.array.parks_at_ns().filter(|at_ns| *at_ns <= now.local_ns) {
            let passed_ns = now.local_ns - at_ns;
            if self.array.advance(at_ns) {
                self.apply_target(Moment { local_ns: at_ns, room_ns: now.room_ns.saturating_sub(passed_ns) });
            }
        }
        self.array.advance(now.local_ns);
        if self.is_movement_due {
            self.apply_target(now);
        }
        let now = self.present(now);
        if let Link::Down { retry_at_ns } = self.link
            && retry_at_ns <= now.local_ns
            && !self.is_held_back()
        {
            match self.device.connect(now) {
                Ok(()) => self.connected(now),
                Err(problem) => self.lost(now, problem),
            }
        }
        self.update_device_stopped(now);
    }

    /// Handles a message of any kind, which arrived at the first time and is handled at the second; returns
    /// the command if it was one that was accepted.
    ///
    /// Refusals are counted by kind and reason in `refused`.
    pub fn handle(
        &mut self,
        (arrived, now): (Moment, Moment),
        content: Content,
        refused: &mut RefusalCounts,
    ) -> Option<MirrorCommand> {
        match content {
            Content::Command(Ok(command)) => {
                if self.follow((arrived, now), &command, refused) {
                    return Some(command);
                }
            }
            Content::Command(Err(error)) => {
                self.array.count_malformed();
                refused.note("command", error.name(), &error);
            }
            Content::Stop(Ok(order)) if order.action == StopAction::Stop => {
                self.stop(now, LatchedStop::new(&order, arrived.room_ns));
            }
            Content::Stop(Ok(order)) => {
                if let Err(refusal) = self.handle_stop(now, &order) {
                    refused.note("rearm", refusal.name(), &refusal);
                }
            }
            Content::Stop(Err(error)) => refused.note("stop", error.name(), &error),
            Content::Repetition(Ok(order)) => self.handle_repetition(now, &order),
            Content::Repetition(Err(error)) => refused.note("stop-repetition", error.name(), &error),
            Content::Rearm(Ok(order)) => {
                if let Err(refusal) = self.handle_rearm(now, &order) {
                    refused.note("rearm", refusal.name(), &refusal);
                }
            }
            Content::Rearm(Err(error)) => refused.note("rearm", error.name(), &error),
            Content::Calibration(Ok(calibration)) => {
                if let Err(unfit) = self.handle_calibration(now, &calibration) {
                    refused.note("calibration", unfit.name(), &unfit);
                }
            }
            Content::Calibration(Err(error)) => {
                self.calibration_refused = true;
                refused.note("calibration", error.name(), &error);
            }
        }
        None
    }

    /// Handles a command like [`Kit::handle`]; returns whether it was accepted. A command that was in flight when the
    /// array was stopped, or when another sender took over, is counted and is no problem.
    pub fn follow(
        &mut self,
        (arrived, now): (Moment, Moment),
        command: &MirrorCommand,
        refused: &mut RefusalCounts,
    ) -> bool {
        let followed = self.handle_waiting_command((arrived, now), command);
        let since_change_ns = arrived.local_ns.saturating_sub(self.changed_ns);
        match &followed {
            Err(refusal @ (Refusal::Stopped | Refusal::LowerEpoch { .. })) if since_change_ns < LEARNED_WITHIN_NS => {
                refused.count_without_problem(&format!("command:{}", refusal.name()));
            }
            Err(refusal) => refused.note("command", refusal.name(), refusal),
            Ok(()) => {}
        }
        followed.is_ok()
    }

    /// Checks a command and applies it to the device if it is accepted.
    ///
    /// # Errors
    /// [`Refusal`]: the target does not change.
    pub fn handle_command(&mut self, now: Moment, command: &MirrorCommand) -> Result<(), Refusal> {
        self.handle_waiting_command((now, now), command)
    }

    fn handle_waiting_command(
        &mut self,
        (arrived, now): (Moment, Moment),
        command: &MirrorCommand,
    ) -> Result<(), Refusal> {
        self.advance(now);
        let now = self.present(now);
        let epoch = self.array.followed().map(|followed| followed.epoch);
        self.array.handle_waiting_command((arrived, now), command)?;
        if epoch != Some(command.epoch) {
            self.changed_ns = now.local_ns;
        }
        self.apply_target(now);
        Ok(())
    }

    /// Refuses re-arms of kind 9, because any process that may stop can publish one.
    pub fn refuse_unnamed_rearm(&mut self, refuse: bool) {
        self.unnamed_rearm_refused = refuse;
    }

    /// Latches a stop and stops the device.
    ///
    /// Every stop stops the device again, because an earlier one may not have reached it.
    pub fn stop(&mut self, now: Moment, stop: LatchedStop) {
        if !self.array.latch().covers(stop.name()) {
            self.await_device();
        }
        if self.array.state() != ArrayState::Stopped {
            self.changed_ns = now.local_ns;
        }
        self.array.stop(stop);
        self.halt(now);
    }

    /// Applies a stop, or a re-arm of kind 9.
    ///
    /// # Errors
    /// [`RearmRefusal`]: a re-arm that releases nothing.
    pub fn handle_stop(&mut self, now: Moment, order: &EmergencyStop) -> Result<(), RearmRefusal> {
        if order.action == StopAction::Stop {
            // Before a reconnection, which would turn the mirrors.
            self.stop(now, LatchedStop::new(order, now.room_ns));
            return Ok(());
        }
        self.advance(now);
        if self.unnamed_rearm_refused {
            return Err(RearmRefusal::Unnamed);
        }
        self.array.handle_stop(now, order)?;
        self.apply_release(now);
        Ok(())
    }

    /// Applies the repetition of a stop.
    pub fn handle_repetition(&mut self, now: Moment, order: &StopRepetition) {
        let was_stopped = self.array.state() == ArrayState::Stopped;
        if self.array.handle_repetition(now, order) {
            if !was_stopped {
                self.changed_ns = now.local_ns;
            }
            self.await_device();
            self.halt(now);
        }
    }

    /// Applies a re-arm that names the stop.
    ///
    /// # Errors
    /// [`RearmRefusal`]: no stop of this name is latched.
    pub fn handle_rearm(&mut self, now: Moment, order: &Rearm) -> Result<(), RearmRefusal> {
        self.advance(now);
        let was_stopped = self.array.state() == ArrayState::Stopped;
        self.array.handle_rearm(order)?;
        if was_stopped {
            self.apply_release(now);
        }
        Ok(())
    }

    /// Sets the calibration before the first step, so that nothing reaches the device.
    ///
    /// # Errors
    /// [`Unfit`]: there is no calibration then.
    pub fn set_calibration(&mut self, calibration: &Calibration) -> Result<(), Unfit> {
        self.correction.replace(calibration, self.array.limits(), self.device.travel_rad())
    }

    /// Uses a calibration from its arrival; the present target is corrected at once.
    ///
    /// # Errors
    /// [`Unfit`]: the calibration in use remains, and telemetry reports the fault.
    pub fn handle_calibration(&mut self, now: Moment, calibration: &Calibration) -> Result<(), Unfit> {
        self.advance(now);
        let replaced = self.set_calibration(calibration);
        self.calibration_refused = replaced.is_err();
        match (&replaced, self.array.state()) {
            (Err(_), _) => {}
            (Ok(()), ArrayState::Stopped) => self.rest(now),
            (Ok(()), _) => self.apply_target(now),
        }
        replaced
    }

    /// Whether a stop is latched that the device has executed.
    pub fn device_stopped(&self) -> bool {
        self.device_stopped
    }

    /// Prepares the measurement for telemetry that is due within some milliseconds.
    pub fn request_measurement(&mut self) {
        if self.link == Link::Up {
            self.device.request_measurement();
        }
    }

    /// When [`Kit::advance`] must be called if no message arrives, in local time.
    pub fn next_ns(&self) -> Option<u64> {
        let retry_at_ns = match self.link {
            Link::Up => None,
            Link::Down { retry_at_ns } => Some(retry_at_ns),
        };
        let movement_ns = self.is_movement_due.then_some(0);
        self.array.changes_at_ns().into_iter().chain(retry_at_ns).chain(movement_ns).min()
    }

    /// The state machine of the rules.
    pub fn array(&self) -> &Array {
        &self.array
    }

    /// The device.
    pub fn device(&self) -> &D {
        &self.device
    }

    /// The device, for functions beyond the contract.
    pub fn device_mut(&mut self) -> &mut D {
        &mut self.device
    }

    /// The last failure of the device.
    pub fn last_problem(&self) -> Option<&DeviceError> {
        self.last_problem.as_ref()
    }

    /// Number of failures of the device so far.
    pub fn problems(&self) -> u64 {
        self.problems
    }

    /// Whether a part of the device did not answer when it was measured last.
    pub fn is_device_absent(&self) -> bool {
        self.is_absent
    }

    /// How often the device was connected.
    pub fn connections(&self) -> u64 {
        self.device.connections().unwrap_or(self.connections)
    }

    /// Whether a stop that waits has to come before the next movement. A stopped array orders none.
    pub(crate) fn is_held_back(&self) -> bool {
        self.array.state() != ArrayState::Stopped && self.has_waiting_stop()
    }
}
