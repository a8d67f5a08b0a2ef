//! A publisher that is no part of the room.

use std::thread;
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, BusConfig, Class, Publisher};
use heliostat_proto::{Message, NodeKind, Room, Stamp};
use heliostat_service::clock::utc_ns;

use crate::observer::encoded;
use crate::wait::wait_until;

/// The source in the stamps of an attacker.
const FORGED_SOURCE: u64 = 0xbad;

/// Timeout of a query for liveliness tokens.
const ALIVE_LIMIT: Duration = Duration::from_millis(500);

/// A publisher that is dropped earlier may take its last message with it.
const LAST_MESSAGE: Duration = Duration::from_millis(50);

/// Time between two bursts of a flood.
const FLOOD_PAUSE: Duration = Duration::from_millis(1);

/// A session that publishes into a room whose processes know nothing of it.
pub struct Attacker {
    bus: Bus,
    room: Room,
    /// Whether a process of the room receives what it publishes.
    is_received: bool,
}

impl Attacker {
    /// Joins the room, and waits until array and controller are connected.
    ///
    /// # Panics
    /// When the bus does not open, or one of the two is absent.
    pub fn join(config: &BusConfig) -> Self {
        let attacker = Self { is_received: true, ..Self::outside(config) };
        wait_until("links to array and controller", || {
            let tokens = attacker.alive();
            let present = |node: NodeKind| tokens.iter().any(|token| token.contains(&format!("/alive/{node}/")));
            present(NodeKind::Controller) && (present(NodeKind::SimNode) || present(NodeKind::Driver))
        });
        attacker
    }

    /// Opens a session that the room refuses: what it publishes has no receiver.
    ///
    /// # Panics
    /// When the bus does not open.
    pub fn outside(config: &BusConfig) -> Self {
        let bus = Bus::open(config).expect("the bus opens");
        Self { bus, room: config.room.clone(), is_received: false }
    }

    /// The liveliness tokens that it sees.
    ///
    /// # Panics
    /// When the session is closed.
    pub fn alive(&self) -> Vec<String> {
        self.bus.alive(&self.room.all_alive(), ALIVE_LIMIT).expect("the session is open")
    }

    /// The room.
    pub fn room(&self) -> &Room {
        &self.room
    }

    /// A stamp of this attacker with the present time.
    pub fn stamp(sequence: u64) -> Stamp {
        Stamp { source: FORGED_SOURCE, sequence, time_ns: utc_ns() }
    }

    /// Publishes a message.
    ///
    /// # Panics
    /// When it cannot be encoded, or has no receiver.
    pub fn publish<T: Message>(&self, key: &str, message: &T) {
        self.publish_payloads(key, &[encoded(message)]);
    }

    /// Publishes payloads in this order; each waits for the ones before it.
    ///
    /// # Panics
    /// When the bus does not take them, or they have no receiver.
    pub fn publish_payloads(&self, key: &str, payloads: &[Vec<u8>]) {
        let publisher = self.publisher(key);
        for payload in payloads {
            publisher.put(payload).expect("the bus takes a payload");
        }
        thread::sleep(LAST_MESSAGE);
    }

    /// Publishes payloads at a steady rate for a duration; returns their number.
    ///
    /// # Panics
    /// When the bus does not take them, or they have no receiver.
    pub fn flood(&self, key: &str, rate_hz: f64, duration: Duration, mut payload: impl FnMut(u64) -> Vec<u8>) -> u64 {
        let publisher = self.publisher(key);
        let (start, mut sent) = (Instant::now(), 0_u64);
        while start.elapsed() < duration {
            // A machine that cannot send at this rate sends at a lower one, and not for longer.
            while (sent as f64) < start.elapsed().as_secs_f64() * rate_hz && start.elapsed() < duration {
                sent += 1;
                publisher.put(&payload(sent)).expect("the bus takes a payload");
            }
            thread::sleep(FLOOD_PAUSE);
        }
        sent
    }

    fn publisher(&self, key: &str) -> Publisher {
        let publisher = self.bus.publisher(key, Class::RealTimeBlock).expect("the key is valid");
        if self.is_received {
            wait_until("a receiver of the attacker", || publisher.has_subscribers().expect("the session is open"));
        }
        publisher
    }
}
