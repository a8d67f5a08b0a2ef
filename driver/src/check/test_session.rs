//! The one who plays: speaks to a driver as a controller and an operator would, and keeps all that it answers.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result};
use heliostat_bus::{Bus, BusError, Class, Publisher, Subscription};
use heliostat_proto::{
    Calibration, Capabilities, CodecError, Counters, EmergencyStop, Message, MirrorCommand, MirrorTelemetry, Nanos,
    NodeKind, Stamp, StopAction, decode, encode,
};

use crate::lines::random_id;

/// How long an answer is waited for; only a driver that never gives it makes this pass.
pub const PATIENCE: Duration = Duration::from_secs(4);

/// Time until the driver is asked again.
const ASK_AGAIN: Duration = Duration::from_millis(50);

/// Validity of a command that is not about validity.
pub const VALIDITY_MS: u32 = 3000;

/// All that was heard.
#[derive(Default)]
pub struct Heard {
    /// Telemetry in the order of its arrival.
    pub telemetry: Vec<MirrorTelemetry>,
    /// Telemetry that could not be decoded.
    pub unsound: Vec<CodecError>,
    /// Announcements.
    pub capabilities: Vec<Capabilities>,
}

/// A session with one driver.
pub struct Player {
    bus: Bus,
    commands: Publisher,
    stops: Publisher,
    calibrations: Publisher,
    heard: Arc<(Mutex<Heard>, Condvar)>,
    _subscriptions: [Subscription; 2],
    /// As fetched at the start.
    pub capabilities: Capabilities,
    /// Whether they were given on request.
    pub answered: bool,
    /// Epoch of the next command.
    pub epoch: u64,
    /// Sequence of the last command.
    pub sequence: u64,
    source: u64,
    calibrations_sent: u64,
}

/// What the driver answers when it is asked. A session that has just been opened may not know yet whom to ask.
fn fetch_capabilities(bus: &Bus) -> Result<Option<Capabilities>> {
    let key = bus.room().capabilities();
    let until = Instant::now() + PATIENCE;
    loop {
        let fetched = bus.fetch(&key, PATIENCE)?.iter().find_map(|payload| decode(payload).ok());
        if fetched.is_some() || Instant::now() >= until {
            return Ok(fetched);
        }
        std::thread::sleep(ASK_AGAIN);
    }
}

impl Player {
    pub fn start(bus: Bus) -> Result<Self> {
        let heard = Arc::new((Mutex::new(Heard::default()), Condvar::new()));
        let keys = bus.room().clone();
        let told = Arc::clone(&heard);
        let telemetry = bus.subscribe(&keys.telemetry(), move |payload| {
            let mut heard = lock(&told);
            match decode(payload) {
                Ok(telemetry) => heard.telemetry.push(telemetry),
                Err(error) => heard.unsound.push(error),
            }
            told.1.notify_all();
        })?;
        let told = Arc::clone(&heard);
        let announced = bus.subscribe(&keys.capabilities(), move |payload| {
            if let Ok(capabilities) = decode(payload) {
                lock(&told).capabilities.push(capabilities);
                told.1.notify_all();
            }
        })?;
        let fetched = fetch_capabilities(&bus)?;
        let mut player = Self {
            commands: bus.publisher(&keys.command(), Class::Order)?,
            stops: bus.publisher(&keys.stop(), Class::Order)?,
            calibrations: bus.publisher(&keys.calibration(), Class::Order)?,
            heard,
            _subscriptions: [telemetry, announced],
            answered: fetched.is_some(),
            capabilities: fetched.unwrap_or_default(),
            epoch: 0,
            sequence: 0,
            source: random_id(),
            calibrations_sent: 0,
            bus,
        };
        if !player.answered {
            let announced = player.wait(PATIENCE, |heard| heard.capabilities.last().cloned());
            player.capabilities = announced.context("the driver never said what it can do: no sound capabilities")?;
        }
        let first = player.wait(PATIENCE, |heard| heard.telemetry.last().cloned());
        let first = first.context("the driver says nothing: no sound telemetry")?;
        // Above whatever it followed before, as a controller that starts now would be.
        player.epoch = first.epoch.max(now_ns() / 1_000_000) + 1;
        Ok(player)
    }

    /// Ends the session.
    pub fn close(self) -> Result<(), BusError> {
        self.bus.close()
    }

    /// The state of the driver as it was told last.
    pub fn last(&self) -> MirrorTelemetry {
        lock(&self.heard).telemetry.last().cloned().unwrap_or_default()
    }

    /// Number of telemetry messages so far.
    pub fn count(&self) -> usize {
        lock(&self.heard).telemetry.len()
    }

    /// Looks at everything heard.
    pub fn look<T>(&self, at: impl FnOnce(&Heard) -> T) -> T {
        at(&lock(&self.heard))
    }

    /// Waits until something is found in what was heard.
    pub fn wait<T>(&self, limit: Duration, find: impl Fn(&Heard) -> Option<T>) -> Option<T> {
        let deadline = Instant::now() + limit;
        let mut heard = lock(&self.heard);
        loop {
            if let Some(found) = find(&heard) {
                return Some(found);
            }
            let left = deadline.checked_duration_since(Instant::now())?;
            heard = self.heard.1.wait_timeout(heard, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Waits for telemetry from index `from` on that fits.
    pub fn telemetry(&self, from: usize, fits: impl Fn(&MirrorTelemetry) -> bool) -> Option<MirrorTelemetry> {
        self.wait(PATIENCE, |heard| heard.telemetry.iter().skip(from).find(|told| fits(told)).cloned())
    }

    /// A sound command, the next of its sequence, with all mirrors at one place.
    pub fn command(&mut self, roll: f64, yaw: f64) -> MirrorCommand {
        self.sequence += 1;
        let mirrors = self.capabilities.mirrors();
        MirrorCommand {
            epoch: self.epoch,
            sequence: self.sequence,
            answers: 1000 + self.sequence,
            time_ns: now_ns(),
            validity_ms: VALIDITY_MS,
            roll: vec![roll as f32; mirrors],
            yaw: vec![yaw as f32; mirrors],
        }
    }

    /// A place within the limits, `share` of the way from the lowest to the highest angles.
    pub fn place(&self, share: f64) -> (f64, f64) {
        let Capabilities { roll, yaw, .. } = &self.capabilities;
        let at = |min: f32, max: f32| f64::from(min) + share * f64::from(max - min);
        (at(roll.min_rad, roll.max_rad), at(yaw.min_rad, yaw.max_rad))
    }

    /// Publishes commands.
    pub fn send(&self, commands: &[MirrorCommand]) -> Result<()> {
        commands.iter().try_for_each(|command| self.send_bytes(&bytes(command)?))
    }

    /// Publishes anything on the command key.
    pub fn send_bytes(&self, payload: &[u8]) -> Result<()> {
        Ok(self.commands.put(payload)?)
    }

    /// Publishes a stop or a re-arm as of a time.
    pub fn order(&self, action: StopAction, time_ns: Nanos) -> Result<()> {
        Ok(self.stops.put(&order_of(self.source, action, time_ns)?)?)
    }

    /// The same by somebody with a liveliness token of their own, which is gone as soon as the driver has shown that it heard.
    pub fn order_and_leave(&self, action: StopAction, shows: impl Fn(&MirrorTelemetry) -> bool) -> Result<bool> {
        let source = random_id();
        let token = self.bus.announce(&self.bus.room().alive(NodeKind::Viewer, source))?;
        let from = self.count();
        self.stops.put(&order_of(source, action, now_ns())?)?;
        let heard = self.telemetry(from, shows).is_some();
        drop(token);
        Ok(heard)
    }

    /// Publishes a calibration for `mirrors` mirrors with these offsets and no gain; gives its sequence.
    pub fn calibrate(&mut self, mirrors: usize, offset_rad: f64) -> Result<u64> {
        self.calibrations_sent += 1;
        let (offsets, gains) = (vec![offset_rad as f32; mirrors], vec![1.0; mirrors]);
        let calibration = Calibration {
            stamp: Stamp { source: self.source, sequence: self.calibrations_sent, time_ns: now_ns() },
            roll_offset_rad: offsets.clone(),
            roll_gain: gains.clone(),
            yaw_offset_rad: offsets,
            yaw_gain: gains,
        };
        self.calibrations.put(&bytes(&calibration)?)?;
        Ok(self.calibrations_sent)
    }

    /// Publishes payloads and waits until the driver has counted them all; what it counted, and what it told then.
    pub fn play(&self, payloads: &[Vec<u8>]) -> Result<(Counters, MirrorTelemetry)> {
        let before = self.settled();
        let from = self.count();
        for payload in payloads {
            self.send_bytes(payload)?;
        }
        let wanted = total(&before.counters) + payloads.len() as u64;
        let after = self.telemetry(from, |told| total(&told.counters) >= wanted).unwrap_or_else(|| self.last());
        Ok((difference(&after.counters, &before.counters), after))
    }

    /// The next telemetry, sampled after all that was sent before has been dealt with.
    fn settled(&self) -> MirrorTelemetry {
        let from = self.count() + 1;
        self.telemetry(from, |_| true).unwrap_or_else(|| self.last())
    }
}

/// UTC in ns.
pub fn now_ns() -> Nanos {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as Nanos)
}

/// A message as a payload.
pub fn bytes<T: Message>(message: &T) -> Result<Vec<u8>> {
    let mut payload = Vec::new();
    encode(message, &mut payload)?;
    Ok(payload)
}

fn order_of(source: u64, action: StopAction, time_ns: Nanos) -> Result<Vec<u8>> {
    let stamp = Stamp { source, sequence: 1, time_ns };
    let (operator, reason) = ("driver check".into(), "check of the contract".into());
    bytes(&EmergencyStop { stamp, action, operator, reason })
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

fn lock(heard: &(Mutex<Heard>, Condvar)) -> MutexGuard<'_, Heard> {
    heard.0.lock().unwrap_or_else(PoisonError::into_inner)
}
