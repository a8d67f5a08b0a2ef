//! The simulated room with its session, clock and counters: what live operation and lockstep share.

use std::borrow::Cow;
use std::time::Instant;

use heliostat_array::arrivals::Arrival;
use heliostat_array::moment::Moment;
use heliostat_array::refusal_counts::{ANOTHER_PROCESS, RefusalCounts};
use heliostat_array::stop_record;
use heliostat_bus::Class;
use heliostat_driver::clock::Clock;
use heliostat_proto::array_keys::array_name;
use heliostat_proto::{ArrayState, Counters, MirrorCommand, NodeKind, NodeStatus, Stamp, cut};
use heliostat_room::baselines::Snapshot;
use heliostat_room::control;
use heliostat_room::mismatch::true_room;
use heliostat_room::reports::Reports;
use heliostat_room::reports::schedule::Schedule;
use heliostat_room::room::SimulatedRoom;
use heliostat_scenario::{Scenario, Streams};
use heliostat_service::log_limit::LogLimit;
use heliostat_service::printable::printable;
use heliostat_service::{Exporter, Page};

use crate::array_node::ArrayNode;
use crate::coverage::Coverage;
use crate::error::NodeError;
use crate::metrics;
use crate::session::RoomSession;
use crate::settings::{Pace, Settings};
use crate::summary::{BeliefSummary, Summary};
use crate::tick_ledger::TickLedger;
use crate::truth_publisher::{Measurements, TruthPublisher};

/// Publications of the array's capabilities and of its safety report in Hz.
const CAPABILITIES_HZ: f64 = 1.0;

/// Publications of the status in Hz.
const STATUS_HZ: f64 = 2.0;

/// When the first telemetry is due: a quarter of an interval before a position report is published.
///
/// A standby judges by the telemetry between two reports whether the leader has answered the first one. Where telemetry
/// is as rare as reports, this leaves the leader most of the interval, and delays no takeover.
fn telemetry_phase_ns(streams: &Streams) -> u64 {
    let interval_ns = streams.positions.interval_ns();
    let published_ns = (streams.positions.latency_ms * 1e6).round() as u64;
    let between_ns = Schedule::new(streams.telemetry.rate_hz, 0).period_ns();
    (published_ns + interval_ns / 4 * 3) % interval_ns % between_ns
}

/// The simulated room with its session, clock, schedules and counters.
pub(crate) struct Node {
    pub room: SimulatedRoom,
    pub reports: Reports,
    pub session: RoomSession,
    pub clock: Clock,
    pub ticks: TickLedger,
    pub refused: RefusalCounts,
    /// The number of refusals that the log has.
    logged_refusals: u64,
    log_limit: LogLimit,
    coverage: Coverage,
    pub telemetry: Schedule,
    pub truth: Schedule,
    pub status: Schedule,
    pub capabilities: Schedule,
    orders: u64,
    /// One for each array of the room.
    arrays: Vec<ArrayNode>,
    /// Taken by the truth publisher when it is created.
    exporter: Option<Exporter>,
    has_exporter: bool,
    scenario: Scenario,
    scenario_hash: String,
    started_ns: u64,
}

impl Node {
    pub fn open(settings: &Settings) -> Result<Self, NodeError> {
        // In lockstep no message may be dropped, and reports must not overtake telemetry.
        let classes = match settings.pace {
            Pace::Live { .. } => [Class::RealTimeDrop, Class::HighDrop],
            Pace::Lockstep { .. } => [Class::RealTimeBlock; 2],
        };
        let scenario = settings.scenario.clone();
        let exporter = settings.metrics.open(settings.bus.certificate_ends())?;
        let mut room = SimulatedRoom::new(&scenario, scenario.read_trace()?.as_deref(), scenario.seed)?;
        if let Some(corrections) = &settings.calibration {
            if room.arrays() > 1 {
                return Err(NodeError::CalibrationOfSeveral { arrays: room.arrays() });
            }
            room.set_calibration(0, &corrections.message(Stamp { sequence: 1, ..Stamp::default() }))?;
        }
        let session = RoomSession::open(&settings.bus, room.arrays(), classes)?;
        let clock = session.clock();
        // Every role may publish under the key of the stop, only operators under that of a re-arm.
        room.refuse_unnamed_rearm(settings.bus.is_authenticated());
        let mut arrays = Vec::new();
        for array in 0..room.arrays() {
            let now = clock.now();
            let capabilities = room.capabilities(array, Stamp::default());
            let record = settings.record.as_ref();
            let opened = record.map(|record| record.open(&settings.bus.room, array, &capabilities, now.room_ns));
            let record = opened.transpose()?.map(|(record, latch)| {
                if let Some(advice) = stop_record::advice(&settings.bus.room, &latch) {
                    tracing::warn!("{advice}");
                }
                latch.stops().iter().for_each(|stop| room.stop(array, now, stop.clone()));
                record
            });
            arrays.push(ArrayNode::new(array, record, settings.bus.room.to_string()));
        }
        // Halfway between two ticks: this samples the mean age of the angles, and does not delay a
        // tick.
        let between_ticks_ns = Schedule::new(scenario.streams.positions.rate_hz, 0).period_ns() / 2;
        let streams = true_room(&scenario, scenario.seed).streams;
        let telemetry_ns = match settings.pace {
            Pace::Live { .. } => telemetry_phase_ns(&streams),
            Pace::Lockstep { .. } => between_ticks_ns,
        };
        Ok(Self {
            reports: Reports::new(&streams, scenario.seed, session.source()),
            telemetry: Schedule::new(scenario.streams.telemetry.rate_hz, telemetry_ns),
            truth: Schedule::new(scenario.streams.truth.rate_hz, between_ticks_ns),
            status: Schedule::new(STATUS_HZ, between_ticks_ns),
            started_ns: clock.now().room_ns,
            scenario_hash: scenario.hash(),
            room,
            session,
            clock,
            ticks: TickLedger::default(),
            refused: RefusalCounts::default(),
            logged_refusals: 0,
            log_limit: LogLimit::default(),
            coverage: Coverage::default(),
            capabilities: Schedule::new(CAPABILITIES_HZ, 0),
            orders: 0,
            arrays,
            has_exporter: exporter.is_some(),
            exporter,
            scenario,
        })
    }

    pub fn truth_publisher(&mut self) -> Result<TruthPublisher, NodeError> {
        TruthPublisher::new(self.room.world(), &self.session, self.scenario.geometry_toml(), self.exporter.take())
    }

    /// Notes another driver or simulator that has joined the room.
    ///
    /// # Errors
    /// This process has to end, because the other one started at the same time.
    pub fn check_claim(&mut self) -> Result<(), NodeError> {
        let Self { session, refused, logged_refusals, .. } = self;
        session.check_claim(|problem| {
            tracing::warn!("{problem}");
            refused.count(ANOTHER_PROCESS, problem);
            *logged_refusals += 1;
        })
    }

    /// Logs the last refusal, if there are new ones and one like it was not logged just before.
    pub fn log_refusals(&mut self) {
        let new = self.refused.problems() - std::mem::replace(&mut self.logged_refusals, self.refused.problems());
        if new == 0 {
            return;
        }
        let problem = format!("refused: {}", printable(self.refused.last_problem()));
        if let Some(line) = self.log_limit.line(Instant::now(), &problem, new) {
            tracing::warn!("{line}");
        }
    }

    /// Gives an arrival to an array at a time; returns the command if it was one that was
    /// accepted.
    pub fn handle(&mut self, array: usize, arrival: Arrival, times: (Moment, Moment)) -> Option<MirrorCommand> {
        let command = self.room.handle(array, times, arrival.content, &mut self.refused)?;
        self.ticks.answered(command.answers, arrival.at.local_ns);
        Some(command)
    }

    /// Records the emergency stops, before telemetry reports them; `again` repeats a write that
    /// failed.
    pub fn keep_latches(&mut self, again: bool) {
        self.arrays.iter_mut().for_each(|array| array.keep_latch(&self.room, again));
    }

    /// Publishes telemetry when it is due, or when the state of an array has changed; with it the
    /// safety report, when the latch has changed.
    pub fn publish_telemetry(&mut self, now: Moment) -> Result<(), NodeError> {
        self.keep_latches(false);
        for array in self.arrays.iter_mut().filter(|array| array.has_new_latch(&self.room)) {
            array.publish_safety(&self.room, &mut self.session, now)?;
        }
        let due = self.telemetry.take(now.local_ns).is_some();
        if due {
            self.room.advance(now.local_ns);
        }
        let Self { arrays, room, session, .. } = self;
        arrays.iter_mut().try_for_each(|array| array.publish_telemetry(room, session, (now, due)))
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
        let Self { arrays, room, session, .. } = self;
        arrays.iter_mut().try_for_each(|array| array.publish_capabilities(room, session, now))
    }

    pub fn publish_safety(&mut self, now: Moment) -> Result<(), NodeError> {
        let Self { arrays, room, session, .. } = self;
        arrays.iter_mut().try_for_each(|array| array.publish_safety(room, session, now))
    }

    /// The arrays that obey commands: those that no stop holds.
    pub fn obedient(&self) -> Vec<usize> {
        let arrays = 0..self.room.arrays();
        arrays.filter(|array| self.room.array(*array).state() != ArrayState::Stopped).collect()
    }

    /// While every array is stopped, no tick can be answered, and none is lost.
    pub fn excuse_ticks(&mut self) {
        if self.obedient().is_empty() {
            self.ticks.excuse();
        }
    }

    /// Whether any array follows or has followed a command.
    fn is_commanded(&self) -> bool {
        (0..self.room.arrays()).any(|array| self.room.array(array).followed().is_some())
    }

    pub fn snapshot(&self, now: Moment) -> Snapshot {
        Snapshot {
            tick: self.reports.tick(),
            time_ns: now.room_ns,
            commanded: self.is_commanded(),
            ..Snapshot::new(self.room.world(), self.room.angles())
        }
    }

    fn status_message(&self, time_ns: u64) -> NodeStatus {
        let summary = self.summary(&Measurements::default());
        let state_of = |array: usize| {
            let name = if array == 0 { "array".to_owned() } else { array_name(array) };
            format!("{name} {:?}", self.room.array(array).state()).to_lowercase()
        };
        let state = match self.is_commanded() {
            false => "waiting for a controller".to_owned(),
            true => (0..self.room.arrays()).map(state_of).collect::<Vec<_>>().join(", "),
        };
        let counts = [
            ("ticks", summary.ticks),
            ("commands", summary.commands),
            ("lost_ticks", summary.lost_ticks),
            ("late_ticks", summary.late_ticks),
            ("unattended_ticks", summary.unattended_ticks),
            ("clipped_commands", summary.clipped_commands),
            ("orders", self.orders),
            (NodeStatus::OTHER_PROCESSES, self.session.others().len() as u64),
            (NodeStatus::STOP_UNRECORDED, self.arrays.iter().filter_map(ArrayNode::record_problem).count() as u64),
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
            ("faulty_mirrors", self.room.faulty_mirrors() as f64),
        ];
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
            timings: vec![("loop".to_owned(), summary.loop_us)],
            last_problem: cut(&self.last_problem()).to_owned(),
            ..NodeStatus::default()
        }
    }

    /// A stop that cannot be recorded, another process with mirrors that is in the room, or the last refusal.
    fn last_problem(&self) -> Cow<'_, str> {
        let record = || self.arrays.iter().find_map(ArrayNode::record_problem).map(Cow::Borrowed);
        let other = || self.session.others().into_iter().next().map(Cow::Owned);
        record().or_else(other).unwrap_or_else(|| self.refused.last_problem().into())
    }

    /// The status, with the metrics of the same time if they are served.
    pub fn status_and_metrics(&self, time_ns: u64) -> (NodeStatus, Option<Page>) {
        let page = || {
            let summary = self.summary(&Measurements::default());
            let mut page = metrics::page(&self.session.room_name(), &summary, &self.ticks);
            // Either all arrays keep their stop, or none.
            if let Some(is_recorded) = self.arrays.iter().map(ArrayNode::is_recorded).min().flatten() {
                page.stop_recorded(&[], is_recorded);
            }
            self.add_array_states(&mut page);
            page
        };
        (self.status_message(time_ns), self.has_exporter.then(page))
    }

    /// Adds the state of each array; one of several has its name.
    fn add_array_states(&self, page: &mut Page) {
        let arrays = self.room.arrays();
        for index in 0..arrays {
            let (name, state) = (array_name(index), self.room.array(index).state().name());
            let named = [("array", name.as_str())];
            page.array_state(&named[..usize::from(arrays > 1)], state);
        }
    }

    pub fn summary(&self, measurements: &Measurements) -> Summary {
        let counters = |count: fn(&Counters) -> u64| -> u64 {
            (0..self.room.arrays()).map(|array| count(self.room.array(array).counters())).sum()
        };
        let refused = self.refused.counts().iter().map(|(name, count)| (name.clone(), *count));
        let mut summary = Summary {
            scenario: self.scenario.name.clone(),
            scenario_hash: self.scenario_hash.clone(),
            seed: self.scenario.seed,
            ticks: self.ticks.published_count(),
            unattended_ticks: self.ticks.unattended(),
            lost_ticks: self.ticks.lost(),
            waiting_ticks: self.ticks.waiting(),
            late_ticks: self.reports.late_ticks(),
            commands: counters(|counters| counters.accepted),
            clipped_commands: counters(|counters| counters.clipped),
            refused: refused.collect(),
            turnover: self.room.world().turnover(),
            loop_us: self.ticks.quantiles_us(),
            belief: BeliefSummary::of(self.coverage.covered()),
            truth_us_mean: measurements.mean_cost_s * 1e6,
            last_problem: self.last_problem().into_owned(),
            ..Summary::default()
        };
        summary.set_rates(&measurements.counters);
        summary
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn telemetry_is_due_a_quarter_of_an_interval_before_a_report_whatever_the_latency() {
        for (rate_hz, latency_ms, due_ms) in
            [(20.0, 0.0, 37.5), (20.0, 60.0, 47.5), (20.0, 15.0, 2.5), (100.0, 0.0, 7.5), (1.0, 0.0, 0.0)]
        {
            let mut streams = Streams::default();
            (streams.positions.rate_hz, streams.positions.latency_ms) = (rate_hz, latency_ms);
            streams.telemetry.rate_hz = 20.0;
            assert_eq!(telemetry_phase_ns(&streams) as f64 / 1e6, due_ms, "{rate_hz} Hz, {latency_ms} ms");
        }
    }
}
