//! The session of an array on the bus, real or simulated: it receives commands, stops, re-arms and
//! calibrations, and publishes telemetry, capabilities and safety reports.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use heliostat_array::content::Content;
use heliostat_array::others::RoomTaken;
use heliostat_bus::{Bus, BusError, Class, Publisher, Service, Subscription};
use heliostat_proto::{Capabilities, CodecError, Message, MirrorTelemetry, SafetyReport, StopReport, decode, encode};
use heliostat_service::locks::lock;
use thiserror::Error;

use crate::clock::Clock;
use crate::receive_queue::ReceiveQueue;

/// Timeout of a query for liveliness tokens.
pub const ALIVE_LIMIT: Duration = Duration::from_secs(1);

/// Why a session cannot be opened or used.
#[derive(Debug, Error)]
pub enum SessionError {
    /// The transport failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// An outgoing message violates the contract.
    #[error("a message cannot be published")]
    Codec(#[from] CodecError),
    /// Another process controls the mirrors.
    #[error(transparent)]
    RoomTaken(#[from] RoomTaken),
}

/// A publisher of messages, with its buffer.
pub struct MessagePublisher {
    publisher: Publisher,
    buffer: Vec<u8>,
}

impl MessagePublisher {
    /// Declares a publisher.
    ///
    /// # Errors
    /// A transport that fails.
    pub fn new(bus: &Bus, key: &str, class: Class) -> Result<Self, SessionError> {
        Ok(Self { publisher: bus.publisher(key, class)?, buffer: Vec::new() })
    }

    /// Encodes a message; [`MessagePublisher::put`] then publishes it.
    ///
    /// # Errors
    /// A message that violates the contract.
    pub fn encode<T: Message>(&mut self, message: &T) -> Result<&Self, SessionError> {
        encode(message, &mut self.buffer)?;
        Ok(self)
    }

    /// Publishes the message that was encoded last.
    ///
    /// # Errors
    /// A transport that fails.
    pub fn put(&self) -> Result<(), SessionError> {
        Ok(self.publisher.put(&self.buffer)?)
    }
}

/// A publisher whose last message also answers queries of its key.
struct AnsweringPublisher {
    publisher: MessagePublisher,
    /// The payload published last.
    answer: Arc<Mutex<Vec<u8>>>,
    _service: Service,
}

impl AnsweringPublisher {
    fn new(bus: &Bus, key: &str, class: Class) -> Result<Self, SessionError> {
        let answer = Arc::new(Mutex::new(Vec::new()));
        let latest = Arc::clone(&answer);
        let service = bus.serve(key, move |payload| {
            payload.extend_from_slice(&lock(&latest));
        })?;
        Ok(Self { publisher: MessagePublisher::new(bus, key, class)?, answer, _service: service })
    }

    fn publish<T: Message>(&mut self, message: &T) -> Result<(), SessionError> {
        self.publisher.encode(message)?;
        lock(&self.answer).clone_from(&self.publisher.buffer);
        self.publisher.put()
    }
}

/// The subscriptions and publishers of an array.
pub struct ArraySession {
    received: Arc<ReceiveQueue>,
    telemetry: MessagePublisher,
    capabilities: AnsweringPublisher,
    safety: AnsweringPublisher,
    stops: AnsweringPublisher,
    _subscriptions: [Subscription; 5],
}

impl ArraySession {
    /// Declares subscriptions and publishers of the array with this index; `class` is that of
    /// telemetry, capabilities, safety and stop reports.
    ///
    /// # Errors
    /// A transport that fails.
    pub fn open(bus: &Bus, index: usize, clock: Clock, class: Class) -> Result<Self, SessionError> {
        let (room, keys) = (bus.room(), bus.room().array(index));
        let received = Arc::new(ReceiveQueue::default());
        let subscribe = |key: String, content: fn(&[u8]) -> Content| {
            let received = Arc::clone(&received);
            bus.subscribe(&key, move |payload| {
                let at = clock.now();
                received.push(at, content(payload));
            })
        };
        let subscriptions = [
            subscribe(keys.command(), |payload| Content::Command(decode(payload)))?,
            subscribe(room.stop(), |payload| Content::Stop(decode(payload)))?,
            subscribe(keys.stop_repetition(), |payload| Content::Repetition(decode(payload)))?,
            subscribe(room.rearm(), |payload| Content::Rearm(decode(payload)))?,
            subscribe(keys.calibration(), |payload| Content::Calibration(decode(payload)))?,
        ];
        Ok(Self {
            received,
            telemetry: MessagePublisher::new(bus, &keys.telemetry(), class)?,
            capabilities: AnsweringPublisher::new(bus, &keys.capabilities(), class)?,
            safety: AnsweringPublisher::new(bus, &keys.safety(), class)?,
            stops: AnsweringPublisher::new(bus, &keys.stops(), class)?,
            _subscriptions: subscriptions,
        })
    }

    /// The queue of received messages.
    pub fn received(&self) -> &Arc<ReceiveQueue> {
        &self.received
    }

    /// Publishes telemetry.
    ///
    /// # Errors
    /// A transport that fails, or telemetry that violates the contract.
    pub fn publish_telemetry(&mut self, telemetry: &MirrorTelemetry) -> Result<(), SessionError> {
        self.telemetry.encode(telemetry)?.put()
    }

    /// Publishes the capabilities, and answers queries with them from now on.
    ///
    /// # Errors
    /// A transport that fails, or capabilities that violate the contract.
    pub fn publish_capabilities(&mut self, capabilities: &Capabilities) -> Result<(), SessionError> {
        self.capabilities.publish(capabilities)
    }

    /// Publishes a stop report, and answers queries with it from now on.
    ///
    /// # Errors
    /// A transport that fails, or a report that violates the contract.
    pub fn publish_stops(&mut self, stops: &StopReport) -> Result<(), SessionError> {
        self.stops.publish(stops)
    }

    /// Publishes a safety report, and answers queries with it from now on.
    ///
    /// # Errors
    /// A transport that fails, or a report that violates the contract.
    pub fn publish_safety(&mut self, safety: &SafetyReport) -> Result<(), SessionError> {
        self.safety.publish(safety)
    }
}
