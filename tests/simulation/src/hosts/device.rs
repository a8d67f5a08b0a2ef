//! The hardware of an array, which outlives its process, and the device that the process drives.

use std::cell::RefCell;
use std::rc::Rc;

use heliostat_array::moment::Moment;
use heliostat_array::{Device, DeviceError};
use heliostat_channel::MirrorAngles;
use heliostat_proto::{AxisLimits, Capabilities, Feedback, ValidityClock};

use crate::mutation::Mutation;
use crate::plan::DeviceFault;

/// Rows and columns of each array.
pub(crate) const SIDE: usize = 3;

/// Mirrors of each array.
pub(crate) const MIRRORS: usize = SIDE * SIDE;

/// Largest angle of each axis in rad.
pub(crate) const RANGE_RAD: f32 = 1.2;

/// Time from the end of validity to parking in ms.
pub(crate) const PARK_AFTER_MS: u32 = 1000;

/// Roll and yaw of the park position in rad.
const PARK_RAD: [f32; 2] = [0.3, -0.2];

/// Mirrors, and what happened to them.
#[derive(Debug)]
pub(crate) struct Hardware {
    faults: Vec<DeviceFault>,
    pub angles: MirrorAngles,
    /// Whether the last order that it executed was a stop.
    pub is_halted: bool,
    /// Orders to turn, executed or not.
    pub sets: u64,
    /// An angle that no driver may order.
    pub bad_angle: Option<f64>,
    validity_clock: ValidityClock,
    /// Orders that wait for the end of a blockage: a stop, and angles after it.
    pending: (bool, Option<MirrorAngles>),
    mutation: Option<Mutation>,
}

/// Hardware that several owners share.
pub(crate) type SharedHardware = Rc<RefCell<Hardware>>;

impl Hardware {
    pub fn new(counts_from_arrival: bool, mutation: Option<Mutation>) -> SharedHardware {
        let validity_clock = if counts_from_arrival { ValidityClock::Arrival } else { ValidityClock::SourceTime };
        Rc::new(RefCell::new(Self {
            faults: Vec::new(),
            angles: MirrorAngles::flat(MIRRORS),
            is_halted: false,
            sets: 0,
            bad_angle: None,
            validity_clock,
            pending: (false, None),
            mutation,
        }))
    }

    pub fn begin(&mut self, fault: DeviceFault) {
        self.faults.push(fault);
    }

    pub fn end(&mut self, fault: DeviceFault) {
        if let Some(index) = self.faults.iter().position(|known| *known == fault) {
            self.faults.remove(index);
        }
        if !self.has(DeviceFault::Blocks) {
            let (is_stopped, angles) = std::mem::take(&mut self.pending);
            self.is_halted |= is_stopped;
            if let Some(angles) = angles {
                (self.angles, self.is_halted) = (angles, false);
            }
        }
    }

    /// Whether it has no fault.
    pub fn is_sound(&self) -> bool {
        self.faults.is_empty()
    }

    fn has(&self, fault: DeviceFault) -> bool {
        self.faults.contains(&fault)
    }

    fn check(&self, faults: &[DeviceFault]) -> Result<(), DeviceError> {
        match faults.iter().find(|fault| self.has(**fault)) {
            Some(fault) => Err(DeviceError::new("board", format!("{fault:?}"))),
            None => Ok(()),
        }
    }

    fn set(&mut self, angles: &MirrorAngles) -> Result<(), DeviceError> {
        self.sets += 1;
        let is_bad = |angle: &&f64| angle.abs() > f64::from(RANGE_RAD) || !angle.is_finite();
        self.bad_angle = self.bad_angle.or(angles.roll.iter().chain(&angles.yaw).find(is_bad).copied());
        self.check(&[DeviceFault::Fails, DeviceFault::RefusesAngles])?;
        if self.has(DeviceFault::Blocks) {
            self.pending.1 = Some(angles.clone());
        } else {
            self.angles.clone_from(angles);
            self.is_halted = false;
        }
        Ok(())
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        if self.mutation == Some(Mutation::DeviceNotStopped) {
            return Ok(());
        }
        self.check(&[DeviceFault::Fails, DeviceFault::RefusesStops])?;
        if self.has(DeviceFault::Blocks) {
            self.pending = (true, None);
        } else {
            self.is_halted = true;
        }
        Ok(())
    }

    fn has_stopped(&self) -> Result<bool, DeviceError> {
        if self.mutation == Some(Mutation::DeviceNotStopped) {
            return Ok(true);
        }
        self.check(&[DeviceFault::Fails, DeviceFault::Silent])?;
        Ok(self.is_halted && !self.has(DeviceFault::Blocks))
    }
}

/// The device of a process.
#[derive(Debug)]
pub(crate) struct SimDevice(pub SharedHardware);

impl Device for SimDevice {
    fn capabilities(&self) -> Capabilities {
        let axis = AxisLimits { min_rad: -RANGE_RAD, max_rad: RANGE_RAD, ..AxisLimits::default() };
        Capabilities {
            hardware: "simulated".into(),
            rows: SIDE as u32,
            columns: SIDE as u32,
            roll: axis,
            yaw: axis,
            feedback: Feedback::ClosedLoop,
            validity_clock: self.0.borrow().validity_clock,
            park_after_ms: PARK_AFTER_MS,
            park_rad: PARK_RAD,
            ..Capabilities::default()
        }
    }

    fn connect(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.0.borrow().check(&[DeviceFault::Fails])
    }

    fn apply(&mut self, _now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError> {
        self.0.borrow_mut().set(angles)
    }

    fn measure(&mut self, _now: Moment, into: &mut MirrorAngles) -> Result<bool, DeviceError> {
        let hardware = self.0.borrow();
        hardware.check(&[DeviceFault::Fails, DeviceFault::Silent])?;
        into.clone_from(&hardware.angles);
        Ok(true)
    }

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.0.borrow_mut().stop()
    }

    fn has_stopped(&mut self) -> Result<bool, DeviceError> {
        self.0.borrow().has_stopped()
    }
}
