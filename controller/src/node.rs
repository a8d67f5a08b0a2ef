//! The edge: opens the bus, subscribes, keeps the status loop going, and ends in order.
//!
//! Nothing here is on the way from a report to its command but the callbacks, which hand each payload to the desk.

use std::{
    hash::{BuildHasher, Hasher, RandomState},
    io::Read,
    path::PathBuf,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        mpsc::{self, Receiver, RecvTimeoutError, Sender},
    },
    time::{Duration, Instant},
};

use anyhow::{Context, bail};
use heliostat_bus::{Bus, BusConfig, Class, Presence, Publisher, Subscription};
use heliostat_proto::{NodeKind, encode, keys::parse_alive};
use heliostat_scenario::Scenario;

use crate::{
    core::Controller,
    desk::{Desk, RoomClock, utc_ns},
    ledger::Ledger,
    policy::{self, ActorSource, PolicyKind},
    refused::Stream,
    status::{Identity, Reporter},
    summary::Summary,
};

/// Time between two status reports.
const STATUS_INTERVAL: Duration = Duration::from_millis(500);

/// Time without any position report after which that is worth a word.
const SILENCE: Duration = Duration::from_secs(3);

/// Decisions on an invented room before the node announces itself.
const WARM_UP_RUNS: usize = 200;

/// What decides where time and epochs come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pace {
    /// UTC; the epoch is the time of the start.
    #[default]
    Live,
    /// The time of the reports; the epoch is 1. The same room gives the same commands, bit for bit.
    Lockstep,
}

/// Everything that a node needs to start.
#[derive(Clone, Debug)]
pub struct NodeConfig {
    /// The room.
    pub scenario: Scenario,
    /// Where to meet it.
    pub bus: BusConfig,
    /// How to decide.
    pub policy: PolicyKind,
    /// The actor's file in place of the built-in one.
    pub model: Option<PathBuf>,
    /// Live or lockstep.
    pub pace: Pace,
    /// When to end without being asked.
    pub run_for: Option<Duration>,
}

/// Ends a running node when it is sent anything.
pub type Stop = Sender<()>;

/// A pair to stop a node by.
pub fn stop_channel() -> (Stop, Receiver<()>) {
    mpsc::channel()
}

/// Ends the node when the parent process closes our standard input.
pub fn stop_with_parent(stop: Stop) {
    std::thread::spawn(move || {
        let mut ignored = [0; 256];
        let mut input = std::io::stdin().lock();
        while !matches!(input.read(&mut ignored), Ok(0) | Err(_)) {}
        // The node may have ended already.
        let _ = stop.send(());
    });
}

/// Runs a controller until it is stopped, and gives its account.
///
/// # Errors
/// Where the actor does not fit, or the bus cannot be opened.
pub fn run(config: &NodeConfig, stopped: &Receiver<()>) -> anyhow::Result<Summary> {
    let started = Instant::now();
    let scenario = &config.scenario;
    let started_ns = utc_ns();
    let (clock, epoch) = match config.pace {
        Pace::Live => (RoomClock::Utc, started_ns / 1_000_000),
        Pace::Lockstep => (RoomClock::Lockstep { newest_ns: 0 }, 1),
    };
    let actor = config.model.clone().map_or(ActorSource::Shipped, ActorSource::Path);
    let policy = policy::build(config.policy, scenario, &actor)?;
    let mut controller = Controller::new(scenario, scenario.channel_model()?, policy, epoch);
    controller.warm_up(WARM_UP_RUNS);
    tracing::info!(policy = controller.policy_name(), epoch, scenario = scenario.name, "ready");

    let bus = Bus::open(&config.bus).context("cannot join the room")?;
    let room = bus.room().clone();
    let publisher = bus.publisher(&room.command(), Class::Control)?;
    let status = bus.publisher(&room.status(NodeKind::Controller), Class::Info)?;
    let desk = Arc::new(Mutex::new(Desk::new(controller, clock, publisher)));
    let subscriptions = subscribe(&bus, &desk)?;
    let source = RandomState::new().build_hasher().finish();
    let token = bus.announce(&room.alive(NodeKind::Controller, source))?;

    let identity = Identity { source, started_ns, scenario: scenario.hash() };
    let deadline = config.run_for.map(|run_for| started + run_for);
    let mut loops = StatusLoop { desk: &desk, status, reporter: Reporter::new(identity), spare: Ledger::new() };
    let mut times = Ledger::new();
    let mut silence_told = false;
    while !wait_for_stop(stopped, deadline) {
        let summary = loops.turn(&mut times);
        if let Some(epoch) = lock(&desk).controller.deposed_by() {
            bail!(
                "another controller (epoch {epoch}) took over the array of room \"{room}\": a room has one controller; stop one of the two"
            );
        }
        if summary.decisions == 0 && !silence_told && started.elapsed() > SILENCE {
            tracing::warn!("{}", nobody_reports(&config.bus));
            silence_told = true;
        }
    }
    drop(subscriptions);
    let mut summary = loops.turn(&mut times);
    if summary.decisions == 0 && summary.last_problem.is_empty() {
        summary.last_problem = nobody_reports(&config.bus);
    }
    drop(token);
    bus.close()?;
    Ok(summary)
}

fn nobody_reports(bus: &BusConfig) -> String {
    format!(
        "no position report came from room \"{}\" (connecting to {}, listening at {}): does the room's process run, with the same --room and a matching endpoint?",
        bus.room,
        if bus.connect.is_empty() { "nobody".into() } else { bus.connect.join(", ") },
        if bus.listen.is_empty() { "nothing".into() } else { bus.listen.join(", ") },
    )
}

/// Waits until the next status report is due; true where the node is to end instead.
fn wait_for_stop(stopped: &Receiver<()>, deadline: Option<Instant>) -> bool {
    let left = deadline.map_or(STATUS_INTERVAL, |deadline| deadline.saturating_duration_since(Instant::now()));
    if left.is_zero() {
        return true;
    }
    match stopped.recv_timeout(left.min(STATUS_INTERVAL)) {
        Ok(()) => true,
        Err(RecvTimeoutError::Timeout) => deadline.is_some_and(|deadline| Instant::now() >= deadline),
        // Nobody is left who could stop us but the deadline.
        Err(RecvTimeoutError::Disconnected) => {
            std::thread::sleep(left.min(STATUS_INTERVAL));
            deadline.is_some_and(|deadline| Instant::now() >= deadline)
        }
    }
}

fn subscribe(bus: &Bus, desk: &Arc<Mutex<Desk>>) -> anyhow::Result<Vec<Subscription>> {
    let room = bus.room();
    let keys = Stream::ALL.map(|stream| match stream {
        Stream::Users => (stream, room.users()),
        Stream::Channel => (stream, room.channel()),
        Stream::Obstacles => (stream, room.obstacles()),
        Stream::Telemetry => (stream, room.telemetry()),
    });
    let mut subscriptions = Vec::with_capacity(keys.len() + 1);
    for (stream, key) in keys {
        let desk = Arc::clone(desk);
        subscriptions.push(bus.subscribe(&key, move |payload| {
            let entered = Instant::now();
            lock(&desk).handle(stream, payload, entered);
        })?);
    }
    let desk = Arc::clone(desk);
    subscriptions.push(bus.watch(&room.all_alive(), move |key, presence| {
        if presence == Presence::Gone
            && let Some((_, source)) = parse_alive(key)
        {
            lock(&desk).controller.source_gone(source);
        }
    })?);
    Ok(subscriptions)
}

/// The desk holds no state that a panic could leave half-made and that the next report would not replace.
fn lock(desk: &Mutex<Desk>) -> MutexGuard<'_, Desk> {
    desk.lock().unwrap_or_else(PoisonError::into_inner)
}

struct StatusLoop<'a> {
    desk: &'a Mutex<Desk>,
    status: Publisher,
    reporter: Reporter,
    /// Exchanged with the desk's ledger, so that the desk is held only for an instant.
    spare: Ledger,
}

impl StatusLoop<'_> {
    /// Takes the new times over into `times`, publishes a status report, and gives the account so far.
    fn turn(&mut self, times: &mut Ledger) -> Summary {
        let snapshot = {
            let mut desk = lock(self.desk);
            std::mem::swap(&mut desk.ledger, &mut self.spare);
            self.reporter.look(&desk)
        };
        times.absorb(&mut self.spare);
        if let Some(problem) = &snapshot.problem {
            tracing::warn!("{problem}");
        }
        let report = self.reporter.report(&snapshot, times);
        let mut payload = Vec::new();
        match encode(&report, &mut payload) {
            // A session that is gone is told by the commands that could not be sent.
            Ok(()) => drop(self.status.put(&payload)),
            Err(error) => tracing::warn!("the status report cannot be written: {error}"),
        }
        let mut summary = snapshot.summary;
        summary.add_times(times);
        summary
    }
}
