//! The decision core of one room: messages and time in, mirror commands out.
//!
//! # Calling order
//!
//! The caller owns the transport, the clock and the threads. It calls
//!
//! 1. [`Controller::new`], then [`Controller::warm_up`] before the first report;
//! 2. a `handle_*` method for each input, in the order of arrival:
//!    [`handle_message`](Controller::handle_message) for a decoded report,
//!    [`handle_malformed`](Controller::handle_malformed) for a payload that does not decode,
//!    [`handle_source_lost`](Controller::handle_source_lost) and
//!    [`handle_source_found`](Controller::handle_source_found) for liveliness,
//!    [`handle_capabilities`](Controller::handle_capabilities),
//!    [`handle_safety`](Controller::handle_safety),
//!    [`handle_unfit_node`](Controller::handle_unfit_node),
//!    [`handle_stop_order`](Controller::handle_stop_order) and
//!    [`handle_rearm`](Controller::handle_rearm) for the array;
//! 3. the `poll_*` method that `handle_message` names by [`Due`]:
//!    [`poll_command`](Controller::poll_command) or
//!    [`poll_stale_command`](Controller::poll_stale_command). Several messages may be handled
//!    before one poll; the poll then decides for the newest tick.
//!    [`handle_and_poll`](Controller::handle_and_poll) does both steps for one message;
//! 4. [`poll_timeout_command`](Controller::poll_timeout_command) again and again, at intervals
//!    shorter than the validity of a command, so that the controller also acts when reports are
//!    absent;
//! 5. optionally, between reports, [`warm_cache`](Controller::warm_cache), which changes no later
//!    command.
//!
//! The caller assigns the sequence number of each command when it sends it, from 1 in each epoch. A
//! caller of a live room reports the last number by [`handle_sent`](Controller::handle_sent) before
//! it passes on telemetry. Getters may be called at any time. No method waits, logs, reads a clock
//! or, after the start-up warm-up, allocates in this project's code.
//!
//! # Stages of a decision
//!
//! 1. **Inbox**: accept the report or refuse it.
//! 2. **Observe**: combine the latest reports into one observation. Mirrors that do not follow are
//!    left out, as are pairs of a mirror and a user beyond the mirror's range.
//! 3. **Infer**: the policy proposes angles; if it fails, the fallback does.
//! 4. **Make safe**: limit the proposal to range and slew rate.
//!
//! # Users
//!
//! A position report may have 0 to 64 users, and other users than the last one. The reports are
//! matched by the users' numbers ([`observer`](crate::observer)). A user without an entry in the
//! channel report has a modelled gain. A policy with fewer slots serves the users with the largest
//! minimum rates ([`selection`](crate::selection)). For a report without users the command repeats
//! the last angles, or has flat mirrors where there was no command. Counters have the users without
//! an entry, and those without a slot.
//!
//! # Degraded modes
//!
//! Each degraded condition has one action and one counter. Where the table names a key, that key
//! of the scenario's `control` table selects the action. The caller's watchdog detects and counts
//! `unanswered`.
//!
//! | condition | key | default action | counter |
//! | --- | --- | --- | --- |
//! | The predicted latency exceeds `deadline_ms`. | `when_late` | repeat the last command | `late` |
//! | The position report is older than `report_age_max_ms`. | `when_stale` | no command | `stale-report` |
//! | No channel report is newer than `report_age_max_ms`, or the report lacks every user. | `when_channel_missing` | the policy decides on modelled direct gains | `channel-missing` |
//! | No position report was accepted for `report_age_max_ms`. | `when_silent` | no command | `silence` |
//! | The policy does not return within 0.1 s: policy timeout. | `when_unanswered` | no command | `unanswered` |
//! | The policy fails, or an angle is not finite. | `fallback` | the fixed point decides | `policy-failed` |
//! | The fallback fails or is `hold`, or there is no last command. | | no command | `held` |
//! | The array is stopped, or does not fit the scenario. | | no command | `withheld` |
//! | The array follows another controller: [`tenure`](crate::tenure). | | no command | `standby` |
//!
//! The caller predicts the latency: the waiting time plus the mean duration of earlier decisions.
//! A `deadline_ms` of 0 means the report interval.
//!
//! # Terms
//!
//! - *Tick*: one sampling of the room. The field `answers` of a command holds the tick of the
//!   report that triggered the command.
//! - *Epoch*: the number under which a controller commands. A higher epoch supersedes a lower one.
//! - *Holding*: the state of an array that keeps its angles after its last command has expired.
//!   The action `hold` is the controller's: it publishes no command.
//! - *Parked*: an array is parked at the position `park_rad` of its capabilities. It parks
//!   `park_after_ms` after the last validity ends. The action `park` differs: it sends a valid
//!   command with zero roll and yaw.
//! - *Start-up warm-up*: runs of the policy on a synthetic room before the first report.
//! - *Cache warm-up*: a repetition of the last decision between two reports.

mod array;
mod degraded_actions;
mod figures;
mod journal;
pub mod memory;

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};
use heliostat_proto::{InputKind, MAX_USERS, MirrorCommand, Nanos, NodeKind};
use heliostat_scenario::{DegradedAction, Scenario};

pub use crate::output::outcome::{Counters, Decision, DegradedMode, Due, Stage, Timing};
use crate::{
    input::{
        inbox::{Inbox, Message},
        refusal::{Refusal, Stream},
    },
    observe::{
        observation::Observation,
        observer::{LosSource, Observer},
    },
    output::{guard::Guard, safety::Limits, tenure::Tenure},
    policy::{self, Policy, ProposedBy, WithFallback},
};
use degraded_actions::{DegradedActions, LastReport};
use journal::Journal;

/// Maximum number of start-up runs on a synthetic room. They change the state of stateful
/// policies, so replay executes this number too.
pub const WARM_UP_RUNS: usize = 200;

/// The decision core of one room. The [module](self) describes the calling order.
pub struct Controller {
    model: ChannelModel,
    inbox: Inbox,
    observer: Observer,
    /// The last observation; its angles are those of the last command.
    observation: Observation,
    policy: WithFallback,
    actions: DegradedActions,
    limits: Limits,
    guard: Guard,
    /// The last accepted position report; absent before the first.
    last_report: Option<LastReport>,
    /// Nominal time between position reports in s.
    interval_s: f64,
    proposed: MirrorAngles,
    /// The last command; its sequence number is the sender's.
    command: MirrorCommand,
    /// Whether `command` was given.
    has_command: bool,
    journal: Journal,
    counters: Counters,
}

impl Controller {
    /// A controller of a scenario's room with this policy, which commands under one epoch; see
    /// [`with_tenure`](Self::with_tenure).
    pub fn new(scenario: &Scenario, model: ChannelModel, policy: Box<dyn Policy>, epoch: u64) -> Self {
        let observation = Observation::with_capacity(&model, scenario.users.count, MAX_USERS);
        let mirrors = model.mirrors.len();
        let validity_ms = scenario.control.validity_ms.round() as u32;
        Self {
            inbox: Inbox::new(scenario),
            observer: Observer::new(scenario, &model),
            proposed: observation.angles.clone(),
            observation,
            policy: WithFallback::new(policy, policy::build_fallback(scenario.control.fallback, scenario)),
            actions: DegradedActions::new(scenario),
            limits: Limits::new(&scenario.control),
            guard: Guard::new(Tenure::fixed(epoch), validity_ms),
            last_report: None,
            interval_s: 1.0 / scenario.streams.positions.rate_hz,
            command: MirrorCommand {
                epoch,
                sequence: 0,
                answers: 0,
                time_ns: 0,
                validity_ms,
                roll: vec![0.0; mirrors],
                yaw: vec![0.0; mirrors],
            },
            has_command: false,
            journal: Journal::disabled(),
            counters: Counters::default(),
            model,
        }
    }

    /// Chooses epochs by this tenure, as in a room with other controllers.
    pub fn with_tenure(mut self, tenure: Tenure) -> Self {
        self.guard.tenure = tenure;
        self
    }

    /// Handles a message that arrived at `now`; the result names the `poll_*` method to call.
    pub fn handle_message(&mut self, now: Nanos, message: Message<'_>) -> Due {
        let (stream, stamp) = (message.stream(), *message.stamp());
        let sources = self.inbox.sources();
        let accepted = self.inbox.accept(now, message);
        if self.inbox.sources() != sources {
            self.observer.forget();
        }
        if accepted.is_ok() {
            self.journal.record_message(stream, &stamp, now);
        }
        match accepted {
            Ok(()) if stream == Stream::Users => {
                if let Some(report) = self.inbox.users() {
                    self.observer.handle_users(report);
                }
                self.last_report = Some(LastReport { accepted_ns: now, silence_handled: false });
                Due::Command
            }
            Err(Refusal::Stale) if stream == Stream::Users => Due::StaleCommand,
            Ok(()) if stream == Stream::Channel => {
                self.observer.handle_channel(&self.model, &self.inbox);
                Due::Nothing
            }
            Ok(()) if stream == Stream::Telemetry => {
                if let Some(telemetry) = self.inbox.telemetry() {
                    self.guard.handle_telemetry(now, telemetry, &mut self.counters);
                }
                Due::Nothing
            }
            _ => Due::Nothing,
        }
    }

    /// Counts a payload that does not decode.
    pub fn handle_malformed(&mut self, stream: Stream, refusal: Refusal) {
        self.inbox.count_malformed(stream, refusal);
    }

    /// A source has left: another source may own the room at once.
    pub fn handle_source_lost(&mut self, node: NodeKind, source: u64) {
        self.inbox.handle_source_lost(node, source);
    }

    /// A source is alive, perhaps again.
    pub fn handle_source_found(&mut self, node: NodeKind, source: u64) {
        self.inbox.handle_source_found(node, source);
    }

    /// Handles a message that arrived at `now`, and polls the command that it makes due. `mark` is
    /// called as each stage ends.
    pub fn handle_and_poll(
        &mut self,
        now: Nanos,
        message: Message<'_>,
        mark: &mut dyn FnMut(Stage),
    ) -> Option<Decision<'_>> {
        match self.handle_message(now, message) {
            Due::Command => Some(self.poll_command(now, Timing::InTime, mark)),
            Due::StaleCommand => Some(self.poll_stale_command(now)),
            Due::Nothing => None,
        }
    }

    /// Decides for the tick of the last accepted position report. `mark` is called as each stage
    /// ends.
    pub fn poll_command(&mut self, now: Nanos, timing: Timing, mark: &mut dyn FnMut(Stage)) -> Decision<'_> {
        self.journal.record_decision(timing.input(), now);
        // The mode matters only where the action holds; else the policy acts.
        let (mut action, mut mode) = (DegradedAction::Policy, DegradedMode::Held);
        if timing == Timing::Late {
            self.counters.count_degraded(DegradedMode::Late);
            (action, mode) = (self.actions.late, DegradedMode::Late);
        }
        if matches!(action, DegradedAction::Policy | DegradedAction::Fallback) {
            match self.observer.observe(&self.model, &self.inbox, now, &mut self.observation) {
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
            if let Some(telemetry) = self.inbox.telemetry() {
                self.observation.scene.exclude_mirrors(&telemetry.unusable);
            }
            if let Some([roll, yaw]) = self.limits.narrow_axes_rad() {
                self.observation.scene.restrict_to_range(&self.model, &roll, &yaw);
            }
            mark(Stage::Observed);
        }
        self.counters.decisions += 1;
        self.policy.tallies.count_decision();
        let tick = self.inbox.users().map_or(0, |report| report.tick);
        self.execute((action, mode), tick, now, mark)
    }

    /// Executes the action for a position report that was too old.
    pub fn poll_stale_command(&mut self, now: Nanos) -> Decision<'_> {
        self.journal.record_decision(InputKind::StaleDecision, now);
        self.counters.decisions += 1;
        self.policy.tallies.count_decision();
        self.counters.count_degraded(DegradedMode::StaleReport);
        self.execute((self.actions.stale, DegradedMode::StaleReport), 0, now, &mut |_| {})
    }

    /// Executes the action for the absence of position reports at `now`, if that is due.
    ///
    /// A silence is counted once. The action `last-good` is repeated at each call, so call this
    /// method at intervals shorter than the validity of a command.
    pub fn poll_timeout_command(&mut self, now: Nanos) -> Option<Decision<'_>> {
        let LastReport { accepted_ns, silence_handled } = self.last_report?;
        // A clock that steps back must not hide a silence.
        if now.abs_diff(accepted_ns) <= self.actions.silent_after_ns {
            return None;
        }
        self.last_report = Some(LastReport { accepted_ns, silence_handled: true });
        if !silence_handled {
            self.counters.count_degraded(DegradedMode::Silence);
        } else if self.actions.silent != DegradedAction::LastGood {
            return None;
        }
        self.journal.record_decision(InputKind::SilenceDecision, now);
        Some(self.execute((self.actions.silent, DegradedMode::Silence), 0, now, &mut |_| {}))
    }

    /// Cache warm-up: repeats observation and inference of the last decision, so that code and data
    /// stay in the processor's caches.
    ///
    /// No later command depends on it. It does nothing before the first decision.
    pub fn warm_cache(&mut self) {
        if self.command.answers == 0 {
            return;
        }
        let observed = self.observer.observe(&self.model, &self.inbox, self.command.time_ns, &mut self.observation);
        if observed.is_some() && self.observation.users() > 0 {
            // The next decision overwrites this proposal before it reads it.
            self.policy.warm_cache(&self.model, &self.observation, &mut self.proposed);
        }
    }

    /// Start-up warm-up: policy and fallback decide for a synthetic room, once for each item of
    /// `runs`. Buffers then have their final sizes, and the caches are warm. Only the state of
    /// stateful policies changes.
    pub fn warm_up(&mut self, runs: impl Iterator) {
        self.policy.warm_up(&self.model, self.observation.users(), runs);
    }

    /// Replaces the policy, and returns the former one. The new policy should have had its
    /// start-up warm-up.
    pub fn replace_policy(&mut self, policy: Box<dyn Policy>) -> Box<dyn Policy> {
        self.policy.replace_policy(policy)
    }

    /// Proposes angles by `action`, limits them and completes the command.
    fn execute(
        &mut self,
        (action, mode): (DegradedAction, DegradedMode),
        tick: u64,
        now: Nanos,
        mark: &mut dyn FnMut(Stage),
    ) -> Decision<'_> {
        match self.guard.permit(now, self.inbox.telemetry(), &mut self.counters) {
            Ok(epoch) => self.command.epoch = epoch,
            Err(withheld) => {
                self.counters.count_degraded(withheld);
                return Decision::Hold(withheld);
            }
        }
        let elapsed_s = self.settle_angles(now);
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
        let clipped = self.limits.bound(&self.observation.angles, elapsed_s, &mut self.proposed);
        self.counters.clipped.range += clipped.range;
        self.counters.clipped.slew += clipped.slew;
        self.policy.tallies.count_command(is_own, clipped);
        self.complete_command(tick, now);
        mark(Stage::MadeSafe);
        let sampled_ns = self.inbox.users().map_or(now, |report| report.stamp.time_ns);
        Decision::Move { command: &mut self.command, age_ns: now.saturating_sub(sampled_ns) }
    }

    /// Sets the observation's angles to those of the mirrors, and returns the time in s since the
    /// mirrors received them.
    ///
    /// The angles are those of the last command while it is valid, and otherwise those of the last
    /// telemetry. Without telemetry all mirrors are flat.
    fn settle_angles(&mut self, now: Nanos) -> f64 {
        let since_command_ns = now.saturating_sub(self.command.time_ns);
        if self.has_command && since_command_ns <= u64::from(self.command.validity_ms) * 1_000_000 {
            return since_command_ns as f64 * 1e-9;
        }
        let angles = &mut self.observation.angles;
        match self.inbox.telemetry() {
            Some(telemetry) => {
                copy_widened(&telemetry.roll_commanded, &mut angles.roll);
                copy_widened(&telemetry.yaw_commanded, &mut angles.yaw);
            }
            None => {
                angles.roll.fill(0.0);
                angles.yaw.fill(0.0);
            }
        }
        self.interval_s
    }

    /// The action for a report without users: no angle is better than the last one.
    fn without_users(&self) -> DegradedAction {
        if self.has_command { DegradedAction::LastGood } else { DegradedAction::Park }
    }

    /// Lets the policy propose, or else the fallback.
    fn propose(&mut self) -> ProposedBy {
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
        self.has_command
    }

    fn complete_command(&mut self, tick: u64, now: Nanos) {
        self.counters.commands += 1;
        self.journal.record_command();
        self.has_command = true;
        self.command.sequence = 0;
        self.command.answers = tick;
        self.command.time_ns = now;
        copy_narrowed(&self.proposed.roll, &mut self.command.roll);
        copy_narrowed(&self.proposed.yaw, &mut self.command.yaw);
        self.observation.set_angles(&self.proposed);
        self.observer.handle_command(&self.command);
    }
}

fn copy_widened(from: &[f32], to: &mut [f64]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = f64::from(*from);
    }
}

fn copy_narrowed(from: &[f64], to: &mut [f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from as f32;
    }
}
