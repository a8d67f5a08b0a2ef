//! The words of the deciding core: stages, answers, departures from the plain way, and the counters of all that.

use heliostat_proto::{MirrorCommand, Nanos};

use crate::safety::Clipped;

/// What was just finished, for a ledger at the edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// It was this message's turn.
    Waited,
    /// The payload became a message.
    Decoded,
    /// The observation is complete.
    Observed,
    /// The policy, or its fallback, proposed angles.
    Inferred,
    /// The proposal is within its limits, and the command complete.
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

/// What a message meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Accepted {
    /// It completes a tick, which `Controller::decide` answers.
    Tick,
    /// It would complete a tick, but is too old; `Controller::answer_stale` answers it.
    TooOld,
    /// Nothing is to be answered.
    Other,
}

/// Whether a decision is in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Haste {
    /// There is time for the policy.
    InTime,
    /// The policy's answer would come too late.
    Late,
}

/// The answer to a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Decision<'a> {
    /// The mirrors are to turn.
    Move {
        /// What to send.
        command: &'a MirrorCommand,
        /// Age of the positions acted on, in ns.
        age_ns: Nanos,
    },
    /// No command: the array holds the last one, and parks when its validity ends.
    Hold(Departure),
}

/// How a tick left the plain way; the table of the module has the answer to each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Departure {
    /// The decision would have been late.
    Late,
    /// The position report was too old.
    StaleReport,
    /// The gains of the direct paths are modelled, not measured.
    ChannelMissing,
    /// No position report came any more.
    Silence,
    /// The policy failed and the fallback acted.
    PolicyFailed,
    /// Nothing could act.
    Held,
    /// The array is stopped, or does not fit.
    Withheld,
}

impl Departure {
    /// All departures, in the order of their counters.
    pub const ALL: [Self; 7] = [
        Self::Late,
        Self::StaleReport,
        Self::ChannelMissing,
        Self::Silence,
        Self::PolicyFailed,
        Self::Held,
        Self::Withheld,
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
        }
    }
}

/// What a controller did so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Position reports that got an answer, be it to hold.
    pub decisions: u64,
    /// Commands among the answers.
    pub commands: u64,
    /// Axis values that the limits changed.
    pub clipped: Clipped,
    departures: [u64; Departure::ALL.len()],
}

impl Counters {
    /// How often a tick left the plain way like this.
    pub fn departures(&self, departure: Departure) -> u64 {
        self.departures[departure as usize]
    }

    pub(crate) fn depart(&mut self, departure: Departure) {
        self.departures[departure as usize] += 1;
    }
}
