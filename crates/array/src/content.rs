//! The messages that arrive for an array.

use heliostat_proto::{Calibration, CodecError, EmergencyStop, MirrorCommand, Rearm, StopAction, StopRepetition};

/// A decoded payload, or the error of its decoding.
#[derive(Clone, Debug)]
pub enum Content {
    /// From the command key.
    Command(Result<MirrorCommand, CodecError>),
    /// From the key of the emergency stop.
    Stop(Result<EmergencyStop, CodecError>),
    /// From the key of the array's stop repetitions.
    Repetition(Result<StopRepetition, CodecError>),
    /// From the key of the re-arm.
    Rearm(Result<Rearm, CodecError>),
    /// From the key of the calibration.
    Calibration(Result<Calibration, CodecError>),
}

impl Content {
    /// Whether the message stops the array.
    pub fn is_stop(&self) -> bool {
        match self {
            Self::Stop(Ok(order)) => order.action == StopAction::Stop,
            Self::Repetition(Ok(_)) => true,
            _ => false,
        }
    }

    /// Whether the message came under the key of the commands.
    pub fn is_command(&self) -> bool {
        matches!(self, Self::Command(_))
    }

    /// Whether the message has a key on which stops arrive.
    pub fn concerns_stops(&self) -> bool {
        matches!(self, Self::Stop(_) | Self::Repetition(_))
    }
}
