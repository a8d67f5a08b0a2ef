//! The trait that hardware implements; `Kit` does everything else.

use std::fmt;
use std::sync::Arc;

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

/// Why no array can have capabilities that a message can hold.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum CapabilitiesError {
    /// It has no mirrors.
    #[error("an array without mirrors: expected rows and columns from 1")]
    NoMirrors,
    /// It would park where no command may turn it.
    #[error("park_rad, {axis} = {found}: expected an angle within the limits of {axis}, {min} to {max} rad")]
    ParkOutside {
        /// "roll" or "yaw".
        axis: &'static str,
        /// The angle of the park position in rad.
        found: f32,
        /// The smallest angle in rad.
        min: f32,
        /// The largest angle in rad.
        max: f32,
    },
}

/// Checks what the contract requires of an array beyond the bytes of its capabilities message.
///
/// # Errors
/// [`CapabilitiesError`].
pub fn check_capabilities(capabilities: &Capabilities) -> Result<(), CapabilitiesError> {
    if capabilities.mirrors() == 0 {
        return Err(CapabilitiesError::NoMirrors);
    }
    let axes = [("roll", &capabilities.roll), ("yaw", &capabilities.yaw)];
    for ((axis, limits), found) in axes.into_iter().zip(capabilities.park_rad) {
        let (min, max) = (limits.min_rad, limits.max_rad);
        if !(min..=max).contains(&found) {
            return Err(CapabilitiesError::ParkOutside { axis, found, min, max });
        }
    }
    Ok(())
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
    /// The present failure of a part of the hardware.
    pub problem: Option<DeviceError>,
}

/// Wakes the thread that runs the kit, after a change of a device that has threads of its own.
#[derive(Clone)]
pub struct Waker(Arc<dyn Fn() + Send + Sync>);

impl Waker {
    /// A waker that calls a function; it must neither wait nor call the device.
    pub fn new(wake: impl Fn() + Send + Sync + 'static) -> Self {
        Self(Arc::new(wake))
    }

    /// Wakes the thread.
    pub fn wake(&self) {
        (self.0)();
    }
}

impl fmt::Debug for Waker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Waker")
    }
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
    fn connect(&mut self, _now: Moment) -> Result<(), DeviceError> {
        Ok(())
    }

    /// Turns all mirrors at once; the angles are within the limits, with the calibration applied.
    ///
    /// # Errors
    /// [`DeviceError`] if the device did not accept them.
    fn apply(&mut self, now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError>;

    /// Writes the measured angles; returns false if the hardware does not measure.
    ///
    /// # Errors
    /// [`DeviceError`] if it measures but does not answer.
    fn measure(&mut self, _now: Moment, _into: &mut MirrorAngles) -> Result<bool, DeviceError> {
        Ok(false)
    }

    /// The condition of the hardware.
    ///
    /// # Errors
    /// [`DeviceError`] if it does not answer.
    fn health(&mut self, _now: Moment) -> Result<Health, DeviceError> {
        Ok(Health::default())
    }

    /// Sets the waker of the thread that makes these calls. A device without threads of its own needs
    /// none.
    fn set_waker(&mut self, _waker: Waker) {}

    /// How often the hardware was connected, where the device connects it on threads of its own.
    fn connections(&self) -> Option<u64> {
        None
    }

    /// Prepares a measurement that is due within some milliseconds.
    fn request_measurement(&mut self) {}

    /// Stops all motion at once. The kit also calls it while the device does not answer.
    ///
    /// A device with threads of its own returns without waiting for the hardware;
    /// [`has_stopped`](Self::has_stopped) then tells when it has stopped.
    ///
    /// # Errors
    /// [`DeviceError`] if the motion may not have stopped; the kit stops it again as soon as it
    /// answers.
    fn stop(&mut self, now: Moment) -> Result<(), DeviceError>;

    /// Whether all hardware has executed the last [`stop`](Self::stop), and still answers. Without
    /// threads of its own a device has done so when `stop` returned.
    ///
    /// # Errors
    /// [`DeviceError`] names a part of the hardware that does not execute it.
    fn has_stopped(&mut self) -> Result<bool, DeviceError> {
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::AxisLimits;

    use super::*;

    #[test]
    fn an_array_has_mirrors_and_parks_within_its_limits() {
        let limits = AxisLimits { min_rad: 0.125, max_rad: 0.5, ..AxisLimits::default() };
        let of = |rows: u32, park_rad: [f32; 2]| {
            let (roll, yaw) = (limits, limits);
            check_capabilities(&Capabilities { rows, columns: 2, roll, yaw, park_rad, ..Capabilities::default() })
        };
        assert_eq!(of(1, [0.125, 0.5]), Ok(()));
        assert_eq!(of(0, [0.125, 0.5]), Err(CapabilitiesError::NoMirrors));
        let outside = of(1, [0.25, 0.0]).expect_err("outside").to_string();
        assert_eq!(outside, "park_rad, yaw = 0: expected an angle within the limits of yaw, 0.125 to 0.5 rad");
    }
}
