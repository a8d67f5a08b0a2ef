//! Whether this process stood still, by how late its main thread wakes up.

use std::time::{Duration, Instant};

/// A wake-up that is later than this is a pause of the process: a standby takes over after a few report intervals.
const PAUSE_MIN: Duration = Duration::from_millis(50);

/// Time for which a pause may explain a takeover, which takes a second at most until the next status names it.
const RECENT: Duration = Duration::from_secs(2);

/// The longest pause of the process within the last seconds.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pauses(Option<(Instant, Duration)>);

impl Pauses {
    /// The main thread wakes at `now`, and was due at `due`.
    pub fn note_wake(&mut self, now: Instant, due: Instant) {
        let pause = now.saturating_duration_since(due);
        if pause > PAUSE_MIN && self.recent(now).is_none_or(|longest| longest <= pause) {
            self.0 = Some((now, pause));
        }
    }

    /// The longest recent pause.
    pub fn recent(&self, now: Instant) -> Option<Duration> {
        let (ended, pause) = self.0?;
        (now.saturating_duration_since(ended) <= RECENT).then_some(pause)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_pause_counts_for_two_seconds_and_a_short_delay_is_none() {
        let start = Instant::now();
        let at = |milliseconds| start + Duration::from_millis(milliseconds);
        let mut pauses = Pauses::default();
        pauses.note_wake(at(150), at(100));
        assert_eq!(pauses.recent(at(150)), None);
        pauses.note_wake(at(400), at(100));
        pauses.note_wake(at(500), at(440));
        assert_eq!(pauses.recent(at(2400)), Some(Duration::from_millis(300)));
        assert_eq!(pauses.recent(at(2401)), None);
        pauses.note_wake(at(2500), at(2440));
        assert_eq!(pauses.recent(at(2500)), Some(Duration::from_millis(60)));
    }
}
