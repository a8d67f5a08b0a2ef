//! What a [`Kit`] reports: telemetry, capabilities, stops and safety.

use heliostat_proto::messages::fault;
use heliostat_proto::{ArrayState, Capabilities, MirrorTelemetry, SafetyReport, Stamp, StopReport, cut};

use super::{Kit, Link};
use crate::device::{Device, Health};
use crate::latch::LatchedStop;
use crate::moment::Moment;

impl<D: Device> Kit<D> {
    /// Measures the mirrors and returns the telemetry of the contract.
    pub fn telemetry(&mut self, now: Moment, stamp: Stamp) -> MirrorTelemetry {
        let (measures, health) = self.measure(now);
        let single = |angles: &[f64]| angles.iter().map(|angle| *angle as f32).collect::<Vec<_>>();
        let measured = |angles: &[f64]| if measures { single(angles) } else { Vec::new() };
        let followed = self.array.followed().copied().unwrap_or_default();
        let mirrors = 0..self.capabilities.mirrors();
        let unusable: Vec<u32> = mirrors
            .filter(|mirror| self.follow_check.is_unusable(*mirror) || health.broken.contains(&(*mirror as u32)))
            .map(|mirror| mirror as u32)
            .collect();
        let is_lost = health.faults & fault::LINK != 0 && health.broken.len() == self.capabilities.mirrors();
        let is_down = self.link != Link::Up || is_lost;
        self.is_absent = is_down || health.problem.is_some();
        if let Some(problem) = health.problem {
            self.note_problem(problem);
        }
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
                | bit(self.calibration_refused, fault::CALIBRATION)
                | bit(self.array.state() == ArrayState::Stopped && !self.device_stopped, fault::STOP),
            counters: *self.array.counters(),
            temperature_c: health.temperature_c,
            roll_commanded: single(&self.array.target().roll),
            yaw_commanded: single(&self.array.target().yaw),
            roll_measured: measured(&self.measured.roll),
            yaw_measured: measured(&self.measured.yaw),
            unusable,
        }
    }

    /// The capabilities of the array.
    pub fn capabilities(&self, stamp: Stamp) -> Capabilities {
        Capabilities { stamp, ..self.capabilities.clone() }
    }

    /// The emergency stops in force, and whether the device has executed them.
    pub fn stops(&self, stamp: Stamp) -> StopReport {
        let stops: Vec<_> = self.array.latch().stops().iter().map(LatchedStop::report).collect();
        let is_open = !stops.is_empty() && !self.device_stopped;
        let problem = self.stop_problem.as_ref().map(ToString::to_string).filter(|_| is_open);
        StopReport {
            stamp,
            device_stopped: self.device_stopped,
            stops,
            released: self.array.released().collect(),
            problem: problem.map(|problem| cut(&problem).to_owned()).unwrap_or_default(),
        }
    }

    /// The emergency stop that was latched last, and the bounds on commands.
    pub fn safety(&self, stamp: Stamp) -> SafetyReport {
        let stop = self.array.latch().stop();
        let bounds = self.array.limits().bounds;
        let LatchedStop { source, sequence, arrived_ns, operator, reason, .. } = stop.cloned().unwrap_or_default();
        SafetyReport {
            stamp,
            stopped: stop.is_some(),
            stop_source: source,
            stop_sequence: sequence,
            stopped_ns: arrived_ns,
            operator,
            reason,
            epoch: self.array.followed().map_or(0, |followed| followed.epoch),
            validity_max_ms: bounds.validity_max_ms,
            epoch_lead_max: bounds.epoch_lead_max,
            sequence_step_max: bounds.sequence_step_max,
        }
    }

    /// Checks whether the mirrors follow. Stopped ones rest where the stop found them, which a device can measure later
    /// than it reports the stop.
    fn check_following(&mut self, now: Moment) {
        if self.array.state() == ArrayState::Stopped {
            self.follow_check.pause();
        } else {
            self.follow_check.update(now.local_ns, self.array.target(), &self.measured);
        }
    }

    /// Reads angles and health; a device that does not answer counts as lost.
    fn measure(&mut self, now: Moment) -> (bool, Health) {
        if self.link != Link::Up {
            return (false, Health::default());
        }
        let answer = self.device.measure(now, &mut self.measured).and_then(|measures| {
            let health = self.device.health(now)?;
            Ok((measures, health))
        });
        match answer {
            Ok((measures, health)) => {
                if measures {
                    self.correction.undo(&mut self.measured);
                    self.check_following(now);
                }
                (measures, health)
            }
            Err(problem) => {
                self.lost(now, problem);
                (false, Health::default())
            }
        }
    }
}
