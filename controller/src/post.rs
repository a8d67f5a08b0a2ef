//! One room as the process serves it: its desk, its thread, what it declared on the bus, and its account.
//!
//! Rooms share a session and nothing else: each has a desk, a queue and a thread of its own, so that one which floods, fails or is taken over
//! by another controller leaves the others alone.

use std::{
    sync::{Arc, Mutex, MutexGuard},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use anyhow::Context;
use heliostat_bus::{Bus, Class, Presence, Publisher, Subscription, Token};
use heliostat_proto::{Capabilities, EmergencyStop, NodeKind, Room, decode, encode, keys::parse_alive};
use heliostat_service::{clock::utc_ns, source_id};

use crate::{
    control::{self, Workshop},
    desk::{Desk, RoomClock},
    intake::{Deciding, Intake, attend, lock, try_lock},
    ledger::Ledger,
    node::{NodeConfig, Pace},
    standby::Standby,
    status::{Identity, Reporter},
    summary::Summary,
};
use heliostat_decide::{
    capabilities::{Examiner, Unfit},
    core::{Controller, WARM_UP_RUNS},
    refusal::Stream,
};
use heliostat_engine::ActorSource;

/// How long an array is asked what it can do.
const CAPABILITIES_WITHIN: Duration = Duration::from_millis(300);

/// A desk that is held longer than this is not answering: no decision takes so long.
const ANSWER_WITHIN: Duration = Duration::from_millis(100);

/// A policy so slow that its warm-up would take longer than this decides cold.
const WARM_UP_MOST: Duration = Duration::from_secs(2);

/// As many items as a warm-up that begins now has runs.
pub fn warm_up_runs() -> impl Iterator {
    let started = Instant::now();
    (0..WARM_UP_RUNS).take_while(move |_| started.elapsed() < WARM_UP_MOST)
}

/// A room that is being served.
pub struct Post {
    room: Room,
    desk: Arc<Mutex<Desk>>,
    intake: Arc<Intake>,
    thread: Option<JoinHandle<()>>,
    declared: Option<(Vec<Subscription>, Token)>,
    standby: Arc<Standby>,
    /// For commands of the standby's.
    in_stead: Publisher,
    /// Since when the desk has been held, and by which decision.
    held: Option<(Instant, u64)>,
    status: Publisher,
    reporter: Reporter,
    /// Exchanged with the desk's ledger, so that the desk is held only for an instant.
    spare: Ledger,
    times: Ledger,
    /// As of the last look.
    summary: Summary,
}

impl Post {
    /// Builds the policy, warms it up, and begins to serve the bus's room.
    ///
    /// # Errors
    /// Where the actor does not fit, or the session is closed.
    pub fn open(bus: &Bus, config: &NodeConfig) -> anyhow::Result<Self> {
        let scenario = &config.scenario;
        let started_ns = utc_ns();
        let (clock, epoch, class) = match config.pace {
            Pace::Live => (RoomClock::Utc, started_ns / 1_000_000, Class::Control),
            // Nobody is in a hurry, and nothing may be dropped.
            Pace::Lockstep => (RoomClock::Lockstep { newest_ns: 0 }, 1, Class::Order),
        };
        let actor = config.model.clone().map_or(ActorSource::Shipped, ActorSource::Path);
        let policy = heliostat_engine::build(config.policy, scenario, &actor)?;
        let model = scenario.channel_model()?;
        let examiner = Examiner::new(scenario, &model, config.force);
        let mut controller = Controller::new(scenario, model.clone(), policy, epoch);
        controller.warm_up(warm_up_runs());
        let room = bus.room().clone();
        tracing::info!(policy = controller.policy_name(), epoch, scenario = scenario.name, %room, "ready");

        let publisher = bus.publisher(&room.command(), class)?;
        let status = bus.publisher(&room.status(NodeKind::Controller), Class::Info)?;
        let standby = Arc::new(Standby::new(scenario.control.when_unanswered));
        let in_stead = bus.publisher(&room.command(), Class::Control)?;
        let desk = Desk::new(controller, clock, (publisher, Arc::clone(&standby)), deadline(config));
        let desk = Arc::new(Mutex::new(desk));
        let intake = Arc::new(Intake::default());
        let deciding = config.deciding.among(1 + config.also_rooms.len());
        let thread = deciding.has_thread().then(|| {
            let (desk, intake) = (Arc::clone(&desk), Arc::clone(&intake));
            let run = move || attend(&desk, &intake, deciding.keep_warm);
            std::thread::Builder::new().name(format!("decide-{room}")).spawn(run)
        });
        let thread = thread.transpose().context("cannot start a room's thread")?;
        let mut subscriptions = subscribe(bus, deciding, &desk, &intake)?;
        subscriptions.extend(learn_of_array(bus, (&desk, &standby), examiner)?);
        let workshop = Workshop { scenario: scenario.clone(), model, own: (config.policy, actor) };
        subscriptions.push(control::listen(bus, &desk, workshop)?);
        let source = source_id::random();
        let token = bus.announce(&room.alive(NodeKind::Controller, source))?;
        let identity = Identity { source, started_ns, scenario: scenario.hash() };
        Ok(Self {
            room,
            desk,
            intake,
            thread,
            declared: Some((subscriptions, token)),
            standby,
            in_stead,
            held: None,
            status,
            reporter: Reporter::new(identity),
            spare: Ledger::new(),
            times: Ledger::new(),
            summary: Summary::default(),
        })
    }

    /// The room.
    pub fn room(&self) -> &Room {
        &self.room
    }

    /// As of the last look.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// The times since the start, as of the last look.
    pub fn times(&self) -> &Ledger {
        &self.times
    }

    /// The epoch of the controller that has taken over the array, if one has.
    pub fn deposed_by(&self) -> Option<u64> {
        try_lock(&self.desk).and_then(|desk| desk.controller.deposed_by())
    }

    /// Why the array of this room cannot be commanded, if it cannot.
    pub fn unfit(&self) -> Option<Unfit> {
        try_lock(&self.desk).and_then(|desk| desk.controller.guard().unfit().cloned())
    }

    /// Lets time pass, since the absence of reports may have to be answered, or that of answers.
    pub fn elapse(&mut self) {
        if let Some(mut desk) = try_lock(&self.desk) {
            self.held = None;
            desk.elapse();
            return;
        }
        // A report is just being answered; or it is the same one still.
        let progress = self.standby.progress();
        match self.held.filter(|(_, decision)| *decision == progress) {
            None => self.held = Some((Instant::now(), progress)),
            Some((since, _)) if since.elapsed() < ANSWER_WITHIN => {}
            Some(_) => self.speak_in_stead(),
        }
    }

    /// Gives the command, where one is to be given, that stands in for an answer.
    fn speak_in_stead(&self) {
        let Some(command) = self.standby.speak(utc_ns()) else { return };
        let mut payload = Vec::new();
        let sent = encode(&command, &mut payload).is_ok() && self.in_stead.put(&payload).is_ok();
        if !sent {
            tracing::warn!(room = %self.room, "the command in the policy's stead could not be sent");
        }
    }

    /// Takes the new times over, publishes a status report, and updates the summary.
    pub fn look(&mut self) {
        let Some(mut desk) = lock_within(&self.desk, ANSWER_WITHIN) else {
            let meanwhile = self.standby.meanwhile();
            let problem = format!("policy {} gives no answer; {meanwhile}", self.summary.policy);
            tracing::warn!(room = %self.room, "{problem}");
            self.summary.unanswered += 1;
            self.summary.last_problem = problem;
            self.publish_status(&self.reporter.silent(&self.summary));
            return;
        };
        std::mem::swap(&mut desk.ledger, &mut self.spare);
        let mut snapshot = self.reporter.look(&desk);
        drop(desk);
        self.times.absorb(&mut self.spare);
        if let Some(problem) = &snapshot.problem {
            tracing::warn!(room = %self.room, "{problem}");
        }
        snapshot.summary.shed += self.intake.shed();
        snapshot.summary.unanswered = self.summary.unanswered;
        let report = self.reporter.report(&snapshot, &self.times);
        self.publish_status(&report);
        self.summary = snapshot.summary;
        self.summary.add_times(&self.times);
    }

    /// Stops serving: nothing is heard any more, and others see that the controller is gone.
    pub fn close(&mut self) {
        let Some((subscriptions, token)) = self.declared.take() else { return };
        drop(subscriptions);
        self.intake.close();
        self.look();
        if let Some(thread) = self.thread.take()
            && lock_within(&self.desk, ANSWER_WITHIN).is_some()
        {
            // It panicked, or it is done.
            let _ = thread.join();
        }
        drop(token);
    }

    fn publish_status(&self, report: &heliostat_proto::NodeStatus) {
        let mut payload = Vec::new();
        match encode(report, &mut payload) {
            // A session that is gone is told by the commands that could not be sent.
            Ok(()) => drop(self.status.put(&payload)),
            Err(error) => tracing::warn!("the status report cannot be written: {error}"),
        }
    }
}

/// How long a decision may take before it is late.
fn deadline(config: &NodeConfig) -> Duration {
    let seconds = match config.scenario.control.deadline_ms {
        0.0 => 1.0 / config.scenario.streams.positions.rate_hz,
        milliseconds => milliseconds * 1e-3,
    };
    Duration::from_secs_f64(seconds)
}

/// The desk, if it is let go within `limit`.
fn lock_within(desk: &Mutex<Desk>, limit: Duration) -> Option<MutexGuard<'_, Desk>> {
    let deadline = Instant::now() + limit;
    loop {
        match try_lock(desk) {
            None if Instant::now() < deadline => std::thread::sleep(Duration::from_micros(100)),
            desk => return desk,
        }
    }
}

/// Hears the room.
fn subscribe(
    bus: &Bus,
    deciding: Deciding,
    desk: &Arc<Mutex<Desk>>,
    intake: &Arc<Intake>,
) -> anyhow::Result<Vec<Subscription>> {
    let room = bus.room();
    // What a report is answered with comes before the reports, so that the first one finds it.
    let keys = [
        (Stream::Telemetry, room.telemetry()),
        (Stream::Obstacles, room.obstacles()),
        (Stream::Channel, room.channel()),
        (Stream::Users, room.users()),
    ];
    let mut subscriptions = Vec::with_capacity(keys.len() + 1);
    for (stream, key) in keys {
        let (desk, intake) = (Arc::clone(desk), Arc::clone(intake));
        let callback = move |payload: &[u8]| intake.handle(deciding, &desk, stream, payload, Instant::now());
        subscriptions.push(bus.subscribe(&key, callback)?);
    }
    let desk = Arc::clone(desk);
    subscriptions.push(bus.watch(&room.all_alive(), move |key, presence| {
        let Some((_, source)) = parse_alive(key) else { return };
        let controller = &mut lock(&desk).controller;
        match presence {
            Presence::Gone => controller.source_gone(source),
            Presence::Alive => controller.source_there(source),
        }
    })?);
    Ok(subscriptions)
}

/// Hears what the array can do, who drives it, and who stops it. Nothing of this is on the way from a report to its command.
fn learn_of_array(
    bus: &Bus,
    (desk, standby): (&Arc<Mutex<Desk>>, &Arc<Standby>),
    examiner: Examiner,
) -> anyhow::Result<[Subscription; 3]> {
    let room = bus.room();
    let examiner = Arc::new(examiner);
    let (judge, judged) = (Arc::clone(&examiner), Arc::clone(desk));
    let mut known = Capabilities::default();
    let mut learn = move |payload: &[u8]| {
        let Ok(new) = decode::<Capabilities>(payload) else { return };
        if known == (Capabilities { stamp: known.stamp, ..new.clone() }) {
            return;
        }
        let verdict = judge.examine(&new);
        lock(&judged).controller.meet_array(&new, verdict);
        known = new;
    };
    // Asked for, so that an array which is there already is known before the first command.
    bus.fetch(&room.capabilities(), CAPABILITIES_WITHIN)?.iter().for_each(|payload| learn(payload));
    let announced = bus.subscribe(&room.capabilities(), learn)?;
    let (heeded, at_once) = (Arc::clone(desk), Arc::clone(standby));
    let stops = bus.subscribe(&room.stop(), move |payload| {
        if let Ok(order) = decode::<EmergencyStop>(payload) {
            at_once.heed(&order);
            lock(&heeded).controller.guard_mut().heed(&order);
        }
    })?;
    let met = Arc::clone(desk);
    let drivers = bus.watch(&room.all_alive(), move |key, presence| {
        let Some((node, _)) = parse_alive(key).filter(|_| presence == Presence::Alive) else { return };
        if let Err(unfit) = examiner.meet(node) {
            lock(&met).controller.guard_mut().forbid(unfit);
        }
    })?;
    Ok([announced, stops, drivers])
}
