//! The loop of a driver process: a kit with a session and a clock.
//!
//! Its thread handles orders and publishes reports. It waits neither for the disk nor for the log, which
//! have threads of their own; a device with threads of its own, such as the boards of this crate, does not make it
//! wait either. A controller in the same process gives its commands by
//! [`ArrayDriver::direct_commands`].

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use heliostat_array::device::{Device, Waker};
use heliostat_array::kit::Kit;
use heliostat_array::latch::Latch;
use heliostat_array::moment::Moment;
use heliostat_array::station::{Identity, Report, Station};
use heliostat_array::stop_record::{END_UNSETTLED, END_WAIT_NS, advice};
use heliostat_array::watch::Watch;
use heliostat_bus::{Bus, BusConfig, BusError, Class};
use heliostat_proto::Stamp;
use heliostat_service::log_limit::LogLimit;
use heliostat_service::{Exporter, MetricsArgs, MetricsError, Stop, source_id};
use thiserror::Error;

use crate::claim::Claim;
use crate::clock::Clock;
use crate::device_log::DeviceLog;
use crate::direct_commands::{DirectCommands, SharedStation};
use crate::end_watch::EndWatch;
use crate::metrics;
use crate::record_thread::RecordThread;
use crate::session::{ArraySession, MessagePublisher, SessionError};
use crate::stop_record::{RecordInUse, StopLog, StopRecordSettings};
use crate::summary::Summary;

/// Longest wait of a process with mirrors, so that a request to end takes effect soon.
pub const SLEEP_MAX: Duration = Duration::from_millis(50);

/// First and longest pause before another attempt to reach the router.
const ROUTER_PAUSES: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(5)];

/// Where a driver runs.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The session with the room.
    pub bus: BusConfig,
    /// How long; without end where absent.
    pub run_for: Option<Duration>,
    /// Where metrics are served.
    pub metrics: MetricsArgs,
    /// Where the emergency stop is kept over a restart.
    pub record: StopRecordSettings,
    /// Index of the array among those of the room.
    pub array: usize,
}

impl Settings {
    /// A driver of the only array that runs until it is stopped, serves no metrics, and starts
    /// stopped: it keeps no state.
    pub fn new(bus: BusConfig) -> Self {
        let (metrics, record) = (MetricsArgs::default(), StopRecordSettings::default());
        Self { bus, run_for: None, metrics, record, array: 0 }
    }
}

/// Why a driver cannot start or continue.
#[derive(Debug, Error)]
pub enum RunError {
    /// The session failed, or another process controls the mirrors of this room.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Another process uses the record of the stop.
    #[error(transparent)]
    Record(#[from] RecordInUse),
    /// The system starts no thread.
    #[error("cannot start the thread of the stop's record: {0}")]
    Thread(std::io::Error),
    /// Metrics cannot be served.
    #[error(transparent)]
    Metrics(#[from] MetricsError),
}

impl From<BusError> for RunError {
    fn from(error: BusError) -> Self {
        Self::Session(error.into())
    }
}

/// Drives a device until `stop` is requested, or for a given time.
///
/// It retries while the router cannot be reached or the device does not answer.
///
/// # Errors
/// [`RunError`]: a transport that fails or is configured wrongly, another process that controls the
/// mirrors of this room or uses the record of their stop, an address at which metrics cannot be served.
pub fn run<D: Device>(kit: Kit<D>, settings: &Settings, stop: &Stop) -> Result<Summary, RunError> {
    let end = settings.run_for.map(|duration| Instant::now() + duration);
    match ArrayDriver::open(kit, settings, stop)? {
        Some(driver) => driver.run(end, stop),
        None => Ok(Summary::default()),
    }
}

/// A driver that has joined its room.
pub struct ArrayDriver<D> {
    driver: Driver<D>,
    bus: Bus,
    claim: Claim,
    clock: Clock,
}

impl<D: Device> ArrayDriver<D> {
    /// Joins the room with a device; `None` when `stop` is requested before.
    ///
    /// # Errors
    /// As for [`run`].
    pub fn open(mut kit: Kit<D>, settings: &Settings, stop: &Stop) -> Result<Option<Self>, RunError> {
        let exporter = settings.metrics.open(settings.bus.certificate_ends())?;
        let Some(bus) = open(&settings.bus, stop)? else { return Ok(None) };
        let array = settings.array;
        let source = source_id::random();
        let mut claim = Claim::begin(&bus, array..array + 1, source)?;
        let clock = Clock::start_in(Duration::ZERO);
        let capabilities = kit.capabilities(Stamp::default());
        let (record, latch_at_start) = settings.record.open(bus.room(), array, &capabilities, clock.now().room_ns)?;
        let (plan, store) = record.split();
        // Every role may publish under the key of the stop, only operators under that of the re-arm.
        kit.refuse_unnamed_rearm(settings.bus.is_authenticated());
        if let Some(latched) = advice(bus.room(), &latch_at_start) {
            tracing::warn!("{latched}");
        }
        let software = concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned();
        let identity = Identity { source, array, software };
        let session = ArraySession::open(&bus, array, clock, Class::HighDrop)?;
        let received = Arc::clone(session.received());
        let watched = Arc::clone(&received);
        kit.set_watch(Watch::new(move || clock.now(), move |is_stop| watched.has_stop(is_stop)));
        kit.device_mut().set_waker(Waker::new(move || received.wake()));
        let station = Station::new(kit, (plan, latch_at_start), identity, clock.now());
        let driver = Driver {
            is_recorded: Arc::new(AtomicBool::new(station.is_recorded())),
            shared: Arc::new(SharedStation::new(station)),
            record: store
                .map(|file| RecordThread::spawn(file, Arc::clone(session.received())))
                .transpose()
                .map_err(RunError::Thread)?,
            session,
            status: MessagePublisher::new(&bus, &bus.room().array(array).driver_status(), Class::LowDrop)?,
            room: bus.room().to_string(),
            exporter,
            logged_latch: Latch::default(),
            is_stop_logged: false,
            stop_log: StopLog::default(),
            logged_problem: String::new(),
            device_log: DeviceLog::default(),
            unusable: Vec::new(),
            log_limit: LogLimit::default(),
        };
        claim.announce(&bus, &bus.room().array(array).driver_alive(source))?;
        Ok(Some(Self { driver, bus, claim, clock }))
    }

    /// The entry of commands from a controller in this process; they are handled while
    /// [`run`](Self::run) runs.
    pub fn direct_commands(&self) -> DirectCommands<D> {
        DirectCommands::new(Arc::clone(&self.driver.shared), Arc::clone(self.driver.session.received()), self.clock)
    }

    /// Whether the present stop is in the record, renewed with each status: for the metrics of this process.
    pub fn is_recorded(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.driver.is_recorded)
    }

    /// Drives the device until `stop` is requested, or until `end`.
    ///
    /// # Errors
    /// A transport that fails, or another process with this array that started at the same time.
    pub fn run(self, end: Option<Instant>, stop: &Stop) -> Result<Summary, RunError> {
        let Self { mut driver, bus, claim, clock } = self;
        let watch = EndWatch::start(stop);
        let running = driver.shared.run();
        let (mut ended, mut claimed) = (Ok(()), Ok(()));
        while ended.is_ok() && claimed.is_ok() && !stop.is_requested() && end.is_none_or(|end| Instant::now() < end) {
            ended = driver.step(clock);
            claimed = claim.check(|problem| driver.shared.lock().note_other_process(problem));
            driver.shared.lock().set_other_processes(claim.count());
        }
        drop(running);
        driver.session.received().end();
        // A stop that comes now is obeyed, and in the record before the end if the disk answers.
        let given_up = Instant::now() + Duration::from_nanos(END_WAIT_NS);
        while ended.is_ok() && !driver.is_settled() && Instant::now() < given_up {
            ended = driver.step(clock);
        }
        if !driver.finish_record(clock, given_up) {
            let station = driver.shared.lock();
            tracing::error!("{}", station.record_problem().unwrap_or(END_UNSETTLED));
        }
        ended?;
        let summary = driver.summary();
        // It watches device and disk, not the transport.
        drop(watch);
        drop((driver, claim));
        bus.close()?;
        claimed?;
        Ok(summary)
    }
}

/// Opens a connection, and retries until the router can be reached; `None` when stopped before.
fn open(config: &BusConfig, stop: &Stop) -> Result<Option<Bus>, SessionError> {
    let [mut pause, longest] = ROUTER_PAUSES;
    while !stop.is_requested() {
        match Bus::open(config) {
            Ok(bus) => return Ok(Some(bus)),
            Err(error @ (BusError::CannotReach { .. } | BusError::Unresolved { .. })) => {
                tracing::warn!("{error}; trying again in {pause:?}")
            }
            Err(error) => return Err(error.into()),
        }
        stop.wait_for(pause);
        pause = longest.min(2 * pause);
    }
    Ok(None)
}

struct Driver<D> {
    shared: Arc<SharedStation<D>>,
    /// Absent where no state is kept.
    record: Option<RecordThread>,
    session: ArraySession,
    status: MessagePublisher,
    room: String,
    exporter: Option<Exporter>,
    is_recorded: Arc<AtomicBool>,
    /// The latch that was logged last.
    logged_latch: Latch,
    /// Whether the log has that the device has executed its stops.
    is_stop_logged: bool,
    stop_log: StopLog,
    /// The problem that was logged last.
    logged_problem: String,
    device_log: DeviceLog,
    /// The mirrors that do not follow, by the last telemetry.
    unusable: Vec<u32>,
    log_limit: LogLimit,
}

impl<D: Device> Driver<D> {
    /// Waits for a message or a due time, handles the messages until a report is due, and publishes
    /// the reports.
    fn step(&mut self, clock: Clock) -> Result<(), SessionError> {
        let wake = clock.instant_at(self.shared.plan_wake()).min(Instant::now() + SLEEP_MAX);
        let received = self.session.received();
        received.wait_until(wake);
        let shared = Arc::clone(&self.shared);
        let mut station = shared.lock();
        while let Some(arrival) = received.pop() {
            station.handle(clock.now(), arrival);
            if station.is_report_due(clock.local_ns()) {
                break;
            }
        }
        station.set_dropped(received.dropped());
        station.advance(clock.now());
        drop(station);
        // A call of the device may have taken long.
        let now = clock.now();
        self.keep_record(now);
        // Published without the lock.
        loop {
            let report = shared.lock().poll_report(now);
            let Some(report) = report else { return Ok(()) };
            self.publish(&report)?;
        }
    }

    /// Learns what became of the last write of the record, and begins the one that is due.
    fn keep_record(&mut self, now: Moment) {
        let Some(record) = &self.record else { return };
        let written = record.poll_written();
        let mut station = self.shared.lock();
        let line = written.as_ref().and_then(|result| station.finish_record(result));
        station.poll_record(now).into_iter().for_each(|task| record.begin(task));
        drop(station);
        match (written, line) {
            (Some(Err(_)), Some(problem)) => self.log(&problem),
            (_, line) => line.into_iter().for_each(|line| tracing::info!("{line}")),
        }
    }

    /// Whether no message waits, and the present stops are in the record or could not be written.
    fn is_settled(&self) -> bool {
        self.session.received().is_empty() && self.shared.lock().is_settled()
    }

    /// Handles the messages that wait, and waits until the present stops are in the record or could not be
    /// written; false if that was not so by this time.
    fn finish_record(&mut self, clock: Clock, given_up: Instant) -> bool {
        loop {
            let now = clock.now();
            let mut station = self.shared.lock();
            while let Some(arrival) = self.session.received().pop() {
                station.handle(now, arrival);
            }
            station.advance(now);
            drop(station);
            self.keep_record(now);
            if self.is_settled() {
                return true;
            }
            if Instant::now() >= given_up {
                return false;
            }
            self.session.received().wait_until(given_up);
        }
    }

    fn publish(&mut self, report: &Report) -> Result<(), SessionError> {
        match report {
            Report::Telemetry(telemetry) => {
                self.unusable.clone_from(&telemetry.unusable);
                self.session.publish_telemetry(telemetry)
            }
            Report::Safety(safety) => {
                let latch = self.shared.lock().kit().array().latch().clone();
                if self.logged_latch != latch {
                    self.stop_log.change(&self.room, &latch);
                    (self.logged_latch, self.is_stop_logged) = (latch, false);
                }
                self.session.publish_safety(safety)
            }
            Report::Stops(stops) => {
                let was_logged = std::mem::replace(&mut self.is_stop_logged, stops.device_stopped);
                if stops.device_stopped && !was_logged {
                    self.stop_log.stopped(&self.room);
                }
                self.session.publish_stops(stops)
            }
            Report::Capabilities(capabilities) => self.session.publish_capabilities(capabilities),
            Report::Status(status) => {
                self.show(&status.last_problem);
                self.status.encode(status)?.put()
            }
        }
    }

    /// Logs a new problem of the status and the end of one, and renews the metrics.
    fn show(&mut self, problem: &str) {
        let summary = self.summary();
        let station = self.shared.lock();
        let (is_absent, problems) = (station.kit().is_device_absent(), station.kit().problems());
        let (state, is_recorded) = (station.kit().array().state(), station.is_recorded());
        drop(station);
        self.is_recorded.store(is_recorded, Ordering::Relaxed);
        let changes = self.device_log.changes(is_absent, problems, &self.unusable);
        if changes.is_lost || self.logged_problem != problem {
            if !problem.is_empty() {
                self.log(problem);
            }
            problem.clone_into(&mut self.logged_problem);
        }
        changes.warning.iter().for_each(|line| tracing::warn!("{line}"));
        changes.ends.iter().for_each(|line| tracing::info!("{line}"));
        if let Some(exporter) = &self.exporter {
            exporter.publish(metrics::page(&self.room, &summary, state, is_recorded));
        }
    }

    /// Logs a problem, unless one like it was logged just before.
    fn log(&mut self, problem: &str) {
        if let Some(line) = self.log_limit.line(Instant::now(), problem, 1) {
            tracing::warn!("{line}");
        }
    }

    fn summary(&self) -> Summary {
        let station = self.shared.lock();
        let counters = station.kit().array().counters();
        Summary {
            commands: counters.accepted,
            clipped_commands: counters.clipped,
            refused: station.refused().counts().clone(),
            connections: station.kit().connections(),
            last_problem: station.last_problem(),
        }
    }
}
