//! The messages that arrive for an array.

use heliostat_proto::{Calibration, CodecError, EmergencyStop, MirrorCommand, Rearm};

/// A decoded payload, or the error of its decoding.
#[derive(Clone, Debug)]
pub enum Content {
    /// From the command key.
    Command(Result<MirrorCommand, CodecError>),
    /// From the key of the emergency stop.
    Stop(Result<EmergencyStop, CodecError>),
    /// From the key of the re-arm.
    Rearm(Result<Rearm, CodecError>),
    /// From the key of the calibration.
    Calibration(Result<Calibration, CodecError>),
}
