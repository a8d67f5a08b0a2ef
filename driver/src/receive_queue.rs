//! The bounded queue of messages for an array, between the transport's thread and the driver's.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use heliostat_array::content::Content;
use heliostat_array::moment::Moment;
use heliostat_proto::StopAction;

/// Capacity for stops, and for all other messages; beyond it the oldest is dropped.
const CAPACITY: usize = 256;

/// A received message.
#[derive(Clone, Debug)]
pub struct Arrival {
    /// When it arrived, before it was decoded.
    pub at: Moment,
    /// Its content.
    pub content: Content,
}

/// A bounded queue in which emergency stops have priority, and commands cannot displace them.
#[derive(Debug, Default)]
pub struct ReceiveQueue {
    queue: Mutex<Queue>,
    filled: Condvar,
}

#[derive(Debug, Default)]
struct Queue {
    stops: VecDeque<Arrival>,
    others: VecDeque<Arrival>,
    dropped: u64,
}

impl Queue {
    fn pop(&mut self) -> Option<Arrival> {
        self.stops.pop_front().or_else(|| self.others.pop_front())
    }
}

impl ReceiveQueue {
    /// Adds a message; called on the transport's thread.
    pub fn push(&self, at: Moment, content: Content) {
        let mut queue = self.lock();
        let Queue { stops, others, dropped } = &mut *queue;
        let target = if matches!(content, Content::Stop(_)) { stops } else { others };
        let arrival = Arrival { at, content };
        if target.len() == CAPACITY {
            *dropped += 1;
            // Undecodable payloads and re-arms on the key of the stop must not displace a stop.
            let least = target.iter().position(|queued| !is_stop(queued));
            match least {
                Some(index) => drop(target.remove(index)),
                None if matches!(arrival.content, Content::Stop(_)) && !is_stop(&arrival) => return,
                None => drop(target.pop_front()),
            }
        }
        target.push_back(arrival);
        drop(queue);
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
        self.lock().dropped
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        // The queue is consistent between two operations, so a panic of another thread does not
        // corrupt it.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Whether the message stops the array.
fn is_stop(arrival: &Arrival) -> bool {
    matches!(&arrival.content, Content::Stop(Ok(order)) if order.action == StopAction::Stop)
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{EmergencyStop, MirrorCommand};

    use super::*;

    fn command() -> Content {
        Content::Command(Ok(MirrorCommand::default()))
    }

    #[test]
    fn keeps_order_drops_the_oldest_and_gives_stops_priority() {
        let queue = ReceiveQueue::default();
        queue.push(Moment::simulated(0), command());
        queue.push(Moment::simulated(0), Content::Stop(Ok(EmergencyStop::default())));
        for i in 1..CAPACITY as u64 + 3 {
            queue.push(Moment::simulated(i), command());
        }
        assert_eq!(queue.dropped(), 3);
        assert!(matches!(queue.pop().unwrap().content, Content::Stop(_)));
        assert_eq!(queue.pop().unwrap().at, Moment::simulated(3));
    }

    #[test]
    fn nothing_else_on_the_key_of_the_stop_displaces_a_stop() {
        let queue = ReceiveQueue::default();
        queue.push(Moment::simulated(0), Content::Stop(Ok(EmergencyStop::default())));
        let rearm = EmergencyStop { action: StopAction::Rearm, ..EmergencyStop::default() };
        for i in 1..2 * CAPACITY as u64 {
            queue.push(Moment::simulated(i), Content::Stop(Ok(rearm.clone())));
        }
        assert_eq!(queue.pop().expect("a message").at, Moment::simulated(0), "the stop is first in the queue");
        for i in 0..=CAPACITY as u64 {
            queue.push(Moment::simulated(i), Content::Stop(Ok(EmergencyStop::default())));
        }
        queue.push(Moment::simulated(9), Content::Stop(Ok(rearm)));
        let all: Vec<Arrival> = std::iter::from_fn(|| queue.pop()).collect();
        assert!(all.len() == CAPACITY && all.iter().all(is_stop), "a queue of stops admits no re-arm");
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
