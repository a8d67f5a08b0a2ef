//! The emergency stop of an array, and its release.
//!
//! A stop is obeyed by every array, from every sender. A re-arm names the stop that it releases, as
//! the array's safety report gives it. An array that publishes no safety report receives the re-arm
//! that belongs to the first messages of the contract, which is compared by time.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, Subscription};
use heliostat_proto::{ArrayState, EmergencyStop, MirrorTelemetry, Rearm, SafetyReport, StopAction, codec};
use heliostat_service::source_id;

use crate::UiError;
use crate::order_publisher::OrderPublisher;
use crate::view::Dated;

/// A report older than this says nothing about the array.
const REPORT_AGE_MAX: Duration = Duration::from_secs(3);
/// Without telemetry for this time, an array that published some has left, and its last safety report
/// no longer counts.
const TELEMETRY_AGE_MAX: Duration = Duration::from_millis(1500);
/// Time to wait for a safety report; an array publishes one each second.
const SAFETY_LIMIT: Duration = Duration::from_millis(1500);
/// Time after which an order is repeated if the array did not confirm it.
const REPEAT_AFTER: Duration = Duration::from_millis(200);

/// Stops the array of a room and releases it.
pub struct StopSwitch {
    source: u64,
    operator: String,
    stop: OrderPublisher,
    rearm: OrderPublisher,
    seen: Arc<Watched>,
    _subscriptions: [Subscription; 2],
}

/// What the array reported last, with arrival times.
#[derive(Default)]
struct Seen {
    state: Dated<ArrayState>,
    safety: Dated<SafetyReport>,
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
        let (telemetry, safety) = (Arc::clone(&seen), Arc::clone(&seen));
        let subscriptions = [
            bus.subscribe(&room.telemetry(), move |payload| {
                if let Ok(report) = codec::decode::<MirrorTelemetry>(payload) {
                    telemetry.note(|seen| seen.state = Some((Instant::now(), report.state)));
                }
            })?,
            bus.subscribe(&room.safety(), move |payload| {
                if let Ok(report) = codec::decode::<SafetyReport>(payload) {
                    safety.note(|seen| seen.safety = Some((Instant::now(), report)));
                }
            })?,
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

    /// What the array reported last: its state and its safety report, with their arrival times.
    pub(crate) fn reported(&self) -> (Dated<ArrayState>, Dated<SafetyReport>) {
        let seen = self.seen.lock();
        (seen.state, seen.safety.clone())
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
        self.rearm_of(self.await_safety().as_ref(), reason)
    }

    /// Publishes a re-arm of the stop in a report; without a report, one that is compared by time.
    fn rearm_of(&self, report: Option<&SafetyReport>, reason: &str) -> Result<(), UiError> {
        let Some(report) = report else {
            return self.send(StopAction::Rearm, reason);
        };
        if !report.stopped {
            return Err(UiError::NotStopped);
        }
        self.rearm.publish(self.source, |stamp| Rearm {
            stamp,
            stop_source: report.stop_source,
            stop_sequence: report.stop_sequence,
            operator: self.operator.clone(),
            reason: reason.to_owned(),
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
        if named.as_ref().is_some_and(|report| !report.stopped) {
            return Err(UiError::NotStopped);
        }
        let is_released = |state| state != ArrayState::Stopped;
        let took = self.repeat_until(limit, "re-arm", is_released, || self.rearm_of(named.as_ref(), reason))?;
        Ok((took, named))
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
            let confirms = |seen: &Seen| seen.state.is_some_and(|(at, state)| at >= sent && is_done(state));
            if self.seen.wait(REPEAT_AFTER, confirms) {
                return Ok(begun.elapsed());
            }
            if begun.elapsed() >= limit {
                result?;
                return Err(UiError::Unconfirmed { order, waited: limit });
            }
        }
    }

    /// The safety report, unless the array publishes none or has left.
    fn await_safety(&self) -> Option<SafetyReport> {
        let has_left = |seen: &Seen| seen.state.is_some_and(|(at, _)| at.elapsed() > TELEMETRY_AGE_MAX);
        let is_fresh =
            |seen: &Seen| !has_left(seen) && seen.safety.as_ref().is_some_and(|(at, _)| at.elapsed() < REPORT_AGE_MAX);
        if !self.seen.wait(SAFETY_LIMIT, is_fresh) {
            return None;
        }
        self.seen.lock().safety.as_ref().map(|(_, report)| report.clone())
    }
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
