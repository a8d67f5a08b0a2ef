//! The parts of the modelled room: the real kit around hardware in memory, and controllers.

use std::hash::{Hash, Hasher};

use heliostat_array::latch::Latch;
use heliostat_array::moment::Moment;
use heliostat_array::rules::{Array, Followed};
use heliostat_array::{Device, DeviceError, Kit};
use heliostat_channel::MirrorAngles;
use heliostat_core::tenure::{Evidence, Tenure};
use heliostat_proto::stop_hold::StopHold;
use heliostat_proto::*;

/// UTC at the start of the model.
pub const START_NS: Nanos = 1_800_000_000_000_000_000;

/// Time of a round: each controller has one report to answer.
pub const ROUND_NS: u64 = 500_000_000;

/// Validity of a command.
const VALIDITY_MS: u32 = 1_000;

/// The instant of a round.
pub fn instant(round: u32) -> Moment {
    let local_ns = u64::from(round) * ROUND_NS;
    Moment { local_ns, room_ns: START_NS + local_ns }
}

/// Equality and hash by the `key`: two values are equal if they behave alike from now on.
macro_rules! by_key {
    ($($type:ident),+) => { $(
        impl PartialEq for $type {
            fn eq(&self, other: &Self) -> bool {
                self.key() == other.key()
            }
        }

        impl Hash for $type {
            fn hash<H: Hasher>(&self, state: &mut H) {
                self.key().hash(state);
            }
        }
    )+ };
}

pub(crate) use by_key;

/// One mirror that turns at once; it keeps its angle when the driver crashes.
#[derive(Clone, Debug, PartialEq)]
pub struct Hardware {
    pub roll: f64,
}

/// The capabilities of an array of one mirror.
pub fn one_mirror() -> Capabilities {
    let axis = AxisLimits { min_rad: -0.5, max_rad: 0.5, ..AxisLimits::default() };
    Capabilities { rows: 1, columns: 1, roll: axis, yaw: axis, park_after_ms: 500, ..Capabilities::default() }
}

impl Device for Hardware {
    fn capabilities(&self) -> Capabilities {
        one_mirror()
    }

    fn apply(&mut self, _now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError> {
        self.roll = angles.roll[0];
        Ok(())
    }

    fn measure(&mut self, _now: Moment, into: &mut MirrorAngles) -> Result<bool, DeviceError> {
        into.roll[0] = self.roll;
        Ok(true)
    }

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        Ok(())
    }
}

/// A running driver.
#[derive(Clone, Debug)]
pub struct Driver {
    pub kit: Kit<Hardware>,
    /// Which start of the driver it is: the source of its reports.
    pub source: u64,
}

impl Driver {
    /// Starts at a round as the driver does, with the latch of its record.
    pub fn start(now: Moment, hardware: Hardware, latch: &Latch, source: u64) -> Self {
        let mut kit = Kit::new(hardware);
        let record = Latch::parse(&latch.to_toml()).expect("the record can be read");
        let record = record.restored(now.room_ns);
        record.stops().iter().for_each(|stop| kit.stop(now, stop.clone()));
        kit.advance(now);
        Self { kit, source }
    }

    /// What the telemetry shows.
    pub fn evidence(&self) -> Evidence {
        let array = self.kit.array();
        let followed = array.followed().copied().unwrap_or_default();
        Evidence::from(&MirrorTelemetry {
            state: array.state(),
            epoch: followed.epoch,
            applied_sequence: followed.sequence,
            counters: *array.counters(),
            ..MirrorTelemetry::default()
        })
    }

    fn key(&self) -> impl Hash + PartialEq + use<> {
        let array: &Array = self.kit.array();
        let Followed { epoch, sequence, .. } = array.followed().copied().unwrap_or_default();
        let angles = [array.target().roll[0], self.kit.device().roll].map(f64::to_bits);
        let state = array.state() as u32;
        let released: Vec<StopName> = array.released().collect();
        let stop = (array.latch().clone(), released, self.kit.device_stopped(), self.source);
        (state, epoch, sequence, array.changes_at_ns(), stop, angles, self.evidence())
    }
}

/// A running controller: its tenure, its latch and its clock.
#[derive(Clone, Debug)]
pub struct Controller {
    /// Which start of which controller it is.
    pub source: u64,
    pub tenure: Tenure,
    pub stop: StopHold,
    /// How far its clock is ahead.
    pub ahead_ns: u64,
    /// Whether the latest telemetry shows a stop.
    array_stopped: bool,
}

impl Controller {
    pub fn start(source: u64, tenure: Tenure, ahead_ns: u64) -> Self {
        let stop = StopHold::default();
        Self { source, tenure, stop, ahead_ns, array_stopped: false }
    }

    /// UTC by its clock.
    pub fn clock_ns(&self, now: Moment) -> Nanos {
        now.room_ns + self.ahead_ns
    }

    /// A report arrives: the command that answers it.
    pub fn handle_report(&mut self, now: Moment) -> Option<MirrorCommand> {
        let time_ns = self.clock_ns(now);
        if self.stop.is_stopped() || self.array_stopped {
            return None;
        }
        let epoch = self.tenure.permit(time_ns).0?;
        let sequence = self.tenure.next_sequence();
        // Each controller commands another angle, so that a change of the leader moves the mirror.
        let roll = vec![0.1 * self.source as f32];
        let command = MirrorCommand { epoch, sequence, time_ns, validity_ms: VALIDITY_MS, roll, ..COMMAND };
        Some(MirrorCommand { yaw: vec![0.0], ..command })
    }

    pub fn handle_telemetry(&mut self, now: Moment, evidence: Evidence) {
        self.array_stopped = evidence.stopped;
        self.tenure.handle_telemetry(self.clock_ns(now), evidence);
    }

    fn key(&self) -> impl Hash + PartialEq + use<> {
        (self.tenure.clone(), self.stop.clone(), (self.source, self.ahead_ns, self.array_stopped))
    }
}

by_key!(Driver, Controller);

/// A command without angles.
pub const COMMAND: MirrorCommand = MirrorCommand {
    epoch: 0,
    sequence: 0,
    answers: 0,
    time_ns: 0,
    validity_ms: VALIDITY_MS,
    roll: Vec::new(),
    yaw: Vec::new(),
};
