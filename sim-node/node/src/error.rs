//! Why a run of the simulator fails.

use heliostat_array::calibration::Unfit;
use heliostat_bus::BusError;
use heliostat_driver::session::SessionError;
use heliostat_driver::stop_record::RecordInUse;
use heliostat_room::world::WorldError;
use heliostat_scenario::TraceFileError;
use heliostat_service::MetricsError;
use thiserror::Error;

/// Why a run cannot start or continue.
#[derive(Debug, Error)]
pub enum NodeError {
    /// The scenario describes no valid room.
    #[error(transparent)]
    World(#[from] WorldError),
    /// The recorded walk cannot be read.
    #[error(transparent)]
    Trace(#[from] TraceFileError),
    /// The transport failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Metrics cannot be served.
    #[error(transparent)]
    Metrics(#[from] MetricsError),
    /// The session of the array cannot be opened or used, or another process controls the room's
    /// mirrors.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Another process uses the record of an array's stop.
    #[error(transparent)]
    Record(#[from] RecordInUse),
    /// The corrections do not fit the array.
    #[error("the calibration does not fit the array")]
    Calibration(#[from] Unfit),
    /// Corrections for a room with several arrays.
    #[error(
        "a calibration is for one array, and the scenario has {arrays} ([[mirrors]]): leave --calibration out, \
         or publish a calibration for each array under its own key"
    )]
    CalibrationOfSeveral {
        /// Number of arrays.
        arrays: usize,
    },
    /// Lockstep: there is no controller.
    #[error(
        "no controller in room \"{room}\" within {waited_s} s: start one with --lockstep in the same room, \
         with a matching endpoint"
    )]
    NoController {
        /// Name of the room.
        room: String,
        /// The timeout in s.
        waited_s: u64,
    },
    /// Lockstep: a tick was not answered.
    #[error(
        "tick {tick} was not answered within {waited_s} s: start the controller with --lockstep, so that it uses \
         the room's time{last_problem}"
    )]
    NoAnswer {
        /// The tick.
        tick: u64,
        /// The timeout in s.
        waited_s: u64,
        /// The last problem, if there was one.
        last_problem: String,
    },
    /// The thread that publishes the truth panicked.
    #[error("the thread that publishes the truth panicked: report this as a bug, with the log")]
    TruthPublisherPanicked,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_printed_with_its_cause_once() {
        let unfit = Unfit::OldSequence { found: 1, used: 2 };
        let cause = unfit.to_string();
        let printed = format!("{:#}", anyhow::Error::from(NodeError::from(unfit)));
        assert_eq!(printed, format!("the calibration does not fit the array: {cause}"));
    }
}
