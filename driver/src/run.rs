//! The loop of a driver process: a kit with a session and a clock.

use std::collections::BTreeMap;
use std::fmt;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use heliostat_array::device::Device;
use heliostat_array::kit::Kit;
use heliostat_array::moment::Moment;
use heliostat_array::refusal_counts::RefusalCounts;
use heliostat_bus::{Bus, BusConfig, BusError, Class};
use heliostat_proto::{ArrayState, NodeKind, NodeStatus, Stamp};
use serde::Serialize;

use crate::clock::{Clock, as_ns};
use crate::session::{ArraySession, MessagePublisher, SessionError, check_alone, random_id};

/// Time between two telemetry messages; the contract requires ten per second.
const TELEMETRY: Duration = Duration::from_millis(50);

/// Time between two publications of the capabilities and of the status.
const ANNOUNCEMENT: Duration = Duration::from_secs(1);

/// Longest wait, so that a stop request takes effect soon.
const SLEEP_MAX: Duration = Duration::from_millis(50);

/// First and longest pause before another attempt to reach the router.
const ROUTER_PAUSES: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(5)];

/// The result of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Commands accepted.
    pub commands: u64,
    /// Of those, with an angle beyond the limits.
    pub clipped_commands: u64,
    /// Messages refused, by name.
    pub refused: BTreeMap<String, u64>,
    /// How often the device was connected.
    pub connections: u64,
    /// The last problem; empty if there was none.
    pub last_problem: String,
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "commands        {} ({} clipped)", self.commands, self.clipped_commands)?;
        writeln!(f, "device          connected {} times", self.connections)?;
        for (name, count) in &self.refused {
            writeln!(f, "refused         {name}: {count}")?;
        }
        if !self.last_problem.is_empty() {
            writeln!(f, "last problem    {}", self.last_problem)?;
        }
        Ok(())
    }
}

/// Drives a device until `stop` is set, or for `duration`.
///
/// It retries while the router cannot be reached or the device does not answer.
///
/// # Errors
/// [`SessionError`]: a transport that fails or is configured wrongly, or another process that
/// controls the mirrors of this room.
pub fn run<D: Device>(
    kit: Kit<D>,
    bus: &BusConfig,
    duration: Option<Duration>,
    stop: &AtomicBool,
) -> Result<Summary, SessionError> {
    let end = duration.map(|duration| Instant::now() + duration);
    let Some(bus) = open(bus, stop)? else { return Ok(Summary::default()) };
    check_alone(&bus)?;
    let clock = Clock::start_in(Duration::ZERO);
    let source = random_id();
    let mut driver = Driver {
        kit,
        session: ArraySession::open(&bus, clock, Class::State)?,
        status: MessagePublisher::new(&bus, &bus.room().status(NodeKind::Driver), Class::Info)?,
        refused: RefusalCounts::default(),
        source,
        sequences: [0; 3],
        published_state: ArrayState::Parked,
        logged_problem: String::new(),
        started_ns: clock.now().room_ns,
    };
    let token = bus.announce(&bus.room().alive(NodeKind::Driver, source))?;
    let (mut telemetry, mut announcement) = (Instant::now(), Instant::now());
    while !stop.load(Ordering::Relaxed) && end.is_none_or(|end| Instant::now() < end) {
        let work = driver.kit.next_ns().map_or(telemetry, |next_ns| clock.instant_at(next_ns));
        let wake = work.min(telemetry).min(announcement).min(Instant::now() + SLEEP_MAX);
        driver.handle_received(wake);
        let now = clock.now();
        driver.kit.advance(now);
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
        if due(&mut announcement, ANNOUNCEMENT) {
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
fn open(config: &BusConfig, stop: &AtomicBool) -> Result<Option<Bus>, SessionError> {
    let [mut pause, longest] = ROUTER_PAUSES;
    while !stop.load(Ordering::Relaxed) {
        match Bus::open(config) {
            Ok(bus) => return Ok(Some(bus)),
            Err(error @ BusError::CannotReach { .. }) => {
                drop(writeln!(std::io::stderr(), "driver: {error}; trying again in {pause:?}"))
            }
            Err(error) => return Err(error.into()),
        }
        std::thread::sleep(pause);
        pause = longest.min(2 * pause);
    }
    Ok(None)
}

struct Driver<D> {
    kit: Kit<D>,
    session: ArraySession,
    status: MessagePublisher,
    refused: RefusalCounts,
    source: u64,
    /// Sequence numbers of telemetry, capabilities and status.
    sequences: [u64; 3],
    /// The state in the last telemetry.
    published_state: ArrayState,
    /// The problem that was logged last.
    logged_problem: String,
    started_ns: u64,
}

impl<D: Device> Driver<D> {
    /// Handles all received messages; waits for the first until `wake`.
    fn handle_received(&mut self, wake: Instant) {
        let mut next = self.session.received().pop_until(wake);
        while let Some(arrival) = next {
            self.kit.handle(arrival.at, arrival.content, &mut self.refused);
            next = self.session.received().pop();
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

    fn publish_capabilities_and_status(&mut self, now: Moment) -> Result<(), SessionError> {
        let stamp = self.stamp(1, now);
        self.session.publish_capabilities(&self.kit.capabilities(stamp))?;
        let summary = self.summary();
        if self.logged_problem != summary.last_problem {
            if !summary.last_problem.is_empty() {
                drop(writeln!(std::io::stderr(), "driver: {}", summary.last_problem));
            }
            self.logged_problem.clone_from(&summary.last_problem);
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

/// How long a text on the command line lasts, in seconds.
///
/// # Errors
/// What is wrong with the text.
pub fn seconds(text: &str) -> Result<Duration, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number of seconds"))?;
    Duration::try_from_secs_f64(value)
        .ok()
        .filter(|duration| as_ns(*duration) > 0)
        .ok_or_else(|| format!("`{text}` is no length of time"))
}
