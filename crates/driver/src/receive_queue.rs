//! The bounded queue of messages for an array, between the transport's thread and the driver's.

use std::sync::{Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use heliostat_array::Waker;
use heliostat_array::arrivals::{Arrival, Arrivals};
use heliostat_array::content::Content;
use heliostat_array::moment::Moment;
use heliostat_array::watch::IsStop;
use heliostat_proto::MirrorCommand;
use heliostat_service::locks::{lock, unpoisoned};

/// Epochs whose commands are known as passed on: a copy can arrive after a controller has begun the next.
const EPOCHS: usize = 4;

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
    /// The last epochs of the commands that this process has passed on itself, the latest first, each with its
    /// last sequence number.
    passed_on: [Option<(u64, u64)>; EPOCHS],
}

impl ReceiveQueue {
    /// Adds a message; called on the transport's thread.
    pub fn push(&self, at: Moment, content: Content) {
        let is_stop = content.is_stop();
        let mut queue = self.lock();
        if queue.is_passed_on(&content) {
            return;
        }
        queue.arrivals.push(at, content);
        let on_stop = queue.on_stop.clone().filter(|_| is_stop);
        drop(queue);
        self.filled.notify_one();
        if let Some(on_stop) = on_stop {
            on_stop.wake();
        }
    }

    /// Notes a command that a controller in this process passes on without the transport. Its copy
    /// from the transport is no arrival. Returns whether no message waits.
    pub fn pass_on(&self, command: &MirrorCommand) -> bool {
        let mut queue = self.lock();
        if queue.passed_on[0].is_none_or(|(epoch, _)| epoch != command.epoch) {
            queue.passed_on.rotate_right(1);
        }
        queue.passed_on[0] = Some((command.epoch, command.sequence));
        queue.arrivals.is_empty()
    }

    /// Adds a command that was [passed on](Self::pass_on).
    pub fn push_passed_on(&self, at: Moment, command: MirrorCommand) {
        self.lock().arrivals.push(at, Content::Command(Ok(command)));
        self.filled.notify_one();
    }

    /// The driver ends: commands are no messages any more.
    pub fn end(&self) {
        self.lock().arrivals.end();
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
            queue = unpoisoned(self.filled.wait_timeout(queue, left)).0;
        }
    }

    /// Waits until a message is there, until `deadline`, or until it is woken.
    pub fn wait_until(&self, deadline: Instant) {
        let mut queue = self.lock();
        while queue.arrivals.is_empty() && !std::mem::take(&mut queue.is_woken) {
            let left = deadline.saturating_duration_since(Instant::now());
            if left == Duration::ZERO {
                return;
            }
            queue = unpoisoned(self.filled.wait_timeout(queue, left)).0;
        }
    }

    /// Whether a stop waits for which this holds.
    pub fn has_stop(&self, is_stop: IsStop<'_>) -> bool {
        self.lock().arrivals.has_stop(is_stop)
    }

    /// Whether no message waits.
    pub fn is_empty(&self) -> bool {
        self.lock().arrivals.is_empty()
    }

    /// Messages that were dropped because the queue was full.
    pub fn dropped(&self) -> u64 {
        self.lock().arrivals.dropped()
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        // The queue is consistent between two operations, so a panic of another thread does not
        // corrupt it.
        lock(&self.queue)
    }
}

impl Queue {
    /// Whether the message is the copy of a command that this process has passed on.
    fn is_passed_on(&self, content: &Content) -> bool {
        let Content::Command(Ok(command)) = content else { return false };
        let mut passed_on = self.passed_on.iter().flatten();
        passed_on.any(|(epoch, sequence)| command.epoch == *epoch && command.sequence <= *sequence)
    }
}

#[cfg(test)]
mod tests {
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
            assert!(queue.pop_until(Instant::now() + Duration::from_secs(60)).is_some());
        });
    }

    #[test]
    fn the_copy_of_a_command_that_was_passed_on_is_no_arrival() {
        let queue = ReceiveQueue::default();
        let numbered = |epoch, sequence| MirrorCommand { epoch, sequence, ..MirrorCommand::default() };
        assert!(queue.pass_on(&numbered(5, 8)));
        for (epoch, sequence) in [(5, 7), (5, 8), (5, 9), (6, 1), (4, 9)] {
            queue.push(Moment::simulated(sequence), Content::Command(Ok(numbered(epoch, sequence))));
        }
        assert!(!queue.pass_on(&numbered(5, 9)), "commands of other controllers wait");
        let kept = || -> Vec<u64> { std::iter::from_fn(|| queue.pop()).map(|arrival| arrival.at.local_ns).collect() };
        assert_eq!(kept(), [9, 1, 9]);
        queue.pass_on(&numbered(6, 1));
        queue.push(Moment::simulated(1), Content::Command(Ok(numbered(5, 9))));
        assert_eq!(kept(), [0; 0], "a late copy of the former epoch");
    }
}
