//! Room time: UTC, or in lockstep the time of the reports.

use heliostat_proto::Nanos;
use heliostat_service::clock::utc_ns;

/// The source of room time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RoomClock {
    /// UTC.
    Utc,
    /// The time of the newest report: the room runs faster or slower than real time, and waits for
    /// the commands.
    Lockstep {
        /// Time of the newest report.
        newest_ns: Nanos,
    },
}

impl RoomClock {
    /// Room time at the arrival of a report of the given time.
    pub fn at_arrival(&mut self, report_ns: Nanos) -> Nanos {
        match self {
            Self::Utc => utc_ns(),
            Self::Lockstep { newest_ns } => {
                *newest_ns = report_ns.max(*newest_ns);
                *newest_ns
            }
        }
    }

    /// Room time now.
    pub fn now(&self) -> Nanos {
        match self {
            Self::Utc => utc_ns(),
            Self::Lockstep { newest_ns } => *newest_ns,
        }
    }
}
