//! One room of the process: sockets, clock, threads, stage times and reports around the room's core,
//! [`RoomCore`].
//!
//! | part | duty | runs on |
//! | --- | --- | --- |
//! | [`receive_queue`] | holds payloads between callbacks and the room's thread | |
//! | [`decision_loop`] | passes inputs to the core, records stage times | the transport's callback or the room's thread; the main thread for missing reports |
//! | `announcements` | holds announcements, orders and tokens until the decision loop is free | callbacks, then the thread that releases the loop |
//! | `transport` | has the publishers, and passes commands to an array of this process | the thread that decides; the main thread for repetitions |
//!
//! `policy_swap` replaces the policy on a thread of its own. Rooms share a session and nothing
//! else, so a room that floods, fails or stands by leaves the others alone.
//!
//! The main thread is the watchdog: it waits at most `POLICY_TIMEOUT` for the lock of the decision
//! loop. A policy that holds the lock for longer is reported and counted, and the room gets no
//! command until it returns.

mod announcements;
pub mod decision_loop;
mod geometry;
mod lost_drivers;
mod peers;
mod policy_swap;
pub mod receive_queue;
mod status;
mod subscriptions;
pub mod transport;

use std::{
    sync::{Arc, Mutex},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use anyhow::Context;
use heliostat_bus::{Bus, Class, Publisher, Subscription, Token};
use heliostat_core::{
    room_core::{Input, Output, Repeater, RoomCore, RoomSettings},
    tenure::{HAND_OVER_NS, Standing, Tenure},
};
use heliostat_models::build_tried;
use heliostat_proto::{NodeKind, NodeStatus, Room, encode};
use heliostat_service::{
    clock::utc_ns,
    exit,
    locks::{lock, lock_within, try_lock},
    log_limit::LogLimit,
    process, source_id,
};

use crate::{
    config::NodeConfig,
    report::{
        stage_times::{PolicyTimes, StageTimes},
        summary::{RoomReport, Summary},
    },
};
use announcements::Announcements;
use decision_loop::{DecisionLoop, PayloadHandler};
use geometry::GeometryComparison;
use peers::PeerStatuses;
use policy_swap::{PolicyBuilder, PolicySwap, warm_up_runs};
use receive_queue::ReceiveQueue;
use status::{Conditions, Identity, Problem, Reporter};
use transport::{LocalArray, Publishers, Transport};

/// Timeout of a policy. No policy for a room with a deadline takes so long.
const POLICY_TIMEOUT: Duration = Duration::from_millis(100);

/// Longest wait of a controller that ends for a standby that takes over.
const HAND_OVER: Duration = Duration::from_nanos(HAND_OVER_NS);

/// A room that is being served.
pub struct RoomRuntime {
    bus: Bus,
    decision_loop: Arc<Mutex<DecisionLoop>>,
    queue: Arc<ReceiveQueue>,
    announcements: Announcements,
    repeater: Arc<Mutex<Repeater>>,
    repetitions: Publishers,
    policy_swap: PolicySwap,
    peers: PeerStatuses,
    /// The room's thread, until it has ended.
    thread: Option<JoinHandle<()>>,
    /// Dropped when the room is closed.
    declared: Option<(Vec<Subscription>, Token)>,
    status: Publisher,
    geometry: GeometryComparison,
    reporter: Reporter,
    /// Exchanged with the decision loop's times, so that its lock is held only for an instant.
    spare_times: StageTimes,
    /// Since the start.
    times: StageTimes,
    policy_times: PolicyTimes,
    /// As of the last status check.
    summary: Summary,
    log_limit: LogLimit,
}

impl RoomRuntime {
    /// Builds the policy, warms it up, and begins to serve the bus's room, with the arrays that this
    /// process drives.
    ///
    /// # Errors
    /// If the policy does not fit the scenario, or the session is closed.
    pub fn open(bus: &Bus, config: &NodeConfig, local: Vec<LocalArray>) -> anyhow::Result<Self> {
        let scenario = &config.scenario;
        let started_ns = utc_ns();
        let source = source_id::random();
        let is_lockstep = config.is_lockstep;
        let live = || Tenure::live(source, scenario.streams.positions.interval_ns());
        let (tenure, class) = match config.standby {
            // The room waits for each command, so a dropped command would stop it.
            _ if is_lockstep => (Tenure::lockstep(1), Class::RealTimeBlock),
            Some(rank) => (live().in_reserve(rank), Class::RealTimeDrop),
            None => (live(), Class::RealTimeDrop),
        };
        let (kind, actor) = (config.policy.kind(), config.policy.actor());
        let (policy, findings) = build_tried(kind, scenario, &actor).map_err(exit::unusable)?;
        let mut core =
            RoomCore::new(scenario, policy, RoomSettings { source, tenure, is_lockstep, force: config.force })?;
        core.warm_up(warm_up_runs());
        let room = bus.room().clone();
        let controller = core.controller();
        let (engine, arrays) = (controller.policy().engine(), controller.arrays());
        tracing::info!(policy = controller.policy().name(), engine, scenario = scenario.name, %room, "ready");

        let repeater = core.repeater();
        let transport = Transport::open(bus, arrays, class, local)?;
        let deadline = Duration::from_secs_f64(config.scenario.decision_deadline_s());
        let decision_loop = DecisionLoop::new(core, transport, deadline, config.times_from_tick);
        let decision_loop = Arc::new(Mutex::new(decision_loop));
        let queue = Arc::new(ReceiveQueue::default());
        let handler = PayloadHandler {
            decision_loop: Arc::clone(&decision_loop),
            queue: Arc::clone(&queue),
            announcements: Announcements::new(&decision_loop, &repeater),
        };
        let thread = Some(spawn(&room, &handler)?);
        let mut subscriptions = subscriptions::subscribe(bus, &handler)?;
        let builder = PolicyBuilder { scenario: scenario.clone(), configured: (kind, actor) };
        let (policy_swap, orders) = PolicySwap::subscribe(bus, &decision_loop, builder)?;
        let (peers, statuses) = PeerStatuses::subscribe(bus)?;
        subscriptions.extend([orders, statuses]);
        policy_swap.report(findings);
        let token = bus.announce(&room.alive(NodeKind::Controller, source))?;
        let host = process::machine_name().unwrap_or_default();
        tracing::info!(%room, host, "this controller is {source:016x}");
        let identity = Identity { source, host, started_ns, scenario: scenario.hash() };
        Ok(Self {
            status: bus.publisher(&room.status(NodeKind::Controller), Class::LowDrop)?,
            bus: bus.enter(room),
            decision_loop,
            queue,
            announcements: handler.announcements,
            repeater,
            repetitions: Publishers::of_repetitions(bus, arrays)?,
            policy_swap,
            peers,
            thread,
            declared: Some((subscriptions, token)),
            geometry: GeometryComparison::new(scenario),
            reporter: Reporter::new(identity),
            spare_times: StageTimes::default(),
            times: StageTimes::default(),
            policy_times: PolicyTimes::default(),
            summary: Summary::default(),
            log_limit: LogLimit::default(),
        })
    }

    /// The room.
    pub fn room(&self) -> &Room {
        self.bus.room()
    }

    /// Counters and names as of the last status check.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// The room's report as of the last status check.
    pub fn report(&self) -> RoomReport<'_> {
        RoomReport {
            room: self.bus.room(),
            source: self.reporter.identity().source,
            host: &self.reporter.identity().host,
            summary: &self.summary,
            times: &self.times,
            policy_times: &self.policy_times,
        }
    }

    /// Executes the action for absent reports, if that is due. Repeats held stops, and announces the
    /// geometry.
    pub fn handle_timeouts(&mut self) {
        if let Some(mut decision_loop) = try_lock(&self.decision_loop) {
            decision_loop.handle(Input::Wake);
        }
        self.announcements.settle();
        // Also while a policy does not return, and published without a lock.
        let mut due: Vec<(Output, Vec<u8>)> = Vec::new();
        lock(&self.repeater).repeat(utc_ns(), &mut due);
        for (output, payload) in &due {
            // A closed session shows in the count of commands that were refused.
            self.repetitions.put(*output, payload);
        }
    }

    /// Takes the new stage times, publishes a status report, and updates the summary. `pause` is the longest recent one
    /// of this process.
    pub fn check_status(&mut self, pause: Option<Duration>) {
        let Some(mut decision_loop) = lock_within(&self.decision_loop, POLICY_TIMEOUT) else {
            self.report_stall();
            return;
        };
        std::mem::swap(&mut decision_loop.times, &mut self.spare_times);
        let peers = decision_loop.room.controller().tenure(0).peers().to_vec();
        let silent_peers = self.peers.silent(&peers, Instant::now());
        let conditions = Conditions {
            without_driver: decision_loop.room.without_driver(utc_ns()),
            geometry: self.geometry.problem().map(str::to_owned),
            connection: self.bus.lost_connection(),
            standby_missing: self.peers.is_standby_missing(&peers, &silent_peers, Instant::now()),
            silent_peers,
            peers,
        };
        let changed = self.geometry.changed(decision_loop.room.announced_geometry(utc_ns()));
        let former = std::mem::take(&mut decision_loop.former_times);
        self.reporter.note_pause(pause);
        let mut snapshot = self.reporter.take_snapshot(&decision_loop, self.policy_swap.counters(), conditions);
        drop(decision_loop);
        self.announcements.settle();
        if let Some(announced) = changed {
            // Without the lock: the comparison reads text that another process wrote.
            self.geometry.compare(announced);
        }
        for (policy, mut times) in former {
            self.policy_times.add(&policy, &times);
            self.times.absorb(&mut times);
        }
        self.policy_times.add(&snapshot.summary.policy, &self.spare_times);
        self.times.absorb(&mut self.spare_times);
        if let Some(problem) = &snapshot.problem {
            self.log(problem, snapshot.occurrences);
        }
        snapshot.summary.dropped += self.queue.dropped();
        snapshot.summary.unanswered = self.summary.unanswered;
        let report = self.reporter.report(&snapshot, &self.times);
        self.publish_status(&report);
        self.summary = snapshot.summary;
        self.summary.add_times(&self.times, &self.policy_times);
    }

    /// Stops serving: withdraws the liveliness token, waits for a standby to take over, unsubscribes,
    /// and ends the room's thread.
    pub fn close(&mut self) {
        let Some((subscriptions, token)) = self.declared.take() else { return };
        drop(token);
        self.hand_over();
        drop(subscriptions);
        self.queue.close();
        self.reporter.end();
        self.check_status(None);
        if let Some(thread) = self.thread.take()
            && lock_within(&self.decision_loop, POLICY_TIMEOUT).is_some()
        {
            // An error means that the thread panicked, which the panic hook has reported.
            let _ = thread.join();
        }
    }

    /// Commands on until a standby does, so that no report lacks an answer.
    fn hand_over(&self) {
        let ends = Instant::now() + HAND_OVER;
        while Instant::now() < ends {
            let Some(decision_loop) = lock_within(&self.decision_loop, POLICY_TIMEOUT) else { return };
            let controller = decision_loop.room.controller();
            let awaits = |array| {
                let tenure = controller.tenure(array);
                !tenure.peers().is_empty() && tenure.standing() == Standing::Leading
            };
            if !(0..controller.arrays()).any(awaits) {
                return;
            }
            drop(decision_loop);
            std::thread::sleep(HAND_OVER / 100);
        }
    }

    fn report_stall(&mut self) {
        let policy = &self.summary.policy;
        let problem =
            format!("policy {policy} has timed out; no command is published: the array holds its angles, then parks");
        self.log(&Problem::Warning(problem.clone()), 1);
        self.summary.unanswered += 1;
        self.summary.last_problem = problem;
        self.publish_status(&self.reporter.report_stall(&self.summary));
    }

    /// Logs a change of state, or a problem that occurred so often unless one like it was logged just
    /// before.
    fn log(&mut self, problem: &Problem, occurrences: u64) {
        let text = problem.text();
        let line = match occurrences {
            0 => Some(text.to_owned()),
            _ => self.log_limit.line(Instant::now(), text, occurrences),
        };
        let Some(line) = line else { return };
        match problem {
            Problem::Alarm(_) => tracing::error!(room = %self.bus.room(), "{line}"),
            Problem::Warning(_) | Problem::Event(_) => tracing::warn!(room = %self.bus.room(), "{line}"),
            Problem::Notice(_) | Problem::End(_) => tracing::info!(room = %self.bus.room(), "{line}"),
        }
    }

    fn publish_status(&self, report: &NodeStatus) {
        let mut payload = Vec::new();
        match encode(report, &mut payload) {
            // A closed session shows in the count of commands that could not be sent.
            Ok(()) => drop(self.status.put(&payload)),
            Err(error) => tracing::warn!("the status report cannot be encoded: {error}"),
        }
    }
}

/// Starts the room's thread.
fn spawn(room: &Room, handler: &PayloadHandler) -> anyhow::Result<JoinHandle<()>> {
    let handler = handler.clone();
    let run = move || decision_loop::run(&handler);
    std::thread::Builder::new().name(format!("decide-{room}")).spawn(run).context("cannot start the room's thread")
}
