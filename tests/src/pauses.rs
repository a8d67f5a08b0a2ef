//! Pauses of the machine: times in which a thread that wants to run does not.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Time between two measurements.
const INTERVAL: Duration = Duration::from_millis(10);

/// Measures the longest pause since its start, by a thread that sleeps for short times; dropping it ends the
/// thread.
///
/// A test of a time that the product promises is repeated after a pause, because the pause is no fault of
/// the product.
pub struct Pauses {
    longest_ms: Arc<AtomicU64>,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Pauses {
    /// Starts to measure.
    pub fn start() -> Self {
        let (longest_ms, ended) = (Arc::<AtomicU64>::default(), Arc::<AtomicBool>::default());
        let (longest, until) = (Arc::clone(&longest_ms), Arc::clone(&ended));
        let thread = thread::spawn(move || {
            while !until.load(Ordering::SeqCst) {
                let begun = Instant::now();
                thread::sleep(INTERVAL);
                let pause = begun.elapsed().saturating_sub(INTERVAL);
                longest.fetch_max(u64::try_from(pause.as_millis()).unwrap_or(u64::MAX), Ordering::SeqCst);
            }
        });
        Self { longest_ms, ended, thread: Some(thread) }
    }

    /// The longest pause so far.
    pub fn longest(&self) -> Duration {
        Duration::from_millis(self.longest_ms.load(Ordering::SeqCst))
    }
}

impl Drop for Pauses {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            // It does not panic.
            let _ = thread.join();
        }
    }
}
