//! A publisher of orders: it numbers them and reports a missing receiver.

use std::sync::{Mutex, RwLock};
use std::thread;
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, Class, Publisher};
use heliostat_proto::{Message, Stamp, codec};
use heliostat_service::clock::utc_ns;
use heliostat_service::locks::{lock, unpoisoned};

use crate::UiError;

/// Zenoh discovers the subscriber of a process that has just joined within this time.
const DISCOVERY_LIMIT: Duration = Duration::from_secs(1);
/// Time between two checks for a subscriber.
const DISCOVERY_CHECK_EVERY: Duration = Duration::from_millis(20);

/// A publisher that numbers its messages. Each goes out through every session that has joined.
pub(crate) struct OrderPublisher {
    /// Name of the receiver in errors.
    receiver: &'static str,
    publishers: RwLock<Vec<Publisher>>,
    sequence: Mutex<u64>,
}

impl OrderPublisher {
    /// Declares a publisher of a key; `receiver` names the process that subscribes to it.
    pub fn new(bus: &Bus, receiver: &'static str, key: &str) -> Result<Self, UiError> {
        let own = Self::without_session(receiver);
        own.join(bus, key)?;
        Ok(own)
    }

    /// The same without a session.
    pub fn without_session(receiver: &'static str) -> Self {
        Self { receiver, publishers: RwLock::default(), sequence: Mutex::new(0) }
    }

    /// Publishes through this session too.
    pub fn join(&self, bus: &Bus, key: &str) -> Result<(), UiError> {
        let publisher = bus.publisher(key, Class::RealTimeBlock)?;
        unpoisoned(self.publishers.write()).push(publisher);
        Ok(())
    }

    /// Waits up to [`DISCOVERY_LIMIT`] for a subscriber, then publishes in any case.
    ///
    /// # Errors
    /// [`UiError::NoReceiver`] if the order was published without a subscriber.
    pub fn publish<M: Message>(&self, source: u64, message: impl FnOnce(Stamp) -> M) -> Result<(), UiError> {
        let has_subscriber = self.await_subscriber()?;
        self.publish_at_once(source, message)?;
        if has_subscriber { Ok(()) } else { Err(UiError::NoReceiver(self.receiver)) }
    }

    /// Publishes without regard to subscribers.
    pub fn publish_at_once<M: Message>(&self, source: u64, message: impl FnOnce(Stamp) -> M) -> Result<(), UiError> {
        // The lock is held while publishing, so that messages leave in the order of their numbers.
        let mut sequence = lock(&self.sequence);
        *sequence += 1;
        let mut payload = Vec::new();
        codec::encode(&message(Stamp { source, sequence: *sequence, time_ns: utc_ns() }), &mut payload)?;
        self.put(&payload)
    }

    /// Publishes a message again, with the stamp that it has.
    pub fn publish_again<M: Message>(&self, message: &M) -> Result<(), UiError> {
        let mut payload = Vec::new();
        codec::encode(message, &mut payload)?;
        self.put(&payload)
    }

    /// Puts a payload into every session; fails if one is closed.
    fn put(&self, payload: &[u8]) -> Result<(), UiError> {
        let publishers = unpoisoned(self.publishers.read());
        let put: Vec<_> = publishers.iter().map(|publisher| publisher.put(payload)).collect();
        Ok(put.into_iter().collect::<Result<(), _>>()?)
    }

    fn await_subscriber(&self) -> Result<bool, UiError> {
        let deadline = Instant::now() + DISCOVERY_LIMIT;
        loop {
            let publishers = unpoisoned(self.publishers.read());
            let found: Result<Vec<bool>, _> = publishers.iter().map(Publisher::has_subscribers).collect();
            drop(publishers);
            let has_subscriber = found?.contains(&true);
            if has_subscriber || Instant::now() >= deadline {
                return Ok(has_subscriber);
            }
            thread::sleep(DISCOVERY_CHECK_EVERY);
        }
    }
}
