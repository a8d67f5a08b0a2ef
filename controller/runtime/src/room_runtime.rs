//! One room of the process: builds and owns the parts that serve it, its subscriptions, and its
//! reports.
//!
//! | part | duty | runs on |
//! | --- | --- | --- |
//! | [`receive_queue`] | holds payloads between callbacks and the room's thread | |
//! | [`decision_loop`] | decodes, decides, records stage times | the transport's callback or the room's thread; the main thread for missing reports |
//! | [`cache_warmer`] | decides when the room's thread warms up the caches | the room's thread |
//! | [`command_sender`] | encodes and publishes commands | the thread that decides |
//! | [`state_publisher`] | publishes belief and state after a command | the thread that decides |
//! | [`stop_repeater`] | repeats held stops to arrays that have not reported them | the main thread |
//!
//! `policy_swap` replaces the policy on a thread of its own. Rooms share a session and nothing
//! else, so a room that floods, fails or stands by leaves the others alone.
//!
//! The main thread is the watchdog: it waits at most `POLICY_TIMEOUT` for the lock of the decision
//! loop. A policy that holds the lock for longer is reported and counted, and the room gets no
//! command until it returns.

pub mod cache_warmer;
pub mod command_sender;
pub mod decision_loop;
mod driver_presence;
mod geometry;
pub mod input_channel;
mod locks;
mod policy_swap;
pub mod receive_queue;
pub mod room_clock;
pub mod state_publisher;
mod status;
pub mod stop_repeater;
mod subscriptions;
mod undecodable;

use std::{
    sync::{Arc, Mutex},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use anyhow::Context;
use heliostat_bus::{Bus, BusError, Class, Publisher, Subscription, Token};
use heliostat_core::{
    capabilities::Examiner,
    core::Controller,
    tenure::{Standing, Tenure},
};
use heliostat_models::build_tried;
use heliostat_proto::{Nanos, NodeKind, NodeStatus, Room, encode};
use heliostat_service::{clock::utc_ns, log_limit::LogLimit, source_id};

use crate::{
    config::{NodeConfig, Pace},
    report::{
        stage_times::{PolicyTimes, StageTimes},
        summary::{RoomReport, Summary},
    },
};
use command_sender::CommandSender;
use decision_loop::{DecisionLoop, PayloadHandler};
use driver_presence::DriverPresence;
use geometry::GeometryExchange;
use locks::{lock_within, try_lock};
use policy_swap::{PolicyBuilder, PolicySwap, warm_up_runs};
use receive_queue::ReceiveQueue;
use room_clock::RoomClock;
use state_publisher::StatePublisher;
use status::{Conditions, Identity, Problem, Reporter};
use stop_repeater::{HeldStops, StopRepeater};
use subscriptions::Arrays;
use undecodable::Decoder;

/// Timeout of a policy. No policy for a room with a deadline takes so long.
const POLICY_TIMEOUT: Duration = Duration::from_millis(100);

/// Longest wait of a controller that ends for a standby that takes over.
const HAND_OVER: Duration = Duration::from_millis(500);

/// A room that is being served.
pub struct RoomRuntime {
    room: Room,
    decision_loop: Arc<Mutex<DecisionLoop>>,
    queue: Arc<ReceiveQueue>,
    stops: Arc<HeldStops>,
    repeater: StopRepeater,
    policy_swap: PolicySwap,
    /// The room's thread, if decisions need one.
    thread: Option<JoinHandle<()>>,
    /// Dropped when the room is closed.
    declared: Option<(Vec<Subscription>, Token)>,
    status: Publisher,
    geometry: GeometryExchange,
    driver: DriverPresence,
    reporter: Reporter,
    decoder: Decoder,
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
    /// Builds the policy, warms it up, and begins to serve the bus's room.
    ///
    /// # Errors
    /// If the policy does not fit the scenario, or the session is closed.
    pub fn open(bus: &Bus, config: &NodeConfig) -> anyhow::Result<Self> {
        let scenario = &config.scenario;
        let started_ns = utc_ns();
        let source = source_id::random();
        let interval_ns = (1e9 / scenario.streams.positions.rate_hz) as Nanos;
        let (clock, tenure, class) = match config.pace {
            Pace::Live => {
                let tenure = Tenure::live(source, interval_ns);
                let tenure = match config.standby {
                    Some(rank) => tenure.in_reserve(rank),
                    None => tenure,
                };
                (RoomClock::Utc, tenure, Class::RealTimeDrop)
            }
            // The room waits for each command, so a dropped command would stop it.
            Pace::Lockstep => (RoomClock::Lockstep { newest_ns: 0 }, Tenure::lockstep(1), Class::RealTimeBlock),
        };
        let actor = config.actor();
        let (policy, findings) = build_tried(config.policy, scenario, &actor)?;
        let model = scenario.channel_model()?;
        let examiner = Examiner::new(scenario, &model, config.force);
        let mut controller = Controller::new(scenario, model.clone(), policy, 0).with_tenure(tenure).with_journal();
        controller.warm_up(warm_up_runs());
        let room = bus.room().clone();
        let engine = controller.engine_name();
        tracing::info!(policy = controller.policy_name(), engine, scenario = scenario.name, %room, "ready");

        let settings = config.decisions.among(1 + config.also_rooms.len());
        let arrays = scenario.mirrors.arrays().iter().enumerate();
        let publishers = arrays.map(|(index, array)| {
            Ok((bus.publisher(&room.array(index).command(), class)?, array.rows * array.columns))
        });
        let sender = CommandSender::new(publishers.collect::<Result<Vec<_>, BusError>>()?);
        let arrays = controller.arrays();
        let stops = Arc::new(HeldStops::new(arrays));
        let repeater = StopRepeater::open(bus, arrays, source)?;
        let published = (sender, StatePublisher::open(bus, source)?);
        let decision_loop = DecisionLoop::new(controller, clock, deadline(config), published, Arc::clone(&stops));
        let decision_loop = Arc::new(Mutex::new(decision_loop.with_settings(settings)));
        let queue = Arc::new(ReceiveQueue::default());
        let thread = settings.has_thread().then(|| spawn(&room, &decision_loop, &queue)).transpose()?;

        let handler = PayloadHandler {
            decision_loop: Arc::clone(&decision_loop),
            queue: Arc::clone(&queue),
            decide_in: settings.decide_in,
        };
        // The arrays first: their announcements precede the first command.
        let decoder = Decoder::default();
        let arrays = Arrays {
            decision_loop: Arc::clone(&decision_loop),
            stops: Arc::clone(&stops),
            decoder: decoder.clone(),
        };
        let mut subscriptions = subscriptions::subscribe_to_arrays(bus, &arrays, &examiner)?;
        subscriptions.extend(subscriptions::subscribe_to_reports(bus, &handler)?);
        let builder = PolicyBuilder { scenario: scenario.clone(), model, configured: (config.policy, actor) };
        let (policy_swap, orders) = PolicySwap::subscribe(bus, &decision_loop, builder)?;
        subscriptions.push(orders);
        policy_swap.report(findings);
        let (mut geometry, announced) = GeometryExchange::open(bus, scenario, source, decoder.clone())?;
        let (driver, tokens) = DriverPresence::open(bus, scenario.mirrors.arrays().len())?;
        subscriptions.extend([announced, tokens]);
        geometry.announce_if_due(started_ns);
        let token = bus.announce(&room.alive(NodeKind::Controller, source))?;
        let identity = Identity { source, started_ns, scenario: scenario.hash() };
        Ok(Self {
            status: bus.publisher(&room.status(NodeKind::Controller), Class::LowDrop)?,
            room,
            decision_loop,
            queue,
            stops,
            repeater,
            policy_swap,
            thread,
            declared: Some((subscriptions, token)),
            geometry,
            driver,
            reporter: Reporter::new(identity),
            decoder,
            spare_times: StageTimes::new(),
            times: StageTimes::new(),
            policy_times: PolicyTimes::default(),
            summary: Summary::default(),
            log_limit: LogLimit::default(),
        })
    }

    /// The room.
    pub fn room(&self) -> &Room {
        &self.room
    }

    /// Counters and names as of the last status check.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// The room's report as of the last status check.
    pub fn report(&self) -> RoomReport<'_> {
        RoomReport { room: &self.room, summary: &self.summary, times: &self.times, policy_times: &self.policy_times }
    }

    /// Executes the action for absent reports, if that is due. Repeats held stops.
    pub fn handle_timeouts(&mut self) {
        self.repeater.repeat(&self.stops);
        if let Some(mut decision_loop) = try_lock(&self.decision_loop) {
            decision_loop.handle_timeout();
        }
    }

    /// Takes the new stage times, publishes a status report, and updates the summary.
    pub fn check_status(&mut self) {
        // Before the lock: the comparison reads text that another process wrote.
        self.geometry.compare_newest();
        self.geometry.announce_if_due(utc_ns());
        let Some(mut decision_loop) = lock_within(&self.decision_loop, POLICY_TIMEOUT) else {
            self.report_stall();
            return;
        };
        std::mem::swap(&mut decision_loop.times, &mut self.spare_times);
        let conditions = Conditions {
            without_driver: self.driver.absent(Instant::now(), &decision_loop.controller),
            geometry: self.geometry.problem().map(str::to_owned),
            undecodable: self.decoder.counts(),
        };
        let former = std::mem::take(&mut decision_loop.former_times);
        let mut snapshot = self.reporter.take_snapshot(&decision_loop, self.policy_swap.counters(), conditions);
        drop(decision_loop);
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
        self.check_status();
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
            let controller = &decision_loop.controller;
            let awaits = |array| {
                let tenure = controller.tenure(array);
                tenure.has_peers() && tenure.standing() == Standing::Leading
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
        let (Problem::Alarm(text) | Problem::Warning(text)) = problem;
        let line = match occurrences {
            0 => Some(text.clone()),
            _ => self.log_limit.line(Instant::now(), text, occurrences),
        };
        let Some(line) = line else { return };
        match problem {
            Problem::Alarm(_) => tracing::error!(room = %self.room, "{line}"),
            Problem::Warning(_) => tracing::warn!(room = %self.room, "{line}"),
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
fn spawn(
    room: &Room,
    decision_loop: &Arc<Mutex<DecisionLoop>>,
    queue: &Arc<ReceiveQueue>,
) -> anyhow::Result<JoinHandle<()>> {
    let (decision_loop, queue) = (Arc::clone(decision_loop), Arc::clone(queue));
    let run = move || decision_loop::run(&decision_loop, &queue);
    std::thread::Builder::new().name(format!("decide-{room}")).spawn(run).context("cannot start the room's thread")
}

/// The deadline of a decision after the arrival of its report: `control.deadline_ms`.
fn deadline(config: &NodeConfig) -> Duration {
    let seconds = match config.scenario.control.deadline_ms {
        0.0 => 1.0 / config.scenario.streams.positions.rate_hz,
        milliseconds => milliseconds * 1e-3,
    };
    Duration::from_secs_f64(seconds)
}
