//! The room of a calibration on the bus: its reports in a queue, its commands, and the status.

use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use heliostat_bus::arriving::fetch;
use heliostat_bus::{Bus, Class, Presence, Publisher, Subscription, Token};
use heliostat_calibrate::commander::{
    Commander, Guest, LEAD_EVERY_NS, LEAD_WITHIN_NS, RELEASE_NS, TELEMETRY_GAP_MAX_NS, VALIDITY_MS,
};
use heliostat_channel::MirrorAngles;
use heliostat_proto::gauges::CalibrationProgress;
use heliostat_proto::keys::parse_alive;
use heliostat_proto::{
    ArrayState, Capabilities, ChannelReport, EmergencyStop, MirrorTelemetry, Nanos, NodeKind, NodeStatus, SafetyReport,
    Stamp, StopAction, StopRepetition, UserReport, decode, encode,
};
use heliostat_scenario::Scenario;
use heliostat_service::clock::utc_ns;
use heliostat_service::locks::lock;
use heliostat_service::source_id;
use heliostat_ui::find_absent_room;

use super::LOOK_EVERY;
use super::args::Args;
use super::commander::PublishedCommands;
use super::interruption;

/// Longest wait for a connection, capabilities, telemetry, the lead, and a calibration that is applied.
pub const WAIT: Duration = Duration::from_nanos(LEAD_WITHIN_NS);

/// Age beyond which a report does not count.
const REPORT_AGE_MAX_NS: Nanos = 1_000_000_000;

/// Reports that the queue holds; a report beyond it is dropped, as one that the network loses.
const QUEUE: usize = 1024;

/// Why a session of an array that was stopped ends, and what to do.
const STOPPED: &str = "the array was stopped: release it with `heliostat rearm`, then continue with --readings";

/// Time after its last status for which another calibration counts as running.
pub const OTHER_GAP_MAX: Duration = Duration::from_secs(2);

/// What arrives for the session.
pub enum Received {
    /// A position report.
    Users(UserReport),
    /// A channel report.
    Channel(ChannelReport),
    /// The time in ns from a command to its application.
    CommandDelay(u64),
}

/// When it arrived, and what. It may be handled much later, after an estimate.
pub type Arrived = (Instant, Received);

/// A session in the room.
pub struct LiveRoom {
    bus: Bus,
    source: u64,
    /// Whether it takes the lead from another controller.
    takes_over: bool,
    /// What is kept of the readings if another controller ends this session.
    kept: String,
    /// Whether another controller may take the lead: a refinement then waits.
    yields: bool,
    /// Source of the telemetry, and the calibration in use, at the start.
    driver: (u64, u64),
    queue: Receiver<Arrived>,
    commands: Arc<Mutex<PublishedCommands>>,
    telemetry: Arc<Mutex<Option<MirrorTelemetry>>>,
    /// When the last telemetry arrived.
    answered: Arc<Mutex<Instant>>,
    /// When another calibration last said how far it is.
    other_calibration: Arc<Mutex<Option<Instant>>>,
    /// The first other array of the room that was seen to follow commands.
    disturbing: Arc<OnceLock<usize>>,
    capabilities: Capabilities,
    status: Publisher,
    shown: NodeStatus,
    token: Option<Token>,
    _subscriptions: Vec<Subscription>,
}

impl LiveRoom {
    /// Joins the room; [`take`](Self::take) takes the lead of its array.
    pub fn open(bus: &Bus, args: &Args, scenario: &Scenario) -> Result<Self> {
        let (room, keys) = (bus.room().clone(), bus.room().array(args.array));
        let source = source_id::random();
        let yields = args.refine.is_some();
        let unanswered = || {
            let text =
                "the array does not answer: connect to the process that drives it, or to its router, and check --room";
            find_absent_room([bus]).map_or_else(|| text.to_owned(), |absent| format!("{text}: {absent}"))
        };
        let capabilities: Capabilities = fetch(bus, &keys.capabilities(), WAIT)?.with_context(unanswered)?;
        let safety: Option<SafetyReport> = fetch(bus, &keys.safety(), WAIT)?;
        let validity_ms = safety.as_ref().map_or(VALIDITY_MS, |safety| match safety.validity_max_ms {
            0 => VALIDITY_MS,
            most => VALIDITY_MS.min(most),
        });
        let [roll, yaw] = capabilities.park_rad.map(f64::from);
        let mirrors = capabilities.mirrors();
        let parked = MirrorAngles { roll: vec![roll; mirrors], yaw: vec![yaw; mirrors] };
        let (sender, queue) = sync_channel(QUEUE);
        let telemetry: Arc<Mutex<Option<MirrorTelemetry>>> = Arc::default();
        // The latest telemetry decides about the lead, so it comes before the first command.
        let first = Arc::clone(&telemetry);
        let early = bus.subscribe(&keys.telemetry(), move |payload| {
            if let Ok(telemetry) = decode(payload) {
                *lock(&first) = Some(telemetry);
            }
        })?;
        let shown = wait(|| lock(&telemetry).clone());
        // The last command of a process that has ended may be valid still: nothing is accepted then.
        let may_end = !args.take_over && !yields && bus.alive(&room.alive_of(NodeKind::Controller), WAIT)?.is_empty();
        let accepted = |shown: &MirrorTelemetry| shown.counters.accepted;
        let shown = match shown.filter(|_| may_end) {
            Some(first) => wait(|| {
                let is_over =
                    |now: &MirrorTelemetry| now.state != ArrayState::Following || accepted(now) != accepted(&first);
                lock(&telemetry).clone().filter(is_over)
            })
            .or(Some(first)),
            None => lock(&telemetry).clone(),
        };
        drop(early);
        let shown = shown.context("the array publishes no telemetry: expected ten messages a second")?;
        ensure!(shown.state != ArrayState::Stopped, "the array is stopped: release it with `heliostat rearm` first");
        let is_led = shown.state == ArrayState::Following;
        ensure!(
            !is_led || args.take_over || yields,
            "the array follows commands with the epoch {}, of a controller or another sender: end it, or give --take-over",
            shown.epoch
        );
        let driver = (shown.stamp.source, shown.calibration);
        let commander = Commander::new(Guest {
            source,
            interval_ns: scenario.streams.positions.interval_ns(),
            validity_ms,
            validity_clock: capabilities.validity_clock,
            takes_over: args.take_over || yields,
            announced: shown.epoch.max(safety.map_or(0, |safety| safety.epoch)),
            parked,
        });
        let publisher = bus.publisher(&keys.command(), Class::RealTimeDrop)?;
        let commands = Arc::new(Mutex::new(PublishedCommands::new(commander, publisher)));
        let answered = Arc::new(Mutex::new(Instant::now()));
        let mut subscriptions = subscribe(bus, args.array, &sender, &commands, (&telemetry, &answered))?;
        let other_calibration: Arc<Mutex<Option<Instant>>> = Arc::default();
        let latest = Arc::clone(&other_calibration);
        subscriptions.push(bus.subscribe(&room.status(NodeKind::Controller), move |payload| {
            if let Ok(status) = decode::<NodeStatus>(payload)
                && status.stamp.source != source
                && CalibrationProgress::of(&status).is_some()
            {
                *lock(&latest) = Some(Instant::now());
            }
        })?);
        let disturbing: Arc<OnceLock<usize>> = Arc::default();
        for other in (0..scenario.mirrors.arrays().len()).filter(|other| *other != args.array) {
            let first = Arc::clone(&disturbing);
            subscriptions.push(bus.subscribe(&bus.room().array(other).telemetry(), move |payload| {
                if decode::<MirrorTelemetry>(payload).is_ok_and(|shown| shown.state == ArrayState::Following) {
                    first.get_or_init(|| other);
                }
            })?);
        }
        let status = bus.publisher(&room.status(NodeKind::Controller), Class::LowDrop)?;
        let shown = NodeStatus {
            stamp: Stamp { source, ..Stamp::default() },
            node: NodeKind::Controller,
            name: format!("calibrate-{:08x}", source >> 32),
            software: env!("CARGO_PKG_VERSION").into(),
            scenario: scenario.hash(),
            started_ns: utc_ns(),
            ..NodeStatus::default()
        };
        Ok(Self {
            bus: bus.enter(room),
            source,
            takes_over: args.take_over || yields,
            kept: interruption::kept(args.readings.as_deref()),
            yields,
            driver,
            queue,
            commands,
            telemetry,
            answered,
            other_calibration,
            disturbing,
            capabilities,
            status,
            shown,
            token: None,
            _subscriptions: subscriptions,
        })
    }

    /// Takes the lead of the array, above the epoch that it follows now.
    ///
    /// # Errors
    /// An array that accepts no command of this process.
    pub fn take(&mut self) -> Result<()> {
        lock(&self.commands).commander.take();
        self.lead()
    }

    /// Whether this process commands the array.
    pub fn is_commanding(&self) -> bool {
        self.token.is_some()
    }

    /// Whether another calibration commands the room.
    pub fn has_other_calibration(&self) -> bool {
        lock(&self.other_calibration).is_some_and(|at| at.elapsed() < OTHER_GAP_MAX)
    }

    /// Whether another controller took the lead from this process while it commanded.
    pub fn has_lost_lead(&self) -> bool {
        self.is_commanding() && lock(&self.commands).commander.superseded_by().is_some()
    }

    /// Until when telemetry has shown the array to follow this process.
    pub fn confirmed_ns(&self) -> Nanos {
        lock(&self.commands).commander.confirmed_ns()
    }

    /// Takes the lead again from a controller that took it, where `--take-over` allows it; if it did, until when
    /// telemetry had shown the former lead.
    ///
    /// # Errors
    /// As [`take`](Self::take).
    pub fn take_again(&mut self) -> Result<Option<Nanos>> {
        let confirmed_ns = self.confirmed_ns();
        let mut taken = Ok(None);
        // A controller can take the lead once more before the array follows this process.
        while self.is_commanding() && !self.yields {
            let Some(epoch) = lock(&self.commands).commander.retake() else { break };
            self.release();
            let led = self.take().map(|()| Some(confirmed_ns));
            let is_stopped = lock(&self.commands).commander.is_stopped();
            taken = led.map_err(|error| not_retaken(is_stopped, error, lost_lead(epoch, &self.kept, self.takes_over)));
        }
        taken
    }

    /// Commands the park position until the array follows this process.
    fn lead(&mut self) -> Result<()> {
        let key = self.bus.room().alive(NodeKind::Controller, self.source);
        self.token = Some(self.bus.announce(&key)?);
        let led = wait(|| {
            let mut commands = lock(&self.commands);
            // A failure to publish shows below, as a lead that is not gained.
            let _ = commands.answer(utc_ns(), 0);
            // A stopped array accepts nothing more.
            commands.commander.has_lead().or(commands.commander.is_stopped().then_some(false))
        });
        gained(lock(&self.commands).commander.is_stopped(), led)
    }

    /// What arrives next, within a limit.
    pub fn receive(&self, limit: Duration) -> Result<Option<Arrived>> {
        let (is_stopped, lost) = {
            let commander = &lock(&self.commands).commander;
            // A lead that was lost since the last look is for `take_again`; a refinement waits for the next idle time.
            let ends = !self.yields && !commander.may_retake();
            (commander.is_stopped(), commander.superseded_by().filter(|_| ends))
        };
        ensure!(!is_stopped, STOPPED);
        if let Some(epoch) = lost {
            bail!(lost_lead(epoch, &self.kept, self.takes_over));
        }
        if lock(&self.telemetry).as_ref().is_some_and(|shown| (shown.stamp.source, shown.calibration) != self.driver) {
            bail!(
                "the array has another driver or another calibration than at the start: begin again without these readings"
            );
        }
        ensure!(
            lock(&self.answered).elapsed() < Duration::from_nanos(TELEMETRY_GAP_MAX_NS),
            "the array does not answer any more: check its driver, then continue with --readings"
        );
        if let Some(other) = self.disturbing.get() {
            ensure!(
                !self.yields,
                "array {other} follows a controller, and its light would be in the readings: --refine needs a room \
                 with one array"
            );
            bail!(
                "array {other} follows a controller, and its light would be in the readings: end that controller, \
                 then continue with --readings"
            );
        }
        match self.queue.recv_timeout(limit) {
            Ok(received) => Ok(Some(received)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => bail!("the session in the room has ended"),
        }
    }

    /// Commands these angles.
    pub fn command(&mut self, angles: MirrorAngles) -> Result<()> {
        lock(&self.commands).command(utc_ns(), angles)
    }

    /// What the array announces.
    pub fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    /// Sequence number of the calibration that the array uses; 0 for none.
    pub fn calibration_in_use(&self) -> u64 {
        lock(&self.telemetry).as_ref().map_or(0, |telemetry| telemetry.calibration)
    }

    /// Mirrors that the array reports not to follow.
    pub fn unusable(&self) -> Vec<u32> {
        lock(&self.telemetry).as_ref().map_or_else(Vec::new, |telemetry| telemetry.unusable.clone())
    }

    /// Publishes how far the session is, while this process commands.
    pub fn publish_status(&mut self, progress: &CalibrationProgress) -> Result<()> {
        if !self.is_commanding() {
            return Ok(());
        }
        self.shown.stamp.sequence += 1;
        self.shown.stamp.time_ns = utc_ns();
        self.shown.state = format!("calibrating: {}", progress.place_name());
        self.shown.counters = vec![(NodeStatus::EPOCH.into(), lock(&self.commands).commander.epoch())];
        self.shown.gauges = progress.gauges().map(|(name, value)| (name.to_owned(), value)).to_vec();
        let mut payload = Vec::new();
        encode(&self.shown, &mut payload)?;
        Ok(self.status.put(&payload)?)
    }

    /// Gives the lead back: the token is withdrawn first, and commands go on until a standby has taken
    /// the lead, for half a second at most.
    pub fn release(&mut self) {
        if self.token.take().is_none() {
            return;
        }
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_nanos(RELEASE_NS)
            && lock(&self.commands).commander.superseded_by().is_none()
        {
            std::thread::sleep(LOOK_EVERY);
        }
        lock(&self.commands).commander.rest();
    }
}

fn subscribe(
    bus: &Bus,
    array: usize,
    sender: &SyncSender<Arrived>,
    commands: &Arc<Mutex<PublishedCommands>>,
    (telemetry, answered): (&Arc<Mutex<Option<MirrorTelemetry>>>, &Arc<Mutex<Instant>>),
) -> Result<Vec<Subscription>> {
    let (room, keys) = (bus.room().clone(), bus.room().array(array));
    let (queue, answering) = (sender.clone(), Arc::clone(commands));
    let users = bus.subscribe(&room.users(), move |payload| {
        let Ok(report) = decode::<UserReport>(payload) else { return };
        if !is_recent(&report.stamp) {
            return;
        }
        // The next report is answered again; a bus that is closed shows at the next command.
        let _ = lock(&answering).answer(utc_ns(), report.tick);
        let _ = queue.try_send((Instant::now(), Received::Users(report)));
    })?;
    let queue = sender.clone();
    let channel = bus.subscribe(&room.channel(), move |payload| {
        if let Ok(report) = decode::<ChannelReport>(payload)
            && is_recent(&report.stamp)
        {
            let _ = queue.try_send((Instant::now(), Received::Channel(report)));
        }
    })?;
    let (queue, comparing, latest) = (sender.clone(), Arc::clone(commands), Arc::clone(telemetry));
    let answered = Arc::clone(answered);
    let telemetry = bus.subscribe(&keys.telemetry(), move |payload| {
        let Ok(telemetry) = decode::<MirrorTelemetry>(payload) else { return };
        if let Some(delay_ns) = lock(&comparing).commander.handle_telemetry(utc_ns(), &telemetry) {
            let _ = queue.try_send((Instant::now(), Received::CommandDelay(delay_ns)));
        }
        *lock(&latest) = Some(telemetry);
        *lock(&answered) = Instant::now();
    })?;
    let watching = Arc::clone(commands);
    let others = bus.watch(&room.alive_of(NodeKind::Controller), move |key, presence| {
        if let Some((_, source)) = parse_alive(key) {
            lock(&watching).commander.handle_controller(source, presence == Presence::Alive);
        }
    })?;
    let ordered = Arc::clone(commands);
    let stops = bus.subscribe(&room.stop(), move |payload| {
        if decode::<EmergencyStop>(payload).is_ok_and(|order| order.action == StopAction::Stop) {
            lock(&ordered).commander.note_stop();
        }
    })?;
    let repeated = Arc::clone(commands);
    let repetitions = bus.subscribe(&keys.stop_repetition(), move |payload| {
        if decode::<StopRepetition>(payload).is_ok() {
            lock(&repeated).commander.note_stop();
        }
    })?;
    Ok(vec![users, channel, telemetry, others, stops, repetitions])
}

/// Whether the lead was gained, and why not; a stop is the first reason, because the array then follows no one.
fn gained(is_stopped: bool, led: Option<bool>) -> Result<()> {
    ensure!(!is_stopped, STOPPED);
    match led {
        Some(true) => Ok(()),
        Some(false) => bail!("the array follows another controller: end it, or give --take-over"),
        None => bail!("the array accepts no command of this process: check its telemetry with `heliostat ui`"),
    }
}

/// Why a lost lead was not taken again. A stop meanwhile is the reason by itself.
fn not_retaken(is_stopped: bool, error: anyhow::Error, lost: String) -> anyhow::Error {
    if is_stopped { error } else { error.context(lost) }
}

/// Why the session ends, what is kept, and what to do.
fn lost_lead(epoch: u64, kept: &str, takes_over: bool) -> String {
    let advice = if takes_over { "if this recurs" } else { "first, or give --take-over" };
    format!(
        "a controller with the epoch {epoch} has taken the lead: no result is written; {kept}. End that controller \
         {advice}"
    )
}

/// Whether the time of a report is within the age that counts, and not in the future.
fn is_recent(stamp: &Stamp) -> bool {
    stamp.time_ns.abs_diff(utc_ns()) < REPORT_AGE_MAX_NS
}

/// Waits until there is a value, for a limited time.
pub fn wait<T>(mut value: impl FnMut() -> Option<T>) -> Option<T> {
    let begun = Instant::now();
    loop {
        if let Some(value) = value() {
            return Some(value);
        }
        if begun.elapsed() >= WAIT {
            return None;
        }
        std::thread::sleep(Duration::from_nanos(LEAD_EVERY_NS));
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn a_lost_lead_is_named_with_the_file_of_the_readings_and_what_to_do() {
        let kept = interruption::kept(Some(Path::new("readings.json")));
        let text = lost_lead(7, &kept, true);
        assert!(text.starts_with("a controller with the epoch 7 has taken the lead: no result is written; "), "{text}");
        assert!(text.contains("readings.json keeps the readings, and the same command continues from them"), "{text}");
        assert!(text.ends_with(". End that controller if this recurs"), "{text}");
        assert!(lost_lead(7, &kept, false).ends_with("End that controller first, or give --take-over"));
    }

    #[test]
    fn a_stop_while_the_lead_is_taken_again_is_named_instead_of_the_lost_lead() {
        for led in [None, Some(false), Some(true)] {
            let stopped = gained(true, led).expect_err("stopped");
            let error = not_retaken(true, stopped, lost_lead(7, "kept", true));
            assert_eq!(format!("{error:#}"), STOPPED);
        }
        let refused = gained(false, None).expect_err("no lead");
        let error = format!("{:#}", not_retaken(false, refused, lost_lead(7, "kept", true)));
        assert!(error.starts_with("a controller with the epoch 7 has taken the lead"), "{error}");
        assert!(gained(false, Some(true)).is_ok());
    }
}
