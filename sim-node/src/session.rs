//! Where the node touches the transport: what it publishes, what it hears, and who else is in the room.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use heliostat_bus::{Bus, BusConfig, Class, Presence, Subscription, Token};
use heliostat_driver::clock::Clock;
use heliostat_driver::inbox::Inbox;
use heliostat_driver::lines::{self, ALIVE_LIMIT, Lines, Outlet};
use heliostat_proto::keys::parse_alive;
use heliostat_proto::{Capabilities, CodecError, MirrorTelemetry, NodeKind, SimulatorControl, Stamp, decode};

use crate::node::NodeError;
use heliostat_sim::streams::Report;

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
    lines: Lines,
    rivals: Arc<Mutex<Vec<String>>>,
    orders: Arc<Mutex<Vec<Order>>>,
    users: Outlet,
    channel: Outlet,
    obstacles: Outlet,
    _declared: (Token, [Subscription; 2]),
}

impl Edge {
    /// Opens a session and declares everything, unless another simulator is in the room.
    ///
    /// `reports` and `telemetry` are the classes of both.
    pub fn open(config: &BusConfig, reports: Class, telemetry: Class) -> Result<Self, NodeError> {
        let bus = Bus::open(config)?;
        let keys = config.room.clone();
        lines::check_alone(&bus)?;
        let source = lines::random_id();
        let clock = Clock::start_in(START_DELAY);
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
        Ok(Self {
            users: Outlet::new(&bus, &keys.users(), reports)?,
            channel: Outlet::new(&bus, &keys.channel(), reports)?,
            obstacles: Outlet::new(&bus, &keys.obstacles(), reports)?,
            lines: Lines::open(&bus, clock, telemetry)?,
            _declared: (bus.announce(&keys.alive(NodeKind::SimNode, source))?, [watch, control]),
            bus,
            clock,
            source,
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

    /// What arrived for the array.
    pub fn inbox(&self) -> &Inbox {
        self.lines.inbox()
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
        Ok(outlet.put()?)
    }

    /// Publishes telemetry.
    pub fn publish_telemetry(&mut self, telemetry: &MirrorTelemetry) -> Result<(), NodeError> {
        Ok(self.lines.tell(telemetry)?)
    }

    /// Publishes the capabilities, and gives them to whoever asks from now on.
    pub fn publish_capabilities(&mut self, capabilities: &Capabilities) -> Result<(), NodeError> {
        Ok(self.lines.announce(capabilities)?)
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
