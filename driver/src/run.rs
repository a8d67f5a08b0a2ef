//! A driver as a process: a kit with a session, a clock and a loop around it.

use std::collections::BTreeMap;
use std::fmt;
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, BusConfig, BusError, Class};
use heliostat_proto::{ArrayState, NodeKind, NodeStatus, Stamp};
use heliostat_service::{Exporter, MetricsArgs, MetricsError, Stop, source_id};
use serde::Serialize;
use thiserror::Error;

use crate::clock::Clock;
use crate::lines::{Lines, LinesError, Outlet, check_alone};
use crate::metrics;
use heliostat_array::device::Device;
use heliostat_array::kit::Kit;
use heliostat_array::moment::Moment;
use heliostat_array::refused::Refused;

/// Between two telemetry messages; the contract asks for ten a second.
const TELEMETRY: Duration = Duration::from_millis(50);

/// Between two announcements of the capabilities, and two statuses.
const ANNOUNCEMENT: Duration = Duration::from_secs(1);

/// Longest sleep, so that the end is noticed soon.
const SLEEP_MAX: Duration = Duration::from_millis(50);

/// First and longest pause before a router that cannot be reached is tried again.
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
}

impl Settings {
    /// A driver that runs until it is stopped and serves no metrics.
    pub fn new(bus: BusConfig) -> Self {
        Self { bus, run_for: None, metrics: MetricsArgs::default() }
    }
}

/// Why a driver cannot start or go on.
#[derive(Debug, Error)]
pub enum RunError {
    /// The session failed, or another process drives the mirrors of this room.
    #[error(transparent)]
    Lines(#[from] LinesError),
    /// Metrics cannot be served.
    #[error(transparent)]
    Metrics(#[from] MetricsError),
}

impl From<BusError> for RunError {
    fn from(error: BusError) -> Self {
        Self::Lines(error.into())
    }
}

/// What a run came to.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Commands followed.
    pub commands: u64,
    /// Of those, with an angle beyond the limits.
    pub clipped_commands: u64,
    /// What was refused, by name.
    pub refused: BTreeMap<String, u64>,
    /// Times that the device was brought up.
    pub connections: u64,
    /// The last thing that went wrong; empty when nothing did.
    pub last_problem: String,
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "commands        {} ({} clipped)", self.commands, self.clipped_commands)?;
        writeln!(f, "device          brought up {} times", self.connections)?;
        for (name, count) in &self.refused {
            writeln!(f, "refused         {name}: {count}")?;
        }
        if !self.last_problem.is_empty() {
            writeln!(f, "last problem    {}", self.last_problem)?;
        }
        Ok(())
    }
}

/// Drives a device until `stop` is requested, or for a given time.
///
/// A router that cannot be reached is tried again, and so is a device that does not answer.
///
/// # Errors
/// [`RunError`]: a transport that is set up wrongly or fails, another process that drives the mirrors of this room, an
/// address at which metrics cannot be served.
pub fn run<D: Device>(kit: Kit<D>, settings: &Settings, stop: &Stop) -> Result<Summary, RunError> {
    let end = settings.run_for.map(|duration| Instant::now() + duration);
    let exporter = settings.metrics.open()?;
    let Some(bus) = open(&settings.bus, stop)? else { return Ok(Summary::default()) };
    check_alone(&bus)?;
    let clock = Clock::start_in(Duration::ZERO);
    let source = source_id::random();
    let mut driver = Driver {
        kit,
        lines: Lines::open(&bus, clock, Class::State)?,
        status: Outlet::new(&bus, &bus.room().status(NodeKind::Driver), Class::Info)?,
        refused: Refused::default(),
        room: bus.room().to_string(),
        exporter,
        source,
        sequences: [0; 3],
        told: ArrayState::Parked,
        told_problem: String::new(),
        started_ns: clock.now().room_ns,
    };
    let token = bus.announce(&bus.room().alive(NodeKind::Driver, source))?;
    let (mut telemetry, mut announcement) = (Instant::now(), Instant::now());
    while !stop.is_requested() && end.is_none_or(|end| Instant::now() < end) {
        let work = driver.kit.next_ns().map_or(telemetry, |next_ns| clock.instant_at(next_ns));
        let wake = work.min(telemetry).min(announcement).min(Instant::now() + SLEEP_MAX);
        driver.hear(wake);
        let now = clock.now();
        driver.kit.advance(now);
        let due = |at: &mut Instant, interval: Duration| {
            let due = Instant::now() >= *at;
            if due {
                *at = Instant::now() + interval;
            }
            due
        };
        if due(&mut telemetry, TELEMETRY) || driver.told != driver.kit.array().state() {
            driver.tell(now)?;
        }
        if due(&mut announcement, ANNOUNCEMENT) {
            driver.announce(now)?;
        }
    }
    driver.refused.set("shed", driver.lines.inbox().shed());
    let summary = driver.summary();
    drop((driver, token));
    bus.close()?;
    Ok(summary)
}

/// Opens the session, as often as it takes to reach a router; nothing when stopped meanwhile.
fn open(config: &BusConfig, stop: &Stop) -> Result<Option<Bus>, LinesError> {
    let [mut pause, longest] = ROUTER_PAUSES;
    while !stop.is_requested() {
        match Bus::open(config) {
            Ok(bus) => return Ok(Some(bus)),
            Err(error @ BusError::CannotReach { .. }) => {
                tracing::warn!("{error}; trying again in {pause:?}");
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
    lines: Lines,
    status: Outlet,
    refused: Refused,
    room: String,
    exporter: Option<Exporter>,
    source: u64,
    /// Of telemetry, capabilities and status.
    sequences: [u64; 3],
    /// State that the last telemetry told.
    told: ArrayState,
    /// Problem that the last status told.
    told_problem: String,
    started_ns: u64,
}

impl<D: Device> Driver<D> {
    /// Takes all that has arrived, waiting for the first until `wake`.
    fn hear(&mut self, wake: Instant) {
        let mut next = self.lines.inbox().pop_until(wake);
        while let Some(arrival) = next {
            self.kit.take(arrival.at, arrival.content, &mut self.refused);
            next = self.lines.inbox().pop();
        }
    }

    fn stamp(&mut self, of: usize, now: Moment) -> Stamp {
        self.sequences[of] += 1;
        Stamp { source: self.source, sequence: self.sequences[of], time_ns: now.room_ns }
    }

    fn tell(&mut self, now: Moment) -> Result<(), LinesError> {
        let stamp = self.stamp(0, now);
        let telemetry = self.kit.telemetry(now, stamp);
        self.told = self.kit.array().state();
        self.lines.tell(&telemetry)
    }

    fn announce(&mut self, now: Moment) -> Result<(), LinesError> {
        let stamp = self.stamp(1, now);
        self.lines.announce(&self.kit.capabilities(stamp))?;
        let summary = self.summary();
        if self.told_problem != summary.last_problem {
            if !summary.last_problem.is_empty() {
                tracing::warn!("{}", summary.last_problem);
            }
            self.told_problem.clone_from(&summary.last_problem);
        }
        if let Some(exporter) = &self.exporter {
            exporter.publish(metrics::page(&self.room, &summary, self.kit.array().state()));
        }
        let stamp = self.stamp(2, now);
        let mut status = NodeStatus {
            stamp,
            node: NodeKind::Driver,
            name: format!("{:016x}", self.source),
            software: concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned(),
            state: format!("array {:?}", self.kit.array().state()).to_lowercase(),
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
        let device = self.kit.last_problem().map(ToString::to_string);
        Summary {
            commands: counters.accepted,
            clipped_commands: counters.clipped,
            refused: self.refused.counts().clone(),
            connections: self.kit.connections(),
            last_problem: device.unwrap_or_else(|| self.refused.last_problem().to_owned()),
        }
    }
}
