//! The settings of a run.

use std::time::Duration;

use heliostat_array::calibration_file::CalibrationFile;
use heliostat_bus::BusConfig;
use heliostat_driver::stop_record::StopRecordSettings;
use heliostat_scenario::Scenario;
use heliostat_service::MetricsArgs;

/// The settings of a run.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The scenario of the room; its seed is the seed of the run.
    pub scenario: Scenario,
    /// The room's name and the endpoints of the session.
    pub bus: BusConfig,
    /// The time base of the room.
    pub pace: Pace,
    /// Where to serve metrics.
    pub metrics: MetricsArgs,
    /// The calibration of the array at the start.
    pub calibration: Option<CalibrationFile>,
    /// Where the emergency stop is kept over a restart; `None` for a room that starts parked and
    /// forgets a stop.
    pub record: Option<StopRecordSettings>,
}

/// The time base of the room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// In real time, for this duration or until stopped.
    Live {
        /// The duration; `None` for a run without end.
        duration: Option<Duration>,
    },
    /// In simulated time; each tick waits for its answer.
    Lockstep {
        /// Number of ticks.
        ticks: u64,
    },
}
