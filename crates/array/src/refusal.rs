//! Why an array refuses a command or a re-arm.

use heliostat_proto::{Nanos, StopName};
use thiserror::Error;

/// Why a command is refused.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Refusal {
    /// Another number of mirrors.
    #[error("a command for an array of size {found}: expected {expected}, the number of its mirrors")]
    WrongCount {
        /// Mirrors in the command.
        found: usize,
        /// Mirrors of the array.
        expected: usize,
    },
    /// An angle is not a number or infinite.
    #[error("an angle of mirror {mirror} is not finite: expected a number in rad")]
    NonFinite {
        /// The first such mirror.
        mirror: usize,
    },
    /// An emergency stop is latched.
    #[error("an emergency stop is latched: re-arm the array first")]
    Stopped,
    /// A sender with a higher epoch has superseded this one.
    #[error(
        "a command of epoch {found}: expected at least {followed}, the epoch that the array follows; \
         end the superseded controller that sends it"
    )]
    LowerEpoch {
        /// Epoch of the command.
        found: u64,
        /// Epoch that the array follows.
        followed: u64,
    },
    /// The command was superseded or repeated.
    #[error("a command of sequence {found}: expected more than {last}, the last one of this epoch")]
    OldSequence {
        /// Sequence number of the command.
        found: u64,
        /// Last sequence number that was accepted.
        last: u64,
    },
    /// The command arrived after its validity had ended.
    #[error("a command {age_ms:.1} ms old: expected less than {validity_ms} ms, its validity")]
    Expired {
        /// Age on arrival in ms.
        age_ms: f64,
        /// Its validity in ms.
        validity_ms: u32,
    },
    /// The time of the command is in the future: the clocks differ.
    #[error("a command {lead_ms:.1} ms in the future: synchronise the clocks of sender and driver")]
    FromFuture {
        /// The lead of its time in ms.
        lead_ms: f64,
    },
    /// The epoch would leave no room for the epochs of later controllers.
    #[error(
        "a command of epoch {found}: expected at most {bound}; start the controller with UTC in ms, \
         or with one more than the epoch in telemetry"
    )]
    EpochBound {
        /// Epoch of the command.
        found: u64,
        /// Highest epoch that the array accepts at this time.
        bound: u64,
    },
    /// The sequence number would leave no room for later commands of the epoch.
    #[error("a command of sequence {found}: expected at most {bound}; continue with a new epoch")]
    SequenceBound {
        /// Sequence number of the command.
        found: u64,
        /// Highest sequence number that the array accepts at this time.
        bound: u64,
    },
    /// The command would hold the array for too long after its sender is lost.
    #[error("a command with a validity of {found_ms} ms: expected at most {bound_ms} ms")]
    ValidityBound {
        /// Validity of the command in ms.
        found_ms: u32,
        /// Longest validity that the array accepts, in ms.
        bound_ms: u32,
    },
}

impl Refusal {
    /// The name under which it is counted.
    pub fn name(&self) -> &'static str {
        match self {
            Self::WrongCount { .. } => "wrong-mirror-count",
            Self::NonFinite { .. } => "not-finite",
            Self::Stopped => "stopped",
            Self::LowerEpoch { .. } => "lower-epoch",
            Self::OldSequence { .. } => "old-sequence",
            Self::Expired { .. } => "expired",
            Self::FromFuture { .. } => "from-future",
            Self::EpochBound { .. } => "epoch-bound",
            Self::SequenceBound { .. } => "sequence-bound",
            Self::ValidityBound { .. } => "validity-bound",
        }
    }
}

/// Why a re-arm does not release the array.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum RearmRefusal {
    /// There is nothing to release.
    #[error("a re-arm of an array that is not stopped: nothing to release")]
    NotStopped,
    /// It names a stop that is not latched.
    #[error("a re-arm of stop {found}: expected {latest}, or another stop in the stop report")]
    OtherStop {
        /// The name in the re-arm.
        found: StopName,
        /// The name of the stop that was latched last.
        latest: StopName,
    },
    /// A re-arm of kind 9 that is not later than the stop.
    #[error("a re-arm of time {found_ns} ns: expected later than {stopped_ns} ns, the time of the latched stop")]
    TooEarly {
        /// Time of the re-arm.
        found_ns: Nanos,
        /// Time of the earliest latched stop.
        stopped_ns: Nanos,
    },
    /// A re-arm of kind 9 where only a named one counts.
    #[error("a re-arm of kind 9 in an authenticated room: expected kind 13, which names the stop that it releases")]
    Unnamed,
}

impl RearmRefusal {
    /// The name under which it is counted.
    pub fn name(&self) -> &'static str {
        match self {
            Self::NotStopped => "not-stopped",
            Self::OtherStop { .. } => "other-stop",
            Self::TooEarly { .. } => "too-early",
            Self::Unnamed => "unnamed",
        }
    }
}
