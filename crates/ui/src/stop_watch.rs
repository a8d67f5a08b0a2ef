//! Watches what the arrays of a room report about the emergency stops.
//!
//! [`ReportedStops`] decides whether a room is stopped; the page and the command line show its result.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, Presence, Subscription};
use heliostat_proto::keys::{parse_alive, parse_array_alive};
use heliostat_proto::reported_stops::{ReportedStops, RoomStop, Standing};
use heliostat_proto::{
    EmergencyStop, Message, MirrorTelemetry, NodeKind, NodeStatus, RoomGeometry, SafetyReport, StopName, StopReport,
    codec, make_place,
};
use heliostat_scenario::Scenario;
use heliostat_service::locks::{lock, unpoisoned};
use heliostat_service::printable::printable;

use crate::UiError;
use crate::array_reports::ArrayReports;
use crate::causes::follows_from_stop;
use crate::expiry::EXPIRY;
use crate::stop_words::{UNKNOWN_ARRAYS, held_in_words, lost_beside_another, problem, unrecorded, unreleased_lost};

/// Time within which two drivers of one array have reported it in turn, each at least twice a second.
const REPORTED_WITHIN: Duration = Duration::from_millis(1500);

/// What an operator is shown of the stops of a room.
#[derive(Clone, Debug, Default)]
pub(crate) struct RoomStops {
    /// The present time of the watch, as in `known` of the stops.
    pub now: Duration,
    /// The stops that are held.
    pub stops: Vec<RoomStop>,
    /// The stops that a controller holds for arrays that do not report, in the words of its state; absent where an
    /// array reports a stop, and where each array reports that it has none.
    pub held: Option<String>,
    /// What each array does about them.
    pub standings: Vec<(usize, Standing)>,
    /// The arrays that have stopped and do not record the stop, in words.
    pub unrecorded: Vec<String>,
    /// What is to be said of the arrays of which drivers are lost, after a release.
    pub unreleased_lost: Vec<String>,
    /// Age of the oldest of the arrays' last reports.
    pub report_age: Option<Duration>,
    /// When this process ordered a stop that is still held.
    pub ordered: Option<Instant>,
    /// Whether the number of arrays of the room is known.
    pub has_geometry: bool,
    /// Whether a viewer that has just opened has heard each array and each controller.
    pub is_heard: bool,
}

impl RoomStops {
    /// Whether a stop is known here.
    pub fn is_held(&self) -> bool {
        !self.stops.is_empty() || self.held.is_some()
    }

    /// Whether every array for which a stop is held has stopped.
    pub fn is_confirmed(&self) -> bool {
        let is_open = self.standings.iter().any(|(_, standing)| standing.is_open());
        let is_known = self.has_geometry && self.is_heard;
        is_known && !is_open && self.standings.iter().any(|(_, standing)| *standing == Standing::Stopped)
    }

    /// The arrays for which no stop is held, while one is held for another array.
    pub fn free(&self) -> Vec<usize> {
        let free = |(array, standing): &(usize, Standing)| (*standing == Standing::Free).then_some(*array);
        self.standings.iter().filter_map(free).collect()
    }

    /// What is open, array by array, and which stops are not recorded.
    pub fn problems(&self) -> Vec<String> {
        let unknown = (!self.has_geometry && !self.stops.is_empty()).then(|| UNKNOWN_ARRAYS.to_owned());
        let open = self.standings.iter().filter_map(|(array, standing)| problem(*array, standing));
        let held = self.held.as_deref().map(held_in_words);
        open.chain(unknown).chain(held).chain(self.unrecorded.iter().cloned()).collect()
    }
}

/// Watches the arrays of a room; the view, the page and the command line share what it has seen.
pub(crate) struct StopWatch {
    state: Arc<WatchState>,
    /// Of each session that has joined.
    subscriptions: Mutex<Vec<Vec<Subscription>>>,
}

/// What was reported, with a signal for each change.
#[derive(Debug)]
struct WatchState {
    /// The origin of its times.
    opened: Instant,
    seen: Mutex<ReportedStops>,
    changed: Condvar,
    arrays: Mutex<ArrayReports>,
    /// The states of the controllers that hold stops, by their sources, with the arrival times.
    holders: Mutex<BTreeMap<u64, (Instant, String)>>,
    /// The sessions in which each token is seen, by its key.
    tokens: Mutex<BTreeMap<String, BTreeSet<usize>>>,
}

impl StopWatch {
    /// Watches the arrays of a room.
    ///
    /// # Errors
    /// [`UiError::Bus`] if the session is closed.
    pub fn open(bus: &Bus) -> Result<Arc<Self>, UiError> {
        let watch = Self::without_session();
        watch.join(bus)?;
        Ok(watch)
    }

    /// Watches nothing yet.
    pub fn without_session() -> Arc<Self> {
        let state = Arc::new(WatchState {
            opened: Instant::now(),
            seen: Mutex::default(),
            changed: Condvar::new(),
            arrays: Mutex::default(),
            holders: Mutex::default(),
            tokens: Mutex::default(),
        });
        Arc::new(Self { state, subscriptions: Mutex::default() })
    }

    /// Watches the arrays that this session reaches too. What two sessions show counts once.
    ///
    /// # Errors
    /// [`UiError::Bus`] if the session is closed.
    pub fn join(&self, bus: &Bus) -> Result<(), UiError> {
        let state = &self.state;
        let mut sessions = lock(&self.subscriptions);
        let session = sessions.len();
        let mut subscriptions = Vec::new();
        let room = bus.room();
        for keys in [room.array(0), room.later_arrays()] {
            let (shown, of_room) = (Arc::clone(state), room.clone());
            subscriptions.push(bus.subscribe_keyed(&keys.telemetry(), move |key, payload| {
                if let Some(array) = of_room.array_of(key, &of_room.telemetry())
                    && let Ok(report) = codec::decode::<MirrorTelemetry>(payload)
                {
                    shown.arrays().note(array, report.clone());
                    shown.note(|seen, now| seen.handle_telemetry(now, array, &report));
                }
            })?);
            subscriptions.push(state.subscribe(
                bus,
                (keys.safety().as_str(), room.safety()),
                |seen, now, (array, report): (_, SafetyReport)| {
                    seen.handle_safety(now, array, &report);
                },
            )?);
            subscriptions.push(state.subscribe(
                bus,
                (keys.stops().as_str(), room.stops()),
                |seen, now, (array, report): (_, StopReport)| {
                    seen.handle_stops(now, array, report);
                },
            )?);
        }
        let announcing = Arc::clone(state);
        subscriptions.push(bus.subscribe(&room.all_geometry(), move |payload| {
            if let Ok(report) = codec::decode::<RoomGeometry>(payload)
                && let Ok(scenario) = Scenario::from_geometry_toml(&report.scenario)
            {
                announcing.note(|seen, now| seen.announce(now, scenario.mirrors.arrays().len()));
            }
        })?);
        let (holding, of_room) = (Arc::clone(state), room.clone());
        subscriptions.push(bus.subscribe_keyed(&room.all_status(), move |key, payload| {
            if let Ok(status) = codec::decode::<NodeStatus>(payload)
                && of_room.status_array(key, &status).is_some()
            {
                holding.note_holder(&status);
                holding.note(|seen, now| seen.handle_status(now, &status));
            }
        })?);
        let present = Arc::clone(state);
        subscriptions.push(bus.watch(&room.all_alive(), move |key, presence| {
            present.note_token(session, key, presence == Presence::Alive);
        })?);
        sessions.push(subscriptions);
        Ok(())
    }

    /// Expects so many arrays, as if a geometry announced them.
    pub fn expect(&self, arrays: usize) {
        self.state.note(|seen, now| seen.announce(now, arrays));
    }

    /// Holds a stop for every array.
    pub fn order(&self, order: &EmergencyStop) {
        self.state.note(|seen, now| seen.order(now, order));
    }

    /// Holds these stops no longer for arrays whose stop report arrived after `since` and names none of them.
    pub fn forget_unlatched(&self, names: &[StopName], since: Duration) {
        self.state.note(|seen, _| seen.forget_unlatched(names, since));
    }

    /// The stops of the room, and what each array does about them.
    pub fn room(&self) -> RoomStops {
        let (seen, now) = (self.lock(), self.now());
        let stops = seen.stops();
        let standings = if stops.is_empty() { Vec::new() } else { seen.standings(now, None) };
        let is_hidden = stops.is_empty() && seen.has_silent_array(now);
        let held = if is_hidden { self.state.held() } else { None };
        let report_age = seen.oldest_report().map(|at| now.saturating_sub(at));
        let unreleased_lost = seen.lost(now).iter().filter_map(unreleased_lost).collect();
        let unrecorded = unrecorded(seen.unrecorded(now));
        let (has_geometry, is_heard) = (seen.has_geometry(), seen.is_heard(now));
        let ordered = None;
        RoomStops {
            now,
            stops,
            held,
            standings,
            unrecorded,
            unreleased_lost,
            report_age,
            ordered,
            has_geometry,
            is_heard,
        }
    }

    /// What differs without a fault while no stop is held: the lost drivers of arrays that another driver serves.
    pub fn remarks(&self) -> Vec<String> {
        let (seen, now) = (self.lock(), self.now());
        let lost = if seen.stops().is_empty() { seen.lost(now) } else { Vec::new() };
        lost.iter().filter(|(array, _)| seen.has_driver(*array)).filter_map(lost_beside_another).collect()
    }

    /// The arrays that two processes report, with the sources of both. A token alone only keeps a stop unconfirmed: it
    /// can be forged, or of a host that has failed. Where tokens name two, the telemetry of both is awaited for a moment.
    pub fn shared(&self) -> Vec<(usize, [u64; 2])> {
        let is_likely = self.lock().has_shared_array();
        if is_likely {
            self.wait(REPORTED_WITHIN, |_, _| !self.state.arrays().shared().is_empty());
        }
        self.state.arrays().shared()
    }

    /// The arrays that report that a device does not answer.
    pub fn lost_devices(&self) -> Vec<usize> {
        self.state.arrays().lost_devices()
    }

    /// The time of the reports, at present.
    pub fn now(&self) -> Duration {
        self.state.opened.elapsed()
    }

    pub fn lock(&self) -> MutexGuard<'_, ReportedStops> {
        self.state.lock()
    }

    /// Notes a report without a session.
    #[cfg(test)]
    pub fn note(&self, set: impl FnOnce(&mut ReportedStops, Duration)) {
        self.state.note(set);
    }

    /// Waits until the condition holds at the present time, at most `limit`; returns whether it holds.
    pub fn wait(&self, limit: Duration, holds: impl Fn(&ReportedStops, Duration) -> bool) -> bool {
        let WatchState { changed, .. } = &*self.state;
        let waited = changed.wait_timeout_while(self.lock(), limit, |seen| !holds(seen, self.now()));
        let (seen, _) = unpoisoned(waited);
        holds(&seen, self.now())
    }
}

impl WatchState {
    /// Subscribes to the reports of arrays, under keys of which this is that of the first array.
    fn subscribe<M: Message + 'static>(
        self: &Arc<Self>,
        bus: &Bus,
        (keys, first): (&str, String),
        note: fn(&mut ReportedStops, Duration, (usize, M)),
    ) -> Result<Subscription, UiError> {
        let (room, state) = (bus.room().clone(), Arc::clone(self));
        Ok(bus.subscribe_keyed(keys, move |key, payload| {
            if let Some(array) = room.array_of(key, &first)
                && let Ok(report) = codec::decode::<M>(payload)
            {
                state.note(|seen, now| note(seen, now, (array, report)));
            }
        })?)
    }

    fn lock(&self) -> MutexGuard<'_, ReportedStops> {
        // Each change is complete before the lock is released.
        lock(&self.seen)
    }

    fn arrays(&self) -> MutexGuard<'_, ArrayReports> {
        lock(&self.arrays)
    }

    fn holders(&self) -> MutexGuard<'_, BTreeMap<u64, (Instant, String)>> {
        lock(&self.holders)
    }

    /// Keeps the state of a controller while it holds stops.
    fn note_holder(&self, status: &NodeStatus) {
        if status.node != NodeKind::Controller {
            return;
        }
        let mut holders = self.holders();
        holders.remove(&status.stamp.source);
        holders.retain(|_, (at, _)| at.elapsed() < EXPIRY);
        let source = status.stamp.source;
        if follows_from_stop(&status.state) && make_place(&mut holders, source, |_| false) {
            holders.insert(source, (Instant::now(), printable(&status.state).into_owned()));
        }
    }

    /// The stops that a controller holds, in the words of its state, unless it is old.
    fn held(&self) -> Option<String> {
        let holders = self.holders();
        holders.values().find(|(at, _)| at.elapsed() < EXPIRY).map(|(_, state)| state.clone())
    }

    /// A process is there as long as one session sees its token.
    fn note_token(&self, session: usize, key: &str, is_alive: bool) {
        let mut tokens = lock(&self.tokens);
        let seen_in = tokens.entry(key.to_owned()).or_default();
        if is_alive {
            seen_in.insert(session);
        } else {
            seen_in.remove(&session);
        }
        let is_there = !seen_in.is_empty();
        if !is_there {
            tokens.remove(key);
        }
        // Under the lock: two sessions report in the order of their changes.
        self.note(|seen, now| match (parse_array_alive(key), parse_alive(key)) {
            (Some(driver), _) => seen.handle_driver(now, driver, is_there),
            (None, Some((NodeKind::Controller, source))) => seen.handle_controller(source, is_there),
            (None, _) => {}
        });
    }

    fn note(&self, set: impl FnOnce(&mut ReportedStops, Duration)) {
        let mut seen = self.lock();
        set(&mut seen, self.opened.elapsed());
        drop(seen);
        self.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{LostDriver, Stamp};

    use super::*;
    use crate::causes::over;

    #[test]
    fn a_stop_that_a_controller_holds_is_shown_only_while_an_array_does_not_report_and_none_reports_a_stop() {
        let watch = StopWatch::without_session();
        let state =
            |state: &str| NodeStatus { node: NodeKind::Controller, state: state.into(), ..NodeStatus::default() };
        let held = "withheld by the stop of anna (\"ladder\") since 12:00:00 UTC";
        watch.state.note_holder(&state(held));
        let room = watch.room();
        assert!(room.is_held() && room.stops.is_empty() && !room.is_confirmed(), "{room:?}");
        assert!(room.problems()[0].starts_with(&format!("no array here reports a stop, and commands are {held}: ")));
        let report = |array| watch.note(|seen, now| seen.handle_telemetry(now, array, &MirrorTelemetry::default()));
        watch.expect(2);
        report(0);
        assert_eq!(watch.room().held.as_deref(), Some(held), "array 1 does not report");
        report(1);
        assert!(!watch.room().is_held(), "the status is from before the release");
        watch.expect(3);
        assert_eq!(watch.room().held.as_deref(), Some(held));
        watch.state.note_holder(&NodeStatus { node: NodeKind::Driver, ..state("running") });
        assert!(watch.room().is_held(), "the status of another process");
        watch.state.note_holder(&state("running"));
        assert!(!watch.room().is_held(), "the controller holds it no longer");
        watch.state.note_holder(&state(held));
        let stamp = Stamp { source: 3, sequence: 4, ..Stamp::default() };
        watch.order(&EmergencyStop { stamp, ..EmergencyStop::default() });
        assert!(watch.room().held.is_none() && watch.room().is_held(), "it is one of the stops");
    }

    #[test]
    fn a_lost_driver_is_a_remark_while_another_one_serves_its_array_and_no_stop_is_held() {
        let watch = StopWatch::without_session();
        let counters = vec![LostDriver { array: 0, source: 7, since_ns: 43_384_000_000_000 }.counter()];
        let status = NodeStatus { node: NodeKind::Controller, counters, ..NodeStatus::default() };
        watch.note(|seen, now| seen.handle_status(now, &status));
        assert_eq!(watch.remarks(), [""; 0], "the array has no driver");
        watch.note(|seen, now| seen.handle_driver(now, (Some(0), 9), true));
        let remark = "driver 0000000000000007 was lost at 12:03:04 UTC, and another driver serves array 0: a stop stays \
                      unconfirmed until it returns, or until its release";
        assert_eq!(watch.remarks(), [remark]);
        let ended = "over: driver 0000000000000007 was lost at 12:03:04 UTC, and another driver serves array 0";
        assert_eq!(over(remark), ended);
        let stamp = Stamp { source: 3, sequence: 4, ..Stamp::default() };
        watch.order(&EmergencyStop { stamp, ..EmergencyStop::default() });
        assert_eq!(watch.remarks(), [""; 0], "the stop names it");
    }
}
