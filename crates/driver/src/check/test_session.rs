//! The session of the check: it sends messages like a controller and an operator, and keeps all
//! answers.

mod stops;

use std::cell::Cell;
use std::collections::BTreeSet;
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, ensure};
use heliostat_bus::arriving::fetch;
use heliostat_bus::{Bus, BusError, Class, Publisher, Subscription};
use heliostat_proto::messages::fault;
use heliostat_proto::{
    ArrayKeys, ArrayState, Calibration, Capabilities, Counters, EmergencyStop, MAX_ARRAYS, Message, MirrorCommand,
    MirrorTelemetry, NodeKind, SafetyReport, Stamp, StopReport, decode, encode,
};
use heliostat_service::clock::utc_ns;
use heliostat_service::locks::{lock, unpoisoned};
use heliostat_service::source_id;

use super::PRESENCE_LIMIT;
use super::received::{Received, problem_of_device};
use super::report::{Failure, describe_failure};
use super::room_in_use::is_commanded;

/// Timeout of an answer, for a driver that never answers.
pub const ANSWER_TIMEOUT: Duration = Duration::from_secs(4);

/// Telemetry messages within which each driver of the array has reported.
const SOURCES_WITHIN: usize = 10;

/// Validity of commands in checks that do not concern validity.
pub const VALIDITY_MS: u32 = 3000;

/// A session with one driver.
pub struct TestSession {
    bus: Bus,
    /// The keys of the array.
    pub keys: ArrayKeys,
    commands: Publisher,
    stops: Publisher,
    rearms: Publisher,
    repetitions: Publisher,
    calibrations: Publisher,
    received: Arc<(Mutex<Received>, Condvar)>,
    _subscriptions: Vec<Subscription>,
    /// The capabilities at the start.
    pub capabilities: Capabilities,
    /// Whether the driver answered the query for them.
    pub answered: bool,
    /// The safety report at the start; `None` for a driver older than this message.
    pub safety: Option<SafetyReport>,
    /// Epoch of the next command.
    pub epoch: u64,
    /// Sequence of the last command.
    pub sequence: u64,
    source: u64,
    /// Whether the array was stopped before the check.
    was_stopped: bool,
    calibrations_sent: u64,
    stops_sent: Cell<u64>,
    /// Whether the room has keys: its driver refuses re-arms of kind 9.
    pub is_authenticated: bool,
    /// How the driver failed.
    pub failure: Option<Failure>,
}

/// Whether a driver of the array, or a simulator, is in the room.
pub fn is_present(bus: &Bus, keys: &ArrayKeys) -> Result<bool> {
    let simulators = bus.room().alive_of(NodeKind::SimNode);
    let present = |tokens: &str| Ok::<_, BusError>(!bus.alive(tokens, PRESENCE_LIMIT)?.is_empty());
    Ok(present(&keys.drivers_alive())? || present(&simulators)?)
}

/// Why an array publishes no capabilities: the room has other arrays only, or its driver breaks the contract.
fn without_capabilities(bus: &Bus, array: usize) -> Result<anyhow::Error> {
    let room = bus.room();
    let mut there = Vec::new();
    // A simulator has no token for each of its arrays.
    if bus.alive(&room.array(array).drivers_alive(), PRESENCE_LIMIT)?.is_empty() {
        for other in 0..MAX_ARRAYS {
            // One that is absent answers at once.
            if !bus.fetch(&room.array(other).capabilities(), ANSWER_TIMEOUT)?.is_empty() {
                there.push(other);
            }
        }
    }
    if there.is_empty() || there.contains(&array) {
        let expected = "expected them each second and in answer to queries";
        return Ok(anyhow!("the driver published no valid capabilities: {expected}"));
    }
    let there: Vec<String> = there.iter().map(usize::to_string).collect();
    Ok(anyhow!("no array {array} in room \"{room}\": expected --array with one of {}", there.join(", ")))
}

impl TestSession {
    pub fn start(bus: Bus, array: usize, is_authenticated: bool) -> Result<Self> {
        let received = Arc::new((Mutex::new(Received::default()), Condvar::new()));
        let (room, keys) = (bus.room().clone(), bus.room().array(array));
        let subscribe = |key: String, note: fn(&mut Received, &[u8])| {
            let shared = Arc::clone(&received);
            bus.subscribe(&key, move |payload| {
                note(&mut lock(&shared.0), payload);
                shared.1.notify_all();
            })
        };
        let mut subscriptions = vec![
            subscribe(keys.telemetry(), |received, payload| match decode(payload) {
                Ok(telemetry) => received.telemetry.push(telemetry),
                Err(error) => received.undecodable.push(error),
            })?,
            subscribe(keys.capabilities(), |received, payload| {
                received.capabilities.extend(decode::<Capabilities>(payload));
            })?,
            subscribe(keys.safety(), |received, payload| received.safety.extend(decode::<SafetyReport>(payload)))?,
            subscribe(keys.stops(), |received, payload| received.stops.extend(decode::<StopReport>(payload)))?,
            subscribe(keys.driver_status(), |received, payload| {
                received.statuses.push((NodeKind::Driver, decode(payload)));
            })?,
            subscribe(room.status(NodeKind::SimNode), |received, payload| {
                received.statuses.push((NodeKind::SimNode, decode(payload)));
            })?,
            subscribe(room.stop(), |received, payload| received.orders.extend(decode::<EmergencyStop>(payload)))?,
        ];
        for other in (0..MAX_ARRAYS).filter(|other| *other != array) {
            subscriptions.push(subscribe(room.array(other).stops(), |received, payload| {
                received.stops_elsewhere.extend(decode::<StopReport>(payload));
            })?);
        }
        let fetched = fetch(&bus, &keys.capabilities(), ANSWER_TIMEOUT)?;
        let mut session = Self {
            commands: bus.publisher(&keys.command(), Class::RealTimeBlock)?,
            stops: bus.publisher(&room.stop(), Class::RealTimeBlock)?,
            rearms: bus.publisher(&room.rearm(), Class::RealTimeBlock)?,
            repetitions: bus.publisher(&keys.stop_repetition(), Class::RealTimeBlock)?,
            calibrations: bus.publisher(&keys.calibration(), Class::RealTimeBlock)?,
            received,
            _subscriptions: subscriptions,
            answered: fetched.is_some(),
            capabilities: fetched.unwrap_or_default(),
            epoch: 0,
            sequence: 0,
            source: source_id::random(),
            was_stopped: false,
            calibrations_sent: 0,
            stops_sent: Cell::new(0),
            safety: None,
            keys,
            is_authenticated,
            failure: None,
            bus,
        };
        if !session.answered {
            let announced = session.wait(ANSWER_TIMEOUT, |received| received.capabilities.last().cloned());
            let Some(announced) = announced else { return Err(without_capabilities(&session.bus, array)?) };
            session.capabilities = announced;
        }
        let first = session.wait(ANSWER_TIMEOUT, |received| received.telemetry.last().cloned());
        let first = first.context("the driver published no valid telemetry: expected ten messages per second")?;
        // Above any epoch that it has followed, like the epoch of a controller that starts now.
        session.epoch = first.epoch.max(utc_ns() / 1_000_000) + 1;
        session.safety = session.wait(ANSWER_TIMEOUT, |received| received.safety.last().cloned());
        session.expect_one_driver()?;
        session.expect_no_commands()?;
        if first.state == ArrayState::Stopped {
            session.release_start()?;
        }
        Ok(session)
    }

    /// Refuses an array that accepts commands of another sender: it would break the rules by them.
    fn expect_no_commands(&self) -> Result<()> {
        let commanded = self.wait(ANSWER_TIMEOUT, |received| is_commanded(&received.telemetry));
        ensure!(
            commanded != Some(true),
            "the array accepts commands with the epoch {}, of a controller or another sender: end it. Nothing was checked",
            self.last().epoch
        );
        Ok(())
    }

    /// Refuses an array that two drivers report: one would break the rules by the messages of the other.
    fn expect_one_driver(&self) -> Result<()> {
        // A driver that publishes less is judged later.
        let _ = self.wait(ANSWER_TIMEOUT, |received| (received.telemetry.len() >= SOURCES_WITHIN).then_some(()));
        let sources = self.inspect(|received| {
            received.telemetry.iter().map(|telemetry| telemetry.stamp.source).collect::<BTreeSet<u64>>()
        });
        let named = sources.iter().map(|source| format!("{source:016x}")).collect::<Vec<_>>().join(", ");
        ensure!(sources.len() == 1, "{} drivers report this array (sources {named}): end all but one", sources.len());
        Ok(())
    }

    /// Ends the session.
    pub fn close(self) -> Result<(), BusError> {
        self.bus.close()
    }

    /// The last telemetry.
    pub fn last(&self) -> MirrorTelemetry {
        lock(&self.received.0).telemetry.last().cloned().unwrap_or_default()
    }

    /// Number of telemetry messages so far.
    pub fn count(&self) -> usize {
        lock(&self.received.0).telemetry.len()
    }

    /// Applies a function to all messages received.
    pub fn inspect<T>(&self, at: impl FnOnce(&Received) -> T) -> T {
        at(&lock(&self.received.0))
    }

    /// Waits until `find` returns a value for the messages received.
    pub fn wait<T>(&self, limit: Duration, find: impl Fn(&Received) -> Option<T>) -> Option<T> {
        let deadline = Instant::now() + limit;
        let mut received = lock(&self.received.0);
        loop {
            if let Some(found) = find(&received) {
                return Some(found);
            }
            let left = deadline.checked_duration_since(Instant::now())?;
            received = unpoisoned(self.received.1.wait_timeout(received, left)).0;
        }
    }

    /// Waits for telemetry, from index `from` on, for which `fits` is true.
    pub fn telemetry(&self, from: usize, fits: impl Fn(&MirrorTelemetry) -> bool) -> Option<MirrorTelemetry> {
        self.wait(ANSWER_TIMEOUT, |received| {
            received.telemetry.iter().skip(from).find(|telemetry| fits(telemetry)).cloned()
        })
    }

    /// A valid command with the next sequence number and the same angles for all mirrors.
    pub fn command(&mut self, roll: f64, yaw: f64) -> MirrorCommand {
        self.sequence += 1;
        let mirrors = self.capabilities.mirrors();
        MirrorCommand {
            epoch: self.epoch,
            sequence: self.sequence,
            answers: 1000 + self.sequence,
            time_ns: utc_ns(),
            validity_ms: VALIDITY_MS,
            roll: vec![roll as f32; mirrors],
            yaw: vec![yaw as f32; mirrors],
        }
    }

    /// Roll and yaw within the limits, at `share` of the range from the lowest to the highest
    /// angle.
    pub fn angles_at(&self, share: f64) -> (f64, f64) {
        let Capabilities { roll, yaw, .. } = &self.capabilities;
        let at = |min: f32, max: f32| f64::from(min) + share * f64::from(max - min);
        (at(roll.min_rad, roll.max_rad), at(yaw.min_rad, yaw.max_rad))
    }

    /// Publishes commands.
    pub fn send(&self, commands: &[MirrorCommand]) -> Result<()> {
        commands.iter().try_for_each(|command| self.send_bytes(&bytes(command)?))
    }

    /// Publishes any payload on the command key.
    pub fn send_bytes(&self, payload: &[u8]) -> Result<()> {
        Ok(self.commands.put(payload)?)
    }

    /// Waits for a safety report, from index `from` on, that fits.
    pub fn safety_report(&self, from: usize, fits: impl Fn(&SafetyReport) -> bool) -> Option<SafetyReport> {
        self.wait(ANSWER_TIMEOUT, |received| received.safety.iter().skip(from).find(|report| fits(report)).cloned())
    }

    /// The answer of the driver to a query of its safety report.
    pub fn fetch_safety(&self) -> Result<Option<SafetyReport>> {
        Ok(fetch(&self.bus, &self.keys.safety(), ANSWER_TIMEOUT)?)
    }

    /// The answer of the driver to a query of its stop report; `None` for a driver older than this
    /// message.
    pub fn fetch_stops(&self) -> Result<Option<StopReport>> {
        let published = self.inspect(|received| received.stops.last().cloned());
        Ok(if published.is_some() { fetch(&self.bus, &self.keys.stops(), ANSWER_TIMEOUT)? } else { None })
    }

    /// Waits until the latest stop report fits.
    pub fn stop_report(&self, fits: impl Fn(&StopReport) -> bool) -> Option<StopReport> {
        self.wait(ANSWER_TIMEOUT, |received| received.stops.last().filter(|report| fits(report)).cloned())
    }

    /// Whether telemetry, from index `from` on, shows a device that does not answer.
    pub fn is_device_lost(&self, from: usize) -> bool {
        self.inspect(|received| received.telemetry.iter().skip(from).any(|shown| shown.faults & fault::LINK != 0))
    }

    /// Notes at this rule whether the driver has left the room, or sends no telemetry.
    pub fn note_failure(&mut self, rule: &'static str) -> Result<()> {
        self.failure = if !is_present(&self.bus, &self.keys)? {
            Some(Failure::Ended(rule))
        } else {
            let from = self.inspect(Received::telemetry_count);
            let next = self.wait(ANSWER_TIMEOUT, |received| (received.telemetry_count() > from).then_some(()));
            next.is_none().then_some(Failure::Silent(rule))
        };
        Ok(())
    }

    /// Why device or driver failed during the check, with what the driver reports about its device.
    pub fn problem(&self) -> Option<String> {
        let reported = self.inspect(|received| {
            let statuses = received.statuses.iter().filter_map(|(_, status)| status.as_ref().ok());
            problem_of_device(statuses).unwrap_or("its status names no problem, and its log may").to_owned()
        });
        describe_failure(self.failure, self.is_device_lost(0).then_some(reported.as_str()))
    }

    /// Publishes a calibration for `mirrors` mirrors with this gain and offset; returns its
    /// sequence.
    pub fn calibrate(&mut self, mirrors: usize, gain: f32, offset_rad: f64) -> Result<u64> {
        self.calibrations_sent += 1;
        let (offsets, gains) = (vec![offset_rad as f32; mirrors], vec![gain; mirrors]);
        let calibration = Calibration {
            stamp: Stamp { source: self.source, sequence: self.calibrations_sent, time_ns: utc_ns() },
            roll_offset_rad: offsets.clone(),
            roll_gain: gains.clone(),
            yaw_offset_rad: offsets,
            yaw_gain: gains,
        };
        self.calibrations.put(&bytes(&calibration)?)?;
        Ok(self.calibrations_sent)
    }

    /// Publishes payloads and waits until the driver has counted them; returns the counts and the
    /// telemetry.
    pub fn send_and_count(&self, payloads: &[Vec<u8>]) -> Result<(Counters, MirrorTelemetry)> {
        let before = self.settled();
        let from = self.count();
        for payload in payloads {
            self.send_bytes(payload)?;
        }
        let expected = total(&before.counters) + payloads.len() as u64;
        let after =
            self.telemetry(from, |telemetry| total(&telemetry.counters) >= expected).unwrap_or_else(|| self.last());
        Ok((difference(&after.counters, &before.counters), after))
    }

    /// The next telemetry that was sampled after all earlier messages were handled.
    fn settled(&self) -> MirrorTelemetry {
        let from = self.count() + 1;
        self.telemetry(from, |_| true).unwrap_or_else(|| self.last())
    }
}

/// A message as a payload.
pub fn bytes<T: Message>(message: &T) -> Result<Vec<u8>> {
    let mut payload = Vec::new();
    encode(message, &mut payload)?;
    Ok(payload)
}

fn total(counters: &Counters) -> u64 {
    counters.accepted + counters.refused()
}

fn difference(after: &Counters, before: &Counters) -> Counters {
    Counters {
        accepted: after.accepted.saturating_sub(before.accepted),
        clipped: after.clipped.saturating_sub(before.clipped),
        late: after.late.saturating_sub(before.late),
        rejected: after.rejected.saturating_sub(before.rejected),
        old_epoch: after.old_epoch.saturating_sub(before.old_epoch),
        old_sequence: after.old_sequence.saturating_sub(before.old_sequence),
        expired: after.expired.saturating_sub(before.expired),
        stopped: after.stopped.saturating_sub(before.stopped),
    }
}
