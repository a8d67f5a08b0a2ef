//! From the bus into a file.
//!
//! Callbacks only copy a payload into a queue; one thread writes. When the queue is full, because the disk was slower than the room for too
//! long, payloads are shed and counted: the room never waits for its recorder.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use heliostat_bus::{Bus, BusConfig, Presence as Liveliness};
use heliostat_proto::{Nanos, NodeKind, Room, VERSION, keys::parse_alive};
use heliostat_scenario::Scenario;
use heliostat_service::clock::utc_ns;
use heliostat_service::{Stop, source_id};
use serde::Serialize;

use crate::account::Account;
use crate::file::{Header, PRESENCE_TOPIC, Presence, Recording, RecordingError, Storage, Topic};
use crate::heard::Heard;
use crate::scene::Scene;
use crate::series::Series;

/// Messages that may wait for the disk.
const QUEUE: usize = 16_384;
/// A chunk is closed at least this often: so much a power cut may cost.
const FLUSH_EVERY: Duration = Duration::from_secs(1);
/// A stop is noticed after this long at the latest.
const WAIT: Duration = Duration::from_millis(50);

const PRESENCE: Topic<'static> = Topic {
    name: PRESENCE_TOPIC,
    encoding: "json",
    schema: "heliostat.Presence",
    schema_encoding: "jsonschema",
    schema_data: br#"{"type":"object","properties":{"node":{"type":"string"},"source":{"type":"number"},"alive":{"type":"boolean"}}}"#,
};

/// Everything that a recorder needs.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The room's scenario; it goes into the file.
    pub scenario: Scenario,
    /// Where to hear the room.
    pub bus: BusConfig,
    /// The file to make.
    pub out: PathBuf,
    /// When to end without being asked.
    pub run_for: Option<Duration>,
    /// Whether to end when everybody who was heard of has left the room.
    pub until_empty: bool,
}

/// What a recording came to.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// The file.
    pub file: PathBuf,
    /// What came and what is missing.
    #[serde(flatten)]
    pub account: Account,
    /// What makes the recording worth less than it could be.
    pub problems: Vec<String>,
    /// Why it could not be written to its end, so that the file holds no account and no index; or that there was nothing to write.
    pub failure: Option<String>,
}

/// What the callbacks hand over.
enum Item {
    Payload { key: String, arrived_ns: Nanos, payload: Vec<u8> },
    Presence { arrived_ns: Nanos, presence: Presence },
}

/// Records a room until it is stopped.
///
/// # Errors
/// Where the bus or the file cannot be opened. A file that can be written no further is no error here: the [`Outcome`] tells.
pub fn run(settings: &Settings, stop: &Stop) -> Result<Outcome> {
    let out = &settings.out;
    let file = OpenOptions::new().write(true).create_new(true).open(out).with_context(|| {
        format!("cannot make {}: wanted a file that does not exist yet, in a folder that does", out.display())
    })?;
    let started = Instant::now();
    let mut writer = RoomWriter::create(file, settings)?;
    let (sender, queue) = sync_channel(QUEUE);
    let shed = Arc::new(AtomicU64::new(0));
    let bus = Bus::open(&settings.bus).context("cannot join the room")?;
    let room = bus.room().clone();
    let source = source_id::random();
    let own_token = room.alive(NodeKind::Viewer, source);
    let (payloads, payloads_shed) = (sender.clone(), Arc::clone(&shed));
    let heard = bus.subscribe_keyed(&room.everything(), move |key, payload| {
        let item = Item::Payload { key: key.to_owned(), arrived_ns: utc_ns(), payload: payload.to_vec() };
        hand_over(&payloads, item, &payloads_shed);
    })?;
    let (tokens, tokens_shed) = (sender, Arc::clone(&shed));
    let seen = bus.watch(&room.all_alive(), move |key, liveliness| {
        let Some((node, source)) = parse_alive(key).filter(|_| key != own_token) else { return };
        let presence = Presence { node, source, alive: liveliness == Liveliness::Alive };
        hand_over(&tokens, Item::Presence { arrived_ns: utc_ns(), presence }, &tokens_shed);
    })?;
    let token = bus.announce(&room.alive(NodeKind::Viewer, source))?;
    drop(writeln!(std::io::stderr(), "record: room {room} into {}", out.display()));

    let deadline = settings.run_for.map(|run_for| started + run_for);
    while !writer.has_failed() && !stop.is_requested() && deadline.is_none_or(|deadline| Instant::now() < deadline) {
        if settings.until_empty && writer.is_empty_again() {
            break;
        }
        match queue.recv_timeout(WAIT) {
            Ok(item) => writer.take(item),
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
        }
        writer.flush_if_due();
    }
    drop((heard, seen, token));
    while let Ok(item) = queue.try_recv() {
        writer.take(item);
    }
    bus.close()?;
    Ok(writer.finish(shed.load(Ordering::Relaxed)))
}

fn hand_over(queue: &SyncSender<Item>, item: Item, shed: &AtomicU64) {
    match queue.try_send(item) {
        Ok(()) => {}
        Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => drop(shed.fetch_add(1, Ordering::Relaxed)),
    }
}

/// Writes what a room says, and what is derived from it.
struct RoomWriter<S: Storage> {
    /// Nothing once writing failed.
    recording: Option<Recording<S>>,
    scene: Scene,
    series: Series,
    account: Account,
    present: Vec<u64>,
    was_present: bool,
    flushed: Instant,
    room: Room,
    scenario_hash: String,
    out: PathBuf,
    problems: Vec<String>,
    failure: Option<String>,
}

impl<S: Storage> RoomWriter<S> {
    fn create(storage: S, settings: &Settings) -> Result<Self> {
        let scenario = &settings.scenario;
        let header = Header {
            room: settings.bus.room.to_string(),
            scenario_name: scenario.name.clone(),
            scenario_hash: scenario.hash(),
            scenario: scenario.to_toml(),
            software: concat!("heliostat ", env!("CARGO_PKG_VERSION")).into(),
            contract: VERSION.to_string(),
            started_ns: utc_ns().to_string(),
        };
        Ok(Self {
            recording: Some(Recording::create(storage, &header)?),
            scene: Scene::new(scenario)?,
            series: Series::default(),
            account: Account::default(),
            present: Vec::new(),
            was_present: false,
            flushed: Instant::now(),
            room: settings.bus.room.clone(),
            scenario_hash: header.scenario_hash,
            out: settings.out.clone(),
            problems: Vec::new(),
            failure: None,
        })
    }

    fn has_failed(&self) -> bool {
        self.recording.is_none()
    }

    /// Whether somebody was there, and nobody is any more.
    fn is_empty_again(&self) -> bool {
        self.was_present && self.present.is_empty()
    }

    fn take(&mut self, item: Item) {
        let Some(mut recording) = self.recording.take() else { return };
        let taken = match item {
            Item::Payload { key, arrived_ns, payload } => self.payload(&mut recording, &key, arrived_ns, &payload),
            Item::Presence { arrived_ns, presence } => {
                drop(writeln!(
                    std::io::stderr(),
                    "record: {} is {}",
                    presence.node,
                    if presence.alive { "here" } else { "gone" }
                ));
                self.present.retain(|source| *source != presence.source);
                if presence.alive && presence.node != NodeKind::Viewer {
                    self.present.push(presence.source);
                    self.was_present = true;
                }
                let json = serde_json::to_vec(&presence).expect("a presence has a JSON form");
                recording.derived(&PRESENCE, arrived_ns, &json)
            }
        };
        self.keep(recording, taken);
    }

    fn payload(
        &mut self,
        recording: &mut Recording<S>,
        key: &str,
        arrived_ns: Nanos,
        payload: &[u8],
    ) -> Result<(), RecordingError> {
        let heard = Heard::read(payload).ok();
        let origin = heard.as_ref().map(Heard::origin);
        recording.payload(key, arrived_ns, origin.map_or(arrived_ns, |origin| origin.time_ns), payload)?;
        self.account.count(key, payload.len(), origin);
        let Some(heard) = heard else { return Ok(()) };
        self.check_scenario(&heard);
        self.series.hear(&heard, arrived_ns, |topic, data| recording.derived(topic, arrived_ns, data))?;
        if self.scene.hear(&heard, arrived_ns) {
            let data = self.scene.draw(arrived_ns).to_vec();
            recording.derived(&self.scene.topic(), arrived_ns, &data)?;
        }
        Ok(())
    }

    /// A recording with another scenario than the room's could not be replayed.
    fn check_scenario(&mut self, heard: &Heard) {
        let Heard::Status(status) = heard else { return };
        if status.scenario.is_empty() || status.scenario == self.scenario_hash {
            return;
        }
        let problem = format!(
            "{} works on scenario {}, the recording says {}: give record the --scenario, --set and --seed that the room has",
            status.node, status.scenario, self.scenario_hash
        );
        if !self.problems.contains(&problem) {
            self.tell(problem);
        }
    }

    fn tell(&mut self, problem: String) {
        drop(writeln!(std::io::stderr(), "record: {problem}"));
        self.problems.push(problem);
    }

    /// Who was not heard, where a replay needs them.
    fn silence(&self) -> Option<&'static str> {
        let heard = |key: String| self.account.streams.contains_key(&key);
        if !heard(self.room.command()) {
            Some(
                "no command was heard: two peers hear each other over a direct link only; connect to the controller as well, or let it connect here",
            )
        } else if !heard(self.room.users()) {
            Some(
                "no position report was heard: two peers hear each other over a direct link only; connect to the room's process as well",
            )
        } else {
            None
        }
    }

    fn flush_if_due(&mut self) {
        if self.flushed.elapsed() < FLUSH_EVERY {
            return;
        }
        self.flushed = Instant::now();
        let Some(mut recording) = self.recording.take() else { return };
        let flushed = recording.flush();
        self.keep(recording, flushed);
    }

    /// Goes on with the recording unless it failed.
    fn keep(&mut self, recording: Recording<S>, outcome: Result<(), RecordingError>) {
        match outcome {
            Ok(()) => self.recording = Some(recording),
            Err(error) => self.failure = Some(error.to_string()),
        }
    }

    fn finish(mut self, shed: u64) -> Outcome {
        self.account.shed = shed;
        if self.account.messages() == 0 {
            let nothing =
                "nothing was heard: does the room's process run, with the same --room and a matching endpoint?";
            self.failure.get_or_insert(nothing.to_owned());
        } else if let Some(problem) = self.silence() {
            self.tell(problem.to_owned());
        }
        if let Some(recording) = self.recording.take() {
            let finished = recording.finish(&self.account);
            self.failure = finished.err().map(|error| error.to_string()).or(self.failure);
        }
        if self.account.messages() == 0 {
            // A file without content would only stand in the way of the next attempt.
            let _ = std::fs::remove_file(&self.out);
        }
        Outcome { file: self.out, account: self.account, problems: self.problems, failure: self.failure }
    }
}
