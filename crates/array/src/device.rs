//! The trait that hardware implements; `Kit` does everything else.

use heliostat_channel::MirrorAngles;
use heliostat_proto::Capabilities;
use thiserror::Error;

use crate::moment::Moment;

/// Why a device failed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{device}: {problem}")]
pub struct DeviceError {
    /// The device: a port or an address.
    pub device: String,
    /// What went wrong, and a remedy if one is known.
    pub problem: String,
}

impl DeviceError {
    /// An error of a device.
    pub fn new(device: impl Into<String>, problem: impl ToString) -> Self {
        Self { device: device.into(), problem: problem.to_string() }
    }
}

/// The condition of the hardware, as it reports it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Health {
    /// Temperature in degrees Celsius.
    pub temperature_c: Option<f32>,
    /// Bits of [`fault`](heliostat_proto::messages::fault) that the hardware reports.
    pub faults: u32,
    /// Mirrors that the hardware reports as not following, ascending.
    pub broken: Vec<u32>,
}

/// Mirrors that can be turned: on a serial port, on a board, in a simulation.
///
/// All calls come from one thread and have the time as an argument. After an error the kit calls
/// [`connect`](Self::connect) repeatedly, with growing pauses, and then [`apply`](Self::apply) with
/// the angles that apply by then.
pub trait Device {
    /// The capabilities of the array, constant while the device runs.
    ///
    /// The kit overwrites the stamp and publishes all other fields unchanged. It enforces the
    /// limits, the park position and the validity clock in them.
    fn capabilities(&self) -> Capabilities;

    /// Minimum and maximum angle of the hardware itself in rad, roll and then yaw.
    ///
    /// This is the range of the announced limits, plus the reserve for the corrections of a
    /// calibration.
    fn travel_rad(&self) -> [[f64; 2]; 2] {
        let Capabilities { roll, yaw, .. } = self.capabilities();
        [roll, yaw].map(|axis| [f64::from(axis.min_rad), f64::from(axis.max_rad)])
    }

    /// Connects and initialises the device.
    ///
    /// # Errors
    /// [`DeviceError`]; the kit tries again later.
    fn connect(&mut self, now: Moment) -> Result<(), DeviceError>;

    /// Turns all mirrors at once; the angles are within the limits, with the calibration applied.
    ///
    /// # Errors
    /// [`DeviceError`] if the device did not accept them.
    fn apply(&mut self, now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError>;

    /// Writes the measured angles; returns false if the hardware does not measure.
    ///
    /// # Errors
    /// [`DeviceError`] if it measures but does not answer.
    fn measure(&mut self, now: Moment, into: &mut MirrorAngles) -> Result<bool, DeviceError>;

    /// The condition of the hardware.
    ///
    /// # Errors
    /// [`DeviceError`] if it does not answer.
    fn health(&mut self, _now: Moment) -> Result<Health, DeviceError> {
        Ok(Health::default())
    }

    /// Stops all motion at once.
    ///
    /// # Errors
    /// [`DeviceError`] if the motion may not have stopped; the kit stops it again as soon as it
    /// answers.
    fn stop(&mut self, now: Moment) -> Result<(), DeviceError>;
}
