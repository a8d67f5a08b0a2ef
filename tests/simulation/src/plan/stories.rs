//! Faults that belong together: a random plan would seldom combine them.

use rand::RngExt;

use super::{Attack, DeviceFault, DiskAfterCrash, Fault, RearmBy, Role, Setup, Timed};
use crate::random::Rng;

/// Draws one of the stories.
pub(super) fn draw(setup: &Setup, rng: &mut Rng) -> Vec<Timed> {
    let at_ms = rng.random_range(2000..4000);
    let array = rng.random_range(0..setup.arrays);
    let after = |after_ms: u64, for_ms: u64, fault: Fault| Timed { at_ms: at_ms + after_ms, for_ms, fault };
    let host = Role::Array(array);
    match rng.random_range(0..10) {
        // A stop that cannot be recorded, and a restart.
        0 => vec![
            after(0, 600, Fault::DiskFull { array }),
            after(200, 0, Fault::Stop),
            after(400, rng.random_range(100..500), Fault::Crash { host, disk: DiskAfterCrash::Kept }),
        ],
        // A record that is gone.
        1 => {
            let disk = if rng.random_bool(0.5) { DiskAfterCrash::Lost } else { DiskAfterCrash::Torn };
            vec![after(0, 0, Fault::Stop), after(rng.random_range(3..300), 300, Fault::Crash { host, disk })]
        }
        // An operator who does not reach an array.
        2 => {
            let pairs = vec![(host, Role::Operator)];
            vec![
                after(0, 1500, Fault::Partition { pairs, holds: rng.random_bool(0.5) }),
                after(300, 0, Fault::Stop),
                after(1000, 0, Fault::Rearm(RearmBy::Name)),
            ]
        }
        // A device that does not stop.
        3 => {
            let how = [DeviceFault::Fails, DeviceFault::Blocks, DeviceFault::RefusesStops, DeviceFault::Silent];
            vec![
                after(0, 2000, Fault::Device { array, how: how[rng.random_range(0..4)] }),
                after(300, 0, Fault::Stop),
                after(rng.random_range(600..2500), 0, Fault::Rearm(RearmBy::Name)),
            ]
        }
        // Two stops, of which one is released.
        4 => vec![
            after(0, 10, Fault::Attack(Attack::ForeignStop)),
            after(300, 0, Fault::Stop),
            after(700, 0, Fault::Rearm(RearmBy::Name)),
        ],
        // Orders that arrive twice and in another order.
        5 => vec![
            after(0, 3000, Fault::Duplicate { from: Role::Operator, to: host, per_mille: 1000 }),
            after(0, 3000, Fault::Reorder { from: Role::Operator, to: host, ms: 250 }),
            after(100, 0, Fault::Stop),
            after(500, 0, Fault::Rearm(RearmBy::Name)),
            after(rng.random_range(550..800), 0, Fault::Stop),
            after(rng.random_range(800..2000), 0, Fault::Rearm(RearmBy::Name)),
        ],
        // An array that is absent when the room is stopped.
        6 => vec![
            after(0, 800, Fault::Crash { host, disk: DiskAfterCrash::Kept }),
            after(200, 0, Fault::Stop),
            after(1500, 0, Fault::Rearm(RearmBy::Time)),
        ],
        // A re-arm by time from a clock that was set back.
        7 => vec![
            after(0, 0, Fault::Stop),
            after(100, 1200, Fault::ClockStep { host: Role::Operator, ms: -3_600_000 }),
            after(500, 0, Fault::Rearm(RearmBy::Time)),
        ],
        // A leader that hangs.
        8 => vec![after(0, 2500, Fault::Freeze { host: Role::Controller(0) })],
        // Commands that arrive twice and in another order.
        _ => vec![
            after(0, 1500, Fault::Duplicate { from: Role::Controller(0), to: host, per_mille: 500 }),
            after(500, 1500, Fault::Reorder { from: Role::Controller(0), to: host, ms: 60 }),
        ],
    }
}
