//! The emergency stop of a room's arrays, and its release.
//!
//! A stop is obeyed by every array, from every sender. A re-arm names the stop that it releases, as
//! the array's safety report gives it. An array that publishes no safety report receives the re-arm
//! that belongs to the first messages of the contract, which is compared by time. Both orders concern
//! every array of the room, and only the telemetry of every array that is present confirms them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, Subscription};
use heliostat_proto::{ArrayState, EmergencyStop, MirrorTelemetry, Rearm, SafetyReport, StopAction, codec};
use heliostat_service::source_id;

use crate::UiError;
use crate::order_publisher::OrderPublisher;
use crate::view::Dated;

/// A report older than this does not show the state of the array.
const REPORT_AGE_MAX: Duration = Duration::from_secs(3);
/// Without telemetry for this time, an array that published some has left, and its last safety report
/// no longer counts.
const TELEMETRY_AGE_MAX: Duration = Duration::from_millis(1500);
/// Time to wait for a safety report; an array publishes one each second.
const SAFETY_LIMIT: Duration = Duration::from_millis(1500);
/// Each array publishes telemetry at least once in this time.
const TELEMETRY_WITHIN: Duration = Duration::from_millis(250);
/// Time after which an order is repeated if the array did not confirm it.
const REPEAT_AFTER: Duration = Duration::from_millis(200);

/// Stops the arrays of a room and releases them.
pub struct StopSwitch {
    source: u64,
    operator: String,
    stop: OrderPublisher,
    rearm: OrderPublisher,
    seen: Arc<Watched>,
    _subscriptions: [Subscription; 4],
}

/// What an array reported last, with arrival times.
#[derive(Clone, Default)]
struct SeenArray {
    state: Dated<ArrayState>,
    safety: Dated<SafetyReport>,
}

/// What each array reported last.
#[derive(Default)]
struct Seen {
    arrays: BTreeMap<usize, SeenArray>,
    /// When the first telemetry arrived.
    first: Option<Instant>,
}

#[derive(Default)]
struct Watched {
    seen: Mutex<Seen>,
    changed: Condvar,
}

impl StopSwitch {
    /// A switch for the array in the room of a session; `operator` is the name in the orders.
    ///
    /// # Errors
    /// [`UiError::Bus`] if the session is closed.
    pub fn new(bus: &Bus, operator: &str) -> Result<Self, UiError> {
        let room = bus.room();
        let seen: Arc<Watched> = Arc::default();
        let (first, later) = (room.array(0), room.later_arrays());
        let subscriptions = [
            watch_telemetry(bus, &first.telemetry(), &seen)?,
            watch_safety(bus, &first.safety(), &seen)?,
            watch_telemetry(bus, &later.telemetry(), &seen)?,
            watch_safety(bus, &later.safety(), &seen)?,
        ];
        Ok(Self {
            source: source_id::random(),
            operator: operator.to_owned(),
            stop: OrderPublisher::new(bus, "array", &room.stop())?,
            rearm: OrderPublisher::new(bus, "array", &room.rearm())?,
            seen,
            _subscriptions: subscriptions,
        })
    }

    /// What the arrays reported last: the state and a safety report, with their arrival times. Of
    /// several arrays the state is stopped where all are, and the report is one with a stop.
    pub(crate) fn reported(&self) -> (Dated<ArrayState>, Dated<SafetyReport>) {
        let seen = self.seen.lock();
        let arrays = seen.present();
        let is_stopped = |array: &&SeenArray| array.state.is_some_and(|(_, state)| state == ArrayState::Stopped);
        let moving = arrays.iter().copied().find(|array| !is_stopped(array));
        let oldest = arrays.iter().copied().min_by_key(|array| array.state.map(|(at, _)| at));
        let state = moving.or(oldest).and_then(|array| array.state);
        let has_stop = |array: &&SeenArray| array.safety.as_ref().is_some_and(|(_, report)| report.stopped);
        let report = arrays.iter().copied().find(has_stop).or(arrays.first().copied());
        (state, report.and_then(|array| array.safety.clone()))
    }

    /// Publishes a stop.
    ///
    /// # Errors
    /// [`UiError::NoReceiver`] if no array subscribes to it, [`UiError::Bus`] if the session is
    /// closed, [`UiError::Codec`] if the reason is too long.
    pub fn stop(&self, reason: &str) -> Result<(), UiError> {
        self.send(StopAction::Stop, reason)
    }

    /// Publishes a re-arm of the stop that the array reports.
    ///
    /// # Errors
    /// [`UiError::NotStopped`] if the array reports no stop; otherwise as [`StopSwitch::stop`].
    pub fn rearm(&self, reason: &str) -> Result<(), UiError> {
        self.rearm_of(&self.await_safety(), reason)
    }

    /// Publishes a re-arm of each stop in the reports; without a report, one that is compared by
    /// time.
    fn rearm_of(&self, reports: &[SafetyReport], reason: &str) -> Result<(), UiError> {
        if reports.is_empty() {
            return self.send(StopAction::Rearm, reason);
        }
        let stops: BTreeSet<(u64, u64)> = reports
            .iter()
            .filter(|report| report.stopped)
            .map(|report| (report.stop_source, report.stop_sequence))
            .collect();
        if stops.is_empty() {
            return Err(UiError::NotStopped);
        }
        stops.into_iter().try_for_each(|(stop_source, stop_sequence)| {
            self.rearm.publish(self.source, |stamp| Rearm {
                stamp,
                stop_source,
                stop_sequence,
                operator: self.operator.clone(),
                reason: reason.to_owned(),
            })
        })
    }

    /// Stops the array, and repeats the stop until telemetry confirms it; returns the time that
    /// this took.
    ///
    /// # Errors
    /// [`UiError::Unconfirmed`] after `limit`; otherwise as [`StopSwitch::stop`].
    pub fn stop_and_confirm(&self, reason: &str, limit: Duration) -> Result<Duration, UiError> {
        self.repeat_until(limit, "stop", |state| state == ArrayState::Stopped, || self.stop(reason))
    }

    /// Releases the array, and repeats the re-arm until telemetry confirms it; returns the time
    /// that this took, and the report with the released stop.
    ///
    /// All repetitions name the same stop, so that a stop that arrives meanwhile stays in force.
    ///
    /// # Errors
    /// [`UiError::Unconfirmed`] after `limit`; otherwise as [`StopSwitch::rearm`].
    pub fn rearm_and_confirm(
        &self,
        reason: &str,
        limit: Duration,
    ) -> Result<(Duration, Option<SafetyReport>), UiError> {
        let named = self.await_safety();
        if !named.is_empty() && named.iter().all(|report| !report.stopped) {
            return Err(UiError::NotStopped);
        }
        let is_released = |state| state != ArrayState::Stopped;
        let took = self.repeat_until(limit, "re-arm", is_released, || self.rearm_of(&named, reason))?;
        Ok((took, named.into_iter().find(|report| report.stopped)))
    }

    fn send(&self, action: StopAction, reason: &str) -> Result<(), UiError> {
        self.stop.publish(self.source, |stamp| EmergencyStop {
            stamp,
            action,
            operator: self.operator.clone(),
            reason: reason.to_owned(),
        })
    }

    fn repeat_until(
        &self,
        limit: Duration,
        order: &'static str,
        is_done: impl Fn(ArrayState) -> bool,
        send: impl Fn() -> Result<(), UiError>,
    ) -> Result<Duration, UiError> {
        let begun = Instant::now();
        loop {
            let sent = Instant::now();
            let result = send();
            let confirms = |seen: &Seen| {
                let is_confirmed =
                    |array: &&SeenArray| array.state.is_some_and(|(at, state)| at >= sent && is_done(state));
                let arrays = seen.present();
                !arrays.is_empty() && arrays.iter().all(is_confirmed)
            };
            if self.seen.wait(REPEAT_AFTER, confirms) {
                let took = begun.elapsed();
                // Another array may not have reported yet.
                let first = self.seen.lock().first.map_or(Duration::ZERO, |first| first.elapsed());
                std::thread::sleep(TELEMETRY_WITHIN.saturating_sub(first));
                if confirms(&self.seen.lock()) {
                    return Ok(took);
                }
            }
            if begun.elapsed() >= limit {
                result?;
                return Err(UiError::Unconfirmed { order, waited: limit });
            }
        }
    }

    /// The safety reports of the arrays that publish some and have not left.
    fn await_safety(&self) -> Vec<SafetyReport> {
        let has_left = |array: &SeenArray| array.state.is_some_and(|(at, _)| at.elapsed() > TELEMETRY_AGE_MAX);
        let is_fresh = |array: &SeenArray| {
            !has_left(array) && array.safety.as_ref().is_some_and(|(at, _)| at.elapsed() < REPORT_AGE_MAX)
        };
        let arrays = |seen: &Seen| -> Vec<SeenArray> {
            seen.arrays.values().filter(|array| !has_left(array)).cloned().collect()
        };
        self.seen.wait(SAFETY_LIMIT, |seen| {
            let arrays = arrays(seen);
            !arrays.is_empty() && arrays.iter().all(is_fresh)
        });
        let reporting = arrays(&self.seen.lock()).into_iter().filter(is_fresh);
        reporting.filter_map(|array| Some(array.safety?.1)).collect()
    }
}

impl Seen {
    /// The arrays whose telemetry is recent; all known ones where there is none such.
    fn present(&self) -> Vec<&SeenArray> {
        let is_recent = |array: &&SeenArray| array.state.is_some_and(|(at, _)| at.elapsed() < TELEMETRY_AGE_MAX);
        let recent: Vec<&SeenArray> = self.arrays.values().filter(is_recent).collect();
        if recent.is_empty() { self.arrays.values().collect() } else { recent }
    }
}

fn watch_telemetry(bus: &Bus, keys: &str, seen: &Arc<Watched>) -> Result<Subscription, UiError> {
    let (room, seen) = (bus.room().clone(), Arc::clone(seen));
    Ok(bus.subscribe_keyed(keys, move |key, payload| {
        if let Ok(report) = codec::decode::<MirrorTelemetry>(payload) {
            let (now, (array, _)) = (Instant::now(), room.first_array_key(key));
            seen.note(|seen| {
                seen.first.get_or_insert(now);
                seen.arrays.entry(array).or_default().state = Some((now, report.state));
            });
        }
    })?)
}

fn watch_safety(bus: &Bus, keys: &str, seen: &Arc<Watched>) -> Result<Subscription, UiError> {
    let (room, seen) = (bus.room().clone(), Arc::clone(seen));
    Ok(bus.subscribe_keyed(keys, move |key, payload| {
        if let Ok(report) = codec::decode::<SafetyReport>(payload) {
            let (now, (array, _)) = (Instant::now(), room.first_array_key(key));
            seen.note(|seen| seen.arrays.entry(array).or_default().safety = Some((now, report)));
        }
    })?)
}

impl Watched {
    fn lock(&self) -> MutexGuard<'_, Seen> {
        // Each report replaces a complete slot, so a poisoned lock protects consistent data.
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note(&self, set: impl FnOnce(&mut Seen)) {
        set(&mut self.lock());
        self.changed.notify_all();
    }

    /// Waits until the condition holds, at most `limit`; returns whether it holds.
    fn wait(&self, limit: Duration, holds: impl Fn(&Seen) -> bool) -> bool {
        let (seen, _) = self
            .changed
            .wait_timeout_while(self.lock(), limit, |seen| !holds(seen))
            .unwrap_or_else(PoisonError::into_inner);
        holds(&seen)
    }
}
