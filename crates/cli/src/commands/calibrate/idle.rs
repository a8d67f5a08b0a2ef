//! When a refinement may command the mirrors: while no user but the holder of the receiver is in the room.

use std::time::{Duration, Instant};

/// Time without another user after which the room is idle.
const IDLE_AFTER: Duration = Duration::from_secs(3);

/// Longest time without a position report in an idle room: without reports a user could enter unseen.
const REPORT_GAP_MAX: Duration = Duration::from_millis(500);

/// What the position reports say about other users.
#[derive(Debug)]
pub struct Idle {
    receiver: u32,
    /// Since when each report has named the holder of the receiver alone.
    since: Option<Instant>,
    reported: Option<Instant>,
}

impl Idle {
    /// Before the first report.
    pub fn new(receiver: u32) -> Self {
        Self { receiver, since: None, reported: None }
    }

    /// Notes the users of a position report that arrived at `now`.
    pub fn handle_users(&mut self, now: Instant, mut users: impl Iterator<Item = u32>) {
        self.interrupt_after_gap(now);
        self.reported = Some(now);
        let is_alone = users.all(|user| user == self.receiver);
        self.since = is_alone.then(|| self.since.unwrap_or(now));
    }

    /// The room is in use from now on, whatever the reports said.
    pub fn interrupt(&mut self) {
        self.since = None;
    }

    /// Whether the room is idle at `now`.
    pub fn is_idle(&mut self, now: Instant) -> bool {
        self.interrupt_after_gap(now);
        self.since.is_some_and(|since| now - since >= IDLE_AFTER)
    }

    fn interrupt_after_gap(&mut self, now: Instant) {
        if self.reported.is_none_or(|reported| now - reported > REPORT_GAP_MAX) {
            self.since = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether the room is idle after a report with these users every 100 ms, of this number.
    fn after(idle: &mut Idle, from: Instant, reports: u32, users: &[u32]) -> (Instant, bool) {
        let mut now = from;
        for _ in 0..reports {
            now += Duration::from_millis(100);
            idle.handle_users(now, users.iter().copied());
        }
        (now, idle.is_idle(now))
    }

    #[test]
    fn a_room_is_idle_some_seconds_after_the_last_other_user_and_in_use_at_once() {
        let (mut idle, begun) = (Idle::new(7), Instant::now());
        assert!(!idle.is_idle(begun), "nothing is known yet");
        let (now, is_idle) = after(&mut idle, begun, 29, &[7]);
        assert!(!is_idle);
        let (now, is_idle) = after(&mut idle, now, 3, &[7]);
        assert!(is_idle);
        let (now, is_idle) = after(&mut idle, now, 1, &[7, 3]);
        assert!(!is_idle, "another user has entered");
        let (now, is_idle) = after(&mut idle, now, 29, &[7]);
        assert!(!is_idle, "three seconds begin again");
        let (now, is_idle) = after(&mut idle, now, 3, &[7]);
        assert!(is_idle);
        assert!(!idle.is_idle(now + Duration::from_millis(600)), "no reports: a user could enter unseen");
        let (now, is_idle) = after(&mut idle, now + Duration::from_millis(600), 5, &[7]);
        assert!(!is_idle);
        let (_, is_idle) = after(&mut idle, now, 30, &[]);
        assert!(is_idle, "a room without users is idle too");
        idle.interrupt();
        assert!(!idle.is_idle(now));
    }
}
