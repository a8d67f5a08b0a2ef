//! Subscribes to a room's public topics and keeps the latest message of each.
//!
//! Callbacks decode and store; the readers compute. A message older than [`EXPIRY`] counts as
//! absent.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, Presence, Subscription};
use heliostat_channel::ChannelModel;
use heliostat_proto::keys::parse_alive;
use heliostat_proto::{
    ChannelReport, Message, MirrorTelemetry, NodeKind, NodeStatus, ObstacleReport, Room, RoomTruth, SumRates,
    UserReport, codec,
};
use heliostat_scenario::Scenario;

use crate::UiError;
use crate::latency::Window;
use crate::problems::Problems;

/// A message older than this is not displayed as current.
pub const EXPIRY: Duration = Duration::from_secs(3);
/// Time span of the chart of sum rates.
const HISTORY: Duration = Duration::from_secs(90);
/// Time between two points of that chart.
const HISTORY_STEP: Duration = Duration::from_millis(200);

/// A message and its arrival time.
pub(crate) type Dated<T> = Option<(Instant, T)>;

/// Sum rates at an instant, for the chart.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    pub at: Instant,
    pub sum: SumRates,
}

/// The latest messages of a room.
#[derive(Default)]
pub(crate) struct Received {
    pub truth: Dated<RoomTruth>,
    pub users: Dated<UserReport>,
    pub channel: Dated<ChannelReport>,
    pub obstacles: Dated<ObstacleReport>,
    pub telemetry: Dated<MirrorTelemetry>,
    /// By the name of the kind of process.
    pub statuses: BTreeMap<&'static str, (Instant, NodeStatus)>,
    /// Kind and source of the processes in the room.
    pub alive: BTreeSet<(&'static str, u64)>,
    pub history: VecDeque<Sample>,
    pub latency: Window,
    pub problems: Problems,
    pub unreadable: u64,
}

/// A view of one room.
pub struct View {
    pub(crate) opened: Instant,
    pub(crate) scenario: Scenario,
    pub(crate) model: ChannelModel,
    received: Arc<Mutex<Received>>,
    _subscriptions: Vec<Subscription>,
}

impl View {
    /// Subscribes to the room of a session; the scenario describes the room.
    ///
    /// # Errors
    /// [`UiError::Channel`] for a scenario that the channel model refuses, [`UiError::Bus`] if the
    /// session is closed.
    pub fn open(bus: &Bus, scenario: &Scenario) -> Result<Self, UiError> {
        let model = scenario.channel_model()?;
        let received: Arc<Mutex<Received>> = Arc::default();
        let subscriptions = subscribe(bus, &received)?;
        Ok(Self { opened: Instant::now(), scenario: scenario.clone(), model, received, _subscriptions: subscriptions })
    }

    /// Whether messages of the room and of a controller have arrived.
    pub fn is_complete(&self) -> bool {
        let received = self.received();
        (received.truth.is_some() || received.users.is_some())
            && received.statuses.contains_key(NodeKind::Controller.name())
    }

    /// The policy in the latest status of a controller, even if it has left.
    pub fn policy(&self) -> Option<String> {
        self.received().statuses.get(NodeKind::Controller.name()).map(|(_, status)| status.policy.clone())
    }

    pub(crate) fn received(&self) -> MutexGuard<'_, Received> {
        lock(&self.received)
    }
}

impl Received {
    /// The message, unless it is old.
    pub fn fresh<T>(message: &Dated<T>) -> Option<&T> {
        message.as_ref().filter(|(at, _)| at.elapsed() < EXPIRY).map(|(_, message)| message)
    }

    fn take_truth(&mut self, truth: RoomTruth) {
        let at = Instant::now();
        if self.history.back().is_none_or(|last| at - last.at >= HISTORY_STEP) {
            self.history.push_back(Sample { at, sum: truth.sum_rate_bps });
        }
        while self.history.front().is_some_and(|first| at - first.at > HISTORY) {
            self.history.pop_front();
        }
        self.truth = Some((at, truth));
    }

    fn take_status(&mut self, status: NodeStatus) {
        if status.node == NodeKind::Controller {
            self.latency.take(&status);
        }
        self.problems.take(&status);
        self.statuses.insert(status.node.name(), (Instant::now(), status));
    }
}

fn lock(received: &Mutex<Received>) -> MutexGuard<'_, Received> {
    // Each message replaces a complete slot, so a poisoned lock protects consistent data.
    received.lock().unwrap_or_else(PoisonError::into_inner)
}

fn subscribe(bus: &Bus, received: &Arc<Mutex<Received>>) -> Result<Vec<Subscription>, UiError> {
    let room: &Room = bus.room();
    let on_alive = Arc::clone(received);
    let alive = bus.watch(&room.all_alive(), move |key, presence| {
        let Some((node, source)) = parse_alive(key) else { return };
        let mut received = lock(&on_alive);
        match presence {
            Presence::Alive => received.alive.insert((node.name(), source)),
            Presence::Gone => received.alive.remove(&(node.name(), source)),
        };
    })?;
    Ok(vec![
        store(bus, &room.truth(), received, Received::take_truth)?,
        store(bus, &room.users(), received, |received, users| received.users = Some((Instant::now(), users)))?,
        store(bus, &room.channel(), received, |received, channel| received.channel = Some((Instant::now(), channel)))?,
        store(bus, &room.obstacles(), received, |received, obstacles| {
            received.obstacles = Some((Instant::now(), obstacles))
        })?,
        store(bus, &room.telemetry(), received, |received, telemetry| {
            received.telemetry = Some((Instant::now(), telemetry))
        })?,
        store(bus, &room.all_status(), received, Received::take_status)?,
        alive,
    ])
}

fn store<M: Message + 'static>(
    bus: &Bus,
    key: &str,
    received: &Arc<Mutex<Received>>,
    take: fn(&mut Received, M),
) -> Result<Subscription, UiError> {
    let received = Arc::clone(received);
    Ok(bus.subscribe(key, move |payload| {
        let decoded = codec::decode::<M>(payload);
        let mut received = lock(&received);
        match decoded {
            Ok(message) => take(&mut received, message),
            Err(_) => received.unreadable += 1,
        }
    })?)
}
