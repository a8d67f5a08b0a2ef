//! What a [`Tenure`](super::Tenure) reads of telemetry, what it keeps of it, and what it says of a change.

use heliostat_proto::{ArrayState, MirrorTelemetry, Nanos};

/// A change of the standing or of the epoch, or a reason that commands are refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TenureEvent {
    /// Telemetry shows a higher epoch: standby begins.
    Superseded,
    /// Telemetry shows no higher epoch, or is absent: standby ends, with the same epoch.
    Resumed,
    /// A new epoch: the controller has just started, or it ends a standby in which the array
    /// accepted no command or the leader left.
    TookOver,
    /// The array refused every command: a new epoch.
    LockedOut,
    /// The array applied a command of the own epoch that this controller never sent: a new epoch.
    ForeignSequence,
    /// The array refused every command as expired: the clocks differ. The epoch stays.
    ClocksDiffer,
    /// The array follows another controller at the first report: standby begins.
    StoodBy,
    /// The former leader still commands after a takeover.
    Contested,
}

impl TenureEvent {
    /// All events, in the order of their counters.
    pub const ALL: [Self; 8] = [
        Self::Superseded,
        Self::Resumed,
        Self::TookOver,
        Self::LockedOut,
        Self::ForeignSequence,
        Self::ClocksDiffer,
        Self::StoodBy,
        Self::Contested,
    ];

    /// The name in counters.
    pub fn name(self) -> &'static str {
        match self {
            Self::Superseded => "superseded",
            Self::Resumed => "resumed",
            Self::TookOver => "took-over",
            Self::LockedOut => "locked-out",
            Self::ForeignSequence => "foreign-sequence",
            Self::ClocksDiffer => "clocks-differ",
            Self::StoodBy => "stood-by",
            Self::Contested => "contested",
        }
    }
}

/// What telemetry shows about the commands that the array accepts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Evidence {
    /// Epoch of the command last applied; 0 before the first.
    pub epoch: u64,
    /// Its sequence number.
    pub applied_sequence: u64,
    /// Commands accepted.
    pub accepted: u64,
    /// Commands refused as malformed or out of bounds, for their epoch, or for their sequence.
    pub refused: u64,
    /// Commands refused as expired.
    pub expired: u64,
    /// An emergency stop is latched.
    pub stopped: bool,
    /// The last command is valid.
    pub following: bool,
}

impl From<&MirrorTelemetry> for Evidence {
    fn from(telemetry: &MirrorTelemetry) -> Self {
        let counters = &telemetry.counters;
        Self {
            epoch: telemetry.epoch,
            applied_sequence: telemetry.applied_sequence,
            accepted: counters.accepted,
            refused: counters.rejected.saturating_add(counters.old_epoch).saturating_add(counters.old_sequence),
            expired: counters.expired,
            stopped: telemetry.state == ArrayState::Stopped,
            following: telemetry.state == ArrayState::Following,
        }
    }
}

/// Commands that were due since the array last accepted one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Unaccepted {
    pub(super) since_ns: Nanos,
    pub(super) last_ns: Nanos,
    /// Counted up to [`DUE_MIN`](super::DUE_MIN).
    pub(super) due: u8,
    /// The evidence at the beginning.
    pub(super) before: Evidence,
}

/// What a standby has seen of the leader.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Watch {
    /// The report whose answer is awaited, and the commands accepted until then.
    pub(super) awaited: Option<(Nanos, u64)>,
    /// The last report.
    pub(super) last_ns: Nanos,
    /// Reports without an accepted command, in sequence.
    pub(super) unanswered: u8,
    /// The liveliness token of the leader has ended.
    pub(super) has_left: bool,
}

/// The evidence at a takeover, until it is settled or contested.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Takeover {
    pub(super) refused: u64,
    pub(super) accepted: u64,
}
