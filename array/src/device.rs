//! What a kind of mirrors has to provide; the kit does everything else.

use heliostat_channel::MirrorAngles;
use heliostat_proto::Capabilities;
use thiserror::Error;

use crate::moment::Moment;

/// Why a device did not do what it was asked to.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{device}: {problem}")]
pub struct DeviceError {
    /// Which device: a port, an address.
    pub device: String,
    /// What went wrong, and what can be done about it where that is known.
    pub problem: String,
}

impl DeviceError {
    /// What went wrong with which device.
    pub fn new(device: impl Into<String>, problem: impl ToString) -> Self {
        Self { device: device.into(), problem: problem.to_string() }
    }
}

/// How the hardware is, as far as it knows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Health {
    /// Temperature in degrees Celsius.
    pub temperature_c: Option<f32>,
    /// Bits of [`fault`](heliostat_proto::messages::fault) that the hardware reports of itself.
    pub faults: u32,
    /// Mirrors that the hardware knows not to follow, ascending.
    pub broken: Vec<u32>,
}

/// Mirrors that can be turned: a serial port, a board, a simulation.
///
/// All calls come from one thread and carry the time at which they count. After an error the kit calls
/// [`connect`](Self::connect) again and again, with growing pauses, and then [`apply`](Self::apply) with whatever is wanted by then.
pub trait Device {
    /// What the mirrors are and can do. The kit overwrites the stamp; everything else is announced as it stands here, and the
    /// limits, the park position and the validity clock in it are what the kit enforces. Constant as long as the device runs.
    fn capabilities(&self) -> Capabilities;

    /// How far the hardware itself can be told to go, roll and yaw, smallest and largest in rad: the limits announced, and what is
    /// kept back for the corrections of a calibration.
    fn travel_rad(&self) -> [[f64; 2]; 2] {
        let Capabilities { roll, yaw, .. } = self.capabilities();
        [roll, yaw].map(|axis| [f64::from(axis.min_rad), f64::from(axis.max_rad)])
    }

    /// Brings the device up.
    ///
    /// # Errors
    /// [`DeviceError`]; the kit tries again later.
    fn connect(&mut self, now: Moment) -> Result<(), DeviceError>;

    /// Turns all mirrors at once; the angles are within the limits, with the calibration applied.
    ///
    /// # Errors
    /// [`DeviceError`] where the device did not take them.
    fn apply(&mut self, now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError>;

    /// Writes where the mirrors are; false where the hardware does not measure.
    ///
    /// # Errors
    /// [`DeviceError`] where it should but does not answer.
    fn measure(&mut self, now: Moment, into: &mut MirrorAngles) -> Result<bool, DeviceError>;

    /// How the hardware is.
    ///
    /// # Errors
    /// [`DeviceError`] where it does not answer.
    fn health(&mut self, _now: Moment) -> Result<Health, DeviceError> {
        Ok(Health::default())
    }

    /// Stops all motion at once.
    ///
    /// # Errors
    /// [`DeviceError`] where that may not have happened; the kit stops it again as soon as it answers.
    fn stop(&mut self, now: Moment) -> Result<(), DeviceError>;
}
