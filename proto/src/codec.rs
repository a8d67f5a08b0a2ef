//! The one way from messages to bytes and the one way back.
//!
//! A payload is the contract's version (one byte), the kind of message (one byte), and the fields one after the other as
//! postcard writes them. Nothing is decoded in part: a payload is a whole, sound message or it is refused by name, and what
//! [`decode`] would refuse [`encode`] does not write. The version is looked at before anything else but the length.

use std::fmt;

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::error::CodecError;
use crate::fields::Fields;
use crate::{MAX_PAYLOAD, VERSION};

/// Bytes that a buffer is given before it is known how many it needs.
const MIN_ROOM: usize = 256;

/// What a payload holds; the number is its second byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Kind {
    /// [`UserReport`](crate::UserReport)
    UserReport = 1,
    /// [`ChannelReport`](crate::ChannelReport)
    ChannelReport = 2,
    /// [`ObstacleReport`](crate::ObstacleReport)
    ObstacleReport = 3,
    /// [`MirrorCommand`](crate::MirrorCommand)
    MirrorCommand = 4,
    /// [`MirrorTelemetry`](crate::MirrorTelemetry)
    MirrorTelemetry = 5,
    /// [`NodeStatus`](crate::NodeStatus)
    NodeStatus = 6,
    /// [`RoomTruth`](crate::RoomTruth)
    RoomTruth = 7,
    /// [`Capabilities`](crate::Capabilities)
    Capabilities = 8,
    /// [`EmergencyStop`](crate::EmergencyStop)
    EmergencyStop = 9,
    /// [`Calibration`](crate::Calibration)
    Calibration = 10,
    /// [`SimulatorControl`](crate::SimulatorControl)
    SimulatorControl = 11,
    /// [`ControllerControl`](crate::ControllerControl)
    ControllerControl = 12,
}

impl Kind {
    /// All kinds of this version.
    pub const ALL: [Self; 12] = [
        Self::UserReport,
        Self::ChannelReport,
        Self::ObstacleReport,
        Self::MirrorCommand,
        Self::MirrorTelemetry,
        Self::NodeStatus,
        Self::RoomTruth,
        Self::Capabilities,
        Self::EmergencyStop,
        Self::Calibration,
        Self::SimulatorControl,
        Self::ControllerControl,
    ];
}

impl fmt::Display for Kind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self {
            Self::UserReport => "user report",
            Self::ChannelReport => "channel report",
            Self::ObstacleReport => "obstacle report",
            Self::MirrorCommand => "mirror command",
            Self::MirrorTelemetry => "mirror telemetry",
            Self::NodeStatus => "node status",
            Self::RoomTruth => "room truth",
            Self::Capabilities => "capabilities message",
            Self::EmergencyStop => "emergency stop",
            Self::Calibration => "calibration",
            Self::SimulatorControl => "simulator control",
            Self::ControllerControl => "controller control",
        };
        formatter.write_str(name)
    }
}

/// A message of the contract. Only this crate implements it.
pub trait Message: Fields + Serialize + Default {
    /// Its kind.
    const KIND: Kind;
}

/// Writes a message into a buffer, in place of what the buffer held; allocates nothing once the buffer is large enough.
///
/// # Errors
/// [`CodecError`] where [`decode`] would refuse the payload; the buffer is left empty.
pub fn encode<T: Message>(message: &T, out: &mut Vec<u8>) -> Result<(), CodecError> {
    message.check(T::KIND).inspect_err(|_| out.clear())?;
    // A slice of fixed length takes numbers several times faster than a vector that checks whether to grow at each of them.
    let mut room = out.capacity().clamp(MIN_ROOM, MAX_PAYLOAD);
    loop {
        out.resize(room, 0);
        out[..2].copy_from_slice(&[VERSION, T::KIND as u8]);
        match postcard::to_slice(message, &mut out[2..]).map(|body| body.len()) {
            Ok(body) => {
                out.truncate(2 + body);
                return Ok(());
            }
            // Out of reach as long as the limits of lists and texts keep every message below it.
            Err(_) if room == MAX_PAYLOAD => {
                out.clear();
                return Err(CodecError::Oversized { found: MAX_PAYLOAD + 1 });
            }
            Err(_) => room = (2 * room).min(MAX_PAYLOAD),
        }
    }
}

/// Reads a message from a payload.
///
/// # Errors
/// [`CodecError`] names what is wrong with the payload.
pub fn decode<T: Message>(payload: &[u8]) -> Result<T, CodecError> {
    let mut message = T::default();
    decode_into(&mut message, payload)?;
    Ok(message)
}

/// Reads a message from a payload into an old message, whose lists and texts are reused: nothing is allocated once they are
/// large enough.
///
/// # Errors
/// [`CodecError`] names what is wrong with the payload; what the message then holds is partly old and partly new, and not to
/// be used.
pub fn decode_into<T: Message>(message: &mut T, payload: &[u8]) -> Result<(), CodecError> {
    let found = kind_of(payload)?;
    if found != T::KIND {
        return Err(CodecError::WrongKind { found, wanted: T::KIND });
    }
    let mut reader = Reader { kind: found, bytes: postcard::Deserializer::from_bytes(&payload[2..]) };
    message.read(&mut reader)?;
    reader.finish()?;
    message.check(found)
}

/// The kind of message that a payload says it holds.
///
/// # Errors
/// [`CodecError::Oversized`], [`CodecError::NoHeader`], [`CodecError::WrongVersion`], [`CodecError::UnknownKind`].
pub fn kind_of(payload: &[u8]) -> Result<Kind, CodecError> {
    if payload.len() > MAX_PAYLOAD {
        return Err(CodecError::Oversized { found: payload.len() });
    }
    match *payload {
        [version, ..] if version != VERSION => Err(CodecError::WrongVersion { found: version }),
        [_, number, ..] => {
            Kind::ALL.into_iter().find(|kind| *kind as u8 == number).ok_or(CodecError::UnknownKind { found: number })
        }
        _ => Err(CodecError::NoHeader { found: payload.len() }),
    }
}

/// Takes the fields of one message from a payload, one after the other.
pub struct Reader<'de> {
    kind: Kind,
    bytes: postcard::Deserializer<'de, postcard::de_flavors::Slice<'de>>,
}

impl<'de> Reader<'de> {
    /// The next field.
    pub(crate) fn value<T: Deserialize<'de>>(&mut self, field: &'static str, place: &mut T) -> Result<(), CodecError> {
        T::deserialize_in_place(&mut self.bytes, place).map_err(|error| self.refusal(field, error))
    }

    /// The next field, a list of at most `limit` entries; the length is refused before anything is allocated for it.
    pub(crate) fn list<T: DeserializeOwned>(
        &mut self,
        field: &'static str,
        limit: usize,
        place: &mut Vec<T>,
    ) -> Result<(), CodecError> {
        let mut found = 0u64;
        self.value(field, &mut found)?;
        if found > limit as u64 {
            return Err(CodecError::TooMany { kind: self.kind, field, found, limit });
        }
        let count = found as usize;
        place.truncate(count);
        for entry in place.iter_mut() {
            self.value(field, entry)?;
        }
        place.reserve(count - place.len());
        while place.len() < count {
            let entry = T::deserialize(&mut self.bytes).map_err(|error| self.refusal(field, error))?;
            place.push(entry);
        }
        Ok(())
    }

    /// Refuses what is left over.
    fn finish(self) -> Result<(), CodecError> {
        let left = self.bytes.finalize().map_or(0, <[u8]>::len);
        if left > 0 { Err(CodecError::TrailingBytes { kind: self.kind, extra: left }) } else { Ok(()) }
    }

    fn refusal(&self, field: &'static str, error: postcard::Error) -> CodecError {
        match error {
            postcard::Error::DeserializeUnexpectedEnd => CodecError::Truncated { kind: self.kind, field },
            other => CodecError::Malformed { kind: self.kind, field, problem: other.to_string() },
        }
    }
}
