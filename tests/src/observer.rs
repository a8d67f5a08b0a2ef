//! A session that receives the messages of a room, and can publish into it.

use std::sync::{Arc, Mutex};

use heliostat_bus::{Bus, BusConfig, Class, Subscription};
use heliostat_proto::{
    Message, MirrorCommand, MirrorTelemetry, NodeKind, NodeStatus, Room, RoomTruth, SafetyReport, UserReport, codec,
};

use crate::wait::wait_until;

/// The payload of a message.
///
/// # Panics
/// When it cannot be encoded.
pub fn encoded<T: Message>(message: &T) -> Vec<u8> {
    let mut payload = Vec::new();
    codec::encode(message, &mut payload).expect("the message is valid");
    payload
}

/// The number of valid messages of a key, and the latest.
pub struct Latest<T> {
    found: Arc<Mutex<(u64, Option<T>)>>,
    _subscription: Subscription,
}

impl<T: Message + Clone + Send + 'static> Latest<T> {
    /// Subscribes to a key.
    ///
    /// # Panics
    /// When the key is invalid.
    pub fn of(bus: &Bus, key: &str) -> Self {
        let found: Arc<Mutex<(u64, Option<T>)>> = Arc::default();
        let kept = Arc::clone(&found);
        let subscription = bus.subscribe(key, move |payload| {
            // A test may publish invalid payloads.
            if let Ok(message) = codec::decode(payload) {
                let mut kept = kept.lock().expect("no callback panics");
                kept.0 += 1;
                kept.1 = Some(message);
            }
        });
        Self { found, _subscription: subscription.expect("the key is valid") }
    }

    /// The number of messages so far, and the latest.
    pub fn counted(&self) -> (u64, Option<T>) {
        self.found.lock().expect("no callback panics").clone()
    }

    /// The latest message.
    pub fn get(&self) -> Option<T> {
        self.counted().1
    }
}

/// A session in a room that keeps the latest message of each kind.
pub struct RoomObserver {
    bus: Bus,
    users: Latest<UserReport>,
    command: Latest<MirrorCommand>,
    telemetry: Latest<MirrorTelemetry>,
    safety: Latest<SafetyReport>,
    truth: Latest<RoomTruth>,
    controller: Latest<NodeStatus>,
    sim_node: Latest<NodeStatus>,
    driver: Latest<NodeStatus>,
}

impl RoomObserver {
    /// Connects to these endpoints.
    ///
    /// # Panics
    /// When the bus does not open.
    pub fn connect(room: &str, endpoints: &[&str]) -> Self {
        let room = Room::new(room).expect("the room name of a test is valid");
        Self::join(&endpoints.iter().fold(BusConfig::new(room), |config, endpoint| config.connect_to(endpoint)))
    }

    /// Joins a room with a configuration.
    ///
    /// # Panics
    /// When the bus does not open.
    pub fn join(config: &BusConfig) -> Self {
        let (room, bus) = (&config.room, Bus::open(config).expect("the bus opens"));
        let status = |node: NodeKind| Latest::of(&bus, &room.status(node));
        Self {
            users: Latest::of(&bus, &room.users()),
            command: Latest::of(&bus, &room.command()),
            telemetry: Latest::of(&bus, &room.telemetry()),
            safety: Latest::of(&bus, &room.safety()),
            truth: Latest::of(&bus, &room.truth()),
            controller: status(NodeKind::Controller),
            sim_node: status(NodeKind::SimNode),
            driver: status(NodeKind::Driver),
            bus,
        }
    }

    /// The room.
    pub fn room(&self) -> &Room {
        self.bus.room()
    }

    /// Publishes bytes on a key.
    ///
    /// # Panics
    /// When the bus does not take them.
    pub fn publish(&self, key: &str, payload: &[u8]) {
        // This class waits instead of dropping, so that each published payload arrives.
        let publisher = self.bus.publisher(key, Class::RealTimeBlock).expect("the key is valid");
        publisher.put(payload).expect("the bus takes a payload");
    }

    /// The newest position report.
    pub fn users(&self) -> Option<UserReport> {
        self.users.get()
    }

    /// The number of commands, and the newest.
    pub fn command(&self) -> (u64, Option<MirrorCommand>) {
        self.command.counted()
    }

    /// The newest telemetry.
    pub fn telemetry(&self) -> Option<MirrorTelemetry> {
        self.telemetry.get()
    }

    /// The number of telemetry messages.
    pub fn telemetry_count(&self) -> u64 {
        self.telemetry.counted().0
    }

    /// The newest safety report.
    pub fn safety(&self) -> Option<SafetyReport> {
        self.safety.get()
    }

    /// The newest truth.
    pub fn truth(&self) -> Option<RoomTruth> {
        self.truth.get()
    }

    /// The newest status of a kind of process.
    pub fn status(&self, node: NodeKind) -> Option<NodeStatus> {
        match node {
            NodeKind::Controller => self.controller.get(),
            NodeKind::Driver => self.driver.get(),
            _ => self.sim_node.get(),
        }
    }

    /// The value of a counter in the newest status; 0 if it is absent.
    pub fn counter(&self, node: NodeKind, name: &str) -> u64 {
        self.status(node).and_then(|status| status.counter(name)).unwrap_or(0)
    }

    /// Waits for ten more commands.
    ///
    /// # Panics
    /// When they do not arrive within the time limit.
    pub fn wait_for_commands(&self) {
        let before = self.command().0;
        wait_until("ten commands", || self.command().0 >= before + 10);
    }
}
