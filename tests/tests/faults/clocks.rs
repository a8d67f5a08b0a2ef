//! Clocks that jump while a process runs, or are wrong at its start.

use heliostat_needs::needs;
use heliostat_tests::faults::{Array, Effect, Launch, Setup, SystemClock};

use crate::{measure, wait_s};

/// Seconds.
const HOUR: i64 = 3600;

/// The effect of a jump of the clock of one process of the room for 3 s.
fn jump(clock: &SystemClock, array: Array, of: fn(&mut Setup) -> &mut Launch, seconds: i64) -> Effect {
    clock.shift(0);
    let mut setup = Setup::new(array);
    of(&mut setup).variables = clock.variables();
    setup.start().undergo(|_| {
        clock.shift(seconds);
        wait_s(3.0);
        clock.shift(0);
    })
}

#[needs("cc")]
#[test]
fn the_array_parks_while_the_clock_of_the_controller_is_1_h_ahead() {
    let clock = SystemClock::build();
    measure("the_array_parks_while_the_clock_of_the_controller_is_1_h_ahead", || {
        jump(&clock, Array::Simulated, |setup| &mut setup.of_controller, HOUR)
    });
}

#[needs("cc")]
#[test]
fn a_controller_that_started_a_day_ahead_can_be_replaced() {
    let clock = SystemClock::build();
    measure("a_controller_that_started_a_day_ahead_can_be_replaced", || {
        clock.shift(24 * HOUR);
        Setup::new(Array::Simulated).start().undergo(|room| {
            room.controller.kill();
            room.setup_mut().of_controller.variables = clock.variables();
            room.restart_controller();
            wait_s(1.5);
            clock.shift(0);
            // Its commands carry the right time, and an epoch of tomorrow.
            wait_s(1.5);
            room.controller.kill();
            room.restart_controller();
        })
    });
}
