//! Which reports went out when, and when each was answered.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::rows::Times;

/// Shared by whoever sends and the callbacks that bring the answers.
#[derive(Clone)]
pub struct Board(Arc<(Mutex<Inner>, Condvar)>);

struct Inner {
    /// When each report was due, from tick 1 on; none once it is answered.
    waiting: Vec<Option<Instant>>,
    times: Times,
}

impl Default for Board {
    fn default() -> Self {
        Self(Arc::new((Mutex::new(Inner { waiting: Vec::new(), times: Times::new() }), Condvar::new())))
    }
}

impl Board {
    /// A report goes out; ticks count from 1 without gaps.
    pub fn sent(&self, tick: u64, due: Instant) {
        let mut inner = self.lock();
        debug_assert_eq!(inner.waiting.len() as u64 + 1, tick);
        inner.waiting.push(Some(due));
    }

    /// An answer arrived; only the first to each report counts.
    pub fn answered(&self, tick: u64, arrived: Instant) {
        let mut inner = self.lock();
        let due = tick.checked_sub(1).and_then(|index| inner.waiting.get_mut(index as usize)).and_then(Option::take);
        if let Some(due) = due {
            inner.times.record(arrived.saturating_duration_since(due));
        }
        drop(inner);
        self.0.1.notify_one();
    }

    /// Waits until a report is answered; false where that takes longer than `limit`.
    pub fn wait(&self, tick: u64, limit: Duration) -> bool {
        let deadline = Instant::now() + limit;
        let mut inner = self.lock();
        loop {
            if inner.waiting.get(tick as usize - 1).is_none_or(Option::is_none) {
                return true;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            inner = self.0.1.wait_timeout(inner, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Forgets what was measured; reports that still wait will not count as lost.
    pub fn begin(&self) {
        let mut inner = self.lock();
        inner.times = Times::new();
        inner.waiting.iter_mut().for_each(|due| *due = None);
    }

    /// What was measured, and how many reports were never answered; each of those is among the times with `lost_after`.
    pub fn take(&self, lost_after: Duration) -> (Times, u64) {
        let mut inner = self.lock();
        let lost = inner.waiting.iter().flatten().count() as u64;
        (0..lost).for_each(|_| inner.times.record(lost_after));
        (std::mem::replace(&mut inner.times, Times::new()), lost)
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.0.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_matched_out_of_order_once_each() {
        let board = Board::default();
        let due = Instant::now();
        (1..=4).for_each(|tick| board.sent(tick, due));
        for tick in [3, 1, 1, 99, 0] {
            board.answered(tick, due + Duration::from_micros(tick));
        }
        assert!(board.wait(3, Duration::ZERO) && !board.wait(2, Duration::ZERO));
        let (times, lost) = board.take(Duration::from_millis(500));
        assert_eq!((times.count(), lost), (4, 2));
        assert_eq!(times.over(Duration::from_millis(400)), 2, "who was never answered waited long");
    }

    #[test]
    fn what_was_before_the_beginning_does_not_count() {
        let board = Board::default();
        board.sent(1, Instant::now());
        board.begin();
        board.answered(1, Instant::now());
        let (times, lost) = board.take(Duration::from_millis(500));
        assert_eq!((times.count(), lost), (0, 0));
    }
}
