//! The two times of a room, and the clocks that tell them.
//!
//! Room time stands in messages: UTC in live operation, simulated time in lockstep. Local time only ever moves forward and paces
//! the node. They are kept apart so that a wall clock that is set does not disturb pacing, watchdogs or latencies.

use std::time::{Duration, Instant};

use heliostat_service::clock::utc_ns;

/// One instant in both times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Moment {
    /// Monotonic time since the start of the node in ns.
    pub local_ns: u64,
    /// Room time in ns.
    pub room_ns: u64,
}

impl Moment {
    /// An instant of simulated time, where both times are the same.
    pub fn simulated(ns: u64) -> Self {
        Self { local_ns: ns, room_ns: ns }
    }
}

/// The clock of live operation.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    start: Instant,
}

impl Clock {
    /// Local time begins after `delay`, which leaves time to get ready for what is due at its beginning.
    pub fn start_in(delay: Duration) -> Self {
        Self { start: Instant::now() + delay }
    }

    /// Local time in ns; 0 before its beginning.
    pub fn local_ns(&self) -> u64 {
        as_ns(Instant::now().saturating_duration_since(self.start))
    }

    /// Both times.
    pub fn now(&self) -> Moment {
        Moment { local_ns: self.local_ns(), room_ns: utc_ns() }
    }

    /// The instant at which local time is `local_ns`.
    pub fn instant_at(&self, local_ns: u64) -> Instant {
        self.start + Duration::from_nanos(local_ns)
    }
}

/// A duration in whole nanoseconds; 584 years fit.
pub fn as_ns(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}
