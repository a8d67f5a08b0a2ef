//! What arrives for an array, between the transport's thread and the driver's: stamped, decoded, in order, never without bound.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use heliostat_array::content::Content;
use heliostat_array::moment::Moment;

/// Most arrivals of each urgency that wait; beyond it the oldest is shed.
const CAPACITY: usize = 256;

/// One payload.
#[derive(Clone, Debug)]
pub struct Arrival {
    /// When it came in, before it was decoded.
    pub at: Moment,
    /// What it holds.
    pub content: Content,
}

/// A bounded queue of arrivals; an emergency stop overtakes the rest, and a flood of commands cannot push it out.
#[derive(Debug, Default)]
pub struct Inbox {
    queue: Mutex<Queue>,
    filled: Condvar,
}

#[derive(Debug, Default)]
struct Queue {
    stops: VecDeque<Arrival>,
    others: VecDeque<Arrival>,
    shed: u64,
}

impl Queue {
    fn pop(&mut self) -> Option<Arrival> {
        self.stops.pop_front().or_else(|| self.others.pop_front())
    }
}

impl Inbox {
    /// Takes a payload as it comes in; called on the transport's thread.
    pub fn push(&self, at: Moment, content: Content) {
        let mut queue = self.lock();
        let Queue { stops, others, shed } = &mut *queue;
        let line = if matches!(content, Content::Stop(_)) { stops } else { others };
        if line.len() == CAPACITY {
            line.pop_front();
            *shed += 1;
        }
        line.push_back(Arrival { at, content });
        drop(queue);
        self.filled.notify_one();
    }

    /// The next arrival, if any.
    pub fn pop(&self) -> Option<Arrival> {
        self.lock().pop()
    }

    /// The next arrival, waiting for one until `deadline`.
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
    use heliostat_proto::{EmergencyStop, MirrorCommand};

    use super::*;

    fn command() -> Content {
        Content::Command(Ok(MirrorCommand::default()))
    }

    #[test]
    fn keeps_order_sheds_the_oldest_and_lets_a_stop_overtake() {
        let inbox = Inbox::default();
        inbox.push(Moment::simulated(0), command());
        inbox.push(Moment::simulated(0), Content::Stop(Ok(EmergencyStop::default())));
        for i in 1..CAPACITY as u64 + 3 {
            inbox.push(Moment::simulated(i), command());
        }
        assert_eq!(inbox.shed(), 3);
        assert!(matches!(inbox.pop().unwrap().content, Content::Stop(_)));
        assert_eq!(inbox.pop().unwrap().at, Moment::simulated(3));
    }

    #[test]
    fn waits_until_the_deadline_and_not_longer() {
        let inbox = Inbox::default();
        assert!(inbox.pop_until(Instant::now() + Duration::from_millis(5)).is_none());
        std::thread::scope(|scope| {
            scope.spawn(|| inbox.push(Moment::simulated(1), command()));
            assert!(inbox.pop_until(Instant::now() + Duration::from_secs(30)).is_some());
        });
    }
}
