//! Where the node touches the transport: what it publishes, what it hears, and who else is in the room.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use heliostat_bus::{Bus, BusConfig, Class, Presence, Publisher, Service, Subscription, Token};
use heliostat_proto::keys::parse_alive;
use heliostat_proto::{
    Capabilities, CodecError, Message, MirrorTelemetry, NodeKind, SimulatorControl, Stamp, decode, encode,
};

use crate::clock::Clock;
use crate::inbox::Inbox;
use crate::node::NodeError;
use crate::streams::Report;

/// How long answers to "who is alive" are waited for.
const ALIVE_LIMIT: Duration = Duration::from_secs(1);

/// From here on everything is declared within milliseconds; time begins after this.
const START_DELAY: Duration = Duration::from_millis(30);

/// Most orders of an operator that wait; beyond it new ones are shed.
const ORDERS_MAX: usize = 64;

/// What came on the key of orders.
type Order = Result<SimulatorControl, CodecError>;

/// The node's publishers and subscriptions.
pub(crate) struct Edge {
    bus: Bus,
    clock: Clock,
    source: u64,
    inbox: Arc<Inbox>,
    rivals: Arc<Mutex<Vec<String>>>,
    orders: Arc<Mutex<Vec<Order>>>,
    users: Outlet,
    channel: Outlet,
    obstacles: Outlet,
    telemetry: Outlet,
    capabilities: Outlet,
    /// What whoever asks for the capabilities gets: the payload published last.
    answer: Arc<Mutex<Vec<u8>>>,
    _declared: (Token, [Subscription; 3], Service),
}

/// A publisher with its buffer.
pub(crate) struct Outlet {
    publisher: Publisher,
    buffer: Vec<u8>,
}

impl Outlet {
    fn new(bus: &Bus, key: &str, class: Class) -> Result<Self, NodeError> {
        Ok(Self { publisher: bus.publisher(key, class)?, buffer: Vec::new() })
    }

    /// Encodes a message; [`Outlet::put`] then publishes it.
    pub fn encode<T: Message>(&mut self, message: &T) -> Result<(), NodeError> {
        Ok(encode(message, &mut self.buffer)?)
    }

    /// Publishes what was encoded last.
    pub fn put(&self) -> Result<(), NodeError> {
        Ok(self.publisher.put(&self.buffer)?)
    }
}

impl Edge {
    /// Opens a session and declares everything, unless another simulator is in the room.
    ///
    /// `telemetry` is the class of the telemetry: in lockstep it must not be overtaken by reports.
    pub fn open(config: &BusConfig, telemetry: Class) -> Result<Self, NodeError> {
        let bus = Bus::open(config)?;
        let keys = config.room.clone();
        // A driver turns the mirrors of its room as a simulator does: there can be only one of them.
        for other in [NodeKind::SimNode, NodeKind::Driver] {
            if let Some(token) = bus.alive(&keys.alive_of(other), ALIVE_LIMIT)?.into_iter().next() {
                return Err(NodeError::RoomTaken { room: keys.to_string(), other, token });
            }
        }
        let source = random_id();
        let clock = Clock::start_in(START_DELAY);
        let inbox = Arc::new(Inbox::default());
        let arrivals = Arc::clone(&inbox);
        let commands = bus.subscribe(&keys.command(), move |payload| arrivals.push(clock.now(), payload))?;
        let rivals = Arc::new(Mutex::new(Vec::new()));
        let seen = Arc::clone(&rivals);
        let watch = bus.watch(&keys.alive_of(NodeKind::SimNode), move |key, presence| {
            let other = parse_alive(key).is_some_and(|(_, id)| id != source);
            if other && presence == Presence::Alive {
                seen.lock().unwrap_or_else(PoisonError::into_inner).push(key.to_owned());
            }
        })?;
        let orders = Arc::new(Mutex::new(Vec::new()));
        let waiting = Arc::clone(&orders);
        let control = bus.subscribe(&keys.simulator_control(), move |payload| {
            let mut waiting = waiting.lock().unwrap_or_else(PoisonError::into_inner);
            if waiting.len() < ORDERS_MAX {
                waiting.push(decode(payload));
            }
        })?;
        let answer = Arc::new(Mutex::new(Vec::new()));
        let latest = Arc::clone(&answer);
        let service = bus.serve(&keys.capabilities(), move |payload| {
            payload.extend_from_slice(&latest.lock().unwrap_or_else(PoisonError::into_inner));
        })?;
        Ok(Self {
            users: Outlet::new(&bus, &keys.users(), Class::Control)?,
            channel: Outlet::new(&bus, &keys.channel(), Class::Control)?,
            obstacles: Outlet::new(&bus, &keys.obstacles(), Class::Control)?,
            telemetry: Outlet::new(&bus, &keys.telemetry(), telemetry)?,
            capabilities: Outlet::new(&bus, &keys.capabilities(), telemetry)?,
            answer,
            _declared: (bus.announce(&keys.alive(NodeKind::SimNode, source))?, [commands, watch, control], service),
            bus,
            clock,
            source,
            inbox,
            rivals,
            orders,
        })
    }

    /// The clock that stamps arrivals.
    pub fn clock(&self) -> Clock {
        self.clock
    }

    /// The random id in every stamp.
    pub fn source(&self) -> u64 {
        self.source
    }

    /// What arrived on the command key.
    pub fn inbox(&self) -> &Inbox {
        &self.inbox
    }

    /// Outlets for truth and status, to be used from another thread.
    pub fn viewer_outlets(&self) -> Result<(Outlet, Outlet), NodeError> {
        let keys = self.bus.room();
        let truth = Outlet::new(&self.bus, &keys.truth(), Class::Info)?;
        let status = Outlet::new(&self.bus, &keys.status(NodeKind::SimNode), Class::Info)?;
        Ok((truth, status))
    }

    /// Publishes a report; `before` runs when all is ready and only the publication remains.
    pub fn publish(&mut self, report: &Report, before: impl FnOnce()) -> Result<(), NodeError> {
        let outlet = match report {
            Report::Obstacles(report) => {
                self.obstacles.encode(report)?;
                &self.obstacles
            }
            Report::Channel(report) => {
                self.channel.encode(report)?;
                &self.channel
            }
            Report::Users(report) => {
                self.users.encode(report)?;
                &self.users
            }
        };
        before();
        outlet.put()
    }

    /// Publishes telemetry.
    pub fn publish_telemetry(&mut self, telemetry: &MirrorTelemetry) -> Result<(), NodeError> {
        self.telemetry.encode(telemetry)?;
        self.telemetry.put()
    }

    /// Publishes the capabilities, and gives them to whoever asks from now on.
    pub fn publish_capabilities(&mut self, capabilities: &Capabilities) -> Result<(), NodeError> {
        self.capabilities.encode(capabilities)?;
        self.answer.lock().unwrap_or_else(PoisonError::into_inner).clone_from(&self.capabilities.buffer);
        self.capabilities.put()
    }

    /// The room's name.
    pub fn room_name(&self) -> String {
        self.bus.room().to_string()
    }

    /// Whether a controller is in the room.
    pub fn controller_is_alive(&self) -> Result<bool, NodeError> {
        Ok(!self.bus.alive(&self.bus.room().alive_of(NodeKind::Controller), ALIVE_LIMIT)?.is_empty())
    }

    /// Tokens of other simulators that have appeared in the room since the last call.
    pub fn new_rivals(&self) -> Vec<String> {
        std::mem::take(&mut *self.rivals.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// What operators have ordered since the last call, sound or not.
    pub fn new_orders(&self) -> Vec<Order> {
        std::mem::take(&mut *self.orders.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// A stamp of this node.
    pub fn stamp(&self, sequence: u64, time_ns: u64) -> Stamp {
        Stamp { source: self.source, sequence, time_ns }
    }

    /// Withdraws everything; others see it at once.
    pub fn close(self) -> Result<(), NodeError> {
        Ok(self.bus.close()?)
    }
}

/// A number that two instances are most unlikely to share: the standard library seeds its hashers from the operating system.
fn random_id() -> u64 {
    use std::hash::{BuildHasher, RandomState};
    RandomState::new().hash_one((std::process::id(), std::time::SystemTime::now()))
}
