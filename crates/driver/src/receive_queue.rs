//! The bounded queue of messages for an array, between the transport's thread and the driver's.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use heliostat_array::Waker;
use heliostat_array::arrivals::{Arrival, Arrivals};
use heliostat_array::content::Content;
use heliostat_array::moment::Moment;

/// [`Arrivals`] for two threads.
#[derive(Debug, Default)]
pub struct ReceiveQueue {
    queue: Mutex<Queue>,
    filled: Condvar,
}

#[derive(Debug, Default)]
struct Queue {
    arrivals: Arrivals,
    /// A wait ends although no message has arrived.
    is_woken: bool,
    /// Called after a stop has arrived, for a thread that waits for several queues.
    on_stop: Option<Waker>,
}

impl ReceiveQueue {
    /// Adds a message; called on the transport's thread.
    pub fn push(&self, at: Moment, content: Content) {
        let is_stop = content.is_stop();
        let mut queue = self.lock();
        queue.arrivals.push(at, content);
        let on_stop = queue.on_stop.clone().filter(|_| is_stop);
        drop(queue);
        self.filled.notify_one();
        if let Some(on_stop) = on_stop {
            on_stop.wake();
        }
    }

    /// Ends the present or the next wait for a message.
    pub fn wake(&self) {
        self.lock().is_woken = true;
        self.filled.notify_one();
    }

    /// Sets what is called after a stop has arrived.
    pub fn set_on_stop(&self, waker: Waker) {
        self.lock().on_stop = Some(waker);
    }

    /// The next message, if any.
    pub fn pop(&self) -> Option<Arrival> {
        self.lock().arrivals.pop()
    }

    /// The next message; waits for one until `deadline`, or until it is woken.
    pub fn pop_until(&self, deadline: Instant) -> Option<Arrival> {
        let mut queue = self.lock();
        loop {
            if let Some(arrival) = queue.arrivals.pop() {
                return Some(arrival);
            }
            if std::mem::take(&mut queue.is_woken) {
                return None;
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
        self.lock().arrivals.dropped()
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
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
