//! What drivers and operators say besides telemetry: capabilities, emergency stop, calibration.

use serde::{Deserialize, Serialize};

use crate::Kind;
use crate::error::CodecError;
use crate::messages::{Stamp, check_mirrors};

/// What one axis of every mirror can do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AxisLimits {
    /// Smallest angle in rad, mechanical.
    pub min_rad: f32,
    /// Largest angle in rad, mechanical.
    pub max_rad: f32,
    /// Fastest turn in rad/s; 0 where unknown.
    pub slew_rad_s: f32,
    /// Time in s from a small step until the mirror stays near its end; 0 where unknown.
    pub settling_s: f32,
    /// Smallest step in rad; 0 where unknown.
    pub resolution_rad: f32,
}

/// Whether the hardware knows where its mirrors are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Feedback {
    /// It does not measure: telemetry has no measured angles.
    #[default]
    OpenLoop,
    /// It measures each angle.
    ClosedLoop,
}

/// From which moment a driver counts the validity of a command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ValidityClock {
    /// From the command's own time, with clocks synchronised to UTC.
    #[default]
    SourceTime,
    /// From its arrival, since the driver has no such clock; it cannot tell a delayed command.
    Arrival,
}

/// What an array is and can do; announced when its driver starts, every second after that, and on request.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Capabilities {
    /// Source, sequence, time.
    pub stamp: Stamp,
    /// Maker and model of the hardware.
    pub hardware: String,
    /// Name and version of the driver.
    pub driver: String,
    /// Rows of mirrors; row 0 is the lowest.
    pub rows: u32,
    /// Columns of mirrors; mirror index = row * columns + column.
    pub columns: u32,
    /// Limits of roll.
    pub roll: AxisLimits,
    /// Limits of yaw.
    pub yaw: AxisLimits,
    /// Open or closed loop.
    pub feedback: Feedback,
    /// How validity is counted.
    pub validity_clock: ValidityClock,
    /// Commands a second that it can follow; 0 where unknown.
    pub command_rate_max_hz: f32,
    /// How long in ms the mirrors hold after validity ended, before they park.
    pub park_after_ms: u32,
    /// Roll and yaw of the park position in rad.
    pub park_rad: [f32; 2],
}

impl Capabilities {
    /// Number of mirrors.
    pub fn mirrors(&self) -> usize {
        (self.rows as usize).saturating_mul(self.columns as usize)
    }

    /// Whether the array has so many mirrors.
    ///
    /// # Errors
    /// [`CodecError::WrongMirrors`].
    pub fn check_mirrors(&self, wanted: usize) -> Result<(), CodecError> {
        check_mirrors(Kind::Capabilities, self.mirrors(), wanted)
    }
}

/// What an operator orders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum StopAction {
    /// Stop at once, and refuse commands from now on.
    #[default]
    Stop,
    /// Follow commands again.
    Rearm,
}

/// Stops an array, or allows it to move again. The stop is latched: only a later re-arm ends it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EmergencyStop {
    /// Source, sequence, time. A re-arm counts only when its time is later than that of the last stop.
    pub stamp: Stamp,
    /// Stop or re-arm.
    pub action: StopAction,
    /// Who orders it.
    pub operator: String,
    /// Why.
    pub reason: String,
}

/// Corrects each mirror's mounting: the device is set to `gain * angle + offset`, mirror by mirror and axis by axis.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Source, sequence, time; telemetry names the sequence in use.
    pub stamp: Stamp,
    /// Offset of roll in rad, one a mirror.
    pub roll_offset_rad: Vec<f32>,
    /// Gain of roll, one a mirror; 1 is none.
    pub roll_gain: Vec<f32>,
    /// Offset of yaw in rad, one a mirror.
    pub yaw_offset_rad: Vec<f32>,
    /// Gain of yaw, one a mirror; 1 is none.
    pub yaw_gain: Vec<f32>,
}

impl Calibration {
    /// Whether the calibration is for an array of so many mirrors.
    ///
    /// # Errors
    /// [`CodecError::WrongMirrors`].
    pub fn check_mirrors(&self, wanted: usize) -> Result<(), CodecError> {
        check_mirrors(Kind::Calibration, self.roll_offset_rad.len(), wanted)
    }
}
