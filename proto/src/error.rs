//! Why a payload is refused.

use thiserror::Error;

use crate::codec::Kind;
use crate::{MAX_PAYLOAD, VERSION};

/// What is wrong with a payload or a message, and what was wanted.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum CodecError {
    /// Longer than any payload may be.
    #[error("payload of {found} bytes: at most {MAX_PAYLOAD} are allowed")]
    Oversized {
        /// Bytes found.
        found: usize,
    },
    /// Too short even for the two bytes of the header.
    #[error("payload of {found} bytes: the header alone has 2, version and kind")]
    NoHeader {
        /// Bytes found.
        found: usize,
    },
    /// Of another version of the contract.
    #[error("payload of contract version {found}: this program speaks version {VERSION}")]
    WrongVersion {
        /// Version found.
        found: u8,
    },
    /// A kind of message that does not exist in this version.
    #[error("payload of kind {found}, which does not exist in version {VERSION}")]
    UnknownKind {
        /// Number found.
        found: u8,
    },
    /// Another kind of message than belongs here.
    #[error("payload holds a {found}: wanted a {wanted}")]
    WrongKind {
        /// Kind found.
        found: Kind,
        /// Kind wanted.
        wanted: Kind,
    },
    /// The payload ends too soon.
    #[error("{kind}: payload ends within {field}")]
    Truncated {
        /// Kind of message.
        kind: Kind,
        /// Field in which it ends.
        field: &'static str,
    },
    /// Bytes that cannot be a value of the field's type.
    #[error("{kind}: bytes of {field} are no valid value: {problem}")]
    Malformed {
        /// Kind of message.
        kind: Kind,
        /// Field.
        field: &'static str,
        /// What is wrong with them.
        problem: String,
    },
    /// Bytes are left after the last field.
    #[error("{kind}: {extra} bytes are left after the last field")]
    TrailingBytes {
        /// Kind of message.
        kind: Kind,
        /// How many are left.
        extra: usize,
    },
    /// A list or a text is longer than allowed.
    #[error("{kind}: {field} has a length of {found}: at most {limit} is allowed")]
    TooMany {
        /// Kind of message.
        kind: Kind,
        /// Field.
        field: &'static str,
        /// Length found.
        found: u64,
        /// Length allowed.
        limit: usize,
    },
    /// Two lists that go together have different lengths.
    #[error("{kind}: {field} has {found} entries: wanted {wanted}, as many as {like}")]
    LengthMismatch {
        /// Kind of message.
        kind: Kind,
        /// Field.
        field: &'static str,
        /// Entries found.
        found: usize,
        /// The field that it goes with.
        like: &'static str,
        /// Entries of that field.
        wanted: usize,
    },
    /// A number is NaN or infinite.
    #[error("{kind}: {field} at index {index} is {value}: wanted a finite number")]
    NotFinite {
        /// Kind of message.
        kind: Kind,
        /// Field.
        field: &'static str,
        /// Index in its list; 0 where there is none.
        index: usize,
        /// The number.
        value: f64,
    },
    /// A number has no meaning in its field.
    #[error("{kind}: {field} at index {index} is {value}: wanted {wanted}")]
    OutOfDomain {
        /// Kind of message.
        kind: Kind,
        /// Field.
        field: &'static str,
        /// Index in its list; 0 where there is none.
        index: usize,
        /// The number.
        value: f64,
        /// What would be right.
        wanted: &'static str,
    },
    /// For an array of another size.
    #[error("{kind} for {found} mirrors: this array has {wanted}")]
    WrongMirrors {
        /// Kind of message.
        kind: Kind,
        /// Mirrors found.
        found: usize,
        /// Mirrors wanted.
        wanted: usize,
    },
    /// About another number of users.
    #[error("{kind} about {found} users: wanted {wanted}")]
    WrongUsers {
        /// Kind of message.
        kind: Kind,
        /// Users found.
        found: usize,
        /// Users wanted.
        wanted: usize,
    },
}

impl CodecError {
    /// The name under which nodes count this refusal.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Oversized { .. } => "oversized",
            Self::NoHeader { .. } | Self::Truncated { .. } => "truncated",
            Self::WrongVersion { .. } => "wrong-version",
            Self::UnknownKind { .. } | Self::WrongKind { .. } => "wrong-kind",
            Self::Malformed { .. } => "malformed",
            Self::TrailingBytes { .. } => "trailing-bytes",
            Self::TooMany { .. } | Self::LengthMismatch { .. } => "bad-length",
            Self::NotFinite { .. } => "not-finite",
            Self::OutOfDomain { .. } => "implausible",
            Self::WrongMirrors { .. } => "wrong-mirror-count",
            Self::WrongUsers { .. } => "wrong-user-count",
        }
    }
}
