//! Whether a driver or a simulator is there to receive the commands.
//!
//! None of this is in the decision path.

use std::{
    collections::BTreeSet,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use heliostat_bus::{Bus, Presence, Subscription};
use heliostat_decide::core::Controller;
use heliostat_proto::{NodeKind, Stamp, keys::parse_alive};

use super::locks::lock;

/// Time without telemetry and without a liveliness token after which the driver is absent. A
/// driver publishes telemetry at least 10 times a second.
const ABSENT_AFTER: Duration = Duration::from_secs(2);

/// Watches the liveliness tokens of drivers and simulators, and the telemetry.
pub struct DriverPresence {
    tokens: Arc<Mutex<BTreeSet<u64>>>,
    detector: AbsenceDetector,
}

/// Finds out that commands are sent for a while without any sign of a driver.
#[derive(Debug, Default)]
struct AbsenceDetector {
    telemetry: Option<Stamp>,
    /// Since when there is no sign of a driver although commands were sent.
    since: Option<Instant>,
}

impl DriverPresence {
    /// Subscribes to the tokens.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn open(bus: &Bus) -> anyhow::Result<(Self, Subscription)> {
        let tokens: Arc<Mutex<BTreeSet<u64>>> = Arc::default();
        let present = Arc::clone(&tokens);
        let subscription = bus.watch(&bus.room().all_alive(), move |key, presence| {
            let Some((NodeKind::Driver | NodeKind::SimNode, source)) = parse_alive(key) else { return };
            match presence {
                Presence::Alive => lock(&present).insert(source),
                Presence::Gone => lock(&present).remove(&source),
            };
        })?;
        Ok((Self { tokens, detector: AbsenceDetector::default() }, subscription))
    }

    /// Whether the commands of a controller reach no driver.
    pub fn is_absent(&mut self, now: Instant, controller: &Controller) -> bool {
        let has_token = !lock(&self.tokens).is_empty();
        let arrays = 0..controller.arrays();
        let telemetry = arrays.map(|array| controller.inbox().telemetry(array).map(|telemetry| telemetry.stamp));
        let telemetry = telemetry.max_by_key(|stamp| stamp.map(|stamp| stamp.time_ns)).flatten();
        self.detector.is_absent(now, has_token, telemetry, controller.counters().commands)
    }
}

impl AbsenceDetector {
    /// `telemetry` is the stamp of the latest one, `commands` the number of commands so far.
    fn is_absent(&mut self, now: Instant, has_token: bool, telemetry: Option<Stamp>, commands: u64) -> bool {
        let has_news = std::mem::replace(&mut self.telemetry, telemetry) != telemetry;
        if has_token || has_news || commands == 0 {
            self.since = None;
            return false;
        }
        now.saturating_duration_since(*self.since.get_or_insert(now)) >= ABSENT_AFTER
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamp(sequence: u64) -> Option<Stamp> {
        Some(Stamp { sequence, ..Stamp::default() })
    }

    #[test]
    fn a_driver_is_absent_after_commands_without_token_and_telemetry_for_a_while() {
        let (mut detector, start) = (AbsenceDetector::default(), Instant::now());
        assert!(!detector.is_absent(start, false, None, 1));
        assert!(!detector.is_absent(start + ABSENT_AFTER / 2, false, None, 9));
        assert!(detector.is_absent(start + ABSENT_AFTER, false, None, 20));
        assert!(!detector.is_absent(start + ABSENT_AFTER, true, None, 20), "a token appeared");
    }

    #[test]
    fn a_driver_with_telemetry_or_a_controller_without_commands_lacks_nothing() {
        let (mut detector, start) = (AbsenceDetector::default(), Instant::now());
        for step in 0..10 {
            assert!(!detector.is_absent(start + step * ABSENT_AFTER, false, stamp(u64::from(step)), 5));
        }
        let last = start + 10 * ABSENT_AFTER;
        assert!(!detector.is_absent(last, false, stamp(9), 5));
        assert!(detector.is_absent(last + ABSENT_AFTER, false, stamp(9), 5), "the telemetry ended");
        let mut idle = AbsenceDetector::default();
        assert!(!idle.is_absent(start, false, None, 0) && !idle.is_absent(last, false, None, 0));
    }
}
