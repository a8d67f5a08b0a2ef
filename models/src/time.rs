//! The time source of policies with a time budget.

use std::{sync::OnceLock, time::Instant};

/// Monotonic time in ns since the first call: the time source of policies with a time budget.
pub fn monotonic_ns() -> u64 {
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_nanos() as u64
}
