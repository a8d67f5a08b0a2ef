//! The queue to the disk, bounded by its messages and by their bytes: a sender can publish messages of megabytes.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

/// Most messages that wait.
const MESSAGES_MAX: usize = 16_384;
/// Most bytes of keys and payloads that wait.
const BYTES_MAX: usize = 256 << 20;

/// What both ends count.
#[derive(Debug, Default)]
struct Counts {
    bytes: AtomicUsize,
    dropped: AtomicU64,
}

/// The end that takes what arrives.
#[derive(Debug)]
pub(super) struct QueueSender<T> {
    entries: SyncSender<(usize, T)>,
    counts: Arc<Counts>,
}

/// The end of the writer.
#[derive(Debug)]
pub(super) struct Queue<T> {
    entries: Receiver<(usize, T)>,
    counts: Arc<Counts>,
}

/// An empty queue.
pub(super) fn bounded<T>() -> (QueueSender<T>, Queue<T>) {
    let ((sender, receiver), counts) = (sync_channel(MESSAGES_MAX), Arc::<Counts>::default());
    (QueueSender { entries: sender, counts: Arc::clone(&counts) }, Queue { entries: receiver, counts })
}

impl<T> Clone for QueueSender<T> {
    fn clone(&self) -> Self {
        Self { entries: self.entries.clone(), counts: Arc::clone(&self.counts) }
    }
}

impl<T> QueueSender<T> {
    /// Adds an entry of so many bytes, which is made only if it has a place. One without a place is dropped and counted.
    pub fn put(&self, bytes: usize, entry: impl FnOnce() -> T) {
        let Counts { bytes: waiting, dropped } = &*self.counts;
        let has_place = waiting.fetch_add(bytes, Ordering::Relaxed) + bytes <= BYTES_MAX;
        if !has_place || self.entries.try_send((bytes, entry())).is_err() {
            waiting.fetch_sub(bytes, Ordering::Relaxed);
            dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl<T> Queue<T> {
    /// The next entry; waits for it, at most so long.
    ///
    /// # Errors
    /// There is none.
    pub fn take(&self, limit: Duration) -> Result<T, RecvTimeoutError> {
        let (bytes, entry) = self.entries.recv_timeout(limit)?;
        self.counts.bytes.fetch_sub(bytes, Ordering::Relaxed);
        Ok(entry)
    }

    /// Entries that were dropped.
    pub fn dropped(&self) -> u64 {
        self.counts.dropped.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_long_messages_fill_the_queue_as_many_short_ones_do() {
        let (sender, queue) = bounded();
        for _ in 0..3 {
            sender.put(BYTES_MAX / 2, || ());
        }
        assert_eq!(queue.dropped(), 1);
        assert!(queue.take(Duration::ZERO).is_ok());
        sender.put(BYTES_MAX / 2, || ());
        assert_eq!(queue.dropped(), 1, "a place is free again");
        while queue.take(Duration::ZERO).is_ok() {}
        (0..=MESSAGES_MAX).for_each(|_| sender.put(0, || ()));
        assert_eq!(queue.dropped(), 2);
    }
}
