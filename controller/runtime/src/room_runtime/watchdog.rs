//! Detects a policy that does not return, and names the command to send on its behalf.
//!
//! # Theory of operation
//!
//! A thread that decides holds the lock of the decision loop. The watchdog counts the begin and end
//! of each decision. If the lock is held and the count has not changed for [`POLICY_TIMEOUT`],
//! that is a policy timeout. The watchdog then names the command of the scenario's
//! `control.when_unanswered`, unless the array is stopped. Operators' stop orders reach the
//! watchdog directly, because the decision loop cannot handle them meanwhile. When the policy
//! returns, the command sender continues the numbering.

use std::{
    sync::{
        Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use heliostat_proto::stop_hold::{HeldStop, StopHold, unknown_stops};
use heliostat_proto::{LatchedStopReport, SafetyReport, StopReport};
use heliostat_scenario::DegradedAction;

use super::{command_sender::OnBehalf, locks::lock};

/// Timeout of a policy. No policy for a room with a deadline takes so long.
pub const POLICY_TIMEOUT: Duration = Duration::from_millis(100);

/// An array whose last telemetry is older than this is absent.
const PRESENT: Duration = Duration::from_secs(1);

/// The stops that are held for one array.
#[derive(Clone, Debug, Default)]
struct HeldArray {
    hold: StopHold,
    /// Arrival of its last telemetry.
    heard: Option<Instant>,
}

/// Watches the decision loop of one room.
pub struct Watchdog {
    /// Absent where the configured action is to send nothing.
    action: Option<OnBehalf>,
    /// Counts the begin and end of each decision.
    progress: AtomicU64,
    /// One for each array.
    stops: Mutex<Vec<HeldArray>>,
    stall: Mutex<StallDetector>,
}

impl Watchdog {
    /// A watchdog of so many arrays with the configured action: repeat the last command, park, or
    /// send nothing.
    pub fn new(action: DegradedAction, arrays: usize) -> Self {
        let action = match action {
            DegradedAction::LastGood => Some(OnBehalf::RepeatLast),
            DegradedAction::Park => Some(OnBehalf::Park),
            DegradedAction::Policy | DegradedAction::Fallback | DegradedAction::Hold => None,
        };
        let stops = Mutex::new(vec![HeldArray::default(); arrays]);
        Self { action, progress: AtomicU64::new(0), stops, stall: Mutex::default() }
    }

    /// A decision begins or ends.
    pub fn on_progress(&self) {
        self.progress.fetch_add(1, Ordering::Relaxed);
    }

    /// Applies a stop, which concerns all arrays.
    pub fn update_stops(&self, apply: impl Fn(&mut StopHold)) {
        lock(&self.stops).iter_mut().for_each(|array| apply(&mut array.hold));
    }

    /// Applies a stop report of an array.
    pub fn handle_stops(&self, array: usize, report: &StopReport) {
        self.handle_reported(array, &report.stops, |hold| hold.handle_stops(report));
    }

    /// Applies a safety report of an array.
    pub fn handle_safety(&self, array: usize, report: &SafetyReport) {
        self.handle_reported(array, report.stop().as_slice(), |hold| hold.handle_safety(report));
    }

    /// Applies a report; a stop in it that was not known concerns all arrays.
    fn handle_reported(&self, array: usize, reported: &[LatchedStopReport], apply: impl FnOnce(&mut StopHold) -> bool) {
        let stops = &mut *lock(&self.stops);
        let unknown = unknown_stops(reported, stops.iter().map(|array| &array.hold));
        if apply(&mut stops[array].hold) {
            for stop in &unknown {
                stops.iter_mut().for_each(|array| array.hold.learn(stop));
            }
        }
    }

    /// Applies the state in telemetry of an array.
    pub fn handle_state(&self, array: usize, source: u64, is_stopped: bool) {
        if let Some(array) = lock(&self.stops).get_mut(array) {
            array.heard = Some(Instant::now());
            array.hold.handle_state(source, is_stopped);
        }
    }

    /// The stops that an array has not reported; whether it is a present array that understands no
    /// repetition.
    pub fn unreported(&self, array: usize) -> (Vec<HeldStop>, bool) {
        let array = &lock(&self.stops)[array];
        let is_present = array.heard.is_some_and(|heard| heard.elapsed() < PRESENT);
        (array.hold.unreported().cloned().collect(), is_present && !array.hold.has_stop_reports())
    }

    /// Whether an array is stopped.
    pub fn is_stopped(&self, array: usize) -> bool {
        lock(&self.stops)[array].hold.is_stopped()
    }

    /// The decision loop was free.
    pub fn on_idle(&self) {
        *lock(&self.stall) = StallDetector::default();
    }

    /// The decision loop was busy at `at`: the command to send on behalf of the policy to the arrays
    /// that are not stopped, if one is due.
    pub fn on_busy(&self, at: Instant) -> Option<OnBehalf> {
        let is_stalled = lock(&self.stall).is_stalled(at, self.progress.load(Ordering::Relaxed));
        self.action.filter(|_| is_stalled && !lock(&self.stops).iter().all(|array| array.hold.is_stopped()))
    }

    /// What happens while the policy does not return, for messages.
    pub fn description(&self) -> &'static str {
        match self.action {
            Some(OnBehalf::RepeatLast) => "the last angles are published again",
            Some(OnBehalf::Park) => "a command with all mirrors flat is published",
            None => "no command is published: the array holds its angles, then parks",
        }
    }
}

/// Distinguishes one long decision from several short ones.
#[derive(Clone, Copy, Debug, Default)]
struct StallDetector {
    /// Since when the loop has been busy, and the progress then.
    busy: Option<(Instant, u64)>,
}

impl StallDetector {
    /// Whether the loop, busy at `at`, has made no progress for [`POLICY_TIMEOUT`].
    fn is_stalled(&mut self, at: Instant, progress: u64) -> bool {
        match self.busy.filter(|(_, then)| *then == progress) {
            Some((since, _)) => at.saturating_duration_since(since) >= POLICY_TIMEOUT,
            None => {
                self.busy = Some((at, progress));
                false
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::EmergencyStop;

    use super::*;

    /// What the watchdog names when one decision has lasted for too long.
    fn after_a_stall(watchdog: &Watchdog) -> Option<OnBehalf> {
        let start = Instant::now();
        watchdog.on_progress();
        assert_eq!(watchdog.on_busy(start), None);
        watchdog.on_busy(start + POLICY_TIMEOUT)
    }

    #[test]
    fn each_action_has_its_command() {
        let commands = [DegradedAction::LastGood, DegradedAction::Park, DegradedAction::Hold]
            .map(|action| after_a_stall(&Watchdog::new(action, 1)));
        assert_eq!(commands, [Some(OnBehalf::RepeatLast), Some(OnBehalf::Park), None]);
    }

    #[test]
    fn no_command_is_due_while_all_arrays_are_stopped_and_each_stop_is_due_for_repetition() {
        let watchdog = Watchdog::new(DegradedAction::LastGood, 2);
        watchdog.update_stops(|hold| hold.order(5, &EmergencyStop::default()));
        assert_eq!(after_a_stall(&watchdog), None);
        assert_eq!(watchdog.unreported(1).0.len(), 1);
        // The second array has it by its state alone, and then drops it.
        watchdog.handle_state(1, 7, true);
        assert_eq!((watchdog.unreported(0).0.len(), watchdog.unreported(1).0.len()), (1, 0));
        watchdog.handle_state(1, 7, false);
        assert!(after_a_stall(&watchdog).is_some());
        assert_eq!([0, 1].map(|array| watchdog.is_stopped(array)), [true, false]);
    }

    #[test]
    fn a_loop_that_was_free_in_between_is_not_stalled() {
        let (watchdog, start) = (Watchdog::new(DegradedAction::LastGood, 1), Instant::now());
        assert_eq!(watchdog.on_busy(start), None);
        watchdog.on_idle();
        assert_eq!(watchdog.on_busy(start + POLICY_TIMEOUT), None);
    }

    #[test]
    fn only_one_decision_that_lasts_too_long_is_a_stall() {
        let (mut detector, start) = (StallDetector::default(), Instant::now());
        assert!(!detector.is_stalled(start, 1));
        assert!(!detector.is_stalled(start + POLICY_TIMEOUT / 2, 1));
        assert!(detector.is_stalled(start + POLICY_TIMEOUT, 1));
        assert!(!detector.is_stalled(start + POLICY_TIMEOUT, 2), "another decision");
        assert!(!detector.is_stalled(start + POLICY_TIMEOUT * 3 / 2, 2));
        assert!(detector.is_stalled(start + POLICY_TIMEOUT * 2, 2));
    }
}
