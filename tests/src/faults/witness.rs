//! A session that records telemetry and keeps the newest of every other message of a room.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use heliostat_bus::{Bus, BusConfig, Subscription};
use heliostat_proto::{
    ArrayState, Capabilities, MirrorCommand, MirrorTelemetry, Nanos, NodeKind, NodeStatus, Room, SafetyReport,
    UserReport, codec,
};
use heliostat_service::clock::utc_ns;

use crate::faults::effect::{Effect, Sample};
use crate::faults::tracker::PERIOD;
use crate::wait::wait_until;

/// Counters of a status that report a fault.
const NOTABLE: [&str; 4] = ["dropped", "unanswered", "policies_refused", "connections"];

/// The same by the beginning of their names.
const NOTABLE_GROUPS: [&str; 4] = ["refused:", "fallback:", "epoch:", "missed:"];

/// Before a fault, the array follows for this long.
const STEADY_NS: u64 = 500_000_000;

/// Commands accepted in that time: half of those at the rate of the reports.
const STEADY_COMMANDS: u64 = 25;

/// Commands accepted after the fault before the array counts as recovered.
const RECOVERED_COMMANDS: u64 = 20;

/// After recovery, until each process has published its status again.
const STATUS_WAIT: Duration = Duration::from_millis(1100);

/// What a witness has received.
#[derive(Debug, Default)]
struct Received {
    samples: Vec<Sample>,
    telemetry: Option<MirrorTelemetry>,
    users: Option<UserReport>,
    command: Option<MirrorCommand>,
    capabilities: Option<Capabilities>,
    safety: Option<SafetyReport>,
    statuses: BTreeMap<&'static str, NodeStatus>,
    /// States of the controllers by the start of their process, in ns.
    controllers: BTreeMap<Nanos, String>,
}

/// A session that records telemetry and keeps the newest of every other message of a room.
///
/// It has direct links to array and controller. An attacker has links of its own, and peers do not
/// forward messages: what is recorded here was published by the processes of the room.
pub struct Witness {
    room: Room,
    received: Arc<Mutex<Received>>,
    _subscription: Subscription,
    _bus: Bus,
}

impl Witness {
    /// Connects to these endpoints.
    ///
    /// # Panics
    /// When the bus does not open.
    pub fn connect(config: &BusConfig) -> Self {
        let bus = Bus::open(config).expect("the bus opens");
        let received: Arc<Mutex<Received>> = Arc::default();
        let taking = Arc::clone(&received);
        let on_message =
            move |key: &str, payload: &[u8]| taking.lock().expect("no callback panics").take(utc_ns(), key, payload);
        let subscription = bus.subscribe_keyed(&config.room.everything(), on_message).expect("the key is valid");
        Self { room: config.room.clone(), received, _subscription: subscription, _bus: bus }
    }

    /// The room.
    pub fn room(&self) -> &Room {
        &self.room
    }

    /// All telemetry so far.
    pub fn samples(&self) -> Vec<Sample> {
        self.with(|received| received.samples.clone())
    }

    /// The newest telemetry; waits for it if there is none yet, as for the other messages.
    ///
    /// # Panics
    /// When there is none within the time limit.
    pub fn telemetry(&self) -> MirrorTelemetry {
        self.wait_for("telemetry", |received| received.telemetry.clone())
    }

    /// The newest user report.
    pub fn users(&self) -> UserReport {
        self.wait_for("a user report", |received| received.users.clone())
    }

    /// The newest command.
    pub fn command(&self) -> MirrorCommand {
        self.wait_for("a command", |received| received.command.clone())
    }

    /// The newest capabilities.
    pub fn capabilities(&self) -> Capabilities {
        self.wait_for("capabilities", |received| received.capabilities.clone())
    }

    /// The newest safety report, if there is one.
    pub fn safety(&self) -> Option<SafetyReport> {
        self.with(|received| received.safety.clone())
    }

    /// The state in the newest telemetry.
    pub fn state(&self) -> Option<ArrayState> {
        self.with(|received| received.telemetry.as_ref().map(|telemetry| telemetry.state))
    }

    /// The newest status of a kind of process.
    pub fn status(&self, node: NodeKind) -> Option<NodeStatus> {
        self.with(|received| received.statuses.get(node.name()).cloned())
    }

    /// Kinds of processes whose status was received.
    pub fn statuses(&self) -> usize {
        self.with(|received| received.statuses.len())
    }

    /// States of the controllers by the start of their process, from statuses since a wait for one of them began.
    pub fn controllers(&self) -> BTreeMap<Nanos, String> {
        self.with(|received| received.controllers.clone())
    }

    /// Waits until one controller leads and all others stand by, by statuses that begin now: the index of the leader.
    /// `started_ns` has the time before the start of each.
    ///
    /// A controller that was just started stands by only after its first statuses.
    ///
    /// # Panics
    /// When that does not happen within the time limit.
    pub fn wait_for_leader(&self, started_ns: &[Nanos]) -> usize {
        self.forget_controllers();
        let mut found = None;
        wait_until("one controller that leads and others that stand by", || {
            let standing = self.is_standby(started_ns);
            let leaders: Vec<usize> = (0..standing.len()).filter(|index| standing[*index] == Some(false)).collect();
            let are_known = standing.iter().all(Option::is_some);
            found = (are_known && leaders.len() == 1).then(|| leaders[0]);
            if are_known && found.is_none() {
                self.forget_controllers();
            }
            found.is_some() && self.state() == Some(ArrayState::Following)
        });
        found.expect("waited for")
    }

    /// Waits until this controller stands by, by a status that begins now.
    ///
    /// # Panics
    /// When it does not within the time limit.
    pub fn wait_for_standby(&self, started_ns: &[Nanos], index: usize) {
        self.forget_controllers();
        wait_until("a standby", || self.is_standby(started_ns)[index] == Some(true));
    }

    /// Whether each controller stands by, by its newest status; `None` without one. `started_ns` has the time before
    /// the start of each.
    fn is_standby(&self, started_ns: &[Nanos]) -> Vec<Option<bool>> {
        let mut found = vec![None; started_ns.len()];
        for (process_ns, state) in self.controllers() {
            // A status is of the controller that was started last before the start that it names.
            let before = |index: &usize| started_ns[*index] <= process_ns;
            if let Some(index) = (0..found.len()).filter(before).max_by_key(|index| started_ns[*index]) {
                found[index] = Some(state == "standby");
            }
        }
        found
    }

    fn forget_controllers(&self) {
        self.received.lock().expect("no callback panics").controllers.clear();
    }

    /// The value of a counter in the newest status; 0 if it is absent.
    pub fn counter(&self, node: NodeKind, name: &str) -> u64 {
        self.status(node).and_then(|status| status.counter(name)).unwrap_or(0)
    }

    /// Counters of refusals and degraded modes, by process and its source.
    pub fn notable_counters(&self) -> BTreeMap<(String, u64), u64> {
        let is_notable =
            |name: &str| NOTABLE.contains(&name) || NOTABLE_GROUPS.iter().any(|group| name.starts_with(group));
        self.with(|received| {
            let of = |status: &NodeStatus| {
                let (node, source) = (status.node, status.started_ns);
                let counters = status.counters.iter().filter(|(name, _)| is_notable(name));
                counters.map(|(name, count)| ((format!("{node}: {name}"), source), *count)).collect::<Vec<_>>()
            };
            received.statuses.values().flat_map(of).collect()
        })
    }

    /// Waits until the array follows again after a fault that began at `begin_ns` and ends now; returns
    /// the effect. `counted` are the notable counters before the fault.
    ///
    /// # Panics
    /// When the array does not follow again within the time limit.
    pub fn effect_since(&self, counted: &BTreeMap<(String, u64), u64>, begin_ns: Nanos) -> Effect {
        let end_ns = utc_ns();
        wait_until("an array that follows again after the fault", || self.has_recovered(end_ns));
        thread::sleep(STATUS_WAIT);
        let period_ns = u64::try_from(PERIOD.as_nanos()).expect("a short time");
        let effect = Effect::between(&self.samples(), begin_ns, end_ns, period_ns);
        Effect { counted: self.risen(counted), ..effect }
    }

    /// Waits until the array follows, and has accepted commands for half a second.
    ///
    /// # Panics
    /// When it does not within the time limit.
    pub fn wait_until_steady(&self) {
        wait_until("an array that follows steadily", || {
            let samples = self.samples();
            let Some(last) = samples.last() else { return false };
            let since = samples.partition_point(|sample| sample.seen_ns + STEADY_NS < last.seen_ns);
            let recent = &samples[since..];
            let follows = recent.iter().all(|sample| {
                sample.state == ArrayState::Following && sample.source == last.source && sample.accepted_ns > 0
            });
            follows && last.accepted - recent[0].accepted >= STEADY_COMMANDS
        });
    }

    fn has_recovered(&self, end_ns: u64) -> bool {
        let samples = self.samples();
        let Some(last) = samples.last() else { return false };
        let mut after = samples.iter().filter(|sample| sample.accepted_ns > end_ns && sample.source == last.source);
        let first = after.next().map(|sample| sample.accepted);
        last.state == ArrayState::Following && first.is_some_and(|first| last.accepted >= first + RECOVERED_COMMANDS)
    }

    /// Notable counters that have risen, largest first.
    fn risen(&self, before: &BTreeMap<(String, u64), u64>) -> Vec<String> {
        let after = self.notable_counters();
        let rise = |(key, count): (&(String, u64), &u64)| {
            (count.saturating_sub(before.get(key).copied().unwrap_or(0)), key.0.clone())
        };
        let mut risen: Vec<_> = after.iter().map(rise).filter(|(count, _)| *count > 0).collect();
        risen.sort_by(|one, other| other.cmp(one));
        risen.into_iter().map(|(count, name)| format!("{name} {count}")).collect()
    }

    fn wait_for<T>(&self, what: &str, read: impl Fn(&Received) -> Option<T>) -> T {
        let mut found = None;
        wait_until(what, || {
            found = self.with(&read);
            found.is_some()
        });
        found.expect("waited for")
    }

    fn with<T>(&self, read: impl FnOnce(&Received) -> T) -> T {
        read(&self.received.lock().expect("no callback panics"))
    }
}

impl Received {
    fn take(&mut self, seen_ns: u64, key: &str, payload: &[u8]) {
        match key.rsplit_once('/').map_or("", |(_, last)| last) {
            "telemetry" => {
                if let Ok(telemetry) = codec::decode(payload) {
                    self.samples.push(Sample::new(seen_ns, &telemetry));
                    self.telemetry = Some(telemetry);
                }
            }
            "users" => keep(&mut self.users, payload),
            "command" => keep(&mut self.command, payload),
            "capabilities" => keep(&mut self.capabilities, payload),
            "safety" => keep(&mut self.safety, payload),
            _ => {
                if let Ok(status) = codec::decode::<NodeStatus>(payload) {
                    if status.node == NodeKind::Controller {
                        self.controllers.insert(status.started_ns, status.state.clone());
                    }
                    self.statuses.insert(status.node.name(), status);
                }
            }
        }
    }
}

fn keep<T: codec::Message>(slot: &mut Option<T>, payload: &[u8]) {
    if let Ok(message) = codec::decode(payload) {
        *slot = Some(message);
    }
}
