//! What arrives on the command key, between the transport's thread and the node's: stamped, decoded, in order, never without bound.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use heliostat_proto::{CodecError, MirrorCommand};

use crate::clock::Moment;

/// Most arrivals that wait; beyond it the oldest is shed.
const CAPACITY: usize = 256;

/// One payload from the command key.
#[derive(Clone, Debug)]
pub struct Arrival {
    /// When it came in, before it was decoded.
    pub at: Moment,
    /// The command, or what is wrong with the payload.
    pub content: Result<MirrorCommand, CodecError>,
}

/// A bounded queue of arrivals.
#[derive(Debug, Default)]
pub struct Inbox {
    queue: Mutex<Queue>,
    filled: Condvar,
}

#[derive(Debug, Default)]
struct Queue {
    arrivals: VecDeque<Arrival>,
    shed: u64,
}

impl Inbox {
    /// Takes a payload as it comes in; called on the transport's thread.
    pub fn push(&self, at: Moment, payload: &[u8]) {
        let content = heliostat_proto::decode(payload);
        let mut queue = self.lock();
        if queue.arrivals.len() == CAPACITY {
            queue.arrivals.pop_front();
            queue.shed += 1;
        }
        queue.arrivals.push_back(Arrival { at, content });
        drop(queue);
        self.filled.notify_one();
    }

    /// The oldest arrival, if any.
    pub fn pop(&self) -> Option<Arrival> {
        self.lock().arrivals.pop_front()
    }

    /// The oldest arrival, waiting for one until `deadline`.
    pub fn pop_until(&self, deadline: Instant) -> Option<Arrival> {
        let mut queue = self.lock();
        loop {
            if let Some(arrival) = queue.arrivals.pop_front() {
                return Some(arrival);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left == Duration::ZERO {
                return None;
            }
            queue = self.filled.wait_timeout(queue, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Arrivals that were shed because nobody took them.
    pub fn shed(&self) -> u64 {
        self.lock().shed
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        // A queue is whole between any two of its operations, so a panic elsewhere does not spoil it.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_order_and_sheds_the_oldest() {
        let inbox = Inbox::default();
        for i in 0..CAPACITY as u64 + 3 {
            inbox.push(Moment::simulated(i), b"no command");
        }
        assert_eq!(inbox.shed(), 3);
        assert_eq!(inbox.pop().unwrap().at, Moment::simulated(3));
        assert!(inbox.pop().unwrap().content.is_err());
    }

    #[test]
    fn waits_until_the_deadline_and_not_longer() {
        let inbox = Inbox::default();
        assert!(inbox.pop_until(Instant::now() + Duration::from_millis(5)).is_none());
        std::thread::scope(|scope| {
            scope.spawn(|| inbox.push(Moment::simulated(1), b""));
            assert!(inbox.pop_until(Instant::now() + Duration::from_secs(30)).is_some());
        });
    }
}
