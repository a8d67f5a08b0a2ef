//! The simulator as a process: what live operation and lockstep share.

use std::time::Duration;

use heliostat_array::calibration::Unfit;
use heliostat_array::calibration_file::CalibrationFile;
use heliostat_array::moment::Moment;
use heliostat_array::refused::Refused;
use heliostat_bus::{BusConfig, BusError, Class};
use heliostat_driver::clock::Clock;
use heliostat_driver::inbox::Arrival;
use heliostat_driver::lines::LinesError;
use heliostat_proto::{ArrayState, MirrorCommand, NodeKind, NodeStatus, Quantiles, Stamp};
use heliostat_scenario::{Scenario, TraceFileError};
use heliostat_service::{Exporter, MetricsArgs, MetricsError, Page, Stop};
use thiserror::Error;

use crate::edge::Edge;
use crate::ledger::Ledger;
use crate::reporter::{Measurements, Reporter};
use crate::summary::Summary;
use crate::{live, lockstep, metrics};
use heliostat_sim::baselines::Snapshot;
use heliostat_sim::control;
use heliostat_sim::room::SimulatedRoom;
use heliostat_sim::schedule::Schedule;
use heliostat_sim::streams::Reports;
use heliostat_sim::world::WorldError;

/// Announcements of the array's capabilities a second.
const CAPABILITIES_HZ: f64 = 1.0;

/// Statuses a second.
const STATUS_HZ: f64 = 2.0;

/// Longest text of a problem in a status, in characters.
const PROBLEM_CHARACTERS: usize = 250;

/// Everything that a run needs.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The room; its seed is the seed of the run.
    pub scenario: Scenario,
    /// Where to meet the controller.
    pub bus: BusConfig,
    /// In which time the room runs.
    pub pace: Pace,
    /// Where metrics are served.
    pub metrics: MetricsArgs,
    /// Corrections that the array has from the start.
    pub calibration: Option<CalibrationFile>,
}

/// In which time the room runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// As time passes, for this long or until stopped.
    Live {
        /// How long; without end where absent.
        duration: Option<Duration>,
    },
    /// In simulated time, each tick waiting for its answer.
    Lockstep {
        /// How many ticks.
        ticks: u64,
    },
}

/// Why a run cannot begin or go on.
#[derive(Debug, Error)]
pub enum NodeError {
    /// The scenario describes no valid room.
    #[error(transparent)]
    World(#[from] WorldError),
    /// The recorded walk cannot be read.
    #[error(transparent)]
    Trace(#[from] TraceFileError),
    /// The transport failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Metrics cannot be served.
    #[error(transparent)]
    Metrics(#[from] MetricsError),
    /// Nothing can be said or heard, or somebody else has the room.
    #[error(transparent)]
    Lines(#[from] LinesError),
    /// The corrections do not fit the array.
    #[error("the calibration does not fit the array: {0}")]
    Calibration(#[from] Unfit),
    /// Lockstep: nobody came to answer.
    #[error("no controller came into room \"{room}\" within {waited_s} s: lockstep needs one")]
    NoController {
        /// Name of the room.
        room: String,
        /// How long was waited, in s.
        waited_s: u64,
    },
    /// Lockstep: a tick was not answered.
    #[error(
        "tick {tick} was not answered within {waited_s} s (the controller needs --lockstep to take its time from the room){last_problem}"
    )]
    NoAnswer {
        /// The tick.
        tick: u64,
        /// How long was waited, in s.
        waited_s: u64,
        /// What went wrong last, if anything did.
        last_problem: String,
    },
    /// The thread that measures the truth panicked.
    #[error("the thread that measures the truth panicked")]
    ReporterPanicked,
}

/// Runs a simulated room until its end, or until `stop` is requested.
///
/// # Errors
/// [`NodeError`]: a room that cannot be built, a transport that fails, another simulator in the room, a tick of a lockstep run that
/// nobody answers.
pub fn run(settings: &Settings, stop: &Stop) -> Result<Summary, NodeError> {
    let node = Node::open(settings)?;
    let Settings { scenario, bus, .. } = settings;
    tracing::info!(
        room = %bus.room,
        scenario = scenario.name,
        hash = scenario.hash(),
        seed = scenario.seed,
        "{}",
        endpoints(&bus.listen, &bus.connect)
    );
    match settings.pace {
        Pace::Live { duration } => live::run(node, duration, stop),
        Pace::Lockstep { ticks } => lockstep::run(node, ticks, stop),
    }
}

fn endpoints(listen: &[String], connect: &[String]) -> String {
    let at = listen.iter().map(|endpoint| format!("listening at {endpoint}"));
    let to = connect.iter().map(|endpoint| format!("connecting to {endpoint}"));
    at.chain(to).collect::<Vec<_>>().join(", ")
}

/// The room with everything around it.
pub(crate) struct Node {
    pub room: SimulatedRoom,
    pub reports: Reports,
    pub edge: Edge,
    pub clock: Clock,
    pub ledger: Ledger,
    pub refused: Refused,
    pub telemetry: Schedule,
    pub truth: Schedule,
    pub status: Schedule,
    pub capabilities: Schedule,
    telemetry_sequence: u64,
    orders: u64,
    capabilities_sequence: u64,
    /// Until the reporter takes it over.
    exporter: Option<Exporter>,
    has_exporter: bool,
    /// As the last telemetry told it.
    told_state: ArrayState,
    scenario: Scenario,
    scenario_hash: String,
    started_ns: u64,
}

impl Node {
    fn open(settings: &Settings) -> Result<Self, NodeError> {
        // In lockstep nothing may be dropped, and telemetry is not to be overtaken by reports.
        let (reports, telemetry) = match settings.pace {
            Pace::Live { .. } => (Class::Control, Class::State),
            Pace::Lockstep { .. } => (Class::Order, Class::Order),
        };
        let scenario = settings.scenario.clone();
        let exporter = settings.metrics.open()?;
        let mut room = SimulatedRoom::new(&scenario, scenario.read_trace()?.as_deref(), scenario.seed)?;
        if let Some(corrections) = &settings.calibration {
            room.calibrate(Moment::default(), &corrections.message(Stamp { sequence: 1, ..Stamp::default() }))?;
        }
        let edge = Edge::open(&settings.bus, reports, telemetry)?;
        let clock = edge.clock();
        // Halfway between two ticks: the mean of an interval's aim, and never in the way of a tick.
        let between_ticks_ns = Schedule::new(scenario.streams.positions.rate_hz, 0).period_ns() / 2;
        Ok(Self {
            reports: Reports::new(&scenario.streams, scenario.users.count, scenario.seed, edge.source()),
            telemetry: Schedule::new(scenario.streams.telemetry.rate_hz, between_ticks_ns),
            truth: Schedule::new(scenario.streams.truth.rate_hz, between_ticks_ns),
            status: Schedule::new(STATUS_HZ, between_ticks_ns),
            started_ns: clock.now().room_ns,
            scenario_hash: scenario.hash(),
            room,
            edge,
            clock,
            ledger: Ledger::default(),
            refused: Refused::default(),
            capabilities: Schedule::new(CAPABILITIES_HZ, 0),
            telemetry_sequence: 0,
            orders: 0,
            capabilities_sequence: 0,
            has_exporter: exporter.is_some(),
            exporter,
            told_state: ArrayState::Parked,
            scenario,
        })
    }

    pub fn reporter(&mut self) -> Result<Reporter, NodeError> {
        Reporter::new(self.room.world(), &self.edge, self.exporter.take())
    }

    /// Gives an arrival to the array at time `at`; the command when it was accepted.
    pub fn receive(&mut self, arrival: Arrival, at: Moment) -> Option<MirrorCommand> {
        let command = self.room.take(at, arrival.content, &mut self.refused)?;
        self.ledger.answered(command.answers, arrival.at.local_ns);
        Some(command)
    }

    /// Publishes telemetry when it is due, or when the array's state has changed.
    pub fn tell_mirrors(&mut self, now: Moment) -> Result<(), NodeError> {
        let due = self.telemetry.take(now.local_ns).is_some();
        if due {
            self.room.advance(now.local_ns);
        }
        let state = self.room.array().state();
        if !due && state == self.told_state {
            return Ok(());
        }
        self.told_state = state;
        self.telemetry_sequence += 1;
        let stamp = self.edge.stamp(self.telemetry_sequence, now.room_ns);
        let telemetry = self.room.telemetry(stamp);
        self.edge.publish_telemetry(&telemetry)
    }

    /// Applies what operators have ordered.
    pub fn obey_orders(&mut self, now: Moment) {
        for order in self.edge.new_orders() {
            match order {
                Ok(order) => {
                    self.room.advance(now.local_ns);
                    self.orders += 1;
                    for refusal in control::apply(&mut self.room, &order) {
                        self.refused.note("control", refusal.name(), &refusal);
                    }
                }
                Err(error) => self.refused.note("control", error.name(), &error),
            }
        }
    }

    /// Refuses what operators have ordered: in lockstep the seed decides.
    pub fn refuse_orders(&mut self) {
        for _ in self.edge.new_orders() {
            let refusal = control::Refusal::Lockstep;
            self.refused.note("control", refusal.name(), &refusal);
        }
    }

    pub fn announce_capabilities(&mut self, now: Moment) -> Result<(), NodeError> {
        self.capabilities_sequence += 1;
        let stamp = self.edge.stamp(self.capabilities_sequence, now.room_ns);
        self.edge.publish_capabilities(&self.room.capabilities(stamp))
    }

    pub fn snapshot(&self, now: Moment) -> Snapshot {
        Snapshot {
            tick: self.reports.tick(),
            time_ns: now.room_ns,
            commanded: self.room.array().followed().is_some(),
            ..Snapshot::new(self.room.world(), self.room.angles())
        }
    }

    fn status_message(&self, time_ns: u64) -> NodeStatus {
        let summary = self.summary(&Measurements::default());
        let state = match self.room.array().followed() {
            None => "waiting for a controller".to_owned(),
            Some(_) => format!("array {:?}", self.room.array().state()).to_lowercase(),
        };
        let counts = [
            ("ticks", summary.ticks),
            ("commands", summary.commands),
            ("lost_ticks", summary.lost_ticks),
            ("late_ticks", summary.late_ticks),
            ("unattended_ticks", summary.unattended_ticks),
            ("clipped_commands", summary.clipped_commands),
            ("orders", self.orders),
        ];
        let refused = summary.refused.into_iter().map(|(name, count)| (format!("refused:{name}"), count));
        let world = self.room.world();
        let [slowest, fastest] = world.speeds_m_s();
        let gauges = [
            ("power_w", world.model().budget.power_w),
            ("speed_min_m_s", slowest),
            ("speed_max_m_s", fastest),
            ("forced_users", world.forced().iter().filter(|forced| **forced).count() as f64),
            ("faulty_mirrors", self.room.actuator().faulty_mirrors() as f64),
        ];
        let us = summary.loop_us;
        let quantiles =
            Quantiles { count: us.count, p50: us.p50, p90: us.p90, p99: us.p99, p999: us.p999, max: us.max };
        NodeStatus {
            stamp: self.edge.stamp(0, time_ns),
            node: NodeKind::SimNode,
            name: format!("{:016x}", self.edge.source()),
            software: concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned(),
            state,
            scenario: self.scenario_hash.clone(),
            started_ns: self.started_ns,
            counters: counts.map(|(name, count)| (name.to_owned(), count)).into_iter().chain(refused).collect(),
            gauges: gauges.map(|(name, value)| (name.to_owned(), value)).to_vec(),
            timings: vec![("loop".to_owned(), quantiles)],
            last_problem: self.refused.last_problem().chars().take(PROBLEM_CHARACTERS).collect(),
            ..NodeStatus::default()
        }
    }

    /// The status with the metrics of the same moment, where they are served.
    pub fn account(&self, time_ns: u64) -> (NodeStatus, Option<Page>) {
        let page = || {
            let summary = self.summary(&Measurements::default());
            metrics::page(&self.edge.room_name(), &summary, &self.ledger)
        };
        (self.status_message(time_ns), self.has_exporter.then(page))
    }

    pub fn summary(&self, measurements: &Measurements) -> Summary {
        let counters = self.room.array().counters();
        let refused = self.refused.counts().iter().map(|(name, count)| (name.clone(), *count));
        let mut summary = Summary {
            scenario: self.scenario.name.clone(),
            scenario_hash: self.scenario_hash.clone(),
            seed: self.scenario.seed,
            ticks: self.ledger.published_count(),
            unattended_ticks: self.ledger.unattended(),
            lost_ticks: self.ledger.lost(),
            late_ticks: self.reports.late_ticks(),
            commands: counters.accepted,
            clipped_commands: counters.clipped,
            refused: refused.collect(),
            loop_us: self.ledger.distribution(),
            truth_us_mean: measurements.mean_cost_s * 1e6,
            last_problem: self.refused.last_problem().to_owned(),
            ..Summary::default()
        };
        summary.set_rates(&measurements.tally);
        summary
    }
}
