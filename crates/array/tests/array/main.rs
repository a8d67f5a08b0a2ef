//! The states of an array from outside, without a transport.

use heliostat_array::bounds::Bounds;
use heliostat_array::moment::Moment;
use heliostat_array::rules::Limits;
use heliostat_proto::ValidityClock;

mod bounds;
mod kit;
mod rules;
mod station;
mod stops;

const MS: u64 = 1_000_000;

/// Any UTC; local time starts at another value, so that a mix of the two fails.
const UTC: u64 = 1_800_000_000_000_000_000;

fn at(ms: u64) -> Moment {
    Moment { local_ns: ms * MS, room_ns: UTC + ms * MS }
}

/// Limits of an array that counts validity from the time of a command.
fn limits(mirrors: usize) -> Limits {
    Limits {
        mirrors,
        roll_rad: [-0.5, 0.5],
        yaw_rad: [-0.5, 0.5],
        park_rad: [0.0, 0.0],
        hold_ns: 300 * MS,
        clock: ValidityClock::SourceTime,
        bounds: Bounds::default(),
    }
}
