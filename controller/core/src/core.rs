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
//!    [`handle_stops`](Controller::handle_stops) for the array;
//! 3. the `poll_*` method that `handle_message` names by [`Due`]:
//!    [`poll_command`](Controller::poll_command) or
//!    [`poll_stale_command`](Controller::poll_stale_command). Several messages may be handled
//!    before one poll; the poll then decides for the newest tick. A learner that proposes angles
//!    itself polls [`poll_observation`](Controller::poll_observation), then
//!    [`poll_proposed`](Controller::poll_proposed).
//!    [`handle_and_poll`](Controller::handle_and_poll) does both steps for one message;
//! 4. [`poll_timeout_command`](Controller::poll_timeout_command) again and again, at intervals
//!    shorter than the validity of a command, so that the controller also acts when reports are
//!    absent.
//!
//! A decision numbers its commands: for each array from 1 in each epoch, rising by one. The number
//! of a command that the transport refuses is used up; an array accepts such gaps. Getters may be
//! called at any time. No method waits, logs, reads a clock or, after the start-up warm-up,
//! allocates in this project's code.
//!
//! # Users
//!
//! A position report may have 0 to 64 users, and other users than the last one. The reports are
//! matched by the users' numbers ([`observer`](crate::observer)). A user without an entry in the
//! channel report has a modelled gain. A policy with fewer slots serves the users with the largest
//! minimum rates ([`selection`](crate::selection)). For a report without users the command repeats
//! the last command, or has flat mirrors where there was none. Counters have the users without an
//! entry, and those without a slot.
//!
//! # The last command
//!
//! The last command to an array is the controller's own one while that is valid. Afterwards it is
//! the one that the array follows by telemetry, if it follows one. A controller that takes over
//! therefore repeats the command of the former leader. Commands on the network are no inputs: a
//! forged one changes nothing here, and a recording lists the telemetry.
//!
//! # Several arrays
//!
//! One decision gives the angles of all mirrors, and one command for each array. Each array has an
//! epoch, a stop and limits of its own. The mirrors of an array that gets no command are left out
//! like mirrors that do not follow, and the others are commanded. Both withheld modes are counted
//! once for each array.
//!
//! # Degraded modes
//!
//! Each degraded condition has one action and one counter. Where the table names a key, that key
//! of the scenario's `control` table selects the action. The caller's watchdog detects and counts
//! `unanswered`, whose only action is to give no command.
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
//! | An array is stopped, or does not fit the scenario; or one of several has left. | | no command to it | `withheld` |
//! | An array follows another controller: [`tenure`](crate::tenure). | | no command to it | `standby` |
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

mod array;
mod array_output;
mod decision;
mod figures;
mod held_stops;
mod journal;
pub mod memory;

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};
use heliostat_proto::{InputKind, MAX_USERS, MirrorCommand, Nanos, NodeKind};
use heliostat_scenario::{Control, DegradedAction, Scenario};
use serde::{Deserialize, Serialize};

pub use decision::Observed;

pub use crate::output::outcome::{ArrayCommand, Counters, Decision, DegradedMode, Due, Stage, Timing};
use crate::{
    input::{
        inbox::{Inbox, Message, publishes},
        refusal::{Refusal, Stream},
    },
    observe::{observation::Observation, observer::Observer},
    output::tenure::Tenure,
    policy::{self, Policy, WithFallback},
};
use array_output::ArrayOutput;
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
    control: Control,
    arrays: Vec<ArrayOutput>,
    /// In a replay, the arrays without a command in the next decision, by bits.
    repeated: Option<u64>,
    /// The last accepted position report; absent before the first.
    last_report: Option<LastReport>,
    /// Nominal time between position reports in s.
    interval_s: f64,
    proposed: MirrorAngles,
    /// Whether `proposed` holds angles of the caller for the command that is due.
    is_proposed: bool,
    /// The last command to all mirrors, with the number of the first array that got one. Its time is
    /// 0 before the first. An array that follows another controller has the angles of that one's.
    command: MirrorCommand,
    /// The same for each of several arrays; empty in a room with one.
    parts: Vec<ArrayCommand>,
    journal: Journal,
    counters: Counters,
}

/// When the last position report was accepted, and whether its absence since then was handled.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct LastReport {
    accepted_ns: Nanos,
    silence_handled: bool,
}

impl Controller {
    /// A controller of a scenario's room with this policy, which commands under one epoch; see
    /// [`with_tenure`](Self::with_tenure).
    pub fn new(scenario: &Scenario, model: ChannelModel, policy: Box<dyn Policy>, epoch: u64) -> Self {
        let observation = Observation::with_capacity(&model, scenario.users.count, MAX_USERS);
        let mirrors = model.mirrors.len();
        Self {
            inbox: Inbox::new(scenario),
            observer: Observer::new(scenario, &model),
            proposed: observation.angles.clone(),
            is_proposed: false,
            observation,
            policy: WithFallback::new(policy, policy::build_fallback(scenario.control.fallback, scenario)),
            control: scenario.control.clone(),
            parts: ArrayCommand::parts(&model.mirrors),
            arrays: ArrayOutput::of(scenario, &model.mirrors, epoch),
            repeated: None,
            last_report: None,
            interval_s: 1.0 / scenario.streams.positions.rate_hz,
            command: MirrorCommand {
                epoch,
                sequence: 0,
                answers: 0,
                time_ns: 0,
                validity_ms: scenario.control.command_validity_ms(),
                roll: vec![0.0; mirrors],
                yaw: vec![0.0; mirrors],
            },
            journal: Journal::default(),
            counters: Counters::default(),
            model,
        }
    }

    /// A copy with a new policy of the same kind, which continues from the present state. From then
    /// on both give the same commands for the same inputs.
    pub fn duplicate(&self, scenario: &Scenario, policy: Box<dyn Policy>) -> Self {
        Self {
            model: self.model.clone(),
            inbox: self.inbox.clone(),
            observer: self.observer.clone(),
            observation: self.observation.clone(),
            policy: self.policy.duplicate(policy, policy::build_fallback(scenario.control.fallback, scenario)),
            control: self.control.clone(),
            arrays: self.arrays.clone(),
            repeated: self.repeated,
            last_report: self.last_report,
            interval_s: self.interval_s,
            proposed: self.proposed.clone(),
            is_proposed: self.is_proposed,
            command: self.command.clone(),
            parts: self.parts.clone(),
            journal: self.journal.clone(),
            counters: self.counters,
        }
    }

    /// Chooses epochs by this tenure, as in a room with other controllers.
    pub fn with_tenure(mut self, tenure: Tenure) -> Self {
        self.arrays.iter_mut().for_each(|array| array.guard.tenure = tenure.clone());
        self
    }

    /// Handles a message that arrived at `now`; the result names the `poll_*` method to call.
    pub fn handle_message(&mut self, now: Nanos, message: Message<'_>) -> Due {
        let (stream, array, &stamp) = message.origin();
        let sources = self.inbox.sources();
        let accepted = self.inbox.accept(now, message);
        if self.inbox.sources() != sources {
            self.observer.forget();
        }
        if accepted.is_ok() {
            self.journal.record_message((stream, array), &stamp, now);
        }
        match (stream, accepted) {
            (Stream::Users, Ok(())) => {
                if let Some(report) = self.inbox.users() {
                    self.observer.handle_users(report);
                }
                self.last_report = Some(LastReport { accepted_ns: now, silence_handled: false });
                self.arrays.iter_mut().for_each(|array| array.guard.tenure.handle_report(now, &stamp));
                return Due::Command;
            }
            (Stream::Users, Err(Refusal::Stale)) => return Due::StaleCommand,
            (Stream::Channel, Ok(())) => self.observer.handle_channel(&self.model, &self.inbox),
            (Stream::Orientation, Ok(())) => {
                if let Some(report) = self.inbox.last_orientation() {
                    self.observer.handle_orientation(report);
                }
            }
            (Stream::Telemetry, Ok(())) => {
                if let Some(telemetry) = self.inbox.telemetry(array) {
                    self.arrays[array].handle_telemetry(now, telemetry, &mut self.counters);
                    self.arrays[array].adopt(now, telemetry, &mut self.command);
                }
            }
            // The next channel report is compared with them.
            (Stream::Obstacles | Stream::Leds, Ok(())) | (_, Err(_)) => {}
        }
        Due::Nothing
    }

    /// Counts a payload of a stream, and of an array for telemetry, that does not decode.
    pub fn handle_malformed(&mut self, place: (Stream, usize), refusal: Refusal, payload: &[u8]) {
        self.inbox.count_malformed(place, refusal, payload);
    }

    /// A source has left: another source may own the room at once.
    pub fn handle_source_lost(&mut self, node: NodeKind, source: u64) {
        self.note_controller(node, source, false);
        for (index, array) in self.arrays.iter_mut().enumerate() {
            if publishes(node, Stream::Telemetry) && self.inbox.array_source(index) == Some(source) {
                array.has_left = true;
            }
        }
        self.inbox.handle_source_lost(node, source);
    }

    /// A source is alive, perhaps again.
    pub fn handle_source_found(&mut self, node: NodeKind, source: u64) {
        self.note_controller(node, source, true);
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
        let action = self.observe(now, timing, mark);
        self.decide(action, now, mark)
    }

    /// Executes the action for a position report that was too old.
    pub fn poll_stale_command(&mut self, now: Nanos) -> Decision<'_> {
        self.journal.record_decision(InputKind::StaleDecision, now);
        self.counters.decisions += 1;
        self.policy.tallies.count_decision();
        self.counters.count_degraded(DegradedMode::StaleReport);
        self.update_permits(now, true);
        self.execute((self.control.when_stale, DegradedMode::StaleReport), 0, now, &mut |_| {})
    }

    /// Executes the action for the absence of position reports at `now`, if that is due.
    ///
    /// A silence is counted once. The action `last-good` is repeated at each call, so call this
    /// method at intervals shorter than the validity of a command.
    pub fn poll_timeout_command(&mut self, now: Nanos) -> Option<Decision<'_>> {
        let LastReport { accepted_ns, silence_handled } = self.last_report?;
        // A clock that steps back must not hide a silence.
        if now.abs_diff(accepted_ns) <= self.control.report_age_max_ns() {
            return None;
        }
        self.last_report = Some(LastReport { accepted_ns, silence_handled: true });
        if !silence_handled {
            self.counters.count_degraded(DegradedMode::Silence);
        } else if self.control.when_silent != DegradedAction::LastGood {
            return None;
        }
        self.journal.record_decision(InputKind::SilenceDecision, now);
        self.update_permits(now, false);
        Some(self.execute((self.control.when_silent, DegradedMode::Silence), 0, now, &mut |_| {}))
    }

    /// Repeats a recorded decision; `None` for one about an absence that is not due.
    pub fn poll_recorded(&mut self, decision: InputKind, now: Nanos) -> Option<Decision<'_>> {
        match decision {
            InputKind::LateDecision => Some(self.poll_command(now, Timing::Late, &mut |_| {})),
            InputKind::StaleDecision => Some(self.poll_stale_command(now)),
            InputKind::SilenceDecision => self.poll_timeout_command(now),
            _ => Some(self.poll_command(now, Timing::InTime, &mut |_| {})),
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
}
