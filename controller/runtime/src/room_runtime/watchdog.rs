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

use heliostat_core::guard::StopLatch;
use heliostat_proto::SafetyReport;
use heliostat_scenario::DegradedAction;

use super::{command_sender::OnBehalf, locks::lock};

/// Timeout of a policy. No policy for a room with a deadline takes so long.
pub const POLICY_TIMEOUT: Duration = Duration::from_millis(100);

/// Watches the decision loop of one room.
pub struct Watchdog {
    /// Absent where the configured action is to send nothing.
    action: Option<OnBehalf>,
    /// Counts the begin and end of each decision.
    progress: AtomicU64,
    /// One for each array.
    stops: Mutex<Vec<StopLatch>>,
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
        let stops = Mutex::new(vec![StopLatch::default(); arrays]);
        Self { action, progress: AtomicU64::new(0), stops, stall: Mutex::default() }
    }

    /// A decision begins or ends.
    pub fn on_progress(&self) {
        self.progress.fetch_add(1, Ordering::Relaxed);
    }

    /// Applies a message about the emergency stop, which concerns all arrays.
    pub fn update_stop(&self, apply: impl Fn(&mut StopLatch)) {
        lock(&self.stops).iter_mut().for_each(apply);
    }

    /// Applies a safety report of an array.
    pub fn handle_safety(&self, array: usize, report: &SafetyReport) {
        lock(&self.stops)[array].handle_safety(report);
    }

    /// Whether an array is stopped.
    pub fn is_stopped(&self, array: usize) -> bool {
        lock(&self.stops)[array].is_stopped()
    }

    /// The decision loop was free.
    pub fn on_idle(&self) {
        *lock(&self.stall) = StallDetector::default();
    }

    /// The decision loop was busy at `at`: the command to send on behalf of the policy to the arrays
    /// that are not stopped, if one is due.
    pub fn on_busy(&self, at: Instant) -> Option<OnBehalf> {
        let is_stalled = lock(&self.stall).is_stalled(at, self.progress.load(Ordering::Relaxed));
        self.action.filter(|_| is_stalled && !lock(&self.stops).iter().all(StopLatch::is_stopped))
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
    use heliostat_proto::{EmergencyStop, Stamp, StopAction};

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
    fn no_command_is_due_while_the_array_is_stopped() {
        let watchdog = Watchdog::new(DegradedAction::LastGood, 2);
        let order = |action, time_ns| {
            let stamp = Stamp { time_ns, ..Stamp::default() };
            let order = EmergencyStop { stamp, action, ..EmergencyStop::default() };
            watchdog.update_stop(|latch| latch.handle_order(time_ns, &order));
        };
        order(StopAction::Stop, 5);
        assert_eq!(after_a_stall(&watchdog), None);
        order(StopAction::Rearm, 5);
        assert_eq!(after_a_stall(&watchdog), None, "a re-arm as old as the stop");
        // A report of one array releases that array.
        let stamp = Stamp { time_ns: 5_000_000_000, ..Stamp::default() };
        watchdog.handle_safety(1, &SafetyReport { stamp, ..SafetyReport::default() });
        assert!(after_a_stall(&watchdog).is_some());
        assert_eq!([0, 1].map(|array| watchdog.is_stopped(array)), [true, false]);
        order(StopAction::Rearm, 6);
        assert_eq!([0, 1].map(|array| watchdog.is_stopped(array)), [false, false]);
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
