//! A publisher of orders: it numbers them and reports a missing receiver.

use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, Class, Publisher};
use heliostat_proto::{Message, Stamp, codec};
use heliostat_service::clock::utc_ns;

use crate::UiError;

/// Zenoh discovers the subscriber of a process that has just joined within this time.
const DISCOVERY_LIMIT: Duration = Duration::from_secs(1);
/// Time between two checks for a subscriber.
const DISCOVERY_CHECK_EVERY: Duration = Duration::from_millis(20);

/// A publisher that numbers its messages.
pub(crate) struct OrderPublisher {
    /// Name of the receiver in errors.
    receiver: &'static str,
    publisher: Publisher,
    sequence: Mutex<u64>,
}

impl OrderPublisher {
    /// Declares a publisher of a key; `receiver` names the process that subscribes to it.
    pub fn new(bus: &Bus, receiver: &'static str, key: &str) -> Result<Self, UiError> {
        let publisher = bus.publisher(key, Class::RealTimeBlock)?;
        Ok(Self { receiver, publisher, sequence: Mutex::new(0) })
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
        let mut sequence = self.sequence.lock().unwrap_or_else(PoisonError::into_inner);
        *sequence += 1;
        let mut payload = Vec::new();
        codec::encode(&message(Stamp { source, sequence: *sequence, time_ns: utc_ns() }), &mut payload)?;
        Ok(self.publisher.put(&payload)?)
    }

    /// Publishes a message again, with the stamp that it has.
    pub fn publish_again<M: Message>(&self, message: &M) -> Result<(), UiError> {
        let mut payload = Vec::new();
        codec::encode(message, &mut payload)?;
        Ok(self.publisher.put(&payload)?)
    }

    fn await_subscriber(&self) -> Result<bool, UiError> {
        let deadline = Instant::now() + DISCOVERY_LIMIT;
        loop {
            let has_subscriber = self.publisher.has_subscribers()?;
            if has_subscriber || Instant::now() >= deadline {
                return Ok(has_subscriber);
            }
            thread::sleep(DISCOVERY_CHECK_EVERY);
        }
    }
}
