//! From a recording onto a bus, in place of the room, for a controller that runs by itself.
//!
//! A recording of lockstep is played in lockstep, each report waiting for its answer, and the answers are compared. One of live operation is
//! played at the pace at which it came, its stamps moved to the present, so that nothing in it is too old.

use std::collections::HashMap;
use std::fmt;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, ensure};
use heliostat_bus::{Bus, BusConfig, Class, Publisher};
use heliostat_proto::{
    ChannelReport, Message, MirrorCommand, MirrorTelemetry, Nanos, NodeKind, ObstacleReport, UserReport, decode, encode,
};
use serde::Serialize;

use crate::file::Entry;
use crate::heard::Heard;
use crate::replay::{self, Clock, difference};

/// How long a controller is waited for.
const CONTROLLER_WAIT: Duration = Duration::from_secs(30);
/// How long the answer to a report of lockstep is waited for, and the last answers of live operation.
const ANSWER_WAIT: Duration = Duration::from_secs(5);
/// Between two looks whether all is answered.
const WAIT: Duration = Duration::from_millis(20);
/// Time for one round of questions who is there.
const ALIVE_LIMIT: Duration = Duration::from_millis(500);

/// What a playback came to.
#[derive(Clone, Debug, Serialize)]
pub struct Playback {
    /// The recording.
    pub file: PathBuf,
    /// In which time it was played.
    pub clock: Clock,
    /// Position reports published.
    pub reports: u64,
    /// Of those: answered.
    pub answered: u64,
    /// Lockstep: answers that are the recorded ones, bit for bit.
    pub same: u64,
    /// Lockstep: answers that differ.
    pub different: u64,
    /// Lockstep: the first difference.
    pub first_difference: Option<String>,
}

/// Plays a recording to whoever is in the room, until its end or until stopped.
///
/// # Errors
/// Where the recording cannot be read, the bus cannot be opened, no controller comes, or a report of lockstep is not answered.
pub fn run(file: &PathBuf, bus: &BusConfig, stopped: &Receiver<()>) -> Result<Playback> {
    let clock = replay::clock(file)?;
    let mut reading = replay::open(file)?;
    let bus = Bus::open(bus).context("cannot join the room")?;
    let room = bus.room().clone();
    let (sender, answers) = channel();
    let _subscription = bus.subscribe(&room.command(), move |payload| {
        if let Ok(command) = decode::<MirrorCommand>(payload) {
            // The player may have ended.
            let _ = sender.send(command);
        }
    })?;
    let mut player = Player {
        outlets: [
            (room.users(), Outlet::Users),
            (room.channel(), Outlet::Channel),
            (room.obstacles(), Outlet::Obstacles),
            (room.telemetry(), Outlet::Telemetry),
        ]
        .into_iter()
        .map(|(key, outlet)| Ok((key.clone(), (bus.publisher(&key, Class::Control)?, outlet))))
        .collect::<Result<_>>()?,
        recorded_commands: room.command(),
        answers,
        start: None,
        decided: HashMap::new(),
        playback: Playback {
            file: file.clone(),
            clock,
            reports: 0,
            answered: 0,
            same: 0,
            different: 0,
            first_difference: None,
        },
    };
    let begun = Instant::now();
    while bus.alive(&room.alive_of(NodeKind::Controller), ALIVE_LIMIT)?.is_empty() {
        ensure!(
            begun.elapsed() < CONTROLLER_WAIT,
            "no controller came into room \"{room}\" within {} s: start one with the same --room and a matching endpoint",
            CONTROLLER_WAIT.as_secs()
        );
    }
    while let Some(mut entry) = reading.entry()? {
        if stopped.try_recv().is_ok() {
            break;
        }
        // The room may be played under another name.
        if let Some((_, rest)) = entry.topic.strip_prefix("heliostat/v1/").and_then(|rest| rest.split_once('/')) {
            entry.topic = format!("heliostat/v1/{room}/{rest}");
            player.take(&entry)?;
        }
    }
    player.await_last_answers();
    bus.close()?;
    Ok(player.playback)
}

#[derive(Clone, Copy, Debug)]
enum Outlet {
    Users,
    Channel,
    Obstacles,
    Telemetry,
}

/// The beginning of a live playback.
#[derive(Clone, Copy, Debug)]
struct Start {
    at: Instant,
    recorded_ns: Nanos,
    shift_ns: Nanos,
}

struct Player {
    outlets: HashMap<String, (Publisher, Outlet)>,
    recorded_commands: String,
    answers: Receiver<MirrorCommand>,
    start: Option<Start>,
    /// Answers of lockstep that wait for the recorded ones, by tick.
    decided: HashMap<u64, MirrorCommand>,
    playback: Playback,
}

impl Player {
    fn take(&mut self, entry: &Entry) -> Result<()> {
        let lockstep = self.playback.clock == Clock::Lockstep;
        if entry.topic == self.recorded_commands {
            if let Ok(Heard::Command(theirs)) = Heard::read(&entry.data)
                && let Some(ours) = self.decided.remove(&theirs.answers)
            {
                match difference(&ours, &theirs, Clock::Live) {
                    None => self.playback.same += 1,
                    Some(found) => {
                        self.playback.different += 1;
                        self.playback.first_difference.get_or_insert(format!("tick {}: {found}", theirs.answers));
                    }
                }
            }
            return Ok(());
        }
        let Some((publisher, outlet)) = self.outlets.get(&entry.topic) else { return Ok(()) };
        let shift_ns = if lockstep { 0 } else { self.wait_for(entry) };
        let payload = match outlet {
            Outlet::Users => shifted(&entry.data, |report: &mut UserReport| report.stamp.time_ns += shift_ns),
            Outlet::Channel => shifted(&entry.data, |report: &mut ChannelReport| report.stamp.time_ns += shift_ns),
            Outlet::Obstacles => shifted(&entry.data, |report: &mut ObstacleReport| report.stamp.time_ns += shift_ns),
            Outlet::Telemetry => shifted(&entry.data, |report: &mut MirrorTelemetry| report.stamp.time_ns += shift_ns),
        };
        // What nobody could read then, nobody can read now: it is played as it came.
        publisher.put(payload.as_deref().unwrap_or(&entry.data))?;
        if let (Outlet::Users, Ok(report)) = (outlet, decode::<UserReport>(&entry.data)) {
            self.playback.reports += 1;
            if lockstep {
                self.await_answer(report.tick)?;
            }
        }
        Ok(())
    }

    /// Waits until it is time for an entry; gives what is to be added to its stamp.
    fn wait_for(&mut self, entry: &Entry) -> Nanos {
        let start = *self.start.get_or_insert_with(|| {
            let now_ns = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos() as Nanos;
            let shift_ns = now_ns.saturating_sub(entry.arrived_ns);
            Start { at: Instant::now(), recorded_ns: entry.arrived_ns, shift_ns }
        });
        let due = start.at + Duration::from_nanos(entry.arrived_ns.saturating_sub(start.recorded_ns));
        self.collect(due.saturating_duration_since(Instant::now()));
        start.shift_ns
    }

    /// Counts answers for so long.
    fn collect(&mut self, limit: Duration) {
        let deadline = Instant::now() + limit;
        loop {
            match self.answers.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(_) => self.playback.answered += 1,
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    /// Waits until every report is answered, or no longer.
    fn await_last_answers(&mut self) {
        let deadline = Instant::now() + ANSWER_WAIT;
        while self.playback.answered < self.playback.reports && Instant::now() < deadline {
            self.collect(WAIT);
        }
    }

    fn await_answer(&mut self, tick: u64) -> Result<()> {
        let deadline = Instant::now() + ANSWER_WAIT;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let command = self.answers.recv_timeout(left).ok().with_context(|| {
                format!(
                    "tick {tick} was not answered within {} s: the controller needs --lockstep to take its time from the recording, and the scenario of the recording",
                    ANSWER_WAIT.as_secs()
                )
            })?;
            if command.answers == tick {
                self.playback.answered += 1;
                self.decided.insert(tick, command);
                return Ok(());
            }
        }
    }
}

/// The payload of the changed message; nothing where it cannot be read.
fn shifted<T: Message>(payload: &[u8], change: impl FnOnce(&mut T)) -> Option<Vec<u8>> {
    let mut message: T = decode(payload).ok()?;
    change(&mut message);
    let mut out = Vec::new();
    encode(&message, &mut out).ok()?;
    Some(out)
}

impl fmt::Display for Playback {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "reports played {}, answered {}", self.reports, self.answered)?;
        if self.clock == Clock::Lockstep {
            write!(formatter, "; answers as recorded {}, different {}", self.same, self.different)?;
        }
        match &self.first_difference {
            Some(found) => write!(formatter, "\nfirst difference: {found}"),
            None => Ok(()),
        }
    }
}
