//! A device in memory that checks each call: angles within its range, and no motion while stopped.

use heliostat_array::moment::Moment;
use heliostat_array::{Device, DeviceError};
use heliostat_channel::MirrorAngles;
use heliostat_proto::{AxisLimits, Capabilities, ValidityClock};

use crate::forge::example_of;

/// Largest angle of the hardware in rad; the capabilities announce less, for calibrations.
const TRAVEL_RAD: f64 = 0.75;

/// Tolerance for angles in single precision, in rad.
const ROUNDING_RAD: f64 = 1e-5;

#[derive(Clone, Debug)]
pub struct BenchDevice {
    capabilities: Capabilities,
    measures: bool,
    angles: MirrorAngles,
    /// Whether calls fail from now on.
    pub fails: bool,
    /// Whether no call has failed since the last connection.
    pub is_connected: bool,
    /// Calls that turned the mirrors.
    pub moves: u64,
    /// Calls that turned the mirrors after the last successful stop.
    pub moves_since_stop: u64,
}

impl BenchDevice {
    pub fn new(clock: ValidityClock, measures: bool) -> Self {
        let axis = AxisLimits { min_rad: -0.5, max_rad: 0.5, ..AxisLimits::default() };
        let capabilities =
            Capabilities { roll: axis, yaw: axis, validity_clock: clock, ..example_of::<Capabilities>() };
        let angles = MirrorAngles::flat(capabilities.mirrors());
        Self { capabilities, measures, angles, fails: false, is_connected: false, moves: 0, moves_since_stop: 0 }
    }

    fn answer(&mut self) -> Result<(), DeviceError> {
        self.is_connected &= !self.fails;
        if self.fails { Err(DeviceError::new("bench", "does not answer")) } else { Ok(()) }
    }
}

impl Device for BenchDevice {
    fn capabilities(&self) -> Capabilities {
        self.capabilities.clone()
    }

    fn travel_rad(&self) -> [[f64; 2]; 2] {
        [[-TRAVEL_RAD, TRAVEL_RAD]; 2]
    }

    fn connect(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.answer()?;
        self.is_connected = true;
        Ok(())
    }

    fn apply(&mut self, _now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError> {
        self.answer()?;
        let mirrors = self.capabilities.mirrors();
        assert_eq!([angles.roll.len(), angles.yaw.len()], [mirrors; 2], "the device has {mirrors} mirrors");
        for angle in angles.roll.iter().chain(&angles.yaw) {
            assert!(angle.abs() <= TRAVEL_RAD + ROUNDING_RAD, "{angle} rad is beyond the range of the device");
        }
        self.angles.clone_from(angles);
        self.moves += 1;
        self.moves_since_stop += 1;
        Ok(())
    }

    fn measure(&mut self, _now: Moment, into: &mut MirrorAngles) -> Result<bool, DeviceError> {
        self.answer()?;
        into.clone_from(&self.angles);
        Ok(self.measures)
    }

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.answer()?;
        self.moves_since_stop = 0;
        Ok(())
    }
}
