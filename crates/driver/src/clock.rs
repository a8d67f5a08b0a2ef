//! The clock of live operation: both times of a room.

use std::time::{Duration, Instant};

use heliostat_service::clock::{as_ns, utc_ns};

use heliostat_array::moment::Moment;

/// The clock of live operation.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    start: Instant,
}

impl Clock {
    /// Local time starts after `delay`: time to prepare what is due at its start.
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
