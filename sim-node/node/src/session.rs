//! The session of the simulator on the bus: the arrays' sessions, the report streams, orders, and
//! liveliness.

use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

use heliostat_array::Waker;
use heliostat_bus::{Bus, BusConfig, Class, Subscription};
use heliostat_driver::claim::Claim;
use heliostat_driver::clock::Clock;
use heliostat_driver::receive_queue::ReceiveQueue;
use heliostat_driver::session::{ALIVE_LIMIT, ArraySession, MessagePublisher};
use heliostat_proto::{BeliefReport, CodecError, NodeKind, SimulatorControl, Stamp, decode};
use heliostat_room::reports::Report;
use heliostat_service::locks::{lock, unpoisoned};
use heliostat_service::source_id;

use crate::error::NodeError;

/// Local time starts after this delay, when all declarations are complete.
const START_DELAY: Duration = Duration::from_millis(30);

/// Capacity for orders of operators, and for beliefs of a controller; beyond it new ones are dropped.
const WAITING_MAX: usize = 64;

/// A payload on the key of orders.
type Order = Result<SimulatorControl, CodecError>;

/// Wakes the loop of the simulator.
#[derive(Debug, Default)]
struct Alarm {
    is_raised: Mutex<bool>,
    raised: Condvar,
}

impl Alarm {
    fn raise(&self) {
        *lock(&self.is_raised) = true;
        self.raised.notify_one();
    }

    /// Waits until it is raised, or until an instant; then it is not raised.
    fn wait(&self, until: Instant) {
        let left = until.saturating_duration_since(Instant::now());
        let guard = lock(&self.is_raised);
        let waited = self.raised.wait_timeout_while(guard, left, |is_raised| !*is_raised);
        *unpoisoned(waited).0 = false;
    }
}

/// The publishers and subscriptions of the simulator.
pub(crate) struct RoomSession {
    bus: Bus,
    clock: Clock,
    source: u64,
    /// One for each array.
    arrays: Vec<ArraySession>,
    /// Set when a stop has arrived for any array.
    stopped: Arc<Alarm>,
    claim: Claim,
    orders: Arc<Mutex<Vec<Order>>>,
    beliefs: Arc<Mutex<Vec<BeliefReport>>>,
    users: MessagePublisher,
    channel: MessagePublisher,
    obstacles: MessagePublisher,
    orientation: MessagePublisher,
    leds: MessagePublisher,
    branches: MessagePublisher,
    _subscriptions: [Subscription; 2],
}

/// Publishers of what only viewers receive.
pub(crate) struct ViewerPublishers {
    pub truth: MessagePublisher,
    pub status: MessagePublisher,
    pub geometry: MessagePublisher,
}

impl RoomSession {
    /// Opens a session for so many arrays and declares everything, unless another driver or simulator
    /// is in the room.
    ///
    /// `reports` and `telemetry` are their classes of transport.
    pub fn open(config: &BusConfig, arrays: usize, [reports, telemetry]: [Class; 2]) -> Result<Self, NodeError> {
        let bus = Bus::open(config)?;
        let keys = config.room.clone();
        let source = source_id::random();
        let claim = Claim::begin(&bus, 0..arrays, source)?;
        let clock = Clock::start_in(START_DELAY);
        let (orders, control) = waiting(&bus, &keys.simulator_control(), |payload| Some(decode(payload)))?;
        let (beliefs, belief) = waiting(&bus, &keys.belief(), |payload| decode(payload).ok())?;
        let stopped = Arc::<Alarm>::default();
        let arrays: Vec<ArraySession> =
            (0..arrays).map(|array| ArraySession::open(&bus, array, clock, telemetry)).collect::<Result<_, _>>()?;
        for array in &arrays {
            let alarm = Arc::clone(&stopped);
            array.received().set_on_stop(Waker::new(move || alarm.raise()));
        }
        let mut session = Self {
            users: MessagePublisher::new(&bus, &keys.users(), reports)?,
            channel: MessagePublisher::new(&bus, &keys.channel(), reports)?,
            obstacles: MessagePublisher::new(&bus, &keys.obstacles(), reports)?,
            orientation: MessagePublisher::new(&bus, &keys.orientation(), reports)?,
            branches: MessagePublisher::new(&bus, &keys.branches(), reports)?,
            leds: MessagePublisher::new(&bus, &keys.leds(), reports)?,
            arrays,
            stopped,
            claim,
            _subscriptions: [control, belief],
            bus,
            clock,
            source,
            orders,
            beliefs,
        };
        session.claim.announce(&session.bus, &keys.alive(NodeKind::SimNode, source))?;
        Ok(session)
    }

    /// The clock that stamps arrivals.
    pub fn clock(&self) -> Clock {
        self.clock
    }

    /// The random id in every stamp.
    pub fn source(&self) -> u64 {
        self.source
    }

    /// Waits until an instant, or until a stop arrives.
    pub fn wait_for_stop(&self, until: Instant) {
        self.stopped.wait(until);
    }

    /// The queue of messages for an array.
    pub fn received(&self, array: usize) -> &ReceiveQueue {
        self.arrays[array].received()
    }

    /// Messages to all arrays that were dropped because a queue was full.
    pub fn dropped(&self) -> u64 {
        self.arrays.iter().map(|array| array.received().dropped()).sum()
    }

    /// The session of an array.
    pub fn array(&mut self, array: usize) -> &mut ArraySession {
        &mut self.arrays[array]
    }

    /// Publishers of truth, status and geometry, for use on another thread.
    pub fn viewer_publishers(&self) -> Result<ViewerPublishers, NodeError> {
        let keys = self.bus.room();
        let publisher = |key: String| MessagePublisher::new(&self.bus, &key, Class::LowDrop);
        Ok(ViewerPublishers {
            truth: publisher(keys.truth())?,
            status: publisher(keys.status(NodeKind::SimNode))?,
            geometry: publisher(keys.geometry(NodeKind::SimNode))?,
        })
    }

    /// Publishes a report; `before` runs between its encoding and its publication.
    pub fn publish(&mut self, report: &Report, before: impl FnOnce()) -> Result<(), NodeError> {
        let publisher = match report {
            Report::Obstacles(report) => self.obstacles.encode(report)?,
            Report::Orientation(report) => self.orientation.encode(report)?,
            Report::Branches(report) => self.branches.encode(report)?,
            Report::Leds(report) => self.leds.encode(report)?,
            Report::Channel(report) => self.channel.encode(report)?,
            Report::Users(report) => self.users.encode(report)?,
        };
        before();
        Ok(publisher.put()?)
    }

    /// The room's name.
    pub fn room_name(&self) -> String {
        self.bus.room().to_string()
    }

    /// Whether a controller is in the room.
    pub fn controller_is_alive(&self) -> Result<bool, NodeError> {
        Ok(!self.bus.alive(&self.bus.room().alive_of(NodeKind::Controller), ALIVE_LIMIT)?.is_empty())
    }

    /// Judges the tokens of other processes with these mirrors, as [`Claim::check`].
    pub fn check_claim(&self, late: impl FnMut(String)) -> Result<(), NodeError> {
        Ok(self.claim.check(late)?)
    }

    /// The problems of the other processes with these mirrors that are in the room.
    pub fn others(&self) -> Vec<String> {
        self.claim.others()
    }

    /// The orders of operators since the last call, with those that cannot be decoded.
    pub fn new_orders(&self) -> Vec<Order> {
        std::mem::take(&mut *lock(&self.orders))
    }

    /// The beliefs of controllers since the last call.
    pub fn new_beliefs(&self) -> Vec<BeliefReport> {
        std::mem::take(&mut *lock(&self.beliefs))
    }

    /// A stamp with this process as its source.
    pub fn stamp(&self, sequence: u64, time_ns: u64) -> Stamp {
        Stamp { source: self.source, sequence, time_ns }
    }

    /// Ends the session; other processes notice it at once.
    pub fn close(self) -> Result<(), NodeError> {
        Ok(self.bus.close()?)
    }
}

/// Messages that wait, and their subscription.
type Waiting<T> = (Arc<Mutex<Vec<T>>>, Subscription);

/// Those of the messages under a key that wait, and their subscription.
fn waiting<T: Send + 'static>(bus: &Bus, key: &str, read: fn(&[u8]) -> Option<T>) -> Result<Waiting<T>, NodeError> {
    let messages = Arc::new(Mutex::new(Vec::new()));
    let arrived = Arc::clone(&messages);
    let subscription = bus.subscribe(key, move |payload| {
        let mut arrived = lock(&arrived);
        if arrived.len() < WAITING_MAX {
            arrived.extend(read(payload));
        }
    })?;
    Ok((messages, subscription))
}
