//! Results of the core: what is due after an input, decisions, degraded modes, and counters.

use std::ops::Range;

use heliostat_channel::MirrorArrays;
use heliostat_proto::{InputKind, MirrorCommand, Nanos, named};

use crate::output::{safety::Clipped, tenure::TenureEvent};

named! {
    /// A stage of a decision that has just ended; a caller may record its time.
    pub enum Stage {
        /// The report's waiting time has ended.
        Waited = "wait",
        /// The payload is decoded.
        Decoded = "decode",
        /// The observation is complete.
        Observed = "observe",
        /// The policy, or its fallback, has proposed angles.
        Inferred = "infer",
        /// The proposal is within its limits, and the command is complete.
        MadeSafe = "safe",
        /// The command was handed to the transport.
        Published = "publish",
    }
}

/// What the caller has to poll after a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Due {
    /// The message completes a tick: call `Controller::poll_command`.
    Command,
    /// The message is a position report that is too old: call
    /// `Controller::poll_stale_command`.
    StaleCommand,
    /// Nothing.
    Nothing,
}

/// Whether the predicted latency of a decision is within `control.deadline_ms`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Timing {
    /// The predicted latency is within the deadline.
    InTime,
    /// The predicted latency exceeds the deadline.
    Late,
}

impl Timing {
    /// The decision as an input in the contract.
    pub fn input(self) -> InputKind {
        match self {
            Self::InTime => InputKind::Decision,
            Self::Late => InputKind::LateDecision,
        }
    }
}

/// The result of a poll.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Decision<'a> {
    /// The mirrors turn.
    Move {
        /// The angles of all mirrors. In a room with one array this is what to send.
        command: &'a MirrorCommand,
        /// In a room with several arrays, what to send to each; else empty.
        parts: &'a [ArrayCommand],
        /// Age of the positions on which the decision is based, in ns.
        age_ns: Nanos,
    },
    /// No command. The array keeps its angles until the validity of the last command plus the
    /// driver's `park_after_ms` has passed, then moves to its park position.
    Hold(DegradedMode),
}

/// The command of a decision to one of several arrays.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArrayCommand {
    /// Index of the array.
    pub array: usize,
    /// Whether the array gets this command; else it gets none.
    pub is_given: bool,
    /// The command.
    pub command: MirrorCommand,
    /// Its mirrors among those of the room.
    mirrors: Range<usize>,
}

impl ArrayCommand {
    /// Flat mirrors for each of several arrays; nothing for one.
    pub(crate) fn parts(arrays: &MirrorArrays) -> Vec<Self> {
        let part = |(array, mirrors): (usize, Range<usize>)| {
            let flat = vec![0.0; mirrors.len()];
            let command = MirrorCommand { roll: flat.clone(), yaw: flat, ..MirrorCommand::default() };
            Self { array, is_given: false, command, mirrors }
        };
        let ranges = arrays.ranges().map(|(_, mirrors)| mirrors).enumerate();
        if arrays.arrays().len() > 1 { ranges.map(part).collect() } else { Vec::new() }
    }

    /// Takes the part of a command to all mirrors, with epoch and sequence of its own; without these
    /// the array gets none. Does not allocate.
    pub(crate) fn set(&mut self, all: &MirrorCommand, number: Option<(u64, u64)>, validity_ms: u32) {
        self.is_given = number.is_some();
        let MirrorCommand { roll, yaw, .. } = &mut self.command;
        roll.copy_from_slice(&all.roll[self.mirrors.clone()]);
        yaw.copy_from_slice(&all.yaw[self.mirrors.clone()]);
        let (roll, yaw) = (std::mem::take(roll), std::mem::take(yaw));
        let (epoch, sequence) = number.unwrap_or_default();
        self.command = MirrorCommand { epoch, sequence, validity_ms, roll, yaw, ..*all };
    }
}

impl<'a> Decision<'a> {
    /// The commands to send, each with the index of its array.
    pub fn commands(&self) -> impl Iterator<Item = (usize, &'a MirrorCommand)> + use<'a> {
        let (command, parts): (_, &[ArrayCommand]) = match *self {
            Self::Move { command, parts, .. } => (Some(command), parts),
            Self::Hold(_) => (None, &[]),
        };
        let only = command.filter(|_| parts.is_empty()).map(|command| (0, command));
        let given = parts.iter().filter(|part| part.is_given).map(|part| (part.array, &part.command));
        only.into_iter().chain(given)
    }
}

named! {
    /// A condition outside normal operation. The table at the head of [`crate::core`] lists the
    /// actions.
    pub enum DegradedMode {
        /// The predicted latency exceeded the deadline.
        Late = "late",
        /// The position report was too old.
        StaleReport = "stale-report",
        /// The gains of the direct paths are modelled, not measured.
        ChannelMissing = "channel-missing",
        /// No position report arrives.
        Silence = "silence",
        /// The policy failed and the fallback acted.
        PolicyFailed = "policy-failed",
        /// Neither policy nor fallback gave angles.
        Held = "held",
        /// An array is stopped, or does not fit the scenario; or one of several has left.
        Withheld = "withheld",
        /// The array follows another controller.
        Standby = "standby",
    }
}

/// Counters of a controller since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Decisions on position reports: commands, and decisions to send none.
    pub decisions: u64,
    /// Commands given, one for each array.
    pub commands: u64,
    /// Axis values that the limits changed.
    pub clipped: Clipped,
    /// Users beyond the capacity of the policy, one for each decision.
    pub unserved_users: u64,
    /// Users with a modelled gain because the channel report lacks them, one for each decision.
    pub unmeasured_users: u64,
    /// Decisions on modelled gains in a room that has never reported gains.
    pub modelled: u64,
    /// Capabilities and safety reports of a source other than the array that is followed.
    pub foreign_arrays: u64,
    /// Array and source of the last of them.
    pub last_foreign_array: Option<(usize, u64)>,
    degraded: [u64; DegradedMode::ALL.len()],
    tenure: [u64; TenureEvent::ALL.len()],
}

impl Counters {
    /// Number of decisions in this degraded mode.
    pub fn degraded(&self, mode: DegradedMode) -> u64 {
        self.degraded[mode as usize]
    }

    /// Number of events of this kind.
    pub fn tenure(&self, event: TenureEvent) -> u64 {
        self.tenure[event as usize]
    }

    pub(crate) fn count_tenure(&mut self, event: TenureEvent) {
        self.tenure[event as usize] += 1;
    }

    pub(crate) fn count_degraded(&mut self, mode: DegradedMode) {
        self.degraded[mode as usize] += 1;
    }
}
