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

/// The latest message of each kind, and for some their number.
#[derive(Clone, Debug, Default)]
struct Received {
    users: (u64, Option<UserReport>),
    command: (u64, Option<MirrorCommand>),
    telemetry: (u64, Option<MirrorTelemetry>),
    safety: (u64, Option<SafetyReport>),
    truth: (u64, Option<RoomTruth>),
    controller: (u64, Option<NodeStatus>),
    sim_node: (u64, Option<NodeStatus>),
    driver: (u64, Option<NodeStatus>),
}

/// A session in a room that keeps the latest message of each kind.
pub struct RoomObserver {
    bus: Bus,
    room: Room,
    received: Arc<Mutex<Received>>,
    _subscriptions: Vec<Subscription>,
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
        let room = config.room.clone();
        let bus = Bus::open(config).expect("the bus opens");
        let received: Arc<Mutex<Received>> = Arc::default();
        let keys = [room.users(), room.command(), room.telemetry(), room.safety(), room.truth(), room.all_status()];
        let subscriptions = keys.map(|key| {
            let received = Arc::clone(&received);
            let on_message =
                move |key: &str, payload: &[u8]| received.lock().expect("no callback panics").take(key, payload);
            bus.subscribe_keyed(&key, on_message).expect("the key is valid")
        });
        Self { bus, room, received, _subscriptions: subscriptions.into() }
    }

    /// The room.
    pub fn room(&self) -> &Room {
        &self.room
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
        self.received().users.1
    }

    /// The number of commands, and the newest.
    pub fn command(&self) -> (u64, Option<MirrorCommand>) {
        self.received().command
    }

    /// The newest telemetry.
    pub fn telemetry(&self) -> Option<MirrorTelemetry> {
        self.received().telemetry.1
    }

    /// The number of telemetry messages.
    pub fn telemetry_count(&self) -> u64 {
        self.received().telemetry.0
    }

    /// The newest safety report.
    pub fn safety(&self) -> Option<SafetyReport> {
        self.received().safety.1
    }

    /// The newest truth.
    pub fn truth(&self) -> Option<RoomTruth> {
        self.received().truth.1
    }

    /// The newest status of a kind of process.
    pub fn status(&self, node: NodeKind) -> Option<NodeStatus> {
        let received = self.received();
        match node {
            NodeKind::Controller => received.controller.1,
            NodeKind::Driver => received.driver.1,
            _ => received.sim_node.1,
        }
    }

    /// The value of a counter in the newest status; 0 if it is absent.
    pub fn counter(&self, node: NodeKind, name: &str) -> u64 {
        let counters = self.status(node).map(|status| status.counters).unwrap_or_default();
        counters.iter().find(|(counter, _)| counter == name).map_or(0, |(_, count)| *count)
    }

    /// Waits for ten more commands.
    ///
    /// # Panics
    /// When they do not arrive within the time limit.
    pub fn wait_for_commands(&self) {
        let before = self.command().0;
        wait_until("ten commands", || self.command().0 >= before + 10);
    }

    fn received(&self) -> Received {
        self.received.lock().expect("no callback panics").clone()
    }
}

impl Received {
    fn take(&mut self, key: &str, payload: &[u8]) {
        // A test may publish invalid payloads: the observer counts valid ones only.
        let last = key.rsplit_once('/').map_or("", |(_, last)| last);
        match last {
            "users" => keep(&mut self.users, codec::decode(payload).ok()),
            "command" => keep(&mut self.command, codec::decode(payload).ok()),
            "telemetry" => keep(&mut self.telemetry, codec::decode(payload).ok()),
            "safety" => keep(&mut self.safety, codec::decode(payload).ok()),
            "truth" => keep(&mut self.truth, codec::decode(payload).ok()),
            name if name == NodeKind::Controller.name() => keep(&mut self.controller, codec::decode(payload).ok()),
            name if name == NodeKind::Driver.name() => keep(&mut self.driver, codec::decode(payload).ok()),
            name if name == NodeKind::SimNode.name() => keep(&mut self.sim_node, codec::decode(payload).ok()),
            _ => {}
        }
    }
}

fn keep<T>(slot: &mut (u64, Option<T>), message: Option<T>) {
    if message.is_some() {
        slot.0 += 1;
        slot.1 = message;
    }
}
