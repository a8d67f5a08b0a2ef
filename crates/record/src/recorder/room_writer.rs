//! Writes the messages of a room, in the order of the queue, into the present file.

use std::collections::HashMap;
use std::fs;
use std::io;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use heliostat_proto::{Nanos, NodeKind, Room, VERSION, cut};
use heliostat_service::{clock::utc_ns, log_limit::EventLimit, printable::printable};

use super::{Outcome, Settings};
use crate::account::Account;
use crate::file::{Header, PRESENCE_TOPIC, Presence, Recording, RecordingError, Storage, Topic};
use crate::place::Place;
use crate::received::Received;
use crate::ring::FaultWatch;
use crate::scene::Scene;
use crate::series::Series;

/// Longest time between two flushes: the most that a power failure can lose.
const FLUSH_EVERY: Duration = Duration::from_secs(1);
/// Most recorded keys that the contract does not have.
const OTHER_KEYS_MAX: usize = 256;
/// Longest of them in bytes.
const OTHER_KEY_MAX: usize = 256;
/// Most problems of which a sender can invent any number, such as differing scenarios.
const PROBLEMS_MAX: usize = 64;
/// Time after which the recorder reports a missing stream, while there is time to mend it.
const MISSING_AFTER: Duration = Duration::from_secs(5);
/// What is wrong where no message was received.
const NOTHING: &str =
    "nothing was received; check that the room's process runs, with the same --room and a matching endpoint";

/// A stream that a replay needs.
#[derive(Clone, Copy)]
struct Needed {
    /// Its key; of telemetry that of the first array.
    key: fn(&Room) -> String,
    /// One message of it.
    message: &'static str,
    /// Its messages.
    stream: &'static str,
    /// The process that publishes it in a real room.
    process: &'static str,
}

/// The streams that a replay needs to repeat the decisions.
const NEEDED: [Needed; 3] = [
    Needed { key: Room::command, message: "command", stream: "commands", process: "controller" },
    Needed { key: Room::users, message: "position report", stream: "position reports", process: "tracker" },
    Needed { key: Room::telemetry, message: "telemetry", stream: "telemetry", process: "driver" },
];

const PRESENCE: Topic<'static> = Topic {
    name: PRESENCE_TOPIC,
    encoding: "json",
    schema: "heliostat.Presence",
    schema_encoding: "jsonschema",
    schema_data: br#"{"type":"object","properties":{"node":{"type":"string"},"source":{"type":"number"},"alive":{"type":"boolean"}}}"#,
};

/// An entry of the queue between the callbacks and the writer.
pub(super) enum Item {
    Payload { key: String, arrived_ns: Nanos, payload: Vec<u8> },
    Presence { arrived_ns: Nanos, presence: Presence },
}

/// A file without messages. Unless it is kept it is removed, because it would block the next attempt.
pub(super) struct Begun {
    pub(super) path: PathBuf,
    pub(super) is_kept: bool,
}

impl Begun {
    /// Messages are to follow.
    pub(super) fn keep(mut self) {
        self.is_kept = true;
    }
}

impl Drop for Begun {
    fn drop(&mut self) {
        if !self.is_kept {
            drop(fs::remove_file(&self.path));
        }
    }
}

/// Writes the messages of a room, and the data derived from them.
pub(super) struct RoomWriter<S: Storage> {
    /// `None` after writing failed.
    recording: Option<Recording<S>>,
    scene: Scene,
    series: Series,
    /// Of all files.
    pub(super) account: Account,
    /// Of the present file.
    file_account: Account,
    header: Header,
    fault_watch: FaultWatch,
    /// Faults that began since they were taken last, in words.
    pub(super) faults: Vec<String>,
    /// Kind and source of the processes in the room, without viewers.
    present: Vec<(NodeKind, u64)>,
    was_present: bool,
    /// The lines about processes that join or leave: a process can have any number of tokens. Each kind of process has a
    /// bound of its own, so that viewers hide no controller.
    presence_lines: HashMap<NodeKind, EventLimit>,
    flushed: Instant,
    /// Whether [`RoomWriter::missing_once`] has looked.
    has_looked: bool,
    /// Recorded keys that the contract does not have.
    other_keys: usize,
    /// Whether the messages of any further key were left out.
    has_left_out: bool,
    room: Room,
    pub(super) place: Place,
    problems: Vec<String>,
    pub(super) failure: Option<String>,
}

impl<S: Storage> RoomWriter<S> {
    pub(super) fn create(storage: S, settings: &Settings, out: PathBuf) -> Result<Self> {
        let scenario = &settings.scenario;
        let header = Header {
            room: settings.bus.room.to_string(),
            scenario_name: scenario.name.clone(),
            scenario_hash: scenario.hash(),
            scenario: scenario.to_shared_toml(),
            software: concat!("heliostat ", env!("CARGO_PKG_VERSION")).into(),
            contract: VERSION.to_string(),
            started_ns: utc_ns().to_string(),
        };
        Ok(Self {
            recording: Some(Recording::create(storage, &header)?),
            scene: Scene::new(scenario)?,
            series: Series::default(),
            account: Account::default(),
            file_account: Account::default(),
            fault_watch: FaultWatch::default(),
            faults: Vec::new(),
            present: Vec::new(),
            was_present: false,
            presence_lines: HashMap::new(),
            flushed: Instant::now(),
            has_looked: false,
            other_keys: 0,
            has_left_out: false,
            room: settings.bus.room.clone(),
            place: Place::new(out),
            header,
            problems: Vec::new(),
            failure: None,
        })
    }

    pub(super) fn has_failed(&self) -> bool {
        self.recording.is_none()
    }

    /// Whether processes were in the room and all have left.
    pub(super) fn is_empty_again(&self) -> bool {
        self.was_present && self.present.is_empty()
    }

    pub(super) fn take(&mut self, item: Item) {
        let Some(mut recording) = self.recording.take() else { return };
        let taken = match item {
            Item::Payload { key, arrived_ns, payload } => self.payload(&mut recording, &key, arrived_ns, &payload),
            Item::Presence { arrived_ns, presence } => {
                if let Some(line) = self.presence_line(Instant::now(), presence) {
                    tracing::info!("{line}");
                }
                self.note_presence(presence);
                let json = serde_json::to_vec(&presence).expect("a presence serialises to JSON");
                recording.derived(&PRESENCE, arrived_ns, &json)
            }
        };
        self.keep(recording, taken);
    }

    /// Notes a process that is no viewer. A viewer can name the source of another process in its token.
    fn note_presence(&mut self, Presence { node, source, alive }: Presence) {
        if node == NodeKind::Viewer {
            return;
        }
        self.present.retain(|known| *known != (node, source));
        if alive {
            self.present.push((node, source));
            self.was_present = true;
        }
    }

    /// The line about a process that joins or leaves; one in ten seconds stands for those of a flood.
    fn presence_line(&mut self, now: Instant, presence: Presence) -> Option<String> {
        let further = format!("further processes ({}) join or leave", presence.node);
        self.presence_lines.entry(presence.node).or_default().line(now, presence, &further)
    }

    fn payload(
        &mut self,
        recording: &mut Recording<S>,
        key: &str,
        arrived_ns: Nanos,
        payload: &[u8],
    ) -> Result<(), RecordingError> {
        if !self.has_place(key) {
            return Ok(());
        }
        let received = Received::read(&self.room, key, payload).ok();
        let origin = received.as_ref().map(Received::origin);
        recording.payload(key, arrived_ns, origin.map_or(arrived_ns, |origin| origin.time_ns), payload)?;
        self.account.count(key, payload.len(), origin);
        self.file_account.count(key, payload.len(), origin);
        let Some(received) = received else { return Ok(()) };
        self.check_scenario(&received);
        if let Received::Geometry(geometry) = &received {
            self.draw_geometry(key, &geometry.scenario);
        }
        self.series.update(&received, arrived_ns, |topic, data| recording.derived(topic, arrived_ns, data))?;
        let (array, _) = self.room.first_array_key(key);
        if let Received::Telemetry(telemetry) = &received {
            self.faults.extend(self.fault_watch.update(array, telemetry));
        }
        if self.scene.update(&received, array, arrived_ns) {
            let data = self.scene.draw(arrived_ns).to_vec();
            recording.derived(&self.scene.topic(), arrived_ns, &data)?;
        }
        Ok(())
    }

    /// Whether the messages of a key are recorded: those of the contract, and those of the first other ones. A file
    /// has places for a limited number of them, and a sender can invent any number, of any length.
    fn has_place(&mut self, key: &str) -> bool {
        if self.room.kind_of(key).is_some() || self.account.streams.contains_key(key) {
            return true;
        }
        let has_place = self.other_keys < OTHER_KEYS_MAX && key.len() <= OTHER_KEY_MAX;
        if has_place {
            self.other_keys += 1;
        } else if !std::mem::replace(&mut self.has_left_out, true) {
            self.report(format!(
                "of the keys that the contract does not have, the first {OTHER_KEYS_MAX} of at most {OTHER_KEY_MAX} bytes are recorded: not recorded are others, for example {}",
                printable(cut(key))
            ));
        }
        has_place
    }

    /// Draws the geometry that a process of the room announces from now on.
    fn draw_geometry(&mut self, key: &str, geometry: &str) {
        let announces = |node: &NodeKind| key == self.room.geometry(*node);
        let Some(node) = [NodeKind::SimNode, NodeKind::Controller].into_iter().find(announces) else { return };
        if let Err(reason) = self.scene.announce(node, geometry) {
            self.report_new(format!("the geometry that {node} announces cannot be drawn: {reason}"));
        }
    }

    /// Reports a process whose scenario differs from the recorded one: a replay leaves out the commands
    /// of such a controller.
    fn check_scenario(&mut self, received: &Received) {
        let Received::Status(status) = received else { return };
        if status.scenario.is_empty() || status.scenario == self.header.scenario_hash {
            return;
        }
        let problem = format!(
            "{} {:016x} uses scenario {}, the recording holds {}; give record or that process the --scenario, --set and --seed of the room",
            status.node, status.stamp.source, status.scenario, self.header.scenario_hash
        );
        self.report_new(problem);
    }

    /// Reports a problem that a sender can repeat or invent: each once, and no more than a list has places for.
    fn report_new(&mut self, problem: String) {
        if self.problems.len() < PROBLEMS_MAX && !self.problems.contains(&problem) {
            self.report(problem);
        }
    }

    fn report(&mut self, problem: String) {
        tracing::warn!("{problem}");
        self.problems.push(problem);
    }

    /// What is missing after some seconds of recording, and what to do, once.
    pub(super) fn missing_once(&mut self, recorded: Duration) -> Option<String> {
        if self.has_looked || recorded < MISSING_AFTER {
            return None;
        }
        self.has_looked = true;
        if self.account.messages() == 0 { Some(NOTHING.to_owned()) } else { self.missing() }
    }

    /// The streams that a replay needs and that were not received.
    fn lacking(&self) -> Vec<Needed> {
        let lacks = |needed: &Needed| !self.account.streams.contains_key(&(needed.key)(&self.room));
        NEEDED.into_iter().filter(lacks).collect()
    }

    /// The streams that a replay needs and that were not received, and what to do.
    fn missing(&self) -> Option<String> {
        let lacking = self.lacking();
        let lacks_command = !self.account.streams.contains_key(&self.room.command());
        if lacks_command && self.fault_watch.has_down() {
            return Some(
                "no command was received: an array is stopped or has lost its device, and a replay needs commands"
                    .into(),
            );
        }
        let joined =
            |part: fn(&Needed) -> &'static str, by: &str| lacking.iter().map(part).collect::<Vec<_>>().join(by);
        let simulator = if lacking.len() > usize::from(lacks_command) { " (or the simulator)" } else { "" };
        (!lacking.is_empty()).then(|| {
            format!(
                "no {} was received: peers exchange messages over direct links only; let the {}{simulator} connect \
                 here (--listen), or connect to where it listens (--connect)",
                joined(|needed| needed.message, ", no "),
                joined(|needed| needed.process, " and the ")
            )
        })
    }

    /// Length of the present file in bytes.
    pub(super) fn bytes(&self) -> u64 {
        self.recording.as_ref().map_or(0, Recording::bytes)
    }

    /// Closes the present file, and continues in the one that `open` gives.
    pub(super) fn next_file(&mut self, open: impl FnOnce() -> io::Result<(S, PathBuf)>) -> Result<()> {
        let Some(recording) = self.recording.take() else { return Ok(()) };
        recording.finish(&std::mem::take(&mut self.file_account))?;
        self.place.check()?;
        let (storage, out) = open()?;
        self.header.started_ns = utc_ns().to_string();
        let begun = Begun { path: out.clone(), is_kept: false };
        self.recording = Some(Recording::create(storage, &self.header)?);
        begun.keep();
        self.place = Place::new(out);
        Ok(())
    }

    pub(super) fn flush_if_due(&mut self) {
        if self.flushed.elapsed() < FLUSH_EVERY {
            return;
        }
        self.flushed = Instant::now();
        let Some(mut recording) = self.recording.take() else { return };
        let flushed = recording.flush().and_then(|()| self.place.check());
        self.keep(recording, flushed);
    }

    /// Keeps the recording unless writing failed.
    fn keep(&mut self, recording: Recording<S>, outcome: Result<(), RecordingError>) {
        match outcome {
            Ok(()) => self.recording = Some(recording),
            Err(error) => self.failure = Some(error.to_string()),
        }
    }

    pub(super) fn finish(mut self, dropped: u64) -> Outcome {
        self.account.dropped = dropped;
        if self.account.messages() == 0 {
            self.failure.get_or_insert(NOTHING.to_owned());
        } else if let Some(problem) = self.missing() {
            self.report(problem);
        }
        let lacking = if self.account.messages() == 0 { Vec::new() } else { self.lacking() };
        if let Some(recording) = self.recording.take() {
            self.file_account.dropped = dropped;
            let finished = recording.finish(&self.file_account).and_then(|()| self.place.check());
            self.failure = finished.err().map(|error| error.to_string()).or(self.failure);
        }
        if self.account.messages() == 0 && self.place.has_file() {
            // An empty file would block the next attempt, since files are not overwritten.
            let _ = fs::remove_file(self.place.path());
        }
        Outcome {
            file: self.place.path().to_owned(),
            files: Vec::new(),
            account: self.account,
            lacks: lacking.iter().map(|needed| needed.stream).collect(),
            problems: self.problems,
            failure: self.failure,
        }
    }
}

#[cfg(test)]
mod tests;
