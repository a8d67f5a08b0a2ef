//! Drivers from outside: devices, the kit and stops.

use std::time::{Duration, Instant};

mod claim;
mod conformance;
mod devices;
mod direct_commands;
#[cfg(unix)]
mod servo_board;
mod servo_board_document;
mod stop_record;
mod stops;

/// Longest wait for something that happens soon.
const LIMIT: Duration = Duration::from_secs(60);

/// Waits until a value is there.
fn until<T>(what: &str, mut find: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        match find() {
            Some(found) => return found,
            None => assert!(begun.elapsed() < LIMIT, "{what} has not come"),
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Waits until a condition holds.
fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    until(what, || is_so().then_some(()));
}
