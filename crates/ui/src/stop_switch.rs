//! The emergency stop of a room's arrays, and its release.
//!
//! A stop is obeyed by every array, from every sender. It is repeated, by its name, to each array that
//! has not reported it. A room is stopped when every array of its announced geometry, and every array
//! that was ever seen, reports the stop and that its device executed it, see [`ReportedStops`]. A re-arm
//! names each stop that it releases. An array that publishes no safety report receives the re-arm that
//! belongs to the first messages of the contract, which is compared by time.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, RwLock};
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, Class, Publisher};
use heliostat_proto::reported_stops::{ReportedStops, RoomStop, Standing};
use heliostat_proto::stop_hold::STOP_REPEAT_NS;
use heliostat_proto::{EmergencyStop, MAX_ARRAYS, Rearm, Stamp, StopAction, StopName, codec, cut};
use heliostat_service::clock::utc_ns;
use heliostat_service::locks::{lock, unpoisoned};
use heliostat_service::source_id;

use crate::UiError;
use crate::notes::two_drivers;
use crate::order_publisher::OrderPublisher;
use crate::stop_watch::{RoomStops, StopWatch};
use crate::stop_words::{UNKNOWN_ARRAYS, lost_device, problem, unheard, unrecorded, unreleased};

/// What an operator has to know of an endpoint that has not answered in time.
const UNANSWERED_ENDPOINT: &str =
    "an endpoint has not answered yet, and an array that only it reaches can move: cut its power";

/// Time after which a stop or a re-arm is repeated.
const REPEAT_AFTER: Duration = Duration::from_nanos(STOP_REPEAT_NS);

/// A process that holds a stop for an array has repeated it, and the array has reported it, after this time. A report
/// waits for the record of the stop for 250 ms.
const REPEATED_WITHIN: Duration = Duration::from_secs(1);

/// Time between two looks at the sessions that are on their way.
const JOIN_CHECK_EVERY: Duration = Duration::from_millis(20);

/// The geometry of a room is announced each second, and so is a safety report. A controller publishes its status twice a
/// second.
const ANNOUNCED_WITHIN: Duration = Duration::from_millis(1500);

/// Stops the arrays of a room and releases them.
pub struct StopSwitch {
    source: u64,
    operator: String,
    stop: OrderPublisher,
    rearm: OrderPublisher,
    repetitions: Repetitions,
    opened: Instant,
    seen: Arc<StopWatch>,
    own: Mutex<Option<OwnStop>>,
    /// Further sessions are on their way.
    is_joining: AtomicBool,
    /// How long a stop awaits the statuses of the controllers that are there.
    statuses_within: Duration,
}

/// The last stop of this process.
#[derive(Clone, Debug)]
struct OwnStop {
    order: EmergencyStop,
    at: Instant,
}

/// The publishers of repetitions.
#[derive(Default)]
struct Repetitions {
    /// Of each session, by array.
    sessions: RwLock<Vec<Vec<Publisher>>>,
    sequences: Mutex<BTreeMap<usize, u64>>,
    last: Mutex<Option<Instant>>,
}

impl StopSwitch {
    /// A switch that reaches no array yet; `operator` is the name in the orders.
    pub fn new(operator: &str) -> Self {
        Self::with(operator, StopWatch::without_session())
    }

    /// A switch for the arrays that a view watches in the room of its session.
    pub(crate) fn of(bus: &Bus, operator: &str, seen: Arc<StopWatch>) -> Result<Self, UiError> {
        let switch = Self::with(operator, seen);
        switch.publish_in(bus)?;
        Ok(switch)
    }

    fn with(operator: &str, seen: Arc<StopWatch>) -> Self {
        Self {
            source: source_id::random(),
            // A text that is too long must keep no order back.
            operator: cut(operator).to_owned(),
            stop: OrderPublisher::without_session("array"),
            rearm: OrderPublisher::without_session("array"),
            repetitions: Repetitions::default(),
            opened: Instant::now(),
            seen,
            own: Mutex::default(),
            is_joining: AtomicBool::new(false),
            statuses_within: ANNOUNCED_WITHIN,
        }
    }

    /// Whether further sessions are on their way: no stop is confirmed before each one has joined or failed.
    pub fn set_joining(&self, is_joining: bool) {
        self.is_joining.store(is_joining, Ordering::SeqCst);
    }

    /// Reaches the arrays that a session of the room reaches, too. They get the last stop of this process, if it is
    /// still held.
    ///
    /// # Errors
    /// [`UiError::Bus`] if the session is closed.
    pub fn join(&self, bus: &Bus) -> Result<(), UiError> {
        self.publish_in(bus)?;
        let own = lock(&self.own).clone();
        if let Some(own) = own.filter(|_| self.is_own_held()) {
            self.stop.publish_again(&own.order)?;
        }
        self.seen.join(bus)
    }

    fn publish_in(&self, bus: &Bus) -> Result<(), UiError> {
        let room = bus.room();
        let publisher = |array| bus.publisher(&room.array(array).stop_repetition(), Class::RealTimeBlock);
        let repetitions = (0..MAX_ARRAYS).map(publisher).collect::<Result<_, _>>()?;
        unpoisoned(self.repetitions.sessions.write()).push(repetitions);
        self.rearm.join(bus, &room.rearm())?;
        self.stop.join(bus, &room.stop())
    }

    /// The stops of the room, and what each array does about them.
    pub(crate) fn room_stops(&self) -> RoomStops {
        let own = lock(&self.own);
        // Before the stops are read: each array that appears holds the stop from then on.
        let is_empty = self.seen.lock().is_empty();
        let room = self.seen.room();
        let is_open = |own: &&OwnStop| is_empty || room.stops.iter().any(|stop| stop.name == own.order.name());
        let ordered = own.as_ref().filter(is_open).map(|own| own.at);
        RoomStops { ordered, ..room }
    }

    /// The number of arrays of the room, where no process announces it.
    pub fn expect(&self, arrays: usize) {
        self.seen.expect(arrays);
    }

    /// All stops that are held or in force. Waits for a first array for `limit` at most, and then until
    /// every array has published its stops, and each controller its lost drivers.
    pub fn stops(&self, limit: Duration) -> Vec<RoomStop> {
        self.seen.wait(limit, |seen, _| seen.has_array());
        self.seen.wait(ANNOUNCED_WITHIN, |seen, _| seen.is_complete() && seen.unheard_controllers().is_empty());
        self.known_stops()
    }

    /// The stops that are held or in force, as far as it is known now.
    pub fn known_stops(&self) -> Vec<RoomStop> {
        self.seen.lock().stops()
    }

    /// The stops that a controller holds for arrays that do not report, in the words of its state; `None` where an array
    /// reports a stop, and where each array reports that it has none.
    pub fn held_by_controller(&self) -> Option<String> {
        self.seen.room().held
    }

    /// The stops that are held or in force beside the known ones. Waits for a first one, for `limit` at most, and no
    /// longer than its holder takes to repeat it.
    pub fn further_stops(&self, known: &[StopName], limit: Duration) -> Vec<RoomStop> {
        let is_further = |stop: &RoomStop| !known.contains(&stop.name);
        self.seen.wait(ANNOUNCED_WITHIN.min(limit), |seen, _| seen.stops().iter().any(is_further));
        self.known_stops().into_iter().filter(is_further).collect()
    }

    /// The arrays that have stopped and do not record the stop, in words.
    ///
    /// Waits for one further stop report of each array that says so, for `limit` at most: a slow disk may have answered
    /// by then. Without one, the last report of the array stands.
    pub fn unrecorded(&self, limit: Duration) -> Vec<String> {
        let seen = self.seen.lock();
        let since = self.seen.now();
        let mut problems: BTreeMap<usize, String> = seen.unrecorded(since).into_iter().collect();
        drop(seen);
        if !problems.is_empty() {
            let has_newer =
                |seen: &ReportedStops, _: Duration| problems.keys().all(|array| seen.has_stops_after(*array, since));
            self.seen.wait(limit, has_newer);
        }
        let seen = self.seen.lock();
        problems.retain(|array, _| !seen.has_stops_after(*array, since));
        problems.extend(seen.unrecorded(self.seen.now()));
        drop(seen);
        unrecorded(problems)
    }

    /// What is to be said of arrays that two processes drive.
    pub fn shared_arrays(&self) -> Vec<String> {
        self.seen.shared().into_iter().map(two_drivers).collect()
    }

    /// What is to be said after a release of the arrays of which drivers are lost.
    pub fn unreleased_lost(&self) -> Vec<String> {
        self.seen.room().unreleased_lost
    }

    /// What is to be said of controllers that have not reported which drivers they have lost.
    pub fn unheard_controllers(&self) -> Vec<String> {
        unheard(&self.seen.lock().unheard_controllers()).into_iter().collect()
    }

    /// What is to be said after a re-arm of the arrays that report that a device does not answer.
    pub fn lost_devices(&self) -> Vec<String> {
        self.seen.lost_devices().into_iter().map(lost_device).collect()
    }

    /// The arrays that have stopped, by index, as far as it is known now.
    pub fn stopped_arrays(&self) -> Vec<usize> {
        let standings = self.room_stops().standings.into_iter();
        standings.filter(|(_, standing)| *standing == Standing::Stopped).map(|(array, _)| array).collect()
    }

    /// What is open of the stops of the room, array by array, as far as it is known now.
    pub fn problems(&self) -> Vec<String> {
        self.room_stops().problems()
    }

    /// The name of the last stop of this process, once it is given.
    pub fn own_name(&self) -> Option<StopName> {
        lock(&self.own).as_ref().map(|own| own.order.name())
    }

    /// The last stop of this process, once it is given, also where no array is seen.
    pub fn own_order(&self) -> Option<EmergencyStop> {
        lock(&self.own).as_ref().map(|own| own.order.clone())
    }

    /// Whether the last stop of this process is held for any array.
    pub fn is_own_held(&self) -> bool {
        self.room_stops().ordered.is_some()
    }

    /// Whether every array has reported that its device executed the last stop of this process.
    pub fn is_own_confirmed(&self) -> bool {
        let own = lock(&self.own);
        let (seen, now) = (self.seen.lock(), self.seen.now());
        let is_stopped = |own: &OwnStop| seen.has_stopped(own.order.name(), now, Duration::ZERO);
        seen.has_geometry() && own.as_ref().is_some_and(is_stopped)
    }

    /// Publishes a stop with a name of its own, which replaces an earlier one of this process: a re-arm
    /// that is on its way releases the stop that its operator saw, and not this one.
    ///
    /// # Errors
    /// [`UiError::NoReceiver`] if no array subscribes to it, [`UiError::Bus`] if the session is
    /// closed, [`UiError::Codec`] if it cannot be encoded.
    pub fn stop(&self, reason: &str) -> Result<EmergencyStop, UiError> {
        let mut sent = None;
        let result = self.stop.publish(self.source, |stamp| {
            let (operator, reason) = (self.operator.clone(), cut(reason).to_owned());
            let order = EmergencyStop { stamp, action: StopAction::Stop, operator, reason };
            // Before it is published, so that the first report of an array finds it.
            self.seen.order(&order);
            let own = OwnStop { order: order.clone(), at: Instant::now() };
            *lock(&self.own) = Some(own);
            sent = Some(order.clone());
            order
        });
        result.map(|()| sent.unwrap_or_default())
    }

    /// Repeats each held stop to the arrays that have not reported it, if that is due.
    pub fn repeat(&self) {
        let mut last = lock(&self.repetitions.last);
        if last.is_some_and(|last| last.elapsed() < REPEAT_AFTER) {
            return;
        }
        *last = Some(Instant::now());
        let unreported = self.seen.lock().unreported(self.seen.now());
        for (array, held, is_older) in unreported {
            // A closed session shows at the next order.
            if is_older {
                let _ = self.stop.publish_again(&held.order());
                continue;
            }
            let mut sequences = lock(&self.repetitions.sequences);
            let sequence = sequences.entry(array).or_default();
            *sequence += 1;
            let repetition = held.repetition(Stamp { source: self.source, sequence: *sequence, time_ns: utc_ns() });
            let mut payload = Vec::new();
            if codec::encode(&repetition, &mut payload).is_ok() {
                let sessions = unpoisoned(self.repetitions.sessions.read());
                for publisher in sessions.iter().filter_map(|arrays| arrays.get(array)) {
                    let _ = publisher.put(&payload);
                }
            }
        }
    }

    /// Stops the arrays, and repeats the stop until each has reported that its device executed it;
    /// returns the time that this took. It then awaits the status of each controller that is there, which names the
    /// drivers that left before.
    ///
    /// # Errors
    /// [`UiError::StopUnconfirmed`] names each array that has not, after `limit`; otherwise as
    /// [`StopSwitch::stop`].
    pub fn stop_and_confirm(&self, reason: &str, limit: Duration) -> Result<Duration, UiError> {
        let (begun, since) = (Instant::now(), self.seen.now());
        let sent = self.stop(reason);
        let own = lock(&self.own).clone();
        let Some(OwnStop { order, .. }) = own.filter(|_| !matches!(sent, Err(UiError::Bus(_) | UiError::Codec(_))))
        else {
            return sent.map(|_| begun.elapsed());
        };
        let name = order.name();
        let is_stopped = |seen: &ReportedStops, now: Duration| seen.has_stopped(name, now, since);
        let mut confirmed: Option<Duration> = None;
        loop {
            let is_confirmed = self.seen.wait(REPEAT_AFTER, is_stopped);
            confirmed = if is_confirmed { confirmed.or(Some(begun.elapsed())) } else { None };
            let (has_geometry, is_joining) = (self.seen.lock().has_geometry(), self.is_joining.load(Ordering::SeqCst));
            let is_told = |seen: &ReportedStops| {
                begun.elapsed() >= self.statuses_within.min(limit) || seen.unheard_controllers().is_empty()
            };
            // By what has arrived since: it can show a further array, or a lost driver.
            let is_final = || {
                let seen = self.seen.lock();
                is_told(&seen) && is_stopped(&seen, self.seen.now())
            };
            if let Some(took) = confirmed.filter(|_| has_geometry && !is_joining && is_final()) {
                return Ok(took);
            }
            let is_counted = has_geometry || is_joining;
            let is_unknown = confirmed.is_some() && !is_counted && self.opened.elapsed() > ANNOUNCED_WITHIN;
            if begun.elapsed() >= limit || is_unknown {
                // A room of unknown size ends the wait before the limit.
                return Err(self.unconfirmed(name, since, limit.min(begun.elapsed()), sent.err()));
            }
            if is_confirmed {
                // The geometry may name an array that has not reported yet.
                let is_joined = || !self.is_joining.load(Ordering::SeqCst);
                self.seen
                    .wait(JOIN_CHECK_EVERY.min(limit), |seen, _| seen.has_geometry() && is_joined() && is_told(seen));
            } else {
                // Only while no array is known: it would also stop those at which an operator has released it.
                if self.seen.lock().is_empty() {
                    self.stop.publish_again(&order)?;
                }
                self.repeat();
            }
        }
    }

    fn unconfirmed(&self, name: StopName, since: Duration, waited: Duration, sent: Option<UiError>) -> UiError {
        let seen = self.seen.lock();
        let not_held = |array: usize| match (seen.holds(array, name), seen.has_reported(array, name)) {
            (true, _) => None,
            (false, true) => Some(format!("another operator has released the stop at array {array}")),
            (false, false) => problem(array, &Standing::Moving),
        };
        let open = |(array, standing): &(usize, Standing)| problem(*array, standing).or_else(|| not_held(*array));
        let mut arrays: Vec<String> = seen.standings(self.seen.now(), Some(since)).iter().filter_map(open).collect();
        if !seen.has_geometry() && seen.has_array() {
            arrays.push(UNKNOWN_ARRAYS.to_owned());
        }
        if self.is_joining.load(Ordering::SeqCst) {
            arrays.push(UNANSWERED_ENDPOINT.to_owned());
        }
        match sent {
            Some(error) if arrays.is_empty() => error,
            _ => UiError::StopUnconfirmed { waited, arrays },
        }
    }

    /// Publishes a re-arm of each of these stops.
    ///
    /// An array of the first messages has no name for its stop. Its re-arm releases all stops of all
    /// arrays, so it is sent only with the names of all.
    ///
    /// # Errors
    /// [`UiError::NotStopped`] if there is none; otherwise as [`StopSwitch::stop`].
    pub fn rearm(&self, names: &[StopName], reason: &str) -> Result<(), UiError> {
        let (seen, now) = (self.seen.lock(), self.seen.now());
        let unnamed = seen.unnamed(now);
        let names_all = seen.stops().iter().all(|stop| names.contains(&stop.name));
        // One that has just appeared may publish its stop reports yet.
        let is_unnamed = !unnamed.is_empty() && unnamed.iter().all(|array| seen.is_settled(*array, now));
        drop(seen);
        if is_unnamed && names_all {
            self.stop.publish(self.source, |stamp| EmergencyStop {
                stamp,
                action: StopAction::Rearm,
                operator: self.operator.clone(),
                reason: cut(reason).to_owned(),
            })?;
        } else if names.is_empty() && unnamed.is_empty() {
            let has_array = self.seen.lock().has_array();
            return Err(if has_array { UiError::NotStopped } else { UiError::NoReceiver("array") });
        }
        names.iter().try_for_each(|name| {
            self.rearm.publish(self.source, |stamp| Rearm {
                stamp,
                stop_source: name.source,
                stop_sequence: name.sequence,
                operator: self.operator.clone(),
                reason: cut(reason).to_owned(),
            })
        })
    }

    /// Releases stops, and repeats the re-arm until no array reports them; returns the time that this
    /// took. A stop that arrives meanwhile stays in force. An array that never had the stop is no obstacle, but each
    /// process that holds the stop for it has the time to repeat it before.
    ///
    /// # Errors
    /// [`UiError::NotStopped`] as soon as every array that reports has published that it has no stop;
    /// [`UiError::RearmUnconfirmed`] names each array that has not released them, after `limit`; otherwise
    /// as [`StopSwitch::rearm`].
    pub fn rearm_and_confirm(&self, names: &[StopName], reason: &str, limit: Duration) -> Result<Duration, UiError> {
        let (begun, since) = (Instant::now(), self.seen.now());
        let is_released =
            |seen: &ReportedStops, now: Duration| seen.has_array() && unreleased(seen, names, now).is_empty();
        loop {
            self.seen.forget_unlatched(names, since + REPEATED_WITHIN);
            let sent = self.rearm(names, reason);
            // What was not sent is not confirmed: the array may not have reported its stop yet.
            if self.seen.wait(REPEAT_AFTER, is_released) && sent.is_ok() {
                return Ok(begun.elapsed());
            }
            let is_futile = matches!(sent, Err(UiError::NotStopped)) && self.seen.lock().has_published(self.seen.now());
            if is_futile || begun.elapsed() >= limit {
                sent?;
                return Err(UiError::RearmUnconfirmed {
                    waited: limit,
                    arrays: unreleased(&self.seen.lock(), names, self.seen.now()),
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use heliostat_proto::{ArrayState, LatchedStopReport, MirrorTelemetry, NodeKind, NodeStatus, StopReport};

    use super::*;

    /// Time limit for an action that takes milliseconds on an idle machine.
    const TIME_LIMIT: Duration = Duration::from_secs(60);

    /// An array reports that its device has executed each stop that is held.
    fn report_stopped(watch: &StopWatch, sequence: u64) {
        watch.note(|seen, now| {
            let stamp = Stamp { source: 9, sequence, time_ns: 0 };
            let latched = |stop: RoomStop| LatchedStopReport {
                source: stop.name.source,
                sequence: stop.name.sequence,
                ..LatchedStopReport::default()
            };
            let stops = seen.stops().into_iter().map(latched).collect();
            let state = ArrayState::Stopped;
            seen.handle_telemetry(now, 0, &MirrorTelemetry { stamp, state, ..MirrorTelemetry::default() });
            seen.handle_stops(now, 0, StopReport { stamp, device_stopped: true, stops, ..StopReport::default() });
        });
    }

    #[test]
    fn a_stop_that_every_array_has_confirmed_awaits_the_status_of_a_controller() {
        let watch = StopWatch::without_session();
        let switch = StopSwitch { statuses_within: TIME_LIMIT, ..StopSwitch::with("ann", Arc::clone(&watch)) };
        watch.expect(1);
        watch.note(|seen, _| seen.handle_controller(5, true));
        let mut sequence = 0;
        let mut report_until = |is_so: &dyn Fn() -> bool| {
            let begun = Instant::now();
            while !is_so() {
                assert!(begun.elapsed() < TIME_LIMIT);
                sequence += 1;
                report_stopped(&watch, sequence);
                thread::sleep(Duration::from_millis(1));
            }
        };
        thread::scope(|scope| {
            let order = scope.spawn(|| switch.stop_and_confirm("test", TIME_LIMIT));
            assert!(watch.wait(TIME_LIMIT, |seen, _| !seen.stops().is_empty()), "the stop is ordered");
            report_until(&|| switch.is_own_confirmed());
            // Otherwise it would end at once.
            assert!(!watch.wait(10 * JOIN_CHECK_EVERY, |_, _| order.is_finished()), "it awaits the status");
            let stamp = Stamp { source: 5, ..Stamp::default() };
            let status = NodeStatus { stamp, node: NodeKind::Controller, ..NodeStatus::default() };
            watch.note(|seen, now| seen.handle_status(now, &status));
            report_until(&|| order.is_finished());
            order.join().unwrap().unwrap();
        });
    }
}
