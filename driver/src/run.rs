//! The loop of a driver process: a kit with a session and a clock.

use std::time::{Duration, Instant};

use heliostat_array::device::Device;
use heliostat_array::kit::Kit;
use heliostat_array::latch::Latch;
use heliostat_array::moment::Moment;
use heliostat_array::refusal_counts::RefusalCounts;
use heliostat_bus::{Bus, BusConfig, BusError, Class};
use heliostat_proto::array_keys::array_name;
use heliostat_proto::{ArrayState, NodeKind, NodeStatus, Stamp};
use heliostat_service::{Exporter, MetricsArgs, MetricsError, Stop, source_id};
use thiserror::Error;

use crate::clock::Clock;
use crate::metrics;
use crate::session::{ArraySession, MessagePublisher, SessionError, check_alone};
use crate::stop_record::{self, StopRecord, StopRecordSettings};
use crate::summary::Summary;

/// Time between two telemetry messages; the contract requires ten per second.
const TELEMETRY: Duration = Duration::from_millis(50);

/// Time between two publications of the capabilities, of the safety report and of the status.
const ANNOUNCEMENT: Duration = Duration::from_secs(1);

/// Longest wait, so that a stop request takes effect soon.
const SLEEP_MAX: Duration = Duration::from_millis(50);

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
/// mirrors of this room, an address at which metrics cannot be served.
pub fn run<D: Device>(mut kit: Kit<D>, settings: &Settings, stop: &Stop) -> Result<Summary, RunError> {
    let end = settings.run_for.map(|duration| Instant::now() + duration);
    let exporter = settings.metrics.open()?;
    let Some(bus) = open(&settings.bus, stop)? else { return Ok(Summary::default()) };
    let array = settings.array;
    check_alone(&bus, array..array + 1)?;
    let clock = Clock::start_in(Duration::ZERO);
    let source = source_id::random();
    let (record, stop_at_start) = StopRecord::open_array(&settings.record, (bus.room(), array), clock.now().room_ns);
    // Every role may publish under the key of the stop, only operators under that of the re-arm.
    kit.refuse_unnamed_rearm(settings.bus.is_authenticated());
    if let Some(latched) = stop_at_start {
        tracing::warn!("{}", stop_record::advice(bus.room(), &latched));
        kit.stop(clock.now(), latched);
    }
    let mut driver = Driver {
        kit,
        record,
        session: ArraySession::open(&bus, array, clock, Class::HighDrop)?,
        status: MessagePublisher::new(&bus, &bus.room().array(array).driver_status(), Class::LowDrop)?,
        refused: RefusalCounts::default(),
        room: bus.room().to_string(),
        name: if array == 0 { "array".to_owned() } else { array_name(array) },
        exporter,
        source,
        sequences: [0; 4],
        published_state: ArrayState::Parked,
        published_latch: Latch::default(),
        logged_problem: String::new(),
        started_ns: clock.now().room_ns,
    };
    let token = bus.announce(&bus.room().array(array).driver_alive(source))?;
    let (mut telemetry, mut announcement) = (Instant::now(), Instant::now());
    while !stop.is_requested() && end.is_none_or(|end| Instant::now() < end) {
        let work = driver.kit.next_ns().map_or(telemetry, |next_ns| clock.instant_at(next_ns));
        let wake = work.min(telemetry).min(announcement).min(Instant::now() + SLEEP_MAX);
        driver.handle_received(wake, telemetry);
        let now = clock.now();
        driver.kit.advance(now);
        driver.keep_latch(false);
        let due = |at: &mut Instant, interval: Duration| {
            let due = Instant::now() >= *at;
            if due {
                *at = Instant::now() + interval;
            }
            due
        };
        if due(&mut telemetry, TELEMETRY) || driver.published_state != driver.kit.array().state() {
            driver.publish_telemetry(now)?;
        }
        let announces = due(&mut announcement, ANNOUNCEMENT);
        if announces || driver.published_latch != *driver.kit.array().latch() {
            driver.publish_safety(now)?;
        }
        if announces {
            driver.keep_latch(true);
            driver.publish_capabilities_and_status(now)?;
        }
    }
    driver.refused.set("dropped", driver.session.received().dropped());
    let summary = driver.summary();
    drop((driver, token));
    bus.close()?;
    Ok(summary)
}

/// Opens a connection, and retries until the router can be reached; `None` when stopped before.
fn open(config: &BusConfig, stop: &Stop) -> Result<Option<Bus>, SessionError> {
    let [mut pause, longest] = ROUTER_PAUSES;
    while !stop.is_requested() {
        match Bus::open(config) {
            Ok(bus) => return Ok(Some(bus)),
            Err(error @ BusError::CannotReach { .. }) => {
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
    kit: Kit<D>,
    record: StopRecord,
    session: ArraySession,
    status: MessagePublisher,
    refused: RefusalCounts,
    room: String,
    /// The array in the status.
    name: String,
    exporter: Option<Exporter>,
    source: u64,
    /// Sequence numbers of telemetry, capabilities, status and safety reports.
    sequences: [u64; 4],
    /// The state in the last telemetry.
    published_state: ArrayState,
    /// The latch in the last safety report.
    published_latch: Latch,
    /// The problem that was logged last.
    logged_problem: String,
    started_ns: u64,
}

impl<D: Device> Driver<D> {
    /// Handles the received messages; waits for the first until `wake`. Returns at `telemetry`, so
    /// that neither a flood nor a slow device delays the telemetry.
    fn handle_received(&mut self, wake: Instant, telemetry: Instant) {
        let mut next = self.session.received().pop_until(wake);
        while let Some(arrival) = next {
            self.kit.handle(arrival.at, arrival.content, &mut self.refused);
            let is_due = Instant::now() >= telemetry;
            next = if is_due { None } else { self.session.received().pop() };
        }
    }

    /// Records the emergency stop, before telemetry reports it and after the device has stopped.
    fn keep_latch(&mut self, again: bool) {
        if let Err(error) = self.record.keep(self.kit.array().latch(), again) {
            tracing::error!("{error}");
        }
    }

    fn stamp(&mut self, of: usize, now: Moment) -> Stamp {
        self.sequences[of] += 1;
        Stamp { source: self.source, sequence: self.sequences[of], time_ns: now.room_ns }
    }

    fn publish_telemetry(&mut self, now: Moment) -> Result<(), SessionError> {
        let stamp = self.stamp(0, now);
        let telemetry = self.kit.telemetry(now, stamp);
        self.published_state = self.kit.array().state();
        self.session.publish_telemetry(&telemetry)
    }

    fn publish_safety(&mut self, now: Moment) -> Result<(), SessionError> {
        let stamp = self.stamp(3, now);
        if self.published_latch != *self.kit.array().latch() {
            stop_record::log_change(&self.room, self.kit.array().latch());
        }
        self.published_latch.clone_from(self.kit.array().latch());
        self.session.publish_safety(&self.kit.safety(stamp))
    }

    fn publish_capabilities_and_status(&mut self, now: Moment) -> Result<(), SessionError> {
        let stamp = self.stamp(1, now);
        self.session.publish_capabilities(&self.kit.capabilities(stamp))?;
        self.refused.set("dropped", self.session.received().dropped());
        let summary = self.summary();
        if self.logged_problem != summary.last_problem {
            if !summary.last_problem.is_empty() {
                tracing::warn!("{}", summary.last_problem);
            }
            self.logged_problem.clone_from(&summary.last_problem);
        }
        let is_recorded = self.record.problem().is_none();
        if let Some(exporter) = &self.exporter {
            exporter.publish(metrics::page(&self.room, &summary, self.kit.array().state(), is_recorded));
        }
        let stamp = self.stamp(2, now);
        let mut status = NodeStatus {
            stamp,
            node: NodeKind::Driver,
            name: format!("{:016x}", self.source),
            software: concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned(),
            state: format!("{} {:?}", self.name, self.kit.array().state()).to_lowercase(),
            started_ns: self.started_ns,
            counters: [("commands", summary.commands), ("connections", summary.connections)]
                .map(|(name, count)| (name.to_owned(), count))
                .into_iter()
                .chain(summary.refused.iter().map(|(name, count)| (format!("refused:{name}"), *count)))
                .collect(),
            ..NodeStatus::default()
        };
        status.set_problem(&summary.last_problem);
        self.status.encode(&status)?;
        self.status.put()
    }

    fn summary(&self) -> Summary {
        let counters = self.kit.array().counters();
        let record = self.record.problem().map(str::to_owned);
        let problem = record.or_else(|| self.kit.last_problem().map(ToString::to_string));
        Summary {
            commands: counters.accepted,
            clipped_commands: counters.clipped,
            refused: self.refused.counts().clone(),
            connections: self.kit.connections(),
            last_problem: problem.unwrap_or_else(|| self.refused.last_problem().to_owned()),
        }
    }
}
