//! The two halves of a decision: the observation, and the command of the action that is then due. A
//! caller that proposes the angles itself acts between them.

use heliostat_channel::{MirrorAngles, mirrors::copy_widened};
use heliostat_proto::Nanos;
use heliostat_scenario::DegradedAction;

use super::{Controller, array_output::copy_narrowed};
use crate::{
    observe::observer::LosSource,
    output::{
        outcome::{Decision, DegradedMode, Stage, Timing},
        safety::Clipped,
    },
    policy::ProposedBy,
};

/// An observation that is complete, and the action that is due for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Observed {
    action: DegradedAction,
    /// What [`Decision::Hold`] reports; the other actions ignore it.
    mode: DegradedMode,
}

impl Controller {
    /// Observes for the command that [`handle_message`](Self::handle_message) made due, for a
    /// caller that proposes the angles itself, such as a learner.
    /// [`observation`](Self::observation) then holds what a policy would read. Call
    /// [`poll_proposed`](Self::poll_proposed) next, with the same `now`.
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
        self.proposed.copy_from(angles);
        self.is_proposed = true;
        self.decide(observed, now, &mut |_| {})
    }

    /// Fills the observation; the action that is then due.
    pub(super) fn observe(&mut self, now: Nanos, timing: Timing, mark: &mut dyn FnMut(Stage)) -> Observed {
        self.is_proposed = false;
        self.journal.record_decision(timing.input(), now);
        self.update_permits(now, true);
        let (mut action, mut mode) = (DegradedAction::Policy, DegradedMode::Held);
        if timing == Timing::Late {
            self.counters.count_degraded(DegradedMode::Late);
            (action, mode) = (self.control.when_late, DegradedMode::Late);
        }
        if matches!(action, DegradedAction::Policy | DegradedAction::Fallback) {
            match self.fill_observation(now) {
                Some(_) if self.observation.users() == 0 => action = self.without_users(),
                Some(LosSource::Measured { unmeasured }) => self.counters.unmeasured_users += unmeasured as u64,
                Some(LosSource::Modelled) => {
                    // A room without receivers never reports gains: nothing is missing there.
                    match self.inbox.last_channel() {
                        Some(_) => self.counters.count_degraded(DegradedMode::ChannelMissing),
                        None => self.counters.modelled += 1,
                    }
                    if action == DegradedAction::Policy {
                        (action, mode) = (self.control.when_channel_missing, DegradedMode::ChannelMissing);
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

    /// Counts the decision, and executes the action that is due.
    pub(super) fn decide(&mut self, due: Observed, now: Nanos, mark: &mut dyn FnMut(Stage)) -> Decision<'_> {
        self.counters.decisions += 1;
        self.policy.tallies.count_decision();
        let tick = self.inbox.users().map_or(0, |report| report.tick);
        self.execute((due.action, due.mode), tick, now, mark)
    }

    /// Fills the observation.
    pub(super) fn fill_observation(&mut self, now: Nanos) -> Option<LosSource> {
        self.observer.observe(&self.model, &self.inbox, now, &mut self.observation)
    }

    /// The action for a report without users: no angle is better than the last one.
    fn without_users(&self) -> DegradedAction {
        if self.has_command() { DegradedAction::LastGood } else { DegradedAction::Park }
    }

    /// Leaves out the mirrors that do not follow, those of arrays without a command, and pairs
    /// beyond the range of an array.
    fn observe_arrays(&mut self) {
        self.observation.scene.exclude_mirrors(self.inbox.unusable());
        let is_one = self.arrays.len() == 1;
        for array in &self.arrays {
            if array.permit.is_err() && !is_one {
                self.observation.scene.exclude(array.mirrors.clone());
            } else if let Some([roll, yaw]) = array.limits.narrow_axes_rad() {
                let (mirrors, ranges) = (array.mirrors.clone(), [&roll, &yaw]);
                self.observation.scene.restrict_array_to_range(&self.model, mirrors, ranges);
            }
        }
    }

    /// Sets the observation's angles to those of the mirrors.
    fn settle_angles(&mut self, now: Nanos) {
        for (index, array) in self.arrays.iter_mut().enumerate() {
            array.settle(now, self.inbox.telemetry(index), self.interval_s, &mut self.observation.angles);
        }
    }

    /// Proposes angles by `action`, limits them and completes the command.
    pub(super) fn execute(
        &mut self,
        (action, mode): (DegradedAction, DegradedMode),
        tick: u64,
        now: Nanos,
        mark: &mut dyn FnMut(Stage),
    ) -> Decision<'_> {
        let Some(epoch) = self.arrays.iter().find_map(|array| array.permit.ok()) else {
            return Decision::Hold(self.arrays[0].permit.err().unwrap_or(DegradedMode::Withheld));
        };
        self.command.epoch = epoch;
        self.settle_angles(now);
        let mut is_own = false;
        let proposed = match action {
            DegradedAction::Policy => {
                let by = self.propose();
                is_own = by == ProposedBy::Policy;
                by != ProposedBy::None
            }
            DegradedAction::Fallback => self.policy.fall_back(&self.model, &self.observation, &mut self.proposed),
            DegradedAction::LastGood => self.repeat(),
            DegradedAction::Park => {
                self.proposed.roll.fill(0.0);
                self.proposed.yaw.fill(0.0);
                true
            }
            DegradedAction::Hold => return Decision::Hold(mode),
        };
        if !proposed {
            self.counters.count_degraded(DegradedMode::Held);
            return Decision::Hold(DegradedMode::Held);
        }
        mark(Stage::Inferred);
        let mut clipped = Clipped::default();
        for array in &self.arrays {
            clipped += array.bound(&self.observation.angles, &mut self.proposed);
        }
        self.counters.clipped += clipped;
        self.policy.tallies.count_command(is_own, clipped);
        self.complete_command(tick, now);
        mark(Stage::MadeSafe);
        let sampled_ns = self.inbox.users().map_or(now, |report| report.stamp.time_ns);
        let age_ns = now.saturating_sub(sampled_ns);
        Decision::Move { command: &self.command, parts: &self.parts, age_ns }
    }

    /// Lets the policy propose, or else the fallback; angles of the caller stay.
    fn propose(&mut self) -> ProposedBy {
        if self.is_proposed {
            return ProposedBy::Policy;
        }
        let by = self.policy.propose(&self.model, &self.observation, &mut self.proposed);
        if by == ProposedBy::Fallback {
            self.counters.count_degraded(DegradedMode::PolicyFailed);
        } else {
            self.counters.unserved_users += self.policy.unserved(self.observation.users()) as u64;
        }
        by
    }

    /// Proposes the last command; false where there is none.
    fn repeat(&mut self) -> bool {
        copy_widened(&self.command.roll, &mut self.proposed.roll);
        copy_widened(&self.command.yaw, &mut self.proposed.yaw);
        self.has_command()
    }

    /// Completes and numbers the command to each array from the proposed angles.
    fn complete_command(&mut self, tick: u64, now: Nanos) {
        let withheld = self.arrays.iter().rev().fold(0, |bits, array| bits << 1 | u64::from(array.permit.is_err()));
        self.counters.commands += self.arrays.len() as u64 - u64::from(withheld.count_ones());
        self.journal.record_command(withheld);
        self.command.answers = tick;
        self.command.time_ns = now;
        copy_narrowed(&self.proposed.roll, &mut self.command.roll);
        copy_narrowed(&self.proposed.yaw, &mut self.command.yaw);
        self.observation.angles.copy_from(&self.proposed);
        self.observer.handle_command(&self.command);
        let mut first = None;
        for (index, array) in self.arrays.iter_mut().enumerate() {
            let number = array.number(now);
            first = first.or(number);
            if let Some(part) = self.parts.get_mut(index) {
                part.set(&self.command, number, array.guard.validity_ms());
            }
        }
        self.command.sequence = first.map_or(0, |(_, sequence)| sequence);
    }
}
