//! When a refinement may command the mirrors: while no user but the holder of the receiver is in the room.

use std::fmt;
use std::time::{Duration, Instant};

/// Time without another user after which the room is idle.
const IDLE_AFTER: Duration = Duration::from_secs(3);

/// Longest time without a position report in an idle room: without reports a user could enter unseen.
const REPORT_GAP_MAX: Duration = Duration::from_millis(500);

/// Why a refinement may not command the mirrors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The position reports name another user.
    User(u32),
    /// No position report has come for some time.
    Silence,
    /// Another controller has taken the lead.
    Controller,
    /// Another calibration commands the room.
    Calibration,
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::User(user) => write!(f, "another user is in the room, number {user}"),
            Self::Silence => f.write_str("position reports are missing"),
            Self::Controller => f.write_str("another controller has taken the lead"),
            Self::Calibration => f.write_str("another calibration commands the room"),
        }
    }
}

/// What the position reports say about other users.
#[derive(Debug)]
pub struct Idle {
    receiver: u32,
    /// Since when each report has named the holder of the receiver alone.
    since: Option<Instant>,
    reported: Option<Instant>,
    /// What ended the last idle time.
    cause: Cause,
}

impl Idle {
    /// Before the first report.
    pub fn new(receiver: u32) -> Self {
        Self { receiver, since: None, reported: None, cause: Cause::Silence }
    }

    /// Notes the users of a position report that arrived at `now`.
    pub fn handle_users(&mut self, now: Instant, mut users: impl Iterator<Item = u32>) {
        self.interrupt_after_gap(now);
        self.reported = Some(now);
        match users.find(|user| *user != self.receiver) {
            Some(other) => self.interrupt(Cause::User(other)),
            None => {
                self.since.get_or_insert(now);
            }
        }
    }

    /// The room is in use from now on, whatever the reports said.
    pub fn interrupt(&mut self, cause: Cause) {
        self.since = None;
        self.cause = cause;
    }

    /// Why the room is not idle at `now`; `None` while it is.
    pub fn cause(&mut self, now: Instant) -> Option<Cause> {
        self.interrupt_after_gap(now);
        let is_idle = self.since.is_some_and(|since| now - since >= IDLE_AFTER);
        (!is_idle).then_some(self.cause)
    }

    fn interrupt_after_gap(&mut self, now: Instant) {
        // A longer silence does not change what ended the idle time.
        if self.since.is_some() && self.reported.is_none_or(|reported| now - reported > REPORT_GAP_MAX) {
            self.interrupt(Cause::Silence);
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
        (now, idle.cause(now).is_none())
    }

    #[test]
    fn a_room_is_idle_some_seconds_after_the_last_other_user_and_in_use_at_once() {
        let (mut idle, begun) = (Idle::new(7), Instant::now());
        assert_eq!(idle.cause(begun), Some(Cause::Silence), "nothing is known yet");
        let (now, is_idle) = after(&mut idle, begun, 29, &[7]);
        assert!(!is_idle);
        let (now, is_idle) = after(&mut idle, now, 3, &[7]);
        assert!(is_idle);
        let (now, is_idle) = after(&mut idle, now, 1, &[7, 3]);
        assert!(!is_idle, "another user has entered");
        assert_eq!(idle.cause(now), Some(Cause::User(3)));
        let (now, is_idle) = after(&mut idle, now, 29, &[7]);
        assert!(!is_idle, "three seconds begin again");
        let (now, is_idle) = after(&mut idle, now, 3, &[7]);
        assert!(is_idle);
        let silent = idle.cause(now + Duration::from_millis(600));
        assert_eq!(silent, Some(Cause::Silence), "no reports: a user could enter unseen");
        let (now, is_idle) = after(&mut idle, now + Duration::from_millis(600), 5, &[7]);
        assert!(!is_idle);
        let (_, is_idle) = after(&mut idle, now, 30, &[]);
        assert!(is_idle, "a room without users is idle too");
        idle.interrupt(Cause::Controller);
        assert_eq!(idle.cause(now), Some(Cause::Controller));
    }
}
