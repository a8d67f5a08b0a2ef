//! What the tests of the rules share: a time, and an array.

use heliostat_array::bounds::Bounds;
use heliostat_array::moment::Moment;
use heliostat_array::rules::Limits;
use heliostat_proto::ValidityClock;

pub const MS: u64 = 1_000_000;
pub const HOLD_NS: u64 = 300 * MS;
/// Any UTC; local time starts at another value, so that a mix of the two fails.
pub const UTC: u64 = 1_800_000_000_000_000_000;

pub fn at(ms: u64) -> Moment {
    Moment { local_ns: ms * MS, room_ns: UTC + ms * MS }
}

pub fn limits(mirrors: usize, clock: ValidityClock) -> Limits {
    Limits {
        mirrors,
        roll_rad: [-0.5, 0.5],
        yaw_rad: [-0.5, 0.5],
        park_rad: [0.0, 0.0],
        hold_ns: HOLD_NS,
        clock,
        bounds: Bounds::default(),
    }
}
