//! What every driver does, whatever its device: rules, watchdog, emergency stop, calibration, telemetry, reconnection.
//!
//! No thread, no socket and no clock: messages and time come in, the device is told what follows. [`crate::run`] puts a session and a
//! clock around it for real devices; the simulated room does so for its own, in real and in simulated time.

use heliostat_channel::MirrorAngles;
use heliostat_proto::messages::fault;
use heliostat_proto::{ArrayState, Calibration, Capabilities, EmergencyStop, MirrorCommand, MirrorTelemetry, Stamp};

use crate::calibration::{Correction, Unfit};
use crate::content::Content;
use crate::device::{Device, DeviceError, Health};
use crate::follow::Follow;
use crate::moment::Moment;
use crate::refused::Refused;
use crate::rules::{Array, Limits, Refusal};

/// First pause before a device that failed is tried again, in ns; it doubles with each failure.
const PAUSE_MIN_NS: u64 = 100_000_000;

/// Longest pause, in ns.
const PAUSE_MAX_NS: u64 = 5_000_000_000;

/// The way to the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Link {
    Up,
    Down { retry_at_ns: u64, pause_ns: u64 },
}

/// A device with everything around it that the contract asks of a driver.
#[derive(Clone, Debug)]
pub struct Kit<D> {
    device: D,
    capabilities: Capabilities,
    array: Array,
    correction: Correction,
    calibration_refused: bool,
    follow: Follow,
    link: Link,
    reconnections: u64,
    last_problem: Option<DeviceError>,
    /// When the mirrors were last told anything.
    applied: Moment,
    corrected: MirrorAngles,
    measured: MirrorAngles,
}

impl<D: Device> Kit<D> {
    /// Around a device that is not connected yet; [`Kit::advance`] does that.
    pub fn new(device: D) -> Self {
        let capabilities = device.capabilities();
        let array = Array::new(Limits::new(&capabilities));
        let flat = MirrorAngles::flat(capabilities.mirrors());
        Self {
            follow: Follow::new(&capabilities),
            device,
            capabilities,
            array,
            correction: Correction::default(),
            calibration_refused: false,
            link: Link::Down { retry_at_ns: 0, pause_ns: PAUSE_MIN_NS },
            reconnections: 0,
            last_problem: None,
            applied: Moment::default(),
            corrected: flat.clone(),
            measured: flat,
        }
    }

    /// Lets time pass: the array holds, parks, and its device is tried again when that is due.
    pub fn advance(&mut self, now: Moment) {
        if let Some(at_ns) = self.array.parks_at_ns().filter(|at_ns| *at_ns <= now.local_ns) {
            let passed_ns = now.local_ns - at_ns;
            if self.array.advance(at_ns) {
                self.tell(Moment { local_ns: at_ns, room_ns: now.room_ns.saturating_sub(passed_ns) });
            }
        }
        self.array.advance(now.local_ns);
        if let Link::Down { retry_at_ns, pause_ns } = self.link
            && retry_at_ns <= now.local_ns
        {
            match self.device.connect(now) {
                Ok(()) => self.connected(now),
                Err(problem) => self.lost(now, problem, (2 * pause_ns).min(PAUSE_MAX_NS)),
            }
        }
    }

    /// Takes whatever arrived; gives the command where it was one that is followed. What is refused is counted by name.
    pub fn take(&mut self, at: Moment, content: Content, refused: &mut Refused) -> Option<MirrorCommand> {
        match content {
            Content::Command(Ok(command)) => match self.command(at, &command) {
                Ok(()) => return Some(command),
                Err(refusal) => refused.note("command", refusal.name(), &refusal),
            },
            Content::Command(Err(error)) => {
                self.array.count_malformed();
                refused.note("command", error.name(), &error);
            }
            Content::Stop(Ok(order)) => self.order(at, &order),
            Content::Stop(Err(error)) => refused.note("stop", error.name(), &error),
            Content::Calibration(Ok(calibration)) => {
                if let Err(unfit) = self.calibrate(at, &calibration) {
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

    /// Takes a command.
    ///
    /// # Errors
    /// [`Refusal`]; the array goes on as if nothing had come.
    pub fn command(&mut self, now: Moment, command: &MirrorCommand) -> Result<(), Refusal> {
        self.advance(now);
        self.array.receive(now, command)?;
        self.tell(now);
        Ok(())
    }

    /// Obeys a stop or a re-arm. A device is stopped again by every stop: it costs nothing, and the first may not have reached it.
    pub fn order(&mut self, now: Moment, order: &EmergencyStop) {
        self.advance(now);
        let changed = self.array.order(order);
        if self.array.state() == ArrayState::Stopped {
            self.halt(now);
        } else if changed {
            self.tell(now);
        }
    }

    /// Takes a calibration into use; mirrors that follow a command are corrected at once.
    ///
    /// # Errors
    /// [`Unfit`]; the one in use stays, and telemetry says so.
    pub fn calibrate(&mut self, now: Moment, calibration: &Calibration) -> Result<(), Unfit> {
        self.advance(now);
        let taken = self.correction.take(calibration, self.array.limits(), self.device.travel_rad());
        self.calibration_refused = taken.is_err();
        if taken.is_ok() && self.array.state() != ArrayState::Stopped {
            self.tell(now);
        }
        taken
    }

    /// What the array does, as the contract tells it.
    pub fn telemetry(&mut self, now: Moment, stamp: Stamp) -> MirrorTelemetry {
        let (measures, health) = self.look(now);
        let single = |angles: &[f64]| angles.iter().map(|angle| *angle as f32).collect::<Vec<_>>();
        let measured = |angles: &[f64]| if measures { single(angles) } else { Vec::new() };
        let followed = self.array.followed().copied().unwrap_or_default();
        let mirrors = 0..self.capabilities.mirrors();
        let unusable: Vec<u32> = mirrors
            .filter(|mirror| self.follow.is_unusable(*mirror) || health.broken.contains(&(*mirror as u32)))
            .map(|mirror| mirror as u32)
            .collect();
        let is_down = self.link != Link::Up;
        let bit = |set: bool, bit: u32| if set { bit } else { 0 };
        MirrorTelemetry {
            stamp,
            state: if is_down && self.array.state() != ArrayState::Stopped {
                ArrayState::Fault
            } else {
                self.array.state()
            },
            epoch: followed.epoch,
            applied_sequence: followed.sequence,
            answers: followed.answers,
            received_ns: followed.received.room_ns,
            applied_ns: if self.array.followed().is_some() { self.applied.room_ns } else { 0 },
            calibration: self.correction.sequence(),
            faults: self.array.faults()
                | health.faults
                | bit(is_down, fault::LINK)
                | bit(!unusable.is_empty(), fault::MIRROR)
                | bit(self.calibration_refused, fault::CALIBRATION),
            counters: *self.array.counters(),
            temperature_c: health.temperature_c,
            roll_commanded: single(&self.array.target().roll),
            yaw_commanded: single(&self.array.target().yaw),
            roll_measured: measured(&self.measured.roll),
            yaw_measured: measured(&self.measured.yaw),
            unusable,
        }
    }

    /// What the array is and can do.
    pub fn capabilities(&self, stamp: Stamp) -> Capabilities {
        Capabilities { stamp, ..self.capabilities.clone() }
    }

    /// When [`Kit::advance`] has something to do if nothing comes, in local time.
    pub fn next_ns(&self) -> Option<u64> {
        let retry_at_ns = match self.link {
            Link::Up => None,
            Link::Down { retry_at_ns, .. } => Some(retry_at_ns),
        };
        self.array.changes_at_ns().into_iter().chain(retry_at_ns).min()
    }

    /// The rules' state.
    pub fn array(&self) -> &Array {
        &self.array
    }

    /// The device.
    pub fn device(&self) -> &D {
        &self.device
    }

    /// For what a device can do beyond the contract.
    pub fn device_mut(&mut self) -> &mut D {
        &mut self.device
    }

    /// What was wrong with the device last.
    pub fn last_problem(&self) -> Option<&DeviceError> {
        self.last_problem.as_ref()
    }

    /// Times that the device was brought up.
    pub fn connections(&self) -> u64 {
        self.reconnections
    }

    /// Tells the device where the mirrors are to point, if it can be reached and may move.
    fn tell(&mut self, now: Moment) {
        self.correction.apply(self.array.target(), &mut self.corrected);
        if self.link == Link::Up {
            match self.device.apply(now, &self.corrected) {
                Ok(()) => self.applied = now,
                Err(problem) => self.lost(now, problem, PAUSE_MIN_NS),
            }
        }
    }

    /// Stops the device; its mirrors are then asked to be where they came to rest.
    fn halt(&mut self, now: Moment) {
        if self.link != Link::Up {
            return;
        }
        if let Err(problem) = self.device.stop(now) {
            self.lost(now, problem, PAUSE_MIN_NS);
            return;
        }
        if self.device.measure(now, &mut self.measured) == Ok(true) {
            self.correction.undo(&mut self.measured);
            self.array.stay_at(&self.measured);
        }
    }

    fn connected(&mut self, now: Moment) {
        self.link = Link::Up;
        self.reconnections += 1;
        if self.array.state() == ArrayState::Stopped {
            self.halt(now);
        } else {
            self.tell(now);
        }
    }

    fn lost(&mut self, now: Moment, problem: DeviceError, pause_ns: u64) {
        self.link = Link::Down { retry_at_ns: now.local_ns.saturating_add(pause_ns), pause_ns };
        self.follow.pause();
        self.last_problem = Some(problem);
    }

    /// Reads angles and health; a device that does not answer is lost.
    fn look(&mut self, now: Moment) -> (bool, Health) {
        if self.link != Link::Up {
            return (false, Health::default());
        }
        let seen = self.device.measure(now, &mut self.measured).and_then(|measures| {
            let health = self.device.health(now)?;
            Ok((measures, health))
        });
        match seen {
            Ok((measures, health)) => {
                if measures {
                    self.correction.undo(&mut self.measured);
                    self.follow.look(now.local_ns, self.array.target(), &self.measured);
                }
                (measures, health)
            }
            Err(problem) => {
                self.lost(now, problem, PAUSE_MIN_NS);
                (false, Health::default())
            }
        }
    }
}
