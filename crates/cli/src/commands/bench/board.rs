//! Due times of reports, and arrival times of the commands that answer them.

use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use heliostat_service::locks::{lock, unpoisoned};

use super::rows::Times;

/// Shared by the sending thread and the callbacks that receive the commands.
#[derive(Clone)]
pub struct Board(Arc<(Mutex<Inner>, Condvar)>);

struct Inner {
    /// Room and due time of each report, from tick 1 on; none if it is answered, superseded or was
    /// never sent.
    waiting: Vec<Option<(usize, Instant)>>,
    /// No report before this index is waiting.
    oldest: usize,
    /// Reports that got no command of their own, because a command for a later report of their room
    /// arrived.
    superseded: u64,
    times: Times,
}

impl Default for Board {
    fn default() -> Self {
        Self(Arc::new((
            Mutex::new(Inner { waiting: Vec::new(), oldest: 0, superseded: 0, times: Times::new() }),
            Condvar::new(),
        )))
    }
}

impl Board {
    /// Notes a report that is sent to a room; ticks count from 1 without gaps.
    pub fn sent(&self, tick: u64, room: usize, due: Instant) {
        let mut inner = self.lock();
        debug_assert_eq!(inner.waiting.len() as u64 + 1, tick);
        inner.waiting.push(Some((room, due)));
    }

    /// Notes the arrival of an answer; only the first to each report counts.
    ///
    /// Earlier reports of the room that still wait are superseded, because the array now has a
    /// newer command. They count with the time until this arrival.
    pub fn answered(&self, tick: u64, arrived: Instant) {
        let mut inner = self.lock();
        let Inner { waiting, oldest, superseded, times } = &mut *inner;
        let index = (tick as usize).wrapping_sub(1);
        if let Some((room, due)) = waiting.get_mut(index).and_then(Option::take) {
            times.record(arrived.saturating_duration_since(due));
            for report in &mut waiting[*oldest..index] {
                if let Some((_, due)) = report.take_if(|(other, _)| *other == room) {
                    times.record(arrived.saturating_duration_since(due));
                    *superseded += 1;
                }
            }
            *oldest += waiting[*oldest..].iter().take_while(|report| report.is_none()).count();
        }
        drop(inner);
        self.0.1.notify_one();
    }

    /// Waits until a report is answered; false if that takes longer than `limit`.
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
            inner = unpoisoned(self.0.1.wait_timeout(inner, left)).0;
        }
    }

    /// Clears all measurements and goes on at this tick. Reports that still wait do not count as
    /// lost.
    pub fn begin(&self, tick: u64) {
        let mut inner = self.lock();
        inner.waiting.resize(tick as usize - 1, None);
        inner.times = Times::new();
        inner.superseded = 0;
        inner.oldest = inner.waiting.len();
        inner.waiting.iter_mut().for_each(|report| *report = None);
    }

    /// The measured times, and the number of reports that got no command of their own.
    ///
    /// Reports that no later command superseded are among the times with `lost_after`.
    pub fn take(&self, lost_after: Duration) -> (Times, u64) {
        let mut inner = self.lock();
        let silent = inner.waiting.iter().flatten().count() as u64;
        (0..silent).for_each(|_| inner.times.record(lost_after));
        (std::mem::take(&mut inner.times), silent + inner.superseded)
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        lock(&self.0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_counts_once_and_supersedes_earlier_reports_of_its_room() {
        let board = Board::default();
        let due = Instant::now();
        // Ticks of two rooms in turn: the answer to 3 supersedes 1 of the same room; 2 and 4 are
        // never answered.
        (1..=4).for_each(|tick| board.sent(tick, tick as usize % 2, due));
        for tick in [3, 1, 99, 0] {
            board.answered(tick, due + Duration::from_millis(10));
        }
        assert!(board.wait(3, Duration::ZERO) && board.wait(1, Duration::ZERO) && !board.wait(2, Duration::ZERO));
        let (times, lost) = board.take(Duration::from_millis(500));
        assert_eq!((times.count(), lost), (4, 3));
        assert_eq!(times.over(Duration::from_millis(400)), 2, "an unanswered report counts with the longest time");
    }

    #[test]
    fn only_reports_after_begin_count() {
        let board = Board::default();
        board.sent(1, 0, Instant::now());
        board.begin(1000);
        board.answered(1, Instant::now());
        let (times, lost) = board.take(Duration::from_millis(500));
        assert_eq!((times.count(), lost), (0, 0));
        board.sent(1000, 0, Instant::now());
        board.answered(1000, Instant::now());
        let (times, lost) = board.take(Duration::from_millis(500));
        assert_eq!((times.count(), lost), (1, 0));
    }
}
