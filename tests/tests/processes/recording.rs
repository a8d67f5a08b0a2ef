//! A room, recorded by one process and replayed by another.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use heliostat_bus::{Bus, BusConfig, Class, private_endpoint};
use heliostat_core::policy::actor_file::ActorFile;
use heliostat_proto::{
    BranchReport, LedReport, MirrorCommand, NodeKind, OrientationReport, Room, Stamp, UserReport, codec,
};
use heliostat_record::account::Account;
use heliostat_record::file::{Reading, Recording};
use heliostat_scenario::Scenario;
use heliostat_tests::{Process, RoomObserver, encoded, golden_recording, programs, wait_until};
use serde_json::Value;
use tempfile::TempDir;

use crate::dense_graphs;

fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

/// A room, a controller, and a recorder connected to both.
struct Setting {
    folder: TempDir,
    room_at: String,
    recorder_at: String,
}

impl Setting {
    fn new() -> Self {
        Self {
            folder: TempDir::new().unwrap(),
            room_at: private_endpoint().unwrap(),
            recorder_at: private_endpoint().unwrap(),
        }
    }

    fn file(&self) -> PathBuf {
        self.folder.path().join("room.mcap")
    }

    fn room(&self, arguments: &[&str]) -> Process {
        Process::heliostat_without_loss(&[&["sim-node", "--listen", &self.room_at, "--json"], arguments].concat())
    }

    fn controller(&self, arguments: &[&str]) -> Process {
        let fixed = ["controller", "--connect", &self.room_at, "--connect", &self.recorder_at];
        let ended = ["--exit-with-parent", "--json"];
        let policy: &[&str] = if arguments.contains(&"--policy") { &[] } else { &["--policy", "fixed-point"] };
        Process::heliostat_without_loss(&[&fixed[..], &ended, policy, arguments].concat())
    }

    fn recorder_arguments(&self) -> Vec<String> {
        let file = text(&self.file());
        let room = ["record", "--scenario", "specular"];
        let arguments = ["--connect", &self.room_at, "--listen", &self.recorder_at, "--json", "--out", &file];
        room.iter().chain(&arguments).map(|&argument| argument.to_owned()).collect()
    }

    /// A recorder that is connected to the room.
    fn recorder(&self, arguments: &[&str]) -> Process {
        let fixed = self.recorder_arguments();
        let fixed: Vec<&str> = fixed.iter().map(String::as_str).collect();
        let recorder = Process::heliostat(&[&fixed, arguments].concat());
        wait_until("a recorder connected to the room", || recorder.has_noted(NodeKind::SimNode));
        recorder
    }

    /// Records until the room has ended; returns the recorder's counts.
    fn record(&self, both: &[&str], room_arguments: &[&str], controller_arguments: &[&str]) -> Value {
        let room = self.room(&[both, room_arguments].concat());
        let recorder = self.recorder(&[both, &["--until-empty"]].concat());
        let controller = self.controller(&[both, controller_arguments].concat());
        room.wait().json();
        // The controller detects the missing reports, after a pause of a busy machine too.
        std::thread::sleep(Duration::from_secs(4));
        // The controller publishes its status at its end at the latest; the status names the
        // policy.
        controller.end().json();
        recorder.wait().json()
    }
}

fn replay(file: &Path, arguments: &[&str]) -> Process {
    Process::heliostat(&[&["replay", &text(file), "--json"], arguments].concat())
}

/// The result of a replay without differences.
fn verified(file: &Path) -> Value {
    replay(file, &["--verify"]).wait().json()
}

/// A copy of a recording, each payload replaced by those that `change` makes of it.
pub fn copy<I: IntoIterator<Item = Vec<u8>>>(from: &Path, to: &Path, mut change: impl FnMut(&str, Vec<u8>) -> I) {
    let mut reading = Reading::open(File::open(from).unwrap()).unwrap();
    let mut recording = Recording::create(File::create_new(to).unwrap(), reading.header()).unwrap();
    while let Some(entry) = reading.entry().unwrap() {
        for payload in change(&entry.topic, entry.data) {
            recording.payload(&entry.topic, entry.arrived_ns, entry.arrived_ns, &payload).unwrap();
        }
    }
    recording.finish(&Account::default()).unwrap();
}

/// The payloads of a recording, in their order.
fn payloads(file: &Path) -> Vec<Vec<u8>> {
    let mut reading = Reading::open(File::open(file).unwrap()).unwrap();
    std::iter::from_fn(|| reading.entry().unwrap()).map(|entry| entry.data).collect()
}

#[test]
fn a_ring_keeps_complete_files_around_a_stop_and_a_second_run_continues_it() {
    let setting = Setting::new();
    let room = setting.room(&[]);
    let ring = ["--ring-mb", "8", "--around-fault", "1", "--exit-with-parent"];
    let names = || -> Vec<String> {
        let entries = fs::read_dir(setting.folder.path()).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    };
    let mut recorder = setting.recorder(&ring);
    let controller = setting.controller(&[]);
    wait_until("two files", || names().len() > 2);
    let stopped = Process::heliostat(&["stop", "--connect", &setting.room_at]).wait();
    assert!(stopped.status.success(), "{}", stopped.errors);
    wait_until("the stop", || recorder.errors().contains("is in the state stopped: the files around it are kept"));
    wait_until("files around the stop", || names().iter().filter(|name| name.contains("-fault")).count() > 1);
    // A power failure ends one run, and an operator the other.
    recorder.kill();
    let before = names();
    let recorder = setting.recorder(&ring);
    wait_until("another file", || names().len() > before.len() + 1);
    let summary = recorder.end().json();
    let files: Vec<PathBuf> = serde_json::from_value(summary["files"].clone()).expect("a list of files");
    assert_eq!(files.len(), names().len(), "the files of both runs: {summary}");
    let messages: usize = files.iter().map(|file| payloads(file).len()).sum();
    assert!(messages > 100, "{messages} messages in {files:?}");
    drop((controller, room));
}

#[test]
fn a_lockstep_run_replays_bit_for_bit_and_a_changed_one_does_not() {
    let setting = Setting::new();
    let account = setting.record(&[], &["--lockstep", "150"], &["--lockstep"]);
    let file = setting.file();
    let streams = account["streams"].as_object().expect("streams by key");
    let users = &streams["heliostat/v1/demo/users"];
    assert_eq!((users["messages"].as_u64(), users["missing"].as_u64()), (Some(150), Some(0)), "{account}");
    assert_eq!((&account["failure"], account["problems"].as_array().map(Vec::len)), (&Value::Null, Some(0)));
    let verdict = verified(&file);
    assert_eq!((verdict["same"].as_u64(), verdict["different"].as_u64()), (Some(150), Some(0)), "{verdict}");
    assert_eq!((&verdict["clock"], &verdict["policies"][0]), (&"lockstep".into(), &"fixed-point".into()));

    // Another policy gives other commands. Without --verify that is not an error.
    let other = replay(&file, &["--policy", "nearest"]).wait().json();
    assert!(other["different"].as_u64() > Some(100) && other["largest_difference_rad"].as_f64() > Some(0.0), "{other}");
    assert_eq!(
        (&other["replaced"][0], &verdict["replaced"][0]),
        (&"nearest in place of fixed-point".into(), &Value::Null)
    );
    let ended = replay(&file, &["--verify", "--policy", "nearest"]).wait();
    assert_eq!(ended.status.code(), Some(1));
    assert!(ended.refusal().contains("does not replay as recorded: tick 1: "), "{}", ended.errors);

    // One bit of the last angle of the 70th command: the lowest of its mantissa.
    let changed = setting.folder.path().join("changed.mcap");
    let mut commands = 0;
    copy(&file, &changed, |topic, mut payload| {
        commands += u64::from(topic.ends_with("mirrors/command"));
        if topic.ends_with("mirrors/command") && commands == 70 {
            let lowest = payload.len() - 4;
            payload[lowest] ^= 1;
        }
        Some(payload)
    });
    let ended = replay(&changed, &["--verify"]).wait();
    assert_eq!(ended.status.code(), Some(1), "{}", ended.errors);
    assert!(ended.errors.contains("tick 70: yaw of mirror 99: recorded "), "{}", ended.errors);
    let verdict: Value = serde_json::from_str(ended.output.trim()).unwrap();
    assert_eq!((verdict["same"].as_u64(), verdict["different"].as_u64()), (Some(149), Some(1)), "{verdict}");

    // The same bit in the file itself is damage, which the checksum of the chunk detects.
    let mut bytes = fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    let damaged = setting.folder.path().join("damaged.mcap");
    fs::write(&damaged, &bytes).unwrap();
    let ended = replay(&damaged, &["--verify"]).wait();
    assert_eq!(ended.status.code(), Some(2), "{} {}", ended.output, ended.errors);

    // Playback into a controller process.
    let endpoint = private_endpoint().unwrap();
    let player = replay(&file, &["--listen", &endpoint]);
    let arguments =
        ["controller", "--lockstep", "--policy", "fixed-point", "--connect", &endpoint, "--exit-with-parent"];
    let controller = Process::heliostat(&arguments);
    let playback = player.wait().json();
    assert_eq!((playback["answered"].as_u64(), playback["same"].as_u64()), (Some(150), Some(150)), "{playback}");
    controller.end();
}

#[test]
fn a_learned_policy_replays_bit_for_bit_with_its_file() {
    let setting = Setting::new();
    let actor = setting.folder.path().join("dense.onnx");
    fs::write(&actor, dense_graphs::dense_actor(&Scenario::default())).unwrap();
    let actor = text(&actor);
    setting.record(&[], &["--lockstep", "100"], &["--lockstep", "--policy", "ddpg", "--model", &actor]);
    let file = setting.file();
    let verdict = replay(&file, &["--model", &actor]).wait().json();
    assert_eq!((verdict["same"].as_u64(), verdict["different"].as_u64()), (Some(100), Some(0)), "{verdict}");
    // Without the file there is nothing to compare with, and the file is named by its hash.
    let hash = ActorFile { origin: String::new(), bytes: fs::read(&actor).unwrap().into() }.hash();
    let output = Command::new(programs().join("heliostat")).arg("replay").arg(&file).arg("--verify").output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains(&format!("SHA-256 begins with {hash}")) && message.contains("--model"), "{message}");
    assert!(output.stdout.is_empty() && message.trim().lines().count() == 1, "{message}");
}

#[test]
fn a_room_with_reported_orientations_replays_bit_for_bit_and_not_without_them() {
    let setting = Setting::new();
    let both = [
        "--set",
        "users.orientation.model=measured",
        "--set",
        "streams.orientation.rate_hz=50",
        "--set",
        "control.belief=none",
    ];
    setting.record(&both, &["--lockstep", "150"], &["--lockstep"]);
    let file = setting.file();
    let verdict = verified(&file);
    assert_eq!((verdict["same"].as_u64(), verdict["different"].as_u64()), (Some(150), Some(0)), "{verdict}");
    let upright = setting.folder.path().join("upright.mcap");
    let mut reports = 0;
    copy(&file, &upright, |topic, mut payload| {
        if topic.ends_with("/orientation") {
            reports += 1;
            let mut report: OrientationReport = codec::decode(&payload).unwrap();
            report.users.iter_mut().for_each(|user| user.quaternion = [1.0, 0.0, 0.0, 0.0]);
            payload = encoded(&report);
        }
        Some(payload)
    });
    assert!(reports >= 70, "{reports}");
    let other = replay(&upright, &["--policy", "fixed-point"]).wait().json();
    assert!(other["different"].as_u64() > Some(0), "{other}");
}

#[test]
fn a_room_with_reported_leds_replays_bit_for_bit_and_not_without_them() {
    let setting = Setting::new();
    let both = [
        "--set",
        "led.positions_m=[[-1.25,0,3],[1.25,0,3]]",
        "--set",
        "streams.channel.leds=gains",
        "--set",
        "users.mobility=seated",
        "--set",
        "users.orientation.model=measured",
    ];
    let account = setting.record(&both, &["--lockstep", "150"], &["--lockstep"]);
    let file = setting.file();
    let messages = |stream: &str| account["streams"][format!("heliostat/v1/demo/{stream}")]["messages"].as_u64();
    assert!(messages("leds") >= Some(60) && messages("leds") == messages("channel"), "{account}");
    let verdict = verified(&file);
    assert_eq!((verdict["same"].as_u64(), verdict["different"].as_u64()), (Some(150), Some(0)), "{verdict}");
    let without = setting.folder.path().join("without.mcap");
    copy(&file, &without, |topic, mut payload| {
        if topic.ends_with("/leds") {
            let mut report: LedReport = codec::decode(&payload).unwrap();
            (report.users, report.gains) = (Vec::new(), Vec::new());
            payload = encoded(&report);
        }
        Some(payload)
    });
    let other = replay(&without, &["--policy", "fixed-point"]).wait().json();
    assert!(other["different"].as_u64() > Some(0), "{other}");
}

#[test]
fn gains_of_branches_are_recorded_and_played_back() {
    let setting = Setting::new();
    let branches = ["--set", "receiver.preset=angle-diversity", "--set", "streams.channel.branches=true"];
    let account = setting.record(&branches, &["--lockstep", "60"], &["--lockstep"]);
    let file = setting.file();
    let messages = |stream: &str| account["streams"][format!("heliostat/v1/demo/{stream}")]["messages"].as_u64();
    assert!(messages("branches") >= Some(60) && messages("branches") == messages("channel"), "{account}");
    let verdict = verified(&file);
    assert_eq!((verdict["same"].as_u64(), verdict["different"].as_u64()), (Some(60), Some(0)), "{verdict}");

    let (endpoint, of_controller) = (private_endpoint().unwrap(), private_endpoint().unwrap());
    let config = BusConfig::new(Room::new("demo").unwrap()).connect_to(&endpoint);
    let player = replay(&file, &["--listen", &endpoint]);
    let bus = Bus::open(&config).unwrap();
    let played = Arc::new(Mutex::new(Vec::new()));
    let kept = Arc::clone(&played);
    let _subscription =
        bus.subscribe(&bus.room().branches(), move |payload| kept.lock().unwrap().push(payload.to_vec())).unwrap();
    let commands = bus.publisher(&bus.room().command(), Class::RealTimeBlock).unwrap();
    wait_until("a connection to the player", || commands.has_subscribers().unwrap());
    let arguments = ["controller", "--lockstep", "--policy", "fixed-point", "--connect", &endpoint, "--listen"];
    let ends = [of_controller.as_str(), "--exit-with-parent"];
    let _controller = Process::heliostat(&[&arguments[..], &ends, &branches].concat());
    let playback = player.wait().json();
    assert_eq!(playback["same"].as_u64(), Some(60), "{playback}");
    let mut recorded = payloads(&file);
    recorded.retain(|payload| codec::decode::<BranchReport>(payload).is_ok());
    let played = played.lock().unwrap();
    // A subscription in its first moments may miss reports, but receives none that was not recorded.
    assert!(played.len() >= 50 && played.iter().all(|payload| recorded.contains(payload)), "{}", played.len());
}

#[test]
fn a_live_recording_replays_after_the_first_decisions() {
    let setting = Setting::new();
    // After the room has ended, the controller publishes one more command, which answers no report.
    let account = setting.record(&["--set", "control.when_silent=\"park\""], &["--seconds", "8"], &[]);
    assert_eq!(account["problems"].as_array().map(Vec::len), Some(0), "{account}");
    let is_unprompted =
        |payload: &Vec<u8>| codec::decode::<MirrorCommand>(payload).is_ok_and(|command| command.answers == 0);
    assert!(payloads(&setting.file()).iter().any(is_unprompted));
    let verdict = verified(&setting.file());
    assert_eq!(verdict["clock"], "live", "{verdict}");
    assert!(verdict["same"].as_u64() > Some(100) && verdict["different"] == 0, "{verdict}");
    assert_eq!(verdict["compared"], account["streams"]["heliostat/v1/demo/mirrors/command"]["messages"], "{verdict}");

    // Playback at double speed into one controller, twice.
    let endpoint = private_endpoint().unwrap();
    let arguments = ["controller", "--policy", "fixed-point", "--connect", &endpoint, "--exit-with-parent"];
    let controller = Process::heliostat(&arguments);
    for _ in 0..2 {
        let playback = replay(&setting.file(), &["--listen", &endpoint, "--rate", "2"]).wait().json();
        let (reports, answered) = (playback["reports"].as_u64().unwrap(), playback["answered"].as_u64().unwrap());
        assert!(reports > 300 && answered > reports / 2, "{playback}");
    }
    controller.end();
}

#[test]
fn the_golden_recording_replays() {
    let verdict = verified(&golden_recording());
    assert_eq!((verdict["same"].as_u64(), verdict["not_counted"].as_u64()), (Some(120), Some(0)), "{verdict}");
}

#[test]
fn a_recording_is_readable_however_the_recorder_ends() {
    let setting = Setting::new();
    let room = setting.room(&["--exit-with-parent"]);
    let controller = setting.controller(&[]);
    let size = |file: &Path| fs::metadata(file).map_or(0, |metadata| metadata.len());

    // Ctrl-C closes the file.
    let recorder = setting.recorder(&[]);
    wait_until("something to be written", || size(&setting.file()) > 300_000);
    Command::new("kill").args(["-INT", &recorder.id().to_string()]).status().unwrap();
    let account = recorder.wait().json();
    assert_eq!(account["failure"], Value::Null, "{account}");
    assert_eq!(replay(&setting.file(), &["--policy", "flat"]).wait().last_json()["complete"], true);

    // A killed recorder loses its last second at most.
    fs::remove_file(setting.file()).unwrap();
    let mut recorder = setting.recorder(&[]);
    wait_until("something to be written", || size(&setting.file()) > 300_000);
    recorder.kill();
    let verdict = replay(&setting.file(), &["--policy", "flat"]).wait().last_json();
    assert_eq!(verdict["complete"], false, "{verdict}");
    assert!(verdict["reports"].as_u64() > Some(50), "{verdict}");

    // A file at its size limit: an error with the number of lost messages, and a valid file.
    fs::remove_file(setting.file()).unwrap();
    let limited = Command::new("bash")
        .args(["-c", "trap '' XFSZ; ulimit -f 900; exec \"$@\"", "bash"])
        .arg(programs().join("heliostat"))
        .args(setting.recorder_arguments())
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&limited.stderr);
    assert_eq!(limited.status.code(), Some(1), "{errors}");
    assert!(errors.contains("no space is left for the recording: it ends after "), "{errors}");
    let account: Value = serde_json::from_slice(&limited.stdout).unwrap();
    assert!(account["failure"].as_str().unwrap().starts_with("no space is left"), "{account}");
    let reports = replay(&setting.file(), &["--policy", "flat"]).wait().last_json()["reports"].as_u64();
    assert!(reports > Some(20), "{reports:?}");
    controller.end();
    room.end();
}

#[test]
fn gaps_are_counted_by_sequence_number() {
    let setting = Setting::new();
    let recorder = Process::heliostat(&[
        "record",
        "--listen",
        &setting.recorder_at,
        "--exit-with-parent",
        "--json",
        "--out",
        &text(&setting.file()),
    ]);
    wait_until("a recorder", || recorder.errors().contains("room demo into"));
    let tracker = RoomObserver::connect("demo", &[&setting.recorder_at]);
    let key = tracker.room().users();
    let publish = |sequence| {
        let stamp = Stamp { source: 7, sequence, time_ns: 1 };
        tracker.publish(&key, &encoded(&UserReport { stamp, tick: sequence, ..UserReport::default() }));
    };
    let size = || fs::metadata(setting.file()).map_or(0, |file| file.len());
    let publish_until_written = |sequence| {
        let before = size();
        wait_until("a report on disk", || {
            publish(sequence);
            size() > before
        });
    };
    publish_until_written(1);
    [2, 3, 7, 8].into_iter().for_each(publish);
    // The first call may see the writing of an earlier report, the second is its own.
    publish_until_written(10);
    publish_until_written(10);
    let account = recorder.end().json();
    let users = &account["streams"][&key];
    assert_eq!((users["missing"].as_u64(), users["sources"].as_u64()), (Some(4), Some(1)), "{account}");
    assert!(account["problems"][0].as_str().unwrap().contains("no command, no telemetry was received"), "{account}");
    // Without a command there is nothing to verify.
    let ended = replay(&setting.file(), &["--verify"]).wait();
    assert_eq!(ended.status.code(), Some(2));
    assert!(ended.errors.contains("cannot be replayed: it holds no command"), "{}", ended.errors);
}

#[test]
fn a_recording_is_not_played_into_a_room_with_an_array_of_its_own() {
    let [at_room, at_controller] = [(); 2].map(|()| private_endpoint().unwrap());
    let _room = Process::heliostat(&["sim-node", "--listen", &at_room]);
    let _controller = Process::heliostat(&["controller", "--connect", &at_room, "--listen", &at_controller]);
    let join = ["--room", "demo", "--connect", &at_room, "--connect", &at_controller];
    let ended = replay(&golden_recording(), &join).wait();
    let refusal = ended.refusal();
    assert!(refusal.contains("has a sim-node already") && refusal.contains("Nothing was played"), "{refusal}");
}

#[test]
fn a_failed_recording_or_replay_is_reported_with_the_cause() {
    let folder = TempDir::new().unwrap();
    let taken = folder.path().join("taken.mcap");
    fs::write(&taken, "something").unwrap();
    let refused = Process::heliostat(&["record", "--seconds", "1", "--out", &text(&taken)]).wait();
    assert!(refused.refusal().contains("does not exist yet"), "{}", refused.errors);
    assert_eq!(fs::read_to_string(&taken).unwrap(), "something");

    let unused = private_endpoint().unwrap();
    let empty = folder.path().join("empty-room.mcap");
    let alone = Process::heliostat(&["record", "--seconds", "1", "--connect", &unused, "--out", &text(&empty)]).wait();
    assert!(alone.refusal().contains("nothing was received"), "{}", alone.errors);

    let golden = golden_recording();
    let refused = |name: &str, expected: &str| {
        for arguments in [&["--verify"][..], &["--listen", unused.as_str()]] {
            let ended = replay(&folder.path().join(name), arguments).wait();
            assert_eq!(ended.status.code(), Some(2), "{name}: {}", ended.errors);
            let expected = format!("{name} cannot be replayed: {expected}");
            assert!(ended.errors.contains(&expected), "{name} {arguments:?}: {}", ended.errors);
        }
    };
    refused("absent.mcap", "No such file");
    refused("taken.mcap", "the file is not an MCAP file");
    let golden_bytes = fs::read(&golden).unwrap();
    fs::write(folder.path().join("begun.mcap"), &golden_bytes[..20]).unwrap();
    refused("begun.mcap", "the file is not a recording of a room");
    fs::write(folder.path().join("cut.mcap"), &golden_bytes[..golden_bytes.len() / 30]).unwrap();
    refused("cut.mcap", "it holds no position report");
    let changed = |name: &str, change: fn(&mut heliostat_record::file::Header)| {
        let mut header = Reading::open(File::open(&golden).unwrap()).unwrap().header().clone();
        change(&mut header);
        let file = File::create_new(folder.path().join(name)).unwrap();
        Recording::create(file, &header).unwrap().finish(&Account::default()).unwrap();
    };
    changed("later.mcap", |header| header.contract = "2".into());
    refused("later.mcap", "the recording uses version 2 of the contract; expected version 1");
    changed("empty.mcap", |_| {});
    refused("empty.mcap", "it holds no position report");
    changed("edited.mcap", |header| header.scenario = header.scenario.replace("seed = 1", "seed = 2"));
    let ended = replay(&folder.path().join("edited.mcap"), &["--verify"]).wait();
    assert_eq!(ended.status.code(), Some(2), "{}", ended.errors);
    assert!(ended.errors.contains("it was changed after it was made"), "{}", ended.errors);
}
