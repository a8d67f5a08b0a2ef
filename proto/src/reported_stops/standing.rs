//! What an array does about the stops that are held for it.

use crate::limits::Nanos;

/// What an array does about the stops that are held for it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Standing {
    /// No stop is held for it.
    Free,
    /// It has latched every stop, and its device has executed them.
    Stopped,
    /// It has latched every stop, and its device has not executed them.
    Latched {
        /// Why, as the array reports it; may be empty.
        problem: String,
    },
    /// Several drivers serve it, and not each of them has latched every stop and stopped its device.
    Shared {
        /// Their number.
        drivers: usize,
        /// The sources of those that have not.
        open: Vec<u64>,
        /// Why, as they report it; may be empty.
        problem: String,
    },
    /// It has stopped by its reports, and a further driver of it was lost before it confirmed the stop.
    Lost {
        /// The sources of such drivers.
        drivers: Vec<u64>,
        /// Since when the first of them is lost, UTC in ns; known of those that a controller reports.
        since_ns: Option<Nanos>,
    },
    /// It has latched a stop; its driver publishes no stop reports.
    Unknown,
    /// It reports, and has not latched every stop.
    Moving,
    /// It does not report.
    Silent,
}

impl Standing {
    /// Whether the mirrors may move although a stop is held.
    pub fn is_open(&self) -> bool {
        !matches!(self, Self::Free | Self::Stopped)
    }
}
