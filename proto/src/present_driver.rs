//! A driver that is in the room, and whether it has ended for another one of its array.

use crate::limits::{Nanos, START_WINDOW_NS};
use crate::messages::MirrorTelemetry;

/// A driver or a simulator whose liveliness token is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PresentDriver {
    /// When its token appeared.
    since_ns: Nanos,
    /// Number of commands that it has accepted, by its telemetry; absent without telemetry.
    accepted: Option<u64>,
}

impl PresentDriver {
    /// One whose token appears now, in ns on a clock of the observer.
    pub fn new(now: Nanos) -> Self {
        Self { since_ns: now, accepted: None }
    }

    /// It has published telemetry. Does not allocate.
    pub fn handle_telemetry(&mut self, report: &MirrorTelemetry) {
        self.accepted = self.accepted.max(Some(report.counters.accepted));
    }

    /// Whether the token of a driver of this source ends now, in ns on the same clock, at the start of the driver and
    /// beside another one of its array with a lower source id, before it accepted a command: it has followed none.
    pub fn has_yielded(&self, now: Nanos, source: u64, others: impl IntoIterator<Item = u64>) -> bool {
        let is_at_start = now.abs_diff(self.since_ns) <= START_WINDOW_NS;
        is_at_start && self.accepted == Some(0) && others.into_iter().any(|other| other < source)
    }
}
