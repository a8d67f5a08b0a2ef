//! The two times of a room.
//!
//! Messages contain room time: UTC in live operation, simulated time in lockstep. Local time is
//! monotonic and paces the process. They are separate, so that a step of the UTC clock does not
//! disturb pacing, watchdogs or latencies.

/// One instant in both times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Moment {
    /// Monotonic time since the start of the process in ns.
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
