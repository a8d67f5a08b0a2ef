//! Waiting with a time limit.

use std::time::{Duration, Instant};

/// Time limit for an event that takes a fraction of a second on an idle machine. It ends a test whose
/// event never happens; a busy machine stays far below it.
const TIME_LIMIT: Duration = Duration::from_secs(120);

/// Waits until the condition is true.
///
/// # Panics
/// When it is not within the time limit; the message names the event.
pub fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + TIME_LIMIT;
    while !is_so() {
        assert!(Instant::now() < deadline, "{what}: not within {} s", TIME_LIMIT.as_secs());
        std::thread::sleep(Duration::from_millis(10));
    }
}
