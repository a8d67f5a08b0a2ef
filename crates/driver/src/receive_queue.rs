//! The bounded queue of messages for an array, between the transport's thread and the driver's.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use heliostat_array::arrivals::{Arrival, Arrivals};
use heliostat_array::content::Content;
use heliostat_array::moment::Moment;

/// [`Arrivals`] for two threads.
#[derive(Debug, Default)]
pub struct ReceiveQueue {
    queue: Mutex<Arrivals>,
    filled: Condvar,
}

impl ReceiveQueue {
    /// Adds a message; called on the transport's thread.
    pub fn push(&self, at: Moment, content: Content) {
        self.lock().push(at, content);
        self.filled.notify_one();
    }

    /// The next message, if any.
    pub fn pop(&self) -> Option<Arrival> {
        self.lock().pop()
    }

    /// The next message; waits for one until `deadline`.
    pub fn pop_until(&self, deadline: Instant) -> Option<Arrival> {
        let mut queue = self.lock();
        loop {
            if let Some(arrival) = queue.pop() {
                return Some(arrival);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left == Duration::ZERO {
                return None;
            }
            queue = self.filled.wait_timeout(queue, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Messages that were dropped because the queue was full.
    pub fn dropped(&self) -> u64 {
        self.lock().dropped()
    }

    fn lock(&self) -> MutexGuard<'_, Arrivals> {
        // The queue is consistent between two operations, so a panic of another thread does not
        // corrupt it.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::MirrorCommand;

    use super::*;

    fn command() -> Content {
        Content::Command(Ok(MirrorCommand::default()))
    }

    #[test]
    fn waits_until_the_deadline_at_the_latest() {
        let queue = ReceiveQueue::default();
        assert!(queue.pop_until(Instant::now() + Duration::from_millis(5)).is_none());
        std::thread::scope(|scope| {
            scope.spawn(|| queue.push(Moment::simulated(1), command()));
            assert!(queue.pop_until(Instant::now() + Duration::from_secs(30)).is_some());
        });
    }
}
