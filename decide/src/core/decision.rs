//! The two halves of a decision: the observation, and the command. A caller that proposes the angles
//! itself acts between them.

use heliostat_channel::MirrorAngles;
use heliostat_proto::Nanos;
use heliostat_scenario::DegradedAction;

use super::Controller;
use crate::{
    observe::observer::{Correctable, LosSource},
    output::outcome::{Decision, DegradedMode, Stage, Timing},
};

/// An observation that is complete, and the action that is due for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Observed {
    action: DegradedAction,
    /// The mode matters only where the action holds; else the policy acts.
    mode: DegradedMode,
}

impl Controller {
    /// Observes for the command that [`handle_message`](Self::handle_message) made due, for a caller
    /// that proposes the angles itself, such as a learner. [`observation`](Self::observation) then
    /// holds what a policy would read. Call [`poll_proposed`](Self::poll_proposed) next, with the
    /// same `now`.
    pub fn poll_observation(&mut self, now: Nanos) -> Observed {
        let observed = self.observe(now, Timing::InTime, &mut |_| {});
        self.settle_angles(now);
        observed
    }

    /// Decides as [`poll_command`](Self::poll_command), with the angles of the caller in place of
    /// the policy's.
    ///
    /// # Panics
    /// If the number of mirrors differs.
    pub fn poll_proposed(&mut self, observed: Observed, now: Nanos, angles: &MirrorAngles) -> Decision<'_> {
        self.proposed.roll.copy_from_slice(&angles.roll);
        self.proposed.yaw.copy_from_slice(&angles.yaw);
        self.is_proposed = true;
        self.decide(observed, now, &mut |_| {})
    }

    /// Decides as [`poll_command`](Self::poll_command), with the corrections of the caller in place of
    /// the policy's. Shape of `corrections`: K * [`Correction::VALUES`](crate::correction::Correction::VALUES),
    /// row-major.
    ///
    /// No effect of the corrections where the policy does not read evidence.
    pub fn poll_corrected(&mut self, observed: Observed, now: Nanos, corrections: &[f32]) -> Decision<'_> {
        let Self { model, inbox, observer, observation, .. } = self;
        let correct = &mut |part: Correctable<'_>| {
            if let Correctable::Receivers(evidence) = part {
                evidence.correct(corrections);
            }
        };
        observer.observe(model, inbox, (now, correct), observation);
        self.observe_arrays();
        self.decide(observed, now, &mut |_| {})
    }

    /// Fills the observation; the action that is then due.
    pub(super) fn observe(&mut self, now: Nanos, timing: Timing, mark: &mut dyn FnMut(Stage)) -> Observed {
        self.is_proposed = false;
        self.journal.record_decision(timing.input(), now);
        self.update_permits(now);
        let (mut action, mut mode) = (DegradedAction::Policy, DegradedMode::Held);
        if timing == Timing::Late {
            self.counters.count_degraded(DegradedMode::Late);
            (action, mode) = (self.actions.late, DegradedMode::Late);
        }
        if matches!(action, DegradedAction::Policy | DegradedAction::Fallback) {
            match self.fill_observation(now) {
                Some(_) if self.observation.users() == 0 => action = self.without_users(),
                Some(LosSource::Measured { unmeasured }) => self.counters.unmeasured_users += unmeasured as u64,
                Some(LosSource::Modelled) => {
                    self.counters.count_degraded(DegradedMode::ChannelMissing);
                    if action == DegradedAction::Policy {
                        (action, mode) = (self.actions.channel_missing, DegradedMode::ChannelMissing);
                    }
                }
                None => {
                    self.counters.count_degraded(DegradedMode::Held);
                    (action, mode) = (DegradedAction::Hold, DegradedMode::Held);
                }
            }
            self.observe_arrays();
            mark(Stage::Observed);
        }
        Observed { action, mode }
    }

    pub(super) fn decide(&mut self, due: Observed, now: Nanos, mark: &mut dyn FnMut(Stage)) -> Decision<'_> {
        self.counters.decisions += 1;
        self.policy.tallies.count_decision();
        let tick = self.inbox.users().map_or(0, |report| report.tick);
        self.execute((due.action, due.mode), tick, now, mark)
    }
}
