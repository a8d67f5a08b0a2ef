//! The two clocks of a process: UTC for messages, monotonic time for intervals.

use std::sync::LazyLock;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// UTC in ns since 1970-01-01T00:00:00; 0 where the machine's clock is set before that.
pub fn utc_ns() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, as_ns)
}

/// Monotonic time in ns since the first call in this process; never steps back.
pub fn monotonic_ns() -> u64 {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    as_ns(START.elapsed())
}

/// A duration in whole ns; 584 years fit.
pub fn as_ns(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn utc_is_later_than_this_test_was_written() {
        assert!(utc_ns() > 1_760_000_000_000_000_000);
    }

    #[test]
    fn monotonic_time_grows_by_the_time_that_passes() {
        let begun = monotonic_ns();
        std::thread::sleep(Duration::from_millis(5));
        assert!(monotonic_ns() - begun >= 5_000_000);
    }
}
