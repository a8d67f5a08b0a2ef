//! What the arrays of a room report about the emergency stops, and which stops are held for them.
//!
//! This is the only place where a process for operators decides whether a room is stopped. The page
//! and the command line show its result.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, Presence, Subscription};
use heliostat_proto::keys::parse_driver_alive;
use heliostat_proto::messages::fault;
use heliostat_proto::stop_hold::{HeldStop, StopHold, unknown_stops};
use heliostat_proto::{
    ArrayState, EmergencyStop, LatchedStopReport, MAX_ARRAYS, Message, MirrorTelemetry, RoomGeometry, SafetyReport,
    StopName, StopReport, codec,
};
use heliostat_scenario::Scenario;
use heliostat_service::printable::printable;

use crate::UiError;
use crate::view::Dated;

/// A stop report is published each second, and at each change. An array without one for this time does
/// not answer.
const REPORT_AGE_MAX: Duration = Duration::from_millis(2500);

/// Telemetry is published ten times a second.
const TELEMETRY_AGE_MAX: Duration = Duration::from_millis(1500);

/// A driver that publishes stop reports has published one after this time of telemetry.
const STOPS_WITHIN: Duration = Duration::from_millis(1500);

/// What is open where no process announces the geometry of the room.
pub(crate) const UNKNOWN_ARRAYS: &str = "no process announces how many arrays the room has, and one that was not seen can move: connect to its controller or router";

/// What an array does about the stops that are held for it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Standing {
    /// No stop is held for it.
    Free,
    /// It has latched every stop, and its device has executed them.
    Stopped,
    /// It has latched every stop, and its device has not executed them.
    Latched {
        /// Why, as the array reports it; may be empty.
        problem: String,
    },
    /// It has latched a stop; its driver publishes no stop reports.
    Unknown,
    /// It reports, and has not latched every stop.
    Moving,
    /// It does not report.
    Silent,
}

impl Standing {
    /// Whether the mirrors may move although a stop is held.
    pub fn is_open(&self) -> bool {
        !matches!(self, Self::Free | Self::Stopped)
    }

    /// What an operator has to know of this array; `None` where nothing is open.
    pub fn problem(&self, array: usize) -> Option<String> {
        Some(match self {
            Self::Free | Self::Stopped => return None,
            Self::Silent => format!("array {array} does not answer: cut its power"),
            Self::Moving => format!("array {array} has not latched the stop: cut its power"),
            Self::Latched { problem } if problem.is_empty() => {
                format!("array {array} has latched the stop, but its device has not executed it: cut its power")
            }
            Self::Latched { problem } => format!(
                "array {array} has latched the stop, but its device has not executed it ({}): cut its power",
                printable(problem)
            ),
            Self::Unknown => format!(
                "array {array} has latched the stop; its driver does not report whether the device executed it: check its mirrors"
            ),
        })
    }
}

/// A stop that is in force or held, with the arrays for which it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ShownStop {
    /// Its name.
    pub name: StopName,
    /// Name of the operator who sent it.
    pub operator: String,
    /// Reason for it.
    pub reason: String,
    /// Indices of the arrays for which it is held.
    pub arrays: Vec<usize>,
    /// When this process learned of it.
    pub known: Instant,
}

/// What an operator is shown of the stops of a room.
#[derive(Clone, Debug, Default)]
pub(crate) struct RoomStops {
    /// The stops that are held.
    pub stops: Vec<ShownStop>,
    /// What each array does about them.
    pub standings: Vec<(usize, Standing)>,
    /// When the oldest of the arrays reported last.
    pub reported: Option<Instant>,
    /// When this process ordered a stop that is still held.
    pub ordered: Option<Instant>,
    /// Whether the number of arrays of the room is known.
    pub has_geometry: bool,
}

impl RoomStops {
    /// Whether every array for which a stop is held has stopped.
    pub fn is_confirmed(&self) -> bool {
        let is_open = self.standings.iter().any(|(_, standing)| standing.is_open());
        self.has_geometry && !is_open && self.standings.iter().any(|(_, standing)| *standing == Standing::Stopped)
    }

    /// The arrays for which no stop is held, while one is held for another array.
    pub fn free(&self) -> Vec<usize> {
        let free = |(array, standing): &(usize, Standing)| (*standing == Standing::Free).then_some(*array);
        self.standings.iter().filter_map(free).collect()
    }

    /// What is open, array by array.
    pub fn problems(&self) -> Vec<String> {
        let unknown = (!self.has_geometry && !self.stops.is_empty()).then(|| UNKNOWN_ARRAYS.to_owned());
        self.standings.iter().filter_map(|(array, standing)| standing.problem(*array)).chain(unknown).collect()
    }
}

/// What an array reported last, with arrival times.
#[derive(Clone, Debug, Default)]
struct SeenArray {
    /// Arrival of its first report.
    first: Option<Instant>,
    state: Dated<ArrayState>,
    /// Arrival of the last telemetry of a stopped device, and its source.
    device_stopped: Dated<u64>,
    safety: Dated<SafetyReport>,
    stops: Dated<StopReport>,
    hold: StopHold,
}

/// What the arrays reported, and what is held for them.
#[derive(Debug, Default)]
pub(crate) struct Seen {
    arrays: BTreeMap<usize, SeenArray>,
    /// Number of arrays of the largest geometry that was announced; 0 before the first.
    announced: usize,
    /// When each stop became known here.
    known: BTreeMap<StopName, Instant>,
}

/// Watches the arrays of a room; the view, the page and the command line share what it has seen.
pub(crate) struct StopWatch {
    state: Arc<WatchState>,
    _subscriptions: Vec<Subscription>,
}

/// [`Seen`], with a signal for each change.
#[derive(Debug, Default)]
struct WatchState {
    seen: Mutex<Seen>,
    changed: Condvar,
}

impl SeenArray {
    /// What the array does about its stops, with reports that arrived after `since` only.
    fn standing(&self, since: Option<Instant>) -> Standing {
        let mut held = self.hold.stops().iter().map(|held| held.name).peekable();
        if held.peek().is_none() {
            return Standing::Free;
        }
        let counts = |at: &Instant, age_max: Duration| at.elapsed() < age_max && since.is_none_or(|since| *at >= since);
        // A report from before `since` counts if telemetry has confirmed it meanwhile.
        let is_confirmed = |report: &StopReport| {
            let telemetry = self.device_stopped.filter(|(_, source)| *source == report.stamp.source);
            report.device_stopped && telemetry.is_some_and(|(at, _)| counts(&at, TELEMETRY_AGE_MAX))
        };
        let is_fresh = |(at, report): &&(Instant, StopReport)| {
            counts(at, REPORT_AGE_MAX) || (at.elapsed() < REPORT_AGE_MAX && is_confirmed(report))
        };
        if let Some((_, report)) = self.stops.as_ref().filter(is_fresh) {
            return match (held.all(|name| report.is_latched(name)), report.device_stopped) {
                (false, _) => Standing::Moving,
                (true, true) => Standing::Stopped,
                (true, false) => Standing::Latched { problem: report.problem.clone() },
            };
        }
        let is_older = self.stops.is_none() && self.is_settled();
        match self.state.filter(|(at, _)| counts(at, TELEMETRY_AGE_MAX)) {
            Some((_, ArrayState::Stopped)) if is_older => Standing::Unknown,
            Some(_) => Standing::Moving,
            None => Standing::Silent,
        }
    }

    /// Whether stop reports of its driver would have arrived.
    fn is_settled(&self) -> bool {
        self.first.is_some_and(|first| first.elapsed() > STOPS_WITHIN)
    }

    /// Whether its driver is present and publishes no stop reports.
    fn is_older(&self) -> bool {
        self.state.is_some_and(|(at, _)| at.elapsed() < TELEMETRY_AGE_MAX) && !self.hold.has_stop_reports()
    }
}

impl Seen {
    /// Number of arrays that have to confirm a stop: those of the announced geometry, and all that
    /// were ever seen.
    fn expected(&self) -> usize {
        let seen = self.arrays.keys().next_back().map_or(0, |last| last + 1);
        seen.max(self.announced)
    }

    /// Whether a geometry was announced.
    pub fn has_geometry(&self) -> bool {
        self.announced > 0
    }

    /// What each array does about the stops that are held for it. Of several reports only those that
    /// arrived after `since` count.
    pub fn standings(&self, since: Option<Instant>) -> Vec<(usize, Standing)> {
        let standing = |array: usize| {
            let seen = self.arrays.get(&array);
            (array, seen.map_or(Standing::Silent, |seen| seen.standing(since)))
        };
        (0..self.expected()).map(standing).collect()
    }

    /// All stops that are held, in the order of their arrival at the first array that has them.
    pub fn stops(&self) -> Vec<ShownStop> {
        let mut stops: Vec<ShownStop> = Vec::new();
        for (array, seen) in &self.arrays {
            for HeldStop { name, operator, reason, .. } in seen.hold.stops() {
                match stops.iter_mut().find(|stop| stop.name == *name) {
                    Some(stop) => stop.arrays.push(*array),
                    None => stops.push(ShownStop {
                        name: *name,
                        operator: operator.clone(),
                        reason: reason.clone(),
                        arrays: vec![*array],
                        known: self.known.get(name).copied().unwrap_or_else(Instant::now),
                    }),
                }
            }
        }
        stops
    }

    /// Whether a stop is held for every array that has to confirm it.
    pub fn is_held_everywhere(&self, name: StopName) -> bool {
        let holds =
            |array| self.arrays.get(&array).is_some_and(|seen| seen.hold.stops().iter().any(|held| held.name == name));
        (0..self.expected()).all(holds)
    }

    /// Holds a stop for every array.
    fn order(&mut self, now: Instant, order: &EmergencyStop) {
        self.known.entry(order.name()).or_insert(now);
        for array in 0..self.expected() {
            self.arrays.entry(array).or_default().hold.order(order.stamp.time_ns, order);
        }
    }

    /// The stops that are due for repetition, with the index of the array, and whether its driver
    /// understands none.
    pub fn unreported(&self) -> Vec<(usize, HeldStop, bool)> {
        let of = |(array, seen): (&usize, &SeenArray)| {
            let (array, is_older) = (*array, seen.is_older());
            seen.hold.unreported().map(|held| (array, held.clone(), is_older)).collect::<Vec<_>>()
        };
        self.arrays.iter().flat_map(of).collect()
    }

    /// The present arrays that are stopped and publish neither stop reports nor safety reports.
    pub fn unnamed(&self) -> Vec<usize> {
        let is_unnamed = |seen: &SeenArray| {
            let is_stopped = seen.state.is_some_and(|(_, state)| state == ArrayState::Stopped);
            is_stopped && seen.is_older() && seen.safety.is_none()
        };
        self.arrays.iter().filter(|(_, seen)| is_unnamed(seen)).map(|(array, _)| *array).collect()
    }

    /// Whether an array has been seen for so long that its stop reports would have arrived.
    pub fn is_settled(&self, array: usize) -> bool {
        self.arrays.get(&array).is_some_and(SeenArray::is_settled)
    }

    /// What is open of a release of these stops, array by array.
    pub fn unreleased(&self, names: &[StopName]) -> Vec<String> {
        let unnamed = self.unnamed();
        let of = |(array, seen): (&usize, &SeenArray)| {
            let is_held = seen.hold.stops().iter().any(|held| names.contains(&held.name));
            let is_silent = seen.state.is_none_or(|(at, _)| at.elapsed() >= TELEMETRY_AGE_MAX);
            match (unnamed.contains(array), is_held, is_silent) {
                (true, ..) => Some(format!("array {array} knows no names of stops: release all with --all")),
                (false, true, true) => Some(format!("array {array} does not answer: it stays stopped")),
                (false, true, false) => Some(format!("array {array} has not released the stop")),
                (false, false, _) => None,
            }
        };
        self.arrays.iter().filter_map(of).collect()
    }

    /// Whether no array is known.
    pub fn is_empty(&self) -> bool {
        self.expected() == 0
    }

    /// Whether any array reports.
    pub fn has_array(&self) -> bool {
        self.arrays.values().any(|seen| seen.first.is_some())
    }

    /// Whether each array that was seen has published its stops, or publishes none.
    pub fn has_published(&self) -> bool {
        self.has_array() && self.arrays.values().all(|seen| seen.stops.is_some() || seen.is_settled())
    }

    /// Whether every array has published its stops.
    pub fn is_complete(&self) -> bool {
        let has_reported = |array| self.arrays.get(&array).is_some_and(|seen: &SeenArray| seen.stops.is_some());
        self.has_geometry() && (0..self.expected()).all(has_reported)
    }

    /// When the oldest of the arrays reported last.
    pub fn oldest_report(&self) -> Option<Instant> {
        self.arrays.values().filter_map(|seen| seen.state.map(|(at, _)| at)).min()
    }

    /// Adds arrays up to an index; stops that are held for another array are held for them too.
    fn add_arrays(&mut self, count: usize) {
        let known: Vec<EmergencyStop> = self.stops().iter().map(ordered).collect();
        for array in 0..count.min(MAX_ARRAYS) {
            if !self.arrays.contains_key(&array) {
                let seen = self.arrays.entry(array).or_default();
                known.iter().for_each(|order| seen.hold.order(0, order));
            }
        }
    }

    fn array(&mut self, array: usize) -> &mut SeenArray {
        self.add_arrays(array + 1);
        let seen = self.arrays.entry(array).or_default();
        seen.first.get_or_insert_with(Instant::now);
        seen
    }

    fn handle_stops(&mut self, array: usize, report: StopReport) {
        // A report that arrives late must not show a device as stopped that has moved on since.
        if self.handle_reported(array, &report.stops, |hold| hold.handle_stops(&report)) {
            self.array(array).stops = Some((Instant::now(), report));
        }
    }

    fn handle_safety(&mut self, array: usize, report: SafetyReport) {
        self.handle_reported(array, report.stop().as_slice(), |hold| hold.handle_safety(&report));
        self.array(array).safety = Some((Instant::now(), report));
    }

    /// Applies a report; whether it counts. A stop in it that was not known concerns all arrays.
    fn handle_reported(
        &mut self,
        array: usize,
        reported: &[LatchedStopReport],
        apply: impl FnOnce(&mut StopHold) -> bool,
    ) -> bool {
        self.array(array);
        let unknown = unknown_stops(reported, self.arrays.values().map(|seen| &seen.hold));
        let counts = apply(&mut self.array(array).hold);
        if counts {
            for stop in &unknown {
                self.arrays.values_mut().for_each(|seen| seen.hold.learn(stop));
            }
        }
        counts
    }

    fn note_names(&mut self) {
        let now = Instant::now();
        let names: BTreeSet<StopName> =
            self.arrays.values().flat_map(|seen| seen.hold.stops().iter().map(|held| held.name)).collect();
        self.known.retain(|name, _| names.contains(name));
        for name in names {
            self.known.entry(name).or_insert(now);
        }
    }
}

/// The order of a stop that is known from reports.
fn ordered(stop: &ShownStop) -> EmergencyStop {
    let mut order =
        EmergencyStop { operator: stop.operator.clone(), reason: stop.reason.clone(), ..EmergencyStop::default() };
    (order.stamp.source, order.stamp.sequence) = (stop.name.source, stop.name.sequence);
    order
}

impl StopWatch {
    /// Watches the arrays of a room.
    ///
    /// # Errors
    /// [`UiError::Bus`] if the session is closed.
    pub fn open(bus: &Bus) -> Result<Arc<Self>, UiError> {
        let state: Arc<WatchState> = Arc::default();
        let mut subscriptions = Vec::new();
        let room = bus.room();
        for keys in [room.array(0), room.later_arrays()] {
            subscriptions.push(state.subscribe(bus, &keys.telemetry(), |seen, array, report: MirrorTelemetry| {
                let seen = seen.array(array);
                let (now, is_stopped) = (Instant::now(), report.state == ArrayState::Stopped);
                seen.hold.handle_state(report.stamp.source, is_stopped);
                seen.state = Some((now, report.state));
                if is_stopped && report.faults & fault::STOP == 0 {
                    seen.device_stopped = Some((now, report.stamp.source));
                }
            })?);
            subscriptions.push(state.subscribe(bus, &keys.safety(), Seen::handle_safety)?);
            subscriptions.push(state.subscribe(bus, &keys.stops(), Seen::handle_stops)?);
        }
        subscriptions.push(state.subscribe(bus, &room.all_geometry(), |seen, _, report: RoomGeometry| {
            if let Ok(scenario) = Scenario::from_geometry_toml(&report.scenario) {
                seen.announced = seen.announced.max(scenario.mirrors.arrays().len());
                seen.add_arrays(seen.announced);
            }
        })?);
        let present = Arc::clone(&state);
        subscriptions.push(bus.watch(&room.all_alive(), move |key, presence| {
            if let Some((array, _)) = parse_driver_alive(key).filter(|_| presence == Presence::Alive) {
                present.note(|seen| seen.add_arrays(array + 1));
            }
        })?);
        Ok(Arc::new(Self { state, _subscriptions: subscriptions }))
    }

    /// Expects so many arrays, as if a geometry announced them.
    pub fn expect(&self, arrays: usize) {
        self.state.note(|seen| {
            seen.announced = seen.announced.max(arrays);
            seen.add_arrays(seen.announced);
        });
    }

    /// Holds a stop for every array.
    pub fn order(&self, order: &EmergencyStop) {
        self.state.note(|seen| seen.order(Instant::now(), order));
    }

    /// The stops of the room, and what each array does about them.
    pub fn room(&self) -> RoomStops {
        let seen = self.lock();
        let stops = seen.stops();
        let standings = if stops.is_empty() { Vec::new() } else { seen.standings(None) };
        let (reported, has_geometry) = (seen.oldest_report(), seen.has_geometry());
        RoomStops { stops, standings, reported, ordered: None, has_geometry }
    }

    pub fn lock(&self) -> MutexGuard<'_, Seen> {
        self.state.lock()
    }

    /// Waits until the condition holds, at most `limit`; returns whether it holds.
    pub fn wait(&self, limit: Duration, holds: impl Fn(&Seen) -> bool) -> bool {
        let WatchState { changed, .. } = &*self.state;
        let waited = changed.wait_timeout_while(self.lock(), limit, |seen| !holds(seen));
        let (seen, _) = waited.unwrap_or_else(PoisonError::into_inner);
        holds(&seen)
    }
}

impl WatchState {
    fn subscribe<M: Message + 'static>(
        self: &Arc<Self>,
        bus: &Bus,
        keys: &str,
        note: fn(&mut Seen, usize, M),
    ) -> Result<Subscription, UiError> {
        let (room, state) = (bus.room().clone(), Arc::clone(self));
        Ok(bus.subscribe_keyed(keys, move |key, payload| {
            if let Ok(report) = codec::decode::<M>(payload) {
                let (array, _) = room.first_array_key(key);
                state.note(|seen| note(seen, array, report));
            }
        })?)
    }

    fn lock(&self) -> MutexGuard<'_, Seen> {
        // Each change is complete before the lock is released.
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note(&self, set: impl FnOnce(&mut Seen)) {
        let mut seen = self.lock();
        set(&mut seen);
        seen.note_names();
        drop(seen);
        self.changed.notify_all();
    }
}
