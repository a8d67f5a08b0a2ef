//! What the tests across processes share: the built programs as processes, and a witness who hears what a room says.
//!
//! Nothing here reaches into a process: tests see what a driver, a viewer or a person at the terminal would see.

mod browser;
mod process;
mod witness;

pub use browser::Browser;
pub use process::{Process, programs};
pub use witness::Witness;

use std::time::{Duration, Instant};

/// How long anything may take that takes a fraction of a second on an idle machine.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// Waits until `true`, or panics with the name of what was waited for.
pub fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !is_so() {
        assert!(Instant::now() < deadline, "waited {} s in vain: {what}", PATIENCE.as_secs());
        std::thread::sleep(Duration::from_millis(10));
    }
}
