//! Messages that a recorded controller accepted although a source ended, or another message has their
//! number: the replay accepts the same ones.
#![cfg(feature = "live")]

use std::fs::File;
use std::path::Path;

use clap::Parser;
use heliostat_core::core::{Controller, Due, Timing, WARM_UP_RUNS};
use heliostat_core::inbox::Message;
use heliostat_core::policy::PolicyKind;
use heliostat_models::{ActorSource, build};
use heliostat_proto::{
    ControllerMemory, Message as Encoded, MirrorCommand, Nanos, NodeKind, Room, Stamp, UserReport, UserState, encode,
};
use heliostat_record::account::Account;
use heliostat_record::cli::{self, ReplayArgs};
use heliostat_record::file::{Header, PRESENCE_TOPIC, Presence, Recording, Topic};
use heliostat_record::replay::{Settings, Verdict, run};
use heliostat_scenario::Scenario;
use heliostat_service::exit::UnusableInput;
use tempfile::TempDir;

const EPOCH: u64 = 7;
const POLICY: PolicyKind = PolicyKind::Greedy;
const REPORTS: u64 = 30;
const TRACKER: u64 = 0x51;
/// The token ends and returns before this report.
const FLAP: u64 = 15;

/// A controller and the recorder of its room, in one process.
struct RecordedRoom {
    room: Room,
    controller: Controller,
    recording: Recording<File>,
    /// Between the clock of the reports and that of the recorder.
    ahead_ns: Nanos,
}

impl RecordedRoom {
    fn new(file: &Path, scenario: &Scenario, ahead_ns: Nanos) -> Self {
        let toml = scenario.to_toml();
        let header = Header {
            room: "a".into(),
            scenario_hash: Scenario::hash_of(&toml),
            scenario: toml,
            contract: "1".into(),
            ..Header::default()
        };
        let policy = build(POLICY, scenario, &ActorSource::Shipped).unwrap();
        let mut controller = Controller::new(scenario, scenario.channel_model().unwrap(), policy, EPOCH).with_journal();
        controller.warm_up(0..WARM_UP_RUNS);
        let recording = Recording::create(File::create_new(file).unwrap(), &header).unwrap();
        Self { room: Room::new("a").unwrap(), controller, recording, ahead_ns }
    }

    fn write<T: Encoded>(&mut self, key: &str, now: Nanos, message: &T) {
        let mut payload = Vec::new();
        encode(message, &mut payload).unwrap();
        self.recording.payload(key, now + self.ahead_ns, now, &payload).unwrap();
    }

    fn write_presence(&mut self, now: Nanos, alive: bool) {
        let presence = Presence { node: NodeKind::Tracker, source: TRACKER, alive };
        let topic = Topic { name: PRESENCE_TOPIC, encoding: "json", schema: "", schema_encoding: "", schema_data: b"" };
        let json = serde_json::to_vec(&presence).unwrap();
        self.recording.derived(&topic, now + self.ahead_ns, &json).unwrap();
    }

    /// A report of a user who walks, and the command that answers it.
    fn report(&mut self, tick: u64, sequence: u64) {
        let now = 1_000_000_000 + tick * 100_000_000;
        let stamp = Stamp { source: TRACKER, sequence: tick, time_ns: now };
        let user = UserState { user: 3, position_m: [0.05 * tick as f32, 0.5, 0.9], ..UserState::default() };
        let mut report = UserReport { stamp, tick, users: vec![user] };
        let (users, command_key) = (self.room.users(), self.room.command());
        self.write(&users, now, &report);
        assert_eq!(self.controller.handle_message(now, Message::Users(&mut report)), Due::Command);
        let decision = self.controller.poll_command(now, Timing::InTime, &mut |_| {});
        let commands: Vec<MirrorCommand> = decision.commands().map(|(_, command)| command.clone()).collect();
        for command in commands {
            self.write(&command_key, now, &MirrorCommand { sequence, ..command });
        }
    }

    /// A report with the stamp of the next one, of a user outside the room, which the controller refuses.
    fn forge(&mut self, tick: u64) {
        let now = 1_000_000_000 + tick * 100_000_000;
        let stamp = Stamp { source: TRACKER, sequence: tick, time_ns: now };
        let user = UserState { user: 3, position_m: [1e3, 0.5, 0.9], ..UserState::default() };
        let mut report = UserReport { stamp, tick, users: vec![user] };
        let users = self.room.users();
        self.write(&users, now, &report);
        assert_eq!(self.controller.handle_message(now, Message::Users(&mut report)), Due::Nothing);
    }

    fn write_memory(&mut self, tick: u64, sequence: u64) {
        let now = 1_000_000_000 + tick * 100_000_000;
        let mut inputs = Vec::new();
        assert!(self.controller.take_inputs(&mut inputs));
        let state = self.controller.memory().to_bytes().unwrap();
        let stamp = Stamp { source: 9, sequence, time_ns: now };
        let key = self.room.controller_memory();
        self.write(&key, now, &ControllerMemory { stamp, epoch: EPOCH, tick, inputs, state });
    }

    /// The controller sees the token of the tracker end and return.
    fn flap(&mut self) {
        self.controller.handle_source_lost(NodeKind::Tracker, TRACKER);
        self.controller.handle_source_found(NodeKind::Tracker, TRACKER);
    }
}

fn scenario() -> Scenario {
    Scenario::builtin("hall").unwrap().with_overrides(&["mirrors.rows=3", "mirrors.columns=3"]).unwrap()
}

fn replay(file: &Path) -> Verdict {
    let settings = Settings { file: file.to_owned(), policy: Some(POLICY), model: None, settle: None };
    run(&settings).unwrap()
}

#[derive(Parser)]
struct CommandLine {
    #[command(flatten)]
    replay: ReplayArgs,
}

#[test]
fn a_replay_in_which_no_command_counts_is_an_error_that_names_the_flag_for_it() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("stateless.mcap");
    let mut room = RecordedRoom::new(&file, &scenario(), 0);
    (1..=REPORTS).for_each(|tick| room.report(tick, 100 + tick));
    room.recording.finish(&Account::default()).unwrap();
    let file = file.to_string_lossy();
    let replayed = |further: &[&str]| {
        let words = [&["replay", &file, "--policy", "greedy"], further].concat();
        cli::replay(CommandLine::parse_from(words).replay)
    };
    for (further, reason) in [(&["--settle", "40"][..], "--settle 40"), (&[], "the first 200 decisions do not count")] {
        let error = replayed(further).expect_err("no command counts");
        assert!(error.is::<UnusableInput>(), "{error}");
        let message = error.to_string();
        assert!(message.contains(reason) && message.contains("--settle 0 compares"), "{message}");
    }
    replayed(&["--settle", "0"]).expect("every command is compared");
}

#[test]
fn a_source_that_returns_in_a_recording_is_followed_again() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("lockstep.mcap");
    // In simulated time, two hours from the recorder's.
    let mut room = RecordedRoom::new(&file, &scenario(), 7_200_000_000_000);
    for tick in 1..=REPORTS {
        if tick == FLAP {
            room.flap();
            let now = 1_000_000_000 + tick * 100_000_000;
            [false, true].into_iter().for_each(|alive| room.write_presence(now, alive));
        }
        room.report(tick, tick);
    }
    room.recording.finish(&Account::default()).unwrap();
    let verdict = replay(&file);
    assert_eq!((verdict.same, verdict.different, verdict.held), (REPORTS, 0, 0), "{verdict:?}");
}

/// The verdict on a live recording whose recorder started after the first commands; `before` comes before
/// each report.
fn live(before: impl Fn(&mut RecordedRoom, u64)) -> (u64, u64, u64) {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("live.mcap");
    let mut room = RecordedRoom::new(&file, &scenario(), 0);
    for tick in 1..=REPORTS {
        before(&mut room, tick);
        room.report(tick, 100 + tick);
        if tick % 10 == 0 {
            room.write_memory(tick, tick / 10);
        }
    }
    room.recording.finish(&Account::default()).unwrap();
    let verdict = replay(&file);
    println!("{verdict:?}");
    (verdict.same, verdict.different, verdict.held)
}

#[test]
fn a_listed_input_is_accepted_where_the_recorder_missed_the_return_of_its_source() {
    let flap = |room: &mut RecordedRoom, tick| {
        if tick == FLAP {
            room.flap();
            room.write_presence(1_000_000_000 + tick * 100_000_000, false);
        }
    };
    assert_eq!(live(flap), (REPORTS - 10, 0, 0));
}

#[test]
fn a_refused_message_with_the_number_of_an_accepted_one_changes_no_replay() {
    assert_eq!(live(RecordedRoom::forge), (REPORTS - 10, 0, 0));
}
