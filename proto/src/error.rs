//! Reasons to refuse a payload.

use thiserror::Error;

use crate::kind::Kind;
use crate::limits::{MAX_PAYLOAD, VERSION};

/// Fault of a payload or of a message, and what was expected.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum CodecError {
    /// The payload is longer than the contract allows.
    #[error("payload of {found} bytes or more: expected at most {MAX_PAYLOAD}")]
    Oversized {
        /// Length found, in bytes.
        found: usize,
    },
    /// The payload is shorter than the header.
    #[error("payload of length {found}: expected at least the 2 bytes of the header, version and kind")]
    NoHeader {
        /// Length found, in bytes.
        found: usize,
    },
    /// The payload belongs to another version of the contract.
    #[error("payload of contract version {found}: expected version {VERSION}; update the older program")]
    WrongVersion {
        /// Version found.
        found: u8,
    },
    /// The kind of message does not exist in this version.
    #[error("payload of kind {found}: expected a kind of version {VERSION}")]
    UnknownKind {
        /// Number found.
        found: u8,
    },
    /// The payload holds another kind of message than expected.
    #[error("payload of the kind \"{found}\": expected \"{expected}\"")]
    WrongKind {
        /// Kind found.
        found: Kind,
        /// Kind expected.
        expected: Kind,
    },
    /// The payload ends before the last field is complete.
    #[error("{kind}: payload ends within {field}")]
    Truncated {
        /// Kind of message.
        kind: Kind,
        /// Field in which the payload ends.
        field: &'static str,
    },
    /// The bytes are not a value of the field's type.
    #[error("{kind}: the bytes of {field} are not a valid value: {problem}")]
    Malformed {
        /// Kind of message.
        kind: Kind,
        /// Name of the field.
        field: &'static str,
        /// Fault of the bytes.
        problem: String,
    },
    /// Bytes remain after the last field.
    #[error("{kind}: the payload continues after the last field by a length of {extra}: expected its end")]
    TrailingBytes {
        /// Kind of message.
        kind: Kind,
        /// Number of bytes that remain.
        extra: usize,
    },
    /// A list or a text is longer than the contract allows.
    #[error("{kind}: {field} has a length of {found}: expected at most {limit}")]
    TooMany {
        /// Kind of message.
        kind: Kind,
        /// Name of the field.
        field: &'static str,
        /// Length found: entries of a list, bytes of a text.
        found: u64,
        /// Largest length allowed.
        limit: usize,
    },
    /// Two lists that must have the same length differ.
    #[error("{kind}: {field} has a length of {found}: expected {expected}, that of {like}")]
    LengthMismatch {
        /// Kind of message.
        kind: Kind,
        /// Name of the field.
        field: &'static str,
        /// Number of entries found.
        found: usize,
        /// Field that sets the length.
        like: &'static str,
        /// Number of entries of that field.
        expected: usize,
    },
    /// A number is NaN or infinite.
    #[error("{kind}: {field} at index {index} is {value}: expected a finite number")]
    NotFinite {
        /// Kind of message.
        kind: Kind,
        /// Name of the field.
        field: &'static str,
        /// Index in the list or structure; 0 for a single number.
        index: usize,
        /// Number found.
        value: f64,
    },
    /// A number is outside the domain of its field.
    #[error("{kind}: {field} at index {index} is {value}: expected {expected}")]
    OutOfDomain {
        /// Kind of message.
        kind: Kind,
        /// Name of the field.
        field: &'static str,
        /// Index in the list or structure; 0 for a single number.
        index: usize,
        /// Number found.
        value: f64,
        /// Description of the domain.
        expected: &'static str,
    },
    /// The message is for an array of another size.
    #[error("{kind} for an array of size {found}: expected {expected}, the number of its mirrors")]
    WrongMirrors {
        /// Kind of message.
        kind: Kind,
        /// Number of mirrors found.
        found: usize,
        /// Number of mirrors of the array.
        expected: usize,
    },
}

impl CodecError {
    /// Name of the counter for this refusal.
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
        }
    }
}
