//! Listens to a room's public topics and keeps the latest of each.
//!
//! Callbacks decode and store; whatever is computed is computed by whoever draws. What was not renewed for [`EXPIRY`] counts as gone.

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

/// What was last received longer ago than this is not shown as the present.
pub const EXPIRY: Duration = Duration::from_secs(3);
/// How much of the past the chart of sum rates shows.
const HISTORY: Duration = Duration::from_secs(90);
/// Between two points of that chart.
const HISTORY_STEP: Duration = Duration::from_millis(200);

/// A message and when it came.
pub(crate) type Dated<T> = Option<(Instant, T)>;

/// Sum rates at an instant, for the chart.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    pub at: Instant,
    pub sum: SumRates,
}

/// The latest of what a room says.
#[derive(Default)]
pub(crate) struct Received {
    pub truth: Dated<RoomTruth>,
    pub users: Dated<UserReport>,
    pub channel: Dated<ChannelReport>,
    pub obstacles: Dated<ObstacleReport>,
    pub telemetry: Dated<MirrorTelemetry>,
    /// By name of the sort of process.
    pub statuses: BTreeMap<&'static str, (Instant, NodeStatus)>,
    /// Sort and source of the processes that are there.
    pub alive: BTreeSet<(&'static str, u64)>,
    pub history: VecDeque<Sample>,
    pub latency: Window,
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
    /// Listens to the room of a session; the scenario says what the room looks like.
    ///
    /// # Errors
    /// [`UiError::Optics`] for a scenario that the optics refuse, [`UiError::Bus`] where the session is closed.
    pub fn open(bus: &Bus, scenario: &Scenario) -> Result<Self, UiError> {
        let model = scenario.channel_model()?;
        let received: Arc<Mutex<Received>> = Arc::default();
        let subscriptions = subscribe(bus, &received)?;
        Ok(Self { opened: Instant::now(), scenario: scenario.clone(), model, received, _subscriptions: subscriptions })
    }

    /// Whether both sides have spoken: the room, be it simulated or real, and a controller.
    pub fn is_complete(&self) -> bool {
        let received = self.received();
        (received.truth.is_some() || received.users.is_some()) && received.statuses.contains_key(NodeKind::Controller.name())
    }

    /// The policy that a controller last said it uses, be it there or not.
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
        self.statuses.insert(status.node.name(), (Instant::now(), status));
    }
}

fn lock(received: &Mutex<Received>) -> MutexGuard<'_, Received> {
    // Each message replaces a whole slot: a panic elsewhere leaves nothing half-made.
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
        listen(bus, &room.truth(), received, Received::take_truth)?,
        listen(bus, &room.users(), received, |received, users| received.users = Some((Instant::now(), users)))?,
        listen(bus, &room.channel(), received, |received, channel| received.channel = Some((Instant::now(), channel)))?,
        listen(bus, &room.obstacles(), received, |received, obstacles| received.obstacles = Some((Instant::now(), obstacles)))?,
        listen(bus, &room.telemetry(), received, |received, telemetry| received.telemetry = Some((Instant::now(), telemetry)))?,
        listen(bus, &room.all_status(), received, Received::take_status)?,
        alive,
    ])
}

fn listen<M: Message + 'static>(
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
