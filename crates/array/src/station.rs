//! An array as a node of a room: what its driver handles, records and publishes, and when.
//!
//! # Theory of Operation
//!
//! [`Station`] is a driver process without transport, clock and thread. It holds a [`Kit`] with the
//! record of its emergency stop, and gives the reports that the contract requires of a driver. The
//! calling order is:
//!
//! 1. [`Station::handle`] for each message, until a report is due ([`Station::is_report_due`]): a
//!    flood delays neither telemetry nor the record of a stop. A stop comes before both.
//! 2. [`Station::advance`]: it holds, parks and reconnects.
//! 3. [`Station::poll_record`]: the caller runs the task, and passes the result to
//!    [`Station::finish_record`]. A caller whose store can block does both on another thread, and goes on.
//! 4. [`Station::poll_report`], and publish what it returns, until it returns `None`. A report that names a
//!    new stop waits for its record.
//! 5. Wait for a message until [`Station::next_ns`] at the latest, and continue with step 1.
//!
//! A caller whose device can block gives its kit a [`Watch`](crate::watch::Watch), and reads the time again after each
//! step.

use heliostat_proto::array_keys::array_name;
use heliostat_proto::{
    ArrayState, Capabilities, MirrorCommand, MirrorTelemetry, NodeKind, NodeStatus, SafetyReport, Stamp, StopReport,
};

use crate::arrivals::Arrival;
use crate::device::Device;
use crate::kit::Kit;
use crate::latch::Latch;
use crate::moment::Moment;
use crate::refusal_counts::{ANOTHER_PROCESS, DROPPED, RefusalCounts};
use crate::stop_record::{RecordError, RecordPlan, RecordTask, with_record_problem};

/// Time between two telemetry messages in ns; the contract requires ten per second.
const TELEMETRY_NS: u64 = 50_000_000;

/// Time between two publications of the capabilities, of the safety report and of the status, in ns.
const ANNOUNCEMENT_NS: u64 = 1_000_000_000;

/// Time from the request of a measurement to the telemetry that shows it, in ns.
const MEASURED_WITHIN_NS: u64 = 10_000_000;

/// The identity of a driver in its messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// The source id in its stamps.
    pub source: u64,
    /// Index of the array among those of the room.
    pub array: usize,
    /// Name and version of the software in the status.
    pub software: String,
}

/// A message to publish.
#[derive(Clone, Debug, PartialEq)]
pub enum Report {
    /// Under the key of the array's telemetry.
    Telemetry(MirrorTelemetry),
    /// Under the key of the array's safety report, and as the answer to queries of it.
    Safety(SafetyReport),
    /// Under the key of the array's stop report, and as the answer to queries of it.
    Stops(StopReport),
    /// Under the key of the array's capabilities, and as the answer to queries of it.
    Capabilities(Capabilities),
    /// Under the key of the driver's status.
    Status(NodeStatus),
}

/// Sequence number and next time of one kind of report.
#[derive(Clone, Copy, Debug, Default)]
struct Timer {
    sequence: u64,
    due_ns: u64,
}

impl Timer {
    /// The stamp of the report that is published now; the next one is due after `interval_ns`.
    fn publish(&mut self, source: u64, now: Moment, interval_ns: u64) -> Stamp {
        self.sequence += 1;
        self.due_ns = now.local_ns.saturating_add(interval_ns);
        Stamp { source, sequence: self.sequence, time_ns: now.room_ns }
    }
}

/// The state of the last stop report.
#[derive(Debug, Default)]
struct PublishedStops {
    latch: Latch,
    /// Whether the device had executed the stops.
    is_stopped: bool,
    /// Why the stops were not in the record.
    problem: Option<String>,
}

/// A kit with the plan of its stop's record, and the reports of a driver.
#[derive(Debug)]
pub struct Station<D> {
    kit: Kit<D>,
    record: RecordPlan,
    identity: Identity,
    started_ns: u64,
    refused: RefusalCounts,
    /// Other processes with this array that are in the room.
    other_processes: u64,
    telemetry: Timer,
    telemetry_ns: u64,
    safety: Timer,
    stops: Timer,
    capabilities: Timer,
    status: Timer,
    /// Whether the measurement for the next telemetry is requested.
    is_measuring: bool,
    /// The state in the last telemetry, and whether its device had executed a stop.
    published_state: (ArrayState, bool),
    /// The latch in the last safety report.
    published_latch: Latch,
    published_stops: PublishedStops,
    /// Numbers of problems of the device and of refused messages, and whether the last one was of the
    /// device.
    problems: ([u64; 2], bool),
    /// Number of problems of the device at the last status.
    shown_of_device: u64,
    /// The time of the last advance.
    local_ns: u64,
}

impl<D: Device> Station<D> {
    /// A station that starts now, stopped if the latch at the start has a stop. All reports are due.
    pub fn new(
        mut kit: Kit<D>,
        (record, latch_at_start): (RecordPlan, Latch),
        identity: Identity,
        now: Moment,
    ) -> Self {
        latch_at_start.stops().iter().for_each(|stop| kit.stop(now, stop.clone()));
        Self {
            kit,
            record,
            identity,
            started_ns: now.room_ns,
            refused: RefusalCounts::default(),
            other_processes: 0,
            telemetry: Timer::default(),
            telemetry_ns: TELEMETRY_NS,
            safety: Timer::default(),
            stops: Timer::default(),
            capabilities: Timer::default(),
            status: Timer::default(),
            is_measuring: false,
            published_state: (ArrayState::Parked, false),
            published_latch: Latch::default(),
            published_stops: PublishedStops::default(),
            problems: ([0; 2], false),
            shown_of_device: 0,
            local_ns: now.local_ns,
        }
    }

    /// Publishes telemetry at another interval in ns.
    #[must_use]
    pub fn with_telemetry_every(self, telemetry_ns: u64) -> Self {
        Self { telemetry_ns, ..self }
    }

    /// Handles a message, which may have waited since it arrived.
    pub fn handle(&mut self, now: Moment, arrival: Arrival) {
        self.kit.handle((arrival.at, now), arrival.content, &mut self.refused);
        self.order_problems();
    }

    /// Handles a command that the caller has decoded into a buffer of its own.
    pub fn handle_command(&mut self, at: Moment, command: &MirrorCommand) {
        self.kit.follow((at, at), command, &mut self.refused);
        self.order_problems();
    }

    /// Sets the number of messages that were dropped before they were handled.
    pub fn set_dropped(&mut self, dropped: u64) {
        self.refused.set(DROPPED, dropped);
    }

    /// Notes a problem: another process with this array has joined the room.
    pub fn note_other_process(&mut self, problem: String) {
        self.refused.count(ANOTHER_PROCESS, problem);
        self.order_problems();
    }

    /// Sets the number of other processes with this array that are in the room.
    pub fn set_other_processes(&mut self, count: u64) {
        self.other_processes = count;
    }

    /// Advances to a time: the array holds, parks, or connects its device.
    pub fn advance(&mut self, now: Moment) {
        self.kit.advance(now);
        let now = self.kit.present(now);
        self.local_ns = now.local_ns;
        self.order_problems();
        if !self.is_measuring && now.local_ns >= self.measurement_ns() {
            self.is_measuring = true;
            self.kit.request_measurement();
        }
    }

    /// The write or the check of the record that is due; a write that failed is repeated when the safety
    /// report is due. None is returned before the last one is finished.
    pub fn poll_record(&mut self, now: Moment) -> Option<RecordTask> {
        let again = now.local_ns >= self.safety.due_ns;
        self.record.poll(self.kit.array().latch(), again, now.local_ns)
    }

    /// Whether the present stops are in the record, or could not be written.
    pub fn is_settled(&self) -> bool {
        self.record.is_settled(self.kit.array().latch())
    }

    /// The task of [`poll_record`](Self::poll_record) has ended; a stop is in force even if it failed. Returns the line of
    /// a log: the failure, or the end of one.
    pub fn finish_record(&mut self, result: &Result<(), RecordError>) -> Option<String> {
        self.record.finish(result)
    }

    /// The next report that is due, if any.
    pub fn poll_report(&mut self, now: Moment) -> Option<Report> {
        if self.reports_wait_until().is_some_and(|until_ns| now.local_ns < until_ns) {
            return None;
        }
        let source = self.identity.source;
        let is_due = |timer: &Timer| now.local_ns >= timer.due_ns;
        // Before the telemetry, so that a process that learns of a new state from it finds the stop.
        if is_due(&self.safety) || self.published_latch != *self.kit.array().latch() {
            let stamp = self.safety.publish(source, now, ANNOUNCEMENT_NS);
            self.published_latch.clone_from(self.kit.array().latch());
            return Some(Report::Safety(self.kit.safety(stamp)));
        }
        if is_due(&self.stops) || self.has_new_stops() {
            let stamp = self.stops.publish(source, now, ANNOUNCEMENT_NS);
            self.published_stops = PublishedStops {
                latch: self.kit.array().latch().clone(),
                is_stopped: self.kit.device_stopped(),
                problem: self.record_problem().map(str::to_owned),
            };
            return Some(Report::Stops(with_record_problem(self.kit.stops(stamp), self.record_problem())));
        }
        if is_due(&self.telemetry) || self.has_changed() {
            let stamp = self.telemetry.publish(source, now, self.telemetry_ns);
            let telemetry = self.kit.telemetry(now, stamp);
            self.order_problems();
            // A measurement can show that the device is lost.
            self.published_state = (self.kit.array().state(), self.kit.device_stopped());
            self.is_measuring = false;
            return Some(Report::Telemetry(telemetry));
        }
        if is_due(&self.capabilities) {
            let stamp = self.capabilities.publish(source, now, ANNOUNCEMENT_NS);
            return Some(Report::Capabilities(self.kit.capabilities(stamp)));
        }
        if is_due(&self.status) {
            let stamp = self.status.publish(source, now, ANNOUNCEMENT_NS);
            let status = self.status(stamp);
            self.shown_of_device = self.kit.problems();
            return Some(Report::Status(status));
        }
        None
    }

    /// Whether telemetry is due at this local time, or the latch has changed: no further message is
    /// handled before the reports. A stop that waits for an array that is not stopped comes before them.
    pub fn is_report_due(&self, local_ns: u64) -> bool {
        let waits = self.reports_wait_until().is_some_and(|until_ns| local_ns < until_ns);
        let is_due = !waits && (local_ns >= self.telemetry.due_ns || self.published_latch != *self.kit.array().latch());
        is_due && !self.kit.is_held_back()
    }

    /// Until when reports wait for the record of the present stops, if they do.
    fn reports_wait_until(&self) -> Option<u64> {
        self.record.holds_until(self.kit.array().latch())
    }

    /// Whether the stops, what the device does about them, or the problem of their record differ from the last stop
    /// report: one is then due at once.
    fn has_new_stops(&self) -> bool {
        let PublishedStops { latch, is_stopped, problem } = &self.published_stops;
        latch != self.kit.array().latch()
            || *is_stopped != self.kit.device_stopped()
            || problem.as_deref() != self.record_problem()
    }

    /// Whether the state differs from the one in the last telemetry: telemetry is then due at once.
    pub fn has_changed(&self) -> bool {
        self.published_state != (self.kit.array().state(), self.kit.device_stopped())
    }

    /// When the measurement for the next telemetry is requested.
    fn measurement_ns(&self) -> u64 {
        self.telemetry.due_ns.saturating_sub(MEASURED_WITHIN_NS)
    }

    /// When [`Station::advance`] must be called if no message arrives, in local time.
    pub fn next_ns(&self) -> u64 {
        let timers = [self.telemetry, self.safety, self.stops, self.capabilities, self.status];
        let measurement = (!self.is_measuring).then(|| self.measurement_ns());
        let reports_wait_until = self.reports_wait_until().filter(|until_ns| self.local_ns < *until_ns);
        let due = timers.into_iter().map(|timer| timer.due_ns.max(reports_wait_until.unwrap_or_default()));
        due.chain(measurement).chain(self.kit.next_ns()).chain(reports_wait_until).min().unwrap_or_default()
    }

    /// The device with the rules, for functions beyond the contract.
    pub fn kit_mut(&mut self) -> &mut Kit<D> {
        &mut self.kit
    }

    /// The device with the rules.
    pub fn kit(&self) -> &Kit<D> {
        &self.kit
    }

    /// Counts of refused messages.
    pub fn refused(&self) -> &RefusalCounts {
        &self.refused
    }

    /// Why the present stops are not in the record.
    pub fn record_problem(&self) -> Option<&str> {
        self.record.problem(self.kit.array().latch(), self.local_ns)
    }

    /// Whether no problem of the record of the present stops is known. A write of them that is under way is one when it
    /// is late; that of a release is none.
    pub fn is_recorded(&self) -> bool {
        self.record.is_recorded(self.kit.array().latch(), self.local_ns)
    }

    /// The present problem of the record; else that of a device that does not answer, or did not since the last status;
    /// else the last one of the device or of a refused message; empty if there was none.
    pub fn last_problem(&self) -> String {
        let (_, is_of_device) = self.problems;
        // A status shows a failure that was over before it, as that of a board that resets.
        let is_present = self.kit.is_device_absent() || self.kit.problems() > self.shown_of_device;
        let of_device = self.kit.last_problem().filter(|_| is_of_device || is_present).map(ToString::to_string);
        let problem = self.record_problem().map(str::to_owned).or(of_device);
        problem.unwrap_or_else(|| self.refused.last_problem().to_owned())
    }

    /// Notes whether the last problem is one of the device: an old one of the device does not hide a
    /// refusal.
    fn order_problems(&mut self) {
        let counts = [self.kit.problems(), self.refused.problems()];
        let ([device, refused], is_of_device) = self.problems;
        let is_of_device = if counts[0] != device { true } else { is_of_device && counts[1] == refused };
        self.problems = (counts, is_of_device);
    }

    fn status(&self, stamp: Stamp) -> NodeStatus {
        let commands = self.kit.array().counters().accepted;
        let counts = [
            ("commands", commands),
            ("connections", self.kit.connections()),
            ("device_absent", u64::from(self.kit.is_device_absent())),
            (NodeStatus::STOP_UNRECORDED, u64::from(!self.is_recorded())),
            (NodeStatus::OTHER_PROCESSES, self.other_processes),
        ];
        let refused = self.refused.counts().iter().map(|(name, count)| (format!("refused:{name}"), *count));
        let array = if self.identity.array == 0 { "array".to_owned() } else { array_name(self.identity.array) };
        let mut status = NodeStatus {
            stamp,
            node: NodeKind::Driver,
            name: format!("{:016x}", self.identity.source),
            software: self.identity.software.clone(),
            state: format!("{array} {}", self.kit.array().state().name()),
            started_ns: self.started_ns,
            counters: counts.map(|(name, count)| (name.to_owned(), count)).into_iter().chain(refused).collect(),
            ..NodeStatus::default()
        };
        status.set_problem(&self.last_problem());
        status
    }
}
