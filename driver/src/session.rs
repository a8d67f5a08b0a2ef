//! What an array says and hears on the bus, whoever runs it: commands, stops and calibrations in, telemetry and capabilities out.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use heliostat_bus::{Bus, BusError, Class, Publisher, Service, Subscription};
use heliostat_proto::{Capabilities, CodecError, Message, MirrorTelemetry, NodeKind, decode, encode};
use thiserror::Error;

use crate::clock::Clock;
use crate::inbox::Inbox;
use heliostat_array::content::Content;

/// How long answers to "who is alive" are waited for.
pub const ALIVE_LIMIT: Duration = Duration::from_secs(1);

/// Why nothing can be said or heard.
#[derive(Debug, Error)]
pub enum LinesError {
    /// The transport failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A message of ours breaks the contract.
    #[error("a message cannot be published: {0}")]
    Codec(#[from] CodecError),
    /// Somebody else turns the mirrors of this room.
    #[error("another {other} is in room \"{room}\" ({token}): stop it, or choose another room with --room")]
    RoomTaken {
        /// Name of the room.
        room: String,
        /// What has it.
        other: NodeKind,
        /// The other's liveliness token.
        token: String,
    },
}

/// Refuses a room whose mirrors somebody else turns: a driver does so as much as a simulator.
///
/// # Errors
/// [`LinesError::RoomTaken`], or a transport that fails.
pub fn check_alone(bus: &Bus) -> Result<(), LinesError> {
    for other in [NodeKind::SimNode, NodeKind::Driver] {
        if let Some(token) = bus.alive(&bus.room().alive_of(other), ALIVE_LIMIT)?.into_iter().next() {
            return Err(LinesError::RoomTaken { room: bus.room().to_string(), other, token });
        }
    }
    Ok(())
}

/// A publisher with its buffer.
pub struct Outlet {
    publisher: Publisher,
    buffer: Vec<u8>,
}

impl Outlet {
    /// Declares a publisher.
    ///
    /// # Errors
    /// A transport that fails.
    pub fn new(bus: &Bus, key: &str, class: Class) -> Result<Self, LinesError> {
        Ok(Self { publisher: bus.publisher(key, class)?, buffer: Vec::new() })
    }

    /// Encodes a message; [`Outlet::put`] then publishes it.
    ///
    /// # Errors
    /// A message that breaks the contract.
    pub fn encode<T: Message>(&mut self, message: &T) -> Result<(), LinesError> {
        Ok(encode(message, &mut self.buffer)?)
    }

    /// Publishes what was encoded last.
    ///
    /// # Errors
    /// A transport that fails.
    pub fn put(&self) -> Result<(), LinesError> {
        Ok(self.publisher.put(&self.buffer)?)
    }
}

/// Everything that an array says and hears.
pub struct Lines {
    inbox: Arc<Inbox>,
    telemetry: Outlet,
    capabilities: Outlet,
    /// What whoever asks for the capabilities gets: the payload published last.
    answer: Arc<Mutex<Vec<u8>>>,
    _declared: ([Subscription; 3], Service),
}

impl Lines {
    /// Declares everything; `class` is that of telemetry and capabilities.
    ///
    /// # Errors
    /// A transport that fails.
    pub fn open(bus: &Bus, clock: Clock, class: Class) -> Result<Self, LinesError> {
        let keys = bus.room();
        let inbox = Arc::new(Inbox::default());
        let hear = |key: String, content: fn(&[u8]) -> Content| {
            let inbox = Arc::clone(&inbox);
            bus.subscribe(&key, move |payload| {
                let at = clock.now();
                inbox.push(at, content(payload));
            })
        };
        let heard = [
            hear(keys.command(), |payload| Content::Command(decode(payload)))?,
            hear(keys.stop(), |payload| Content::Stop(decode(payload)))?,
            hear(keys.calibration(), |payload| Content::Calibration(decode(payload)))?,
        ];
        let answer = Arc::new(Mutex::new(Vec::new()));
        let latest = Arc::clone(&answer);
        let service = bus.serve(&keys.capabilities(), move |payload| {
            payload.extend_from_slice(&latest.lock().unwrap_or_else(PoisonError::into_inner));
        })?;
        Ok(Self {
            inbox,
            telemetry: Outlet::new(bus, &keys.telemetry(), class)?,
            capabilities: Outlet::new(bus, &keys.capabilities(), class)?,
            answer,
            _declared: (heard, service),
        })
    }

    /// What arrived.
    pub fn inbox(&self) -> &Inbox {
        &self.inbox
    }

    /// Publishes telemetry.
    ///
    /// # Errors
    /// A transport that fails, or telemetry that breaks the contract.
    pub fn tell(&mut self, telemetry: &MirrorTelemetry) -> Result<(), LinesError> {
        self.telemetry.encode(telemetry)?;
        self.telemetry.put()
    }

    /// Publishes the capabilities, and gives them to whoever asks from now on.
    ///
    /// # Errors
    /// A transport that fails, or capabilities that break the contract.
    pub fn announce(&mut self, capabilities: &Capabilities) -> Result<(), LinesError> {
        self.capabilities.encode(capabilities)?;
        self.answer.lock().unwrap_or_else(PoisonError::into_inner).clone_from(&self.capabilities.buffer);
        self.capabilities.put()
    }
}

/// A number that two instances are most unlikely to share: the standard library seeds its hashers from the operating system.
pub fn random_id() -> u64 {
    use std::hash::{BuildHasher, RandomState};
    RandomState::new().hash_one((std::process::id(), std::time::SystemTime::now()))
}
