//! Messages to bytes and back; the only file that names postcard.
//!
//! A payload is the contract's version (one byte), the kind of message (one byte), and the fields
//! in order as postcard writes them. A payload is either a complete, valid message or it is refused
//! with a specific error; [`encode`] never writes a payload that [`decode`] would refuse. The
//! version is checked first, after the length.

use postcard::ser_flavors::{Flavor, Slice};
use serde::{Deserialize, Serialize, Serializer, de::DeserializeOwned};
use thiserror::Error;

use crate::error::CodecError;
pub use crate::kind::Kind;
use crate::limits::{MAX_PAYLOAD, VERSION};

/// Length of the header: version and kind.
const HEADER: usize = 2;

/// Initial size of a buffer in bytes, before the size of the message is known.
const MIN_SIZE: usize = 256;

/// A message of the contract. The message table of this crate implements it; other crates only use
/// it.
pub trait Message: Default {
    /// Kind of the message.
    const KIND: Kind;

    /// Reads all fields in the order of their bytes.
    ///
    /// # Errors
    /// [`CodecError`] where the bytes are not those of the field.
    fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError>;

    /// Writes all fields in the order of their bytes.
    ///
    /// # Errors
    /// [`BufferFull`] where the buffer is too short.
    fn write(&self, writer: &mut Writer<'_>) -> Result<(), BufferFull>;

    /// Checks that the fields keep the rules of the contract.
    ///
    /// # Errors
    /// [`CodecError`] names the field that breaks a rule.
    fn check(&self) -> Result<(), CodecError>;
}

/// Writes a message into a buffer and replaces its contents; allocates nothing once the buffer is
/// large enough.
///
/// # Errors
/// [`CodecError`] where [`decode`] would refuse the payload; the buffer is then empty.
pub fn encode<T: Message>(message: &T, out: &mut Vec<u8>) -> Result<(), CodecError> {
    message.check().inspect_err(|_| out.clear())?;
    // postcard writes numbers several times faster into a slice than into a vector, which checks
    // its capacity for each number.
    let mut size = out.capacity().clamp(MIN_SIZE, MAX_PAYLOAD);
    loop {
        out.resize(size, 0);
        out[..HEADER].copy_from_slice(&[VERSION, T::KIND.number()]);
        match written(message, &mut out[HEADER..]) {
            Ok(body) => {
                out.truncate(HEADER + body);
                return Ok(());
            }
            // Unreachable while the limits of lists and texts keep every message shorter.
            Err(BufferFull) if size == MAX_PAYLOAD => {
                out.clear();
                return Err(CodecError::Oversized { found: MAX_PAYLOAD + 1 });
            }
            Err(BufferFull) => size = (2 * size).min(MAX_PAYLOAD),
        }
    }
}

/// Writes the fields into a slice and returns their length in bytes.
fn written<T: Message>(message: &T, out: &mut [u8]) -> Result<usize, BufferFull> {
    let mut writer = Writer { bytes: postcard::Serializer { output: Slice::new(out) } };
    message.write(&mut writer)?;
    writer.bytes.output.finalize().map(|body| body.len()).map_err(|_| BufferFull)
}

/// Reads a message from a payload.
///
/// # Errors
/// [`CodecError`] names the fault of the payload.
pub fn decode<T: Message>(payload: &[u8]) -> Result<T, CodecError> {
    let mut message = T::default();
    decode_into(&mut message, payload)?;
    Ok(message)
}

/// Reads a message from a payload into an existing message; allocates nothing once its lists and
/// texts are large enough.
///
/// # Errors
/// [`CodecError`] names the fault of the payload. The message then holds a mixture of old and new
/// fields and must not be used.
pub fn decode_into<T: Message>(message: &mut T, payload: &[u8]) -> Result<(), CodecError> {
    let found = kind_of(payload)?;
    if found != T::KIND {
        return Err(CodecError::WrongKind { found, expected: T::KIND });
    }
    let mut reader = Reader::of_body(payload);
    message.read(&mut reader)?;
    match reader.bytes.finalize().map_or(0, <[u8]>::len) {
        0 => message.check(),
        extra => Err(CodecError::TrailingBytes { kind: found, extra }),
    }
}

/// The kind of message that the header of a payload names.
///
/// # Errors
/// [`CodecError::Oversized`], [`CodecError::NoHeader`], [`CodecError::WrongVersion`],
/// [`CodecError::UnknownKind`].
pub fn kind_of(payload: &[u8]) -> Result<Kind, CodecError> {
    if payload.len() > MAX_PAYLOAD {
        return Err(CodecError::Oversized { found: payload.len() });
    }
    match *payload {
        [version, ..] if version != VERSION => Err(CodecError::WrongVersion { found: version }),
        [_, number, ..] => Kind::from_number(number).ok_or(CodecError::UnknownKind { found: number }),
        _ => Err(CodecError::NoHeader { found: payload.len() }),
    }
}

/// Reads values from the body of a payload.
pub struct Reader<'de> {
    bytes: postcard::Deserializer<'de, postcard::de_flavors::Slice<'de>>,
}

impl<'de> Reader<'de> {
    /// Reads from behind the header of a payload, which [`kind_of`] accepts.
    pub(crate) fn of_body(payload: &'de [u8]) -> Self {
        Self { bytes: postcard::Deserializer::from_bytes(&payload[HEADER..]) }
    }

    /// Reads the next number, bool or text; a text keeps its memory.
    #[inline]
    pub(crate) fn take<T: Deserialize<'de>>(&mut self, value: &mut T) -> Result<(), Unreadable> {
        T::deserialize_in_place(&mut self.bytes, value).map_err(|error| match error {
            postcard::Error::DeserializeUnexpectedEnd => Unreadable::Truncated,
            other => Unreadable::Invalid(other.to_string()),
        })
    }
}

/// Why the next bytes are not a value.
pub(crate) enum Unreadable {
    /// The payload ends within the value.
    Truncated,
    /// The bytes do not form a value of the type.
    Invalid(String),
}

/// Writes values into a buffer.
pub struct Writer<'a> {
    bytes: postcard::Serializer<Slice<'a>>,
}

impl Writer<'_> {
    /// Writes a number, a bool or a text.
    #[inline]
    pub(crate) fn put<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), BufferFull> {
        value.serialize(&mut self.bytes).map_err(|_| BufferFull)
    }

    /// Writes a length, then bytes.
    pub(crate) fn put_bytes(&mut self, bytes: &[u8]) -> Result<(), BufferFull> {
        self.bytes.serialize_bytes(bytes).map_err(|_| BufferFull)
    }
}

/// Why bytes are not a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the bytes are not a state of this version: {reason}")]
pub struct StateError {
    reason: &'static str,
}

/// Writes a state of this program in the format of messages, without a header. The bits of floating
/// point numbers are kept.
///
/// # Errors
/// [`StateError`] where the type cannot be written in this format.
pub fn encode_state<T: Serialize>(state: &T) -> Result<Vec<u8>, StateError> {
    postcard::to_stdvec(state).map_err(|_| StateError { reason: "it has a list of unknown length" })
}

/// Reads a state that [`encode_state`] has written.
///
/// # Errors
/// [`StateError`] where the bytes do not form a value of the type, or bytes remain.
pub fn decode_state<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, StateError> {
    match postcard::take_from_bytes(bytes) {
        Ok((state, [])) => Ok(state),
        Ok(_) => Err(StateError { reason: "bytes remain after it" }),
        Err(postcard::Error::DeserializeUnexpectedEnd) => Err(StateError { reason: "it ends too early" }),
        Err(_) => Err(StateError { reason: "a value is not valid" }),
    }
}

/// The buffer is too short for the message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BufferFull;
