//! One who hears what a room says, and can speak into it.

use std::sync::{Arc, Mutex};

use heliostat_bus::{Bus, BusConfig, Class, Subscription};
use heliostat_proto::{MirrorCommand, MirrorTelemetry, NodeKind, NodeStatus, Room, RoomTruth, UserReport, codec};

use crate::wait_until;

/// The latest of each message, and how many came.
#[derive(Clone, Debug, Default)]
struct Heard {
    users: (u64, Option<UserReport>),
    command: (u64, Option<MirrorCommand>),
    telemetry: (u64, Option<MirrorTelemetry>),
    truth: (u64, Option<RoomTruth>),
    controller: (u64, Option<NodeStatus>),
    sim_node: (u64, Option<NodeStatus>),
}

/// A session in a room that remembers the latest of everything.
pub struct Witness {
    bus: Bus,
    room: Room,
    heard: Arc<Mutex<Heard>>,
    _subscriptions: Vec<Subscription>,
}

impl Witness {
    /// Connects to these endpoints.
    ///
    /// # Panics
    /// When the bus does not open.
    pub fn connect(room: &str, endpoints: &[&str]) -> Self {
        let room = Room::new(room).expect("a test names its room well");
        Self::join(&endpoints.iter().fold(BusConfig::new(room), |config, endpoint| config.connect_to(endpoint)))
    }

    /// Joins a room, listening or connecting as the configuration says.
    ///
    /// # Panics
    /// When the bus does not open.
    pub fn join(config: &BusConfig) -> Self {
        let room = config.room.clone();
        let bus = Bus::open(config).expect("the bus opens");
        let heard: Arc<Mutex<Heard>> = Arc::default();
        let keys = [room.users(), room.command(), room.telemetry(), room.truth(), room.all_status()];
        let subscriptions = keys.map(|key| {
            let heard = Arc::clone(&heard);
            let listen = move |key: &str, payload: &[u8]| heard.lock().expect("no listener panics").take(key, payload);
            bus.subscribe_keyed(&key, listen).expect("the key is one")
        });
        Self { bus, room, heard, _subscriptions: subscriptions.into() }
    }

    /// The room.
    pub fn room(&self) -> &Room {
        &self.room
    }

    /// Publishes bytes on a key.
    ///
    /// # Panics
    /// When the bus does not take them.
    pub fn say(&self, key: &str, payload: &[u8]) {
        // The class that waits rather than being dropped, so that each payload said is one received.
        let publisher = self.bus.publisher(key, Class::Order).expect("the key is one");
        publisher.put(payload).expect("the bus takes a payload");
    }

    /// The newest position report.
    pub fn users(&self) -> Option<UserReport> {
        self.heard().users.1
    }

    /// How many commands came, and the newest.
    pub fn command(&self) -> (u64, Option<MirrorCommand>) {
        self.heard().command
    }

    /// The newest telemetry.
    pub fn telemetry(&self) -> Option<MirrorTelemetry> {
        self.heard().telemetry.1
    }

    /// The newest truth.
    pub fn truth(&self) -> Option<RoomTruth> {
        self.heard().truth.1
    }

    /// The newest status of a sort of process.
    pub fn status(&self, node: NodeKind) -> Option<NodeStatus> {
        let heard = self.heard();
        if node == NodeKind::Controller { heard.controller.1 } else { heard.sim_node.1 }
    }

    /// The value of a counter in the newest status; 0 where it is not named.
    pub fn counter(&self, node: NodeKind, name: &str) -> u64 {
        let counters = self.status(node).map(|status| status.counters).unwrap_or_default();
        counters.iter().find(|(counter, _)| counter == name).map_or(0, |(_, count)| *count)
    }

    /// Waits until the room's mirrors follow commands.
    ///
    /// # Panics
    /// When they do not in good time.
    pub fn wait_for_commands(&self) {
        let before = self.command().0;
        wait_until("ten commands", || self.command().0 >= before + 10);
    }

    fn heard(&self) -> Heard {
        self.heard.lock().expect("no listener panics").clone()
    }
}

impl Heard {
    fn take(&mut self, key: &str, payload: &[u8]) {
        // A test may say what nobody can read: a witness only counts what is whole.
        let last = key.rsplit_once('/').map_or("", |(_, last)| last);
        match last {
            "users" => keep(&mut self.users, codec::decode(payload).ok()),
            "command" => keep(&mut self.command, codec::decode(payload).ok()),
            "telemetry" => keep(&mut self.telemetry, codec::decode(payload).ok()),
            "truth" => keep(&mut self.truth, codec::decode(payload).ok()),
            name if name == NodeKind::Controller.name() => keep(&mut self.controller, codec::decode(payload).ok()),
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
