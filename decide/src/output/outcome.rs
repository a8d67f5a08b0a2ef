//! Results of the core: what is due after an input, decisions, degraded modes, and counters.

use heliostat_proto::{InputKind, MirrorCommand, Nanos};

use crate::output::{safety::Clipped, tenure::TenureEvent};

/// A stage of a decision that has just ended; a caller may record its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The report's waiting time has ended.
    Waited,
    /// The payload is decoded.
    Decoded,
    /// The observation is complete.
    Observed,
    /// The policy, or its fallback, has proposed angles.
    Inferred,
    /// The proposal is within its limits, and the command is complete.
    MadeSafe,
    /// The command was handed to the transport.
    Published,
}

impl Stage {
    /// All stages in the order in which they pass.
    pub const ALL: [Self; 6] =
        [Self::Waited, Self::Decoded, Self::Observed, Self::Inferred, Self::MadeSafe, Self::Published];

    /// The name in summaries.
    pub fn name(self) -> &'static str {
        match self {
            Self::Waited => "wait",
            Self::Decoded => "decode",
            Self::Observed => "observe",
            Self::Inferred => "infer",
            Self::MadeSafe => "safe",
            Self::Published => "publish",
        }
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
#[derive(Debug, PartialEq)]
pub enum Decision<'a> {
    /// The mirrors turn.
    Move {
        /// What to send. Its sequence number is 0: the sender assigns it.
        command: &'a mut MirrorCommand,
        /// Age of the positions on which the decision is based, in ns.
        age_ns: Nanos,
    },
    /// No command. The array keeps its angles until the validity of the last command plus the
    /// driver's `park_after_ms` has passed, then moves to its park position.
    Hold(DegradedMode),
}

/// A condition outside normal operation. The table at the head of [`crate::core`] lists the
/// actions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DegradedMode {
    /// The predicted latency exceeded the deadline.
    Late,
    /// The position report was too old.
    StaleReport,
    /// The gains of the direct paths are modelled, not measured.
    ChannelMissing,
    /// No position report arrives.
    Silence,
    /// The policy failed and the fallback acted.
    PolicyFailed,
    /// Neither policy nor fallback gave angles.
    Held,
    /// The array is stopped, or does not fit the scenario.
    Withheld,
    /// The array follows another controller.
    Standby,
}

impl DegradedMode {
    /// All modes, in the order of their counters.
    pub const ALL: [Self; 8] = [
        Self::Late,
        Self::StaleReport,
        Self::ChannelMissing,
        Self::Silence,
        Self::PolicyFailed,
        Self::Held,
        Self::Withheld,
        Self::Standby,
    ];

    /// The name in counters.
    pub fn name(self) -> &'static str {
        match self {
            Self::Late => "late",
            Self::StaleReport => "stale-report",
            Self::ChannelMissing => "channel-missing",
            Self::Silence => "silence",
            Self::PolicyFailed => "policy-failed",
            Self::Held => "held",
            Self::Withheld => "withheld",
            Self::Standby => "standby",
        }
    }
}

/// Counters of a controller since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Decisions on position reports: commands, and decisions to send none.
    pub decisions: u64,
    /// Commands given.
    pub commands: u64,
    /// Axis values that the limits changed.
    pub clipped: Clipped,
    /// Users beyond the capacity of the policy, one for each decision.
    pub unserved_users: u64,
    /// Users with a modelled gain because the channel report lacks them, one for each decision.
    pub unmeasured_users: u64,
    /// Capabilities and safety reports of a source other than the array that is followed.
    pub foreign_arrays: u64,
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
