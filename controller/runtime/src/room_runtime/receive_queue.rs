//! The bounded queue between the transport's callbacks and the room's thread.
//!
//! It holds at most `CAPACITY` payloads; beyond that the oldest is dropped. Buffers are reused,
//! so passing a payload on does not allocate once the buffers have grown.

use std::{
    collections::VecDeque,
    sync::{Condvar, Mutex},
    time::Instant,
};

use heliostat_core::room_core::InputChannel;
use heliostat_service::locks::{lock, unpoisoned};

/// Most payloads that wait.
const CAPACITY: usize = 64;

/// A buffer larger than this, in bytes, is freed after use.
const BUFFER_MAX: usize = 1 << 16;

/// One received payload.
pub struct Arrival {
    /// The stream to which it belongs.
    pub channel: InputChannel,
    /// The payload.
    pub payload: Vec<u8>,
    /// When the callback was entered.
    pub entered: Instant,
}

/// Payloads that wait for the room's thread.
#[derive(Default)]
pub struct ReceiveQueue {
    state: Mutex<State>,
    filled: Condvar,
}

#[derive(Default)]
struct State {
    waiting: VecDeque<Arrival>,
    spare: Vec<Vec<u8>>,
    dropped: u64,
    closed: bool,
}

impl ReceiveQueue {
    /// Appends a payload.
    pub fn push(&self, channel: impl Into<InputChannel>, payload: &[u8], entered: Instant) {
        let mut state = lock(&self.state);
        let oldest = if state.waiting.len() == CAPACITY { state.waiting.pop_front() } else { None };
        state.dropped += u64::from(oldest.is_some());
        let mut buffer = oldest.map(|arrival| arrival.payload).or_else(|| state.spare.pop()).unwrap_or_default();
        buffer.clear();
        buffer.extend_from_slice(payload);
        state.waiting.push_back(Arrival { channel: channel.into(), payload: buffer, entered });
        drop(state);
        self.filled.notify_one();
    }

    /// Takes the oldest payload.
    pub fn pop(&self) -> Option<Arrival> {
        lock(&self.state).waiting.pop_front()
    }

    /// Returns a payload's buffer for reuse.
    pub fn recycle(&self, buffer: Vec<u8>) {
        if buffer.capacity() <= BUFFER_MAX {
            lock(&self.state).spare.push(buffer);
        }
    }

    /// Whether no payload waits.
    pub fn is_empty(&self) -> bool {
        lock(&self.state).waiting.is_empty()
    }

    /// Payloads dropped because too many waited.
    pub fn dropped(&self) -> u64 {
        lock(&self.state).dropped
    }

    /// Ends the room's thread.
    pub fn close(&self) {
        lock(&self.state).closed = true;
        self.filled.notify_one();
    }

    /// Waits for a payload; false once the queue is closed.
    pub fn wait(&self) -> bool {
        let waits = |state: &mut State| state.waiting.is_empty() && !state.closed;
        !unpoisoned(self.filled.wait_while(lock(&self.state), waits)).closed
    }
}

#[cfg(test)]
mod tests {
    use heliostat_core::refusal::Stream;

    use super::*;

    #[test]
    fn the_oldest_payload_is_dropped_and_order_is_kept() {
        let queue = ReceiveQueue::default();
        let now = Instant::now();
        for index in 0..CAPACITY as u32 + 3 {
            queue.push(Stream::Users, &index.to_le_bytes(), now);
        }
        assert_eq!(queue.dropped(), 3);
        for index in 3..CAPACITY as u32 + 3 {
            assert_eq!(queue.pop().unwrap().payload, index.to_le_bytes());
        }
        assert!(queue.pop().is_none());
    }

    #[test]
    fn buffers_are_reused_unless_they_are_large() {
        let queue = ReceiveQueue::default();
        let mut buffer = Vec::with_capacity(1000);
        let place = buffer.as_ptr();
        buffer.push(1);
        queue.recycle(buffer);
        queue.recycle(Vec::with_capacity(2 * BUFFER_MAX));
        queue.push(Stream::Channel, b"abc", Instant::now());
        let arrival = queue.pop().unwrap();
        assert_eq!((arrival.payload.as_slice(), arrival.payload.as_ptr()), (&b"abc"[..], place));
        queue.push(Stream::Channel, b"abc", Instant::now());
        assert!(queue.pop().unwrap().payload.capacity() < BUFFER_MAX);
    }

    #[test]
    fn passing_payloads_on_does_not_allocate() {
        let queue = ReceiveQueue::default();
        let pass = || {
            (0..3).for_each(|_| queue.push(Stream::Users, &[7; 300], Instant::now()));
            while let Some(arrival) = queue.pop() {
                queue.recycle(arrival.payload);
            }
        };
        pass();
        pass();
        assert_eq!(allocation_counter::measure(pass).count_total, 0);
    }

    #[test]
    fn closing_the_queue_ends_a_wait() {
        let queue = ReceiveQueue::default();
        std::thread::scope(|scope| {
            scope.spawn(|| queue.close());
            assert!(!queue.wait());
        });
    }
}
