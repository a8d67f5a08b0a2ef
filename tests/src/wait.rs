//! Waiting with a time limit.

use std::time::{Duration, Instant};

/// Time limit for an event that takes a fraction of a second on an idle machine. It ends a test whose
/// event never happens; a busy machine stays far below it.
pub const TIME_LIMIT: Duration = Duration::from_secs(120);

/// Pause between two looks, as a share of the time since the first: a look can cost more than the event.
const PAUSE_SHARE: f64 = 0.05;
const SHORTEST_PAUSE: Duration = Duration::from_millis(10);
const LONGEST_PAUSE: Duration = Duration::from_millis(50);

/// Waits until the condition is true.
///
/// # Panics
/// When it is not within the time limit; the message names the event.
pub fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_so() {
        let waited = start.elapsed();
        assert!(waited < TIME_LIMIT, "{what}: not within {} s", TIME_LIMIT.as_secs());
        std::thread::sleep(waited.mul_f64(PAUSE_SHARE).clamp(SHORTEST_PAUSE, LONGEST_PAUSE));
    }
}
