//! The simulated room with its session, clock and counters: what live operation and lockstep share.

use heliostat_array::latch::Latch;
use heliostat_array::moment::Moment;
use heliostat_array::refusal_counts::RefusalCounts;
use heliostat_bus::Class;
use heliostat_driver::clock::Clock;
use heliostat_driver::receive_queue::Arrival;
use heliostat_driver::stop_record;
use heliostat_driver::stop_record::StopRecord;
use heliostat_proto::{ArrayState, MirrorCommand, NodeKind, NodeStatus, Quantiles, Stamp};
use heliostat_scenario::Scenario;
use heliostat_service::{Exporter, Page};
use heliostat_sim::baselines::Snapshot;
use heliostat_sim::control;
use heliostat_sim::mismatch::true_room;
use heliostat_sim::reports::Reports;
use heliostat_sim::reports::schedule::Schedule;
use heliostat_sim::room::SimulatedRoom;

use crate::coverage::Coverage;
use crate::error::NodeError;
use crate::metrics;
use crate::session::RoomSession;
use crate::settings::{Pace, Settings};
use crate::summary::{BeliefSummary, Summary, TurnoverSummary};
use crate::tick_ledger::TickLedger;
use crate::truth_publisher::{Measurements, TruthPublisher};

/// Publications of the array's capabilities and of its safety report in Hz.
const CAPABILITIES_HZ: f64 = 1.0;

/// Publications of the status in Hz.
const STATUS_HZ: f64 = 2.0;

/// Longest text of a problem in a status, in characters.
const PROBLEM_CHARACTERS: usize = 250;

/// The simulated room with its session, clock, schedules and counters.
pub(crate) struct Node {
    pub room: SimulatedRoom,
    pub reports: Reports,
    pub session: RoomSession,
    pub clock: Clock,
    pub ticks: TickLedger,
    pub refused: RefusalCounts,
    coverage: Coverage,
    pub telemetry: Schedule,
    pub truth: Schedule,
    pub status: Schedule,
    pub capabilities: Schedule,
    telemetry_sequence: u64,
    orders: u64,
    capabilities_sequence: u64,
    safety_sequence: u64,
    /// The emergency stop on disk.
    record: Option<StopRecord>,
    /// Taken by the truth publisher when it is created.
    exporter: Option<Exporter>,
    has_exporter: bool,
    /// The state in the last telemetry.
    published_state: ArrayState,
    /// The latch in the last safety report; `None` before the first.
    published_latch: Option<Latch>,
    /// Name of the room, for the log.
    name: String,
    scenario: Scenario,
    scenario_hash: String,
    started_ns: u64,
}

impl Node {
    pub fn open(settings: &Settings) -> Result<Self, NodeError> {
        // In lockstep no message may be dropped, and reports must not overtake telemetry.
        let (reports, telemetry) = match settings.pace {
            Pace::Live { .. } => (Class::RealTimeDrop, Class::HighDrop),
            Pace::Lockstep { .. } => (Class::RealTimeBlock, Class::RealTimeBlock),
        };
        let scenario = settings.scenario.clone();
        let exporter = settings.metrics.open()?;
        let mut room = SimulatedRoom::new(&scenario, scenario.read_trace()?.as_deref(), scenario.seed)?;
        if let Some(corrections) = &settings.calibration {
            room.set_calibration(&corrections.message(Stamp { sequence: 1, ..Stamp::default() }))?;
        }
        let session = RoomSession::open(&settings.bus, reports, telemetry)?;
        let clock = session.clock();
        // Every role may publish under the key of the stop, only operators under that of a re-arm.
        room.refuse_unnamed_rearm(settings.bus.is_authenticated());
        let record = settings.record.as_ref().map(|record| {
            let (record, stop_at_start) = StopRecord::open(record, &settings.bus.room, clock.now().room_ns);
            if let Some(stop) = stop_at_start {
                tracing::warn!("{}", stop_record::advice(&settings.bus.room, &stop));
                room.stop(clock.now(), stop);
            }
            record
        });
        // Halfway between two ticks: this samples the mean age of the angles, and does not delay a
        // tick.
        let between_ticks_ns = Schedule::new(scenario.streams.positions.rate_hz, 0).period_ns() / 2;
        Ok(Self {
            reports: Reports::new(&true_room(scenario, scenario.seed).streams, scenario.seed, session.source()),
            telemetry: Schedule::new(scenario.streams.telemetry.rate_hz, between_ticks_ns),
            truth: Schedule::new(scenario.streams.truth.rate_hz, between_ticks_ns),
            status: Schedule::new(STATUS_HZ, between_ticks_ns),
            started_ns: clock.now().room_ns,
            scenario_hash: scenario.hash(),
            room,
            session,
            clock,
            ticks: TickLedger::default(),
            refused: RefusalCounts::default(),
            coverage: Coverage::default(),
            capabilities: Schedule::new(CAPABILITIES_HZ, 0),
            telemetry_sequence: 0,
            orders: 0,
            capabilities_sequence: 0,
            safety_sequence: 0,
            record,
            has_exporter: exporter.is_some(),
            exporter,
            published_state: ArrayState::Parked,
            published_latch: None,
            name: settings.bus.room.to_string(),
            scenario,
        })
    }

    pub fn truth_publisher(&mut self) -> Result<TruthPublisher, NodeError> {
        TruthPublisher::new(self.room.world(), &self.session, self.scenario.geometry_toml(), self.exporter.take())
    }

    /// Gives an arrival to the array at time `at`; returns the command if it was one that was
    /// accepted.
    pub fn handle(&mut self, arrival: Arrival, at: Moment) -> Option<MirrorCommand> {
        let command = self.room.handle(at, arrival.content, &mut self.refused)?;
        self.ticks.answered(command.answers, arrival.at.local_ns);
        Some(command)
    }

    /// Records the emergency stop, before telemetry reports it; `again` repeats a write that
    /// failed.
    pub fn keep_latch(&mut self, again: bool) {
        let Some(record) = &mut self.record else { return };
        if let Err(error) = record.keep(self.room.array().latch(), again) {
            tracing::error!("{error}");
        }
    }

    /// Publishes telemetry when it is due, or when the array's state has changed; with it the
    /// safety report, when the latch has changed.
    pub fn publish_telemetry(&mut self, now: Moment) -> Result<(), NodeError> {
        self.keep_latch(false);
        if self.published_latch.as_ref() != Some(self.room.array().latch()) {
            self.publish_safety(now)?;
        }
        let due = self.telemetry.take(now.local_ns).is_some();
        if due {
            self.room.advance(now.local_ns);
        }
        let state = self.room.array().state();
        if !due && state == self.published_state {
            return Ok(());
        }
        self.published_state = state;
        self.telemetry_sequence += 1;
        let stamp = self.session.stamp(self.telemetry_sequence, now.room_ns);
        let telemetry = self.room.telemetry(stamp);
        self.session.publish_telemetry(&telemetry)
    }

    /// Applies the orders of operators.
    pub fn apply_orders(&mut self, now: Moment) {
        for order in self.session.new_orders() {
            match order {
                Ok(order) => {
                    self.room.advance(now.local_ns);
                    self.orders += 1;
                    for refusal in control::apply(&mut self.room, &order) {
                        let problem = format!("{}: {refusal}", order.stamp.order_name());
                        self.refused.note("control", refusal.name(), &problem);
                    }
                }
                Err(error) => self.refused.note("control", error.name(), &error),
            }
        }
    }

    /// Refuses the orders of operators: in lockstep the seed determines the run.
    pub fn refuse_orders(&mut self) {
        for order in self.session.new_orders() {
            let refusal = control::OrderRefusal::Lockstep;
            let name = order.map(|order| order.stamp.order_name()).unwrap_or_default();
            self.refused.note("control", refusal.name(), &format!("{name}: {refusal}"));
        }
    }

    /// Compares the controller's beliefs with the room, which was moved on to `now`.
    pub fn compare_beliefs(&mut self, now: Moment) {
        self.coverage.update(now.room_ns, self.room.world(), self.session.new_beliefs());
    }

    pub fn publish_capabilities(&mut self, now: Moment) -> Result<(), NodeError> {
        self.capabilities_sequence += 1;
        let stamp = self.session.stamp(self.capabilities_sequence, now.room_ns);
        self.session.publish_capabilities(&self.room.capabilities(stamp))
    }

    pub fn publish_safety(&mut self, now: Moment) -> Result<(), NodeError> {
        self.safety_sequence += 1;
        let latch = self.room.array().latch();
        if self.published_latch.as_ref().is_some_and(|published| published != latch) {
            stop_record::log_change(&self.name, latch);
        }
        self.published_latch = Some(latch.clone());
        let stamp = self.session.stamp(self.safety_sequence, now.room_ns);
        self.session.publish_safety(&self.room.safety(stamp))
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
        let turnover = summary.turnover.map(|turnover| {
            [("entered", turnover.entered), ("left", turnover.left), ("turned_away", turnover.turned_away)]
        });
        let turnover = turnover.into_iter().flatten().map(|(name, count)| (format!("users_{name}"), count));
        let refused = summary.refused.into_iter().map(|(name, count)| (format!("refused:{name}"), count));
        let world = self.room.world();
        let [slowest, fastest] = world.speeds_m_s();
        let gauges = [
            ("power_w", world.model().budget.power_w),
            ("speed_min_m_s", slowest),
            ("speed_max_m_s", fastest),
            ("forced_users", world.forced().iter().filter(|forced| **forced).count() as f64),
            ("users", world.ids().len() as f64),
            ("faulty_mirrors", self.room.actuator().faulty_mirrors() as f64),
        ];
        let us = summary.loop_us;
        let quantiles =
            Quantiles { count: us.count, p50: us.p50, p90: us.p90, p99: us.p99, p999: us.p999, max: us.max };
        NodeStatus {
            stamp: self.session.stamp(0, time_ns),
            node: NodeKind::SimNode,
            name: format!("{:016x}", self.session.source()),
            software: concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned(),
            state,
            scenario: self.scenario_hash.clone(),
            started_ns: self.started_ns,
            counters: counts
                .map(|(name, count)| (name.to_owned(), count))
                .into_iter()
                .chain(turnover)
                .chain(refused)
                .collect(),
            gauges: gauges.map(|(name, value)| (name.to_owned(), value)).to_vec(),
            timings: vec![("loop".to_owned(), quantiles)],
            last_problem: self.last_problem().chars().take(PROBLEM_CHARACTERS).collect(),
            ..NodeStatus::default()
        }
    }

    /// A stop that cannot be recorded, or the last refusal.
    fn last_problem(&self) -> &str {
        let record = self.record.as_ref().and_then(StopRecord::problem);
        record.unwrap_or_else(|| self.refused.last_problem())
    }

    /// The status, with the metrics of the same time if they are served.
    pub fn status_and_metrics(&self, time_ns: u64) -> (NodeStatus, Option<Page>) {
        let page = || {
            let summary = self.summary(&Measurements::default());
            metrics::page(&self.session.room_name(), &summary, &self.ticks)
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
            ticks: self.ticks.published_count(),
            unattended_ticks: self.ticks.unattended(),
            lost_ticks: self.ticks.lost(),
            late_ticks: self.reports.late_ticks(),
            commands: counters.accepted,
            clipped_commands: counters.clipped,
            refused: refused.collect(),
            turnover: self.room.world().turnover().map(TurnoverSummary::from),
            loop_us: self.ticks.distribution(),
            belief: BeliefSummary::of(self.coverage.covered()),
            truth_us_mean: measurements.mean_cost_s * 1e6,
            last_problem: self.last_problem().to_owned(),
            ..Summary::default()
        };
        summary.set_rates(&measurements.tally);
        summary
    }
}
