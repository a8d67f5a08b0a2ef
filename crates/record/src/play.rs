//! Publishes a recording on a bus, in place of the room, for a controller in a process of its own.
//!
//! A lockstep recording is played in lockstep: each report waits for its command, and the commands
//! are compared. A live recording is played at the recorded speed or a multiple of it, with its
//! stamps shifted to the present, so that no report is too old, and with source ids and ticks of its own: the
//! recorded processes may run still, their tokens of liveliness must not end with the playback, and the
//! answers to their reports are none to the played ones. In both, the played arrays obey the controllers of
//! the playback (`played_array.rs`).

mod moved;
mod played_array;

use std::collections::{BTreeMap, HashMap, HashSet, btree_map};
use std::fmt;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use heliostat_array::moment::Moment;
use heliostat_bus::{AccessRole, Bus, BusArgs, Class, Publisher, Token};
use heliostat_proto::keys::parse_alive;
use heliostat_proto::{MirrorCommand, MirrorTelemetry, Nanos, NodeKind, Room, decode};
use heliostat_service::clock::{monotonic_ns, utc_ns};
use heliostat_service::{Stop, output, source_id};
use serde::Serialize;

use moved::{OutputChannel, Start, encoded};
use played_array::PlayedArray;

use crate::file::{self, Entry};
use crate::received::Received;
use crate::replay::{self, Beginning, Clock, difference};

/// Longest time to wait for a controller.
const CONTROLLER_WAIT: Duration = Duration::from_secs(30);
/// Longest time to wait for the answer to a lockstep report, and for the last answers in live
/// operation.
const ANSWER_WAIT: Duration = Duration::from_secs(5);
/// Longest time in lockstep from the command to one array to those to the others.
const OTHERS_WAIT: Duration = Duration::from_millis(200);
/// Time between two checks whether every report is answered.
const WAIT: Duration = Duration::from_millis(20);
/// Longest time for one query of the processes in the room.
const ALIVE_LIMIT: Duration = Duration::from_millis(500);

/// What to play, and how to play it.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The recording.
    pub file: PathBuf,
    /// The room to publish in, instead of the recorded one.
    pub room: Option<Room>,
    /// The endpoints.
    pub bus: BusArgs,
    /// Speed relative to the recorded one.
    pub rate: f64,
}

/// The result of a playback.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Playback {
    /// The recording.
    pub file: PathBuf,
    /// The clock of the recording.
    pub clock: Clock,
    /// Position reports published.
    pub reports: u64,
    /// Reports among them that were answered.
    pub answered: u64,
    /// Whether the recording was cut, so that later messages are missing.
    pub was_cut: bool,
    /// Lockstep: answers that equal the recorded ones bit for bit.
    pub same: u64,
    /// Lockstep: answers that differ.
    pub different: u64,
    /// Lockstep: the first difference.
    pub first_difference: Option<String>,
}

/// Plays a recording into a room, until its end or until stopped.
///
/// # Errors
/// [`UnusableInput`](heliostat_service::exit::UnusableInput) if the recording cannot be read; a bus
/// that cannot be opened, a controller that does not join, a lockstep report that is not answered.
pub fn run(settings: &Settings, stop: &Stop) -> Result<Playback> {
    let unusable = || replay::unusable(&settings.file);
    let Beginning { room: recorded_room, clock, capabilities, mirrors } =
        Beginning::read(&settings.file).with_context(unusable)?;
    let arrays = mirrors.len();
    ensure!(
        clock == Clock::Live || settings.rate == 1.0,
        "--rate {}: this is a lockstep recording, where each report waits for its answer; expected no --rate",
        settings.rate
    );
    let mut reading = file::open(&settings.file).with_context(unusable)?;
    let room = settings.room.clone().unwrap_or_else(|| recorded_room.clone());
    let flags = BusArgs { room: Some(room.name().to_owned()), ..settings.bus.clone() };
    let bus = Bus::open(&flags.config_or_listen(&[AccessRole::Simulator])?).context("cannot join the room")?;
    let serve = |(array, payload): (usize, Vec<u8>)| {
        bus.serve(&room.array(array).capabilities(), move |answer| answer.clone_from(&payload))
    };
    let _arrays = capabilities.into_iter().map(serve).collect::<Result<Vec<_>, _>>()?;
    let (sender, answers) = channel();
    let subscribe = |array: usize| {
        let sender = sender.clone();
        bus.subscribe(&room.array(array).command(), move |payload| {
            if let Ok(command) = decode::<MirrorCommand>(payload) {
                // The player may have ended.
                let _ = sender.send((array, command));
            }
        })
    };
    let _subscriptions = (0..arrays).map(subscribe).collect::<Result<Vec<_>, _>>()?;
    let mut player = Player {
        channels: channels(&bus, &recorded_room, arrays, clock)?,
        present: BTreeMap::new(),
        recorded_room: recorded_room.clone(),
        arrays: mirrors.into_iter().map(PlayedArray::new).collect(),
        answers,
        rate: settings.rate,
        salt: if clock == Clock::Live { source_id::random() } else { 0 },
        start: None,
        unanswered: HashSet::new(),
        played_ns: 0,
        decided: HashMap::new(),
        recorded: HashMap::new(),
        playback: Playback { file: settings.file.clone(), clock, ..Playback::default() },
    };
    let begun = Instant::now();
    let mut reported = false;
    while bus.alive(&room.alive_of(NodeKind::Controller), ALIVE_LIMIT)?.is_empty() {
        if stop.is_requested() {
            bus.close()?;
            return Ok(player.playback);
        }
        if !reported {
            output::note(format_args!("replay: waiting for a controller in room {room}"));
            reported = true;
        }
        ensure!(
            begun.elapsed() < CONTROLLER_WAIT,
            "no controller joined room \"{room}\" within {} s; start one with the same --room and a matching endpoint",
            CONTROLLER_WAIT.as_secs()
        );
    }
    check_free(&bus)?;
    let mut ends = false;
    while let Some(entry) = reading.entry().with_context(unusable)? {
        ends = stop.is_requested();
        if ends {
            break;
        }
        player.take(&bus, &entry)?;
    }
    if !ends {
        player.playback.was_cut = reading.account().is_none();
        player.await_last_answers();
    }
    bus.close()?;
    Ok(player.playback)
}

/// Refuses a room with reports or arrays of its own, with which the played ones would mix.
fn check_free(bus: &Bus) -> Result<()> {
    let room = bus.room();
    let alive = bus.alive(&room.all_alive(), ALIVE_LIMIT)?;
    let mut kinds = alive.iter().filter_map(|key| Some(parse_alive(key)?.0));
    let source = kinds.find(|kind| matches!(kind, NodeKind::SimNode | NodeKind::Driver | NodeKind::Tracker));
    match source {
        None => Ok(()),
        Some(kind) => bail!(
            "room \"{room}\" has a {} already, and its messages would mix with the played ones; end it, or play into \
             a room of its own with --room. Nothing was played",
            kind.name()
        ),
    }
}

/// The publisher for each recorded key; the room may have another name than the recorded one.
fn channels(
    bus: &Bus,
    recorded: &Room,
    arrays: usize,
    clock: Clock,
) -> Result<HashMap<String, (Publisher, OutputChannel)>> {
    let class = if clock == Clock::Live { Class::RealTimeDrop } else { Class::RealTimeBlock };
    let room = bus.room();
    let keys = [
        (recorded.users(), room.users(), OutputChannel::Users),
        (recorded.channel(), room.channel(), OutputChannel::Channel),
        (recorded.obstacles(), room.obstacles(), OutputChannel::Obstacles),
        (recorded.orientation(), room.orientation(), OutputChannel::Orientation),
        (recorded.branches(), room.branches(), OutputChannel::Branches),
        (recorded.leds(), room.leds(), OutputChannel::Leds),
    ];
    let of_arrays = (0..arrays).flat_map(|array| {
        let (from, to) = (recorded.array(array), room.array(array));
        [
            (from.telemetry(), to.telemetry(), OutputChannel::Telemetry),
            (from.capabilities(), to.capabilities(), OutputChannel::Capabilities),
        ]
    });
    let publisher =
        |(from, to, channel): (String, String, OutputChannel)| Ok((from, (bus.publisher(&to, class)?, channel)));
    keys.into_iter().chain(of_arrays).map(publisher).collect()
}

struct Player {
    /// By the recorded key.
    channels: HashMap<String, (Publisher, OutputChannel)>,
    /// Liveliness tokens of the played sources: a controller releases the room when they are gone.
    present: BTreeMap<u64, Token>,
    recorded_room: Room,
    arrays: Vec<PlayedArray>,
    /// Commands, each with the index of its array.
    answers: Receiver<(usize, MirrorCommand)>,
    rate: f64,
    /// What changes a recorded source id into that of a live playback; 0 in lockstep.
    salt: u64,
    start: Option<Start>,
    /// Ticks of the played position reports that no command has answered.
    unanswered: HashSet<u64>,
    /// The latest time of played positions and telemetry.
    played_ns: Nanos,
    /// Lockstep answers that wait for the recorded ones, by array and tick.
    decided: HashMap<(usize, u64), MirrorCommand>,
    /// Recorded commands that came before their report, by array and tick.
    recorded: HashMap<(usize, u64), MirrorCommand>,
    playback: Playback,
}

impl Player {
    fn take(&mut self, bus: &Bus, entry: &Entry) -> Result<()> {
        let (array, topic) = self.recorded_room.first_array_key(&entry.topic);
        if topic == self.recorded_room.command() {
            if let Ok(theirs) = decode::<MirrorCommand>(&entry.data) {
                match self.decided.remove(&(array, theirs.answers)) {
                    Some(ours) => self.compare(ours, &theirs),
                    None => drop(self.recorded.insert((array, theirs.answers), theirs)),
                }
            }
            return Ok(());
        }
        if !self.channels.contains_key(&entry.topic) {
            return Ok(());
        }
        let received = Received::read(&self.recorded_room, &entry.topic, &entry.data).ok();
        if let Some(received) = &received {
            let source = received.origin().source ^ self.salt;
            if let btree_map::Entry::Vacant(place) = self.present.entry(source) {
                place.insert(bus.announce(&bus.room().alive(NodeKind::Tracker, source))?);
            }
            if let Received::Users(_) | Received::Telemetry(_) = received {
                self.played_ns = self.played_ns.max(received.origin().time_ns);
            }
        }
        let start = (self.playback.clock == Clock::Live).then(|| self.wait_for(entry));
        let now = self.now();
        let (publisher, channel) = &self.channels[&entry.topic];
        let mut payload = start.and_then(|start| channel.moved(&entry.data, &start));
        if let OutputChannel::Telemetry = channel {
            let recorded = payload.as_deref().unwrap_or(&entry.data);
            payload = decode::<MirrorTelemetry>(recorded).ok().and_then(|mut telemetry| {
                self.arrays[array].update(now, &mut telemetry);
                encoded(&telemetry)
            });
        }
        // An unreadable payload is played as recorded.
        publisher.put(payload.as_deref().unwrap_or(&entry.data))?;
        if let Some(Received::Users(report)) = received {
            self.playback.reports += 1;
            self.unanswered.insert(start.map_or(report.tick, |start| start.played_tick(report.tick)));
            if start.is_none() {
                self.await_answer(report.tick)?;
            }
        }
        Ok(())
    }

    /// The time of the arrays: simulated in lockstep, where a pause of this process must change nothing.
    fn now(&self) -> Moment {
        match self.playback.clock {
            Clock::Lockstep => Moment::simulated(self.played_ns),
            Clock::Live => Moment { local_ns: monotonic_ns(), room_ns: utc_ns() },
        }
    }

    fn compare(&mut self, ours: MirrorCommand, theirs: &MirrorCommand) {
        // The recording does not show which number the command had before the playback.
        let ours = MirrorCommand { sequence: theirs.sequence, ..ours };
        match difference(&ours, theirs, Clock::Lockstep) {
            None => self.playback.same += 1,
            Some(found) => {
                self.playback.different += 1;
                self.playback.first_difference.get_or_insert(format!("tick {}: {found}", theirs.answers));
            }
        }
    }

    /// Waits until an entry is due.
    fn wait_for(&mut self, entry: &Entry) -> Start {
        let (rate, salt) = (self.rate, self.salt);
        let start = *self.start.get_or_insert_with(|| Start {
            at: Instant::now(),
            at_ns: utc_ns(),
            recorded_ns: entry.arrived_ns,
            rate,
            salt,
        });
        self.collect(start.due(entry.arrived_ns).saturating_duration_since(Instant::now()));
        start
    }

    /// Counts answers until the time limit.
    fn collect(&mut self, limit: Duration) {
        let deadline = Instant::now() + limit;
        loop {
            match self.answers.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok((array, command)) => {
                    let now = self.now();
                    self.arrays[array].handle_command(now, &command);
                    // A report counts once, whatever the number of arrays.
                    self.playback.answered += u64::from(self.unanswered.remove(&command.answers));
                }
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    /// Waits until every report is answered, or the time limit is reached.
    fn await_last_answers(&mut self) {
        let deadline = Instant::now() + ANSWER_WAIT;
        while self.playback.answered < self.playback.reports && Instant::now() < deadline {
            self.collect(WAIT);
        }
    }

    fn await_answer(&mut self, tick: u64) -> Result<()> {
        let mut deadline = Instant::now() + ANSWER_WAIT;
        let mut answers = 0;
        while answers < self.arrays.len() {
            let left = deadline.saturating_duration_since(Instant::now());
            let Ok((array, command)) = self.answers.recv_timeout(left) else { break };
            let now = self.now();
            self.arrays[array].handle_command(now, &command);
            if command.answers != tick {
                continue;
            }
            // The commands of one decision follow each other; an array that is stopped gets none.
            deadline = Instant::now() + OTHERS_WAIT;
            answers += 1;
            match self.recorded.remove(&(array, tick)) {
                Some(theirs) => self.compare(command, &theirs),
                None => drop(self.decided.insert((array, tick), command)),
            }
        }
        ensure!(
            answers > 0,
            "tick {tick} was not answered within {} s; start the controller with --lockstep and the scenario of the recording",
            ANSWER_WAIT.as_secs()
        );
        self.playback.answered += 1;
        Ok(())
    }
}

impl fmt::Display for Playback {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.clock == Clock::Lockstep {
            writeln!(formatter, "answers as recorded {}, different {}", self.same, self.different)?;
        }
        if let Some(found) = &self.first_difference {
            writeln!(formatter, "first difference: {found}")?;
        }
        write!(formatter, "reports played {}, answered {}", self.reports, self.answered)?;
        if self.was_cut {
            write!(formatter, "\nthe recording was cut: later messages are missing")?;
        }
        Ok(())
    }
}
