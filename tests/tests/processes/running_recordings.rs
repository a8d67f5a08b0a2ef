//! Recordings of a room and a controller that were running before the recorder: a replay compares
//! commands from the first recorded state of the controller on, and a new controller answers a playback.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use heliostat_bus::private_endpoint;
use heliostat_proto::{ControllerMemory, InputKind, MirrorTelemetry, UserReport, codec};
use heliostat_tests::{Process, encoded, golden_recording, wait_until};
use serde_json::Value;
use tempfile::TempDir;

use crate::recording::copy;

/// A room with the filter, whose recorder starts some seconds after the controller.
struct Setting {
    folder: TempDir,
    room: Process,
    controller: Process,
    endpoints: [String; 2],
    settings: Vec<&'static str>,
}

impl Setting {
    /// Starts room and controller, and waits until the belief has a past.
    fn new(settings: &[&'static str], policy: &str) -> Self {
        let endpoints = [private_endpoint().unwrap(), private_endpoint().unwrap()];
        let [room_at, controller_at] = &endpoints;
        let filter = ["--scenario", "hall", "--set", "control.belief=\"filter\""];
        let settings = [&filter[..], settings].concat();
        let both = |arguments: &[&str]| Process::heliostat_without_loss(&[arguments, &settings].concat());
        let room = both(&["sim-node", "--listen", room_at, "--exit-with-parent"]);
        let ended = ["--exit-with-parent", "--json", "--policy", policy];
        let controller = both(&[&["controller", "--connect", room_at, "--listen", controller_at], &ended[..]].concat());
        std::thread::sleep(Duration::from_secs(3));
        Self { folder: TempDir::new().unwrap(), room, controller, endpoints, settings }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A recorder of the running room that has written something.
    fn recorder(&self, file: &Path) -> Process {
        let [room_at, controller_at] = &self.endpoints;
        let out = file.to_string_lossy();
        let arguments =
            ["record", "--connect", room_at, "--connect", controller_at, "--exit-with-parent", "--json", "--out", &out];
        let recorder = Process::heliostat(&[&arguments[..], &self.settings].concat());
        wait_until("something to be written", || file.metadata().is_ok_and(|metadata| metadata.len() > 100_000));
        recorder
    }

    /// Ends room and controller; the folder stays until it is dropped.
    fn end(self) -> TempDir {
        drop(self.room);
        self.controller.end().json();
        self.folder
    }
}

/// Replays a recording by the policy that made it.
fn replay(file: &Path, policy: &str) -> Value {
    Process::heliostat(&["replay", &file.to_string_lossy(), "--json", "--policy", policy]).wait().json()
}

/// Asserts that a replay compares many commands of a recording, and that all are equal.
fn assert_replays(file: &Path, policy: &str) -> Value {
    let verdict = replay(file, policy);
    let count = |name: &str| verdict[name].as_u64().expect("a count");
    assert!(count("same") > 50, "{verdict}");
    assert_eq!((count("different"), count("held")), (0, 0), "{verdict}");
    assert_eq!(verdict["unrestored"], Value::Null, "{verdict}");
    verdict
}

/// The counts of a playback into a controller that starts with it: position reports, and answers.
fn play(file: &Path, controller: &[&str]) -> (u64, u64) {
    let endpoint = private_endpoint().unwrap();
    let player = Process::heliostat(&["replay", &file.to_string_lossy(), "--listen", &endpoint, "--json"]);
    let arguments = ["controller", "--policy", "fixed-point", "--connect", &endpoint, "--exit-with-parent"];
    let controller = Process::heliostat(&[&arguments[..], controller].concat());
    let playback = player.wait().json();
    controller.end();
    let count = |name: &str| playback[name].as_u64().expect("a count");
    (count("reports"), count("answered"))
}

#[test]
fn a_new_controller_answers_the_playback_of_a_recording_that_began_while_another_one_led() {
    let setting = Setting::new(&[], "fixed-point");
    let file = setting.file("room.mcap");
    let recorder = setting.recorder(&file);
    wait_until("a recording of some seconds", || file.metadata().unwrap().len() > 400_000);
    recorder.end().json();
    let _folder = setting.end();
    let (reports, answered) = play(&file, &[]);
    assert!(reports > 20 && answered > reports / 2, "{answered} of {reports}");

    // The recorded controller had a clock that is a day ahead.
    let ahead = file.with_file_name("ahead.mcap");
    let mut first = None;
    copy(&file, &ahead, |_, payload| {
        let Ok(mut telemetry) = codec::decode::<MirrorTelemetry>(&payload) else { return Some(payload) };
        first.get_or_insert(telemetry.epoch);
        telemetry.epoch += 24 * 3600 * 1000;
        Some(encoded(&telemetry))
    });
    assert!(first > Some(0), "the recording began while the array followed a controller");
    let (reports, answered) = play(&ahead, &[]);
    assert!(reports > 20 && answered > reports / 2, "{answered} of {reports}");
}

#[test]
fn a_new_lockstep_controller_answers_the_second_half_of_a_recording() {
    let folder = TempDir::new().unwrap();
    let half = folder.path().join("half.mcap");
    let mut begun = false;
    copy(&golden_recording(), &half, |topic, payload| {
        begun |= codec::decode::<UserReport>(&payload).is_ok_and(|report| report.tick > 60);
        (begun || topic.ends_with("capabilities")).then_some(payload)
    });
    let array = ["--set", "mirrors.rows=5", "--set", "mirrors.columns=5"];
    assert_eq!(play(&half, &[&["--lockstep", "--scenario", "specular"], &array[..]].concat()), (60, 60));
}

#[test]
fn a_recording_of_a_running_controller_with_a_filter_replays_bit_for_bit() {
    let setting = Setting::new(&[], "greedy");
    let file = setting.file("room.mcap");
    let begun = Instant::now();
    let recorder = setting.recorder(&file);
    std::thread::sleep(Duration::from_secs(9));
    let account = recorder.end().json();
    let memories = account["streams"]["heliostat/v1/demo/controller/memory"]["messages"].as_u64();
    // About one each second; the recording may take longer than the sleep.
    let most = begun.elapsed().as_secs() + 6;
    assert!((5..=most).contains(&memories.expect("states were recorded")), "{account}");
    let _folder = setting.end();
    let verdict = assert_replays(&file, "greedy");

    // The state that the controller had before the recording is what makes the commands equal.
    let without = file.with_file_name("without.mcap");
    copy(&file, &without, |topic, payload| (!topic.ends_with("controller/memory")).then_some(payload));
    let settled = ["replay", &without.to_string_lossy(), "--json", "--policy", "greedy", "--settle", "20"];
    let other = Process::heliostat(&settled).wait().json();
    assert!(other["different"].as_u64() > Some(0), "{other}");

    // A report that the recorder did not receive makes the state unknown until the next one.
    let gap = file.with_file_name("gap.mcap");
    let (mut reports, mut states) = (0, 0);
    copy(&file, &gap, |topic, payload| {
        states += u64::from(topic.ends_with("controller/memory"));
        reports += u64::from(topic.ends_with("/users") && states == 1);
        (!(topic.ends_with("/users") && states == 1 && reports == 5)).then_some(payload)
    });
    let fewer = assert_replays(&gap, "greedy");
    assert!(fewer["same"].as_u64() < verdict["same"].as_u64(), "{fewer} {verdict}");

    // A report that the controller did not accept, beside those that it did.
    let foreign = file.with_file_name("foreign.mcap");
    let (mut dropped, mut states) = (0, 0);
    copy(&file, &foreign, |topic, mut payload| {
        let Ok(mut memory) = codec::decode::<ControllerMemory>(&payload) else { return Some(payload) };
        states += 1;
        if topic.ends_with("controller/memory") && states == 3 {
            let before = memory.inputs.len();
            let mut inputs = memory.inputs.iter().map(|input| input.input);
            let report = inputs.position(|input| input == InputKind::Users).expect("a report");
            memory.inputs.remove(report);
            dropped = before - memory.inputs.len();
            payload = encoded(&memory);
        }
        Some(payload)
    });
    assert_eq!(dropped, 1);
    let differs = replay(&foreign, "greedy");
    assert!(differs["different"].as_u64() > Some(0), "the listed inputs are the ones that count: {differs}");
}

#[test]
fn a_recording_of_a_running_controller_with_reported_orientations_replays_bit_for_bit() {
    let tilted = ["--set", "users.orientation.model=measured", "--set", "streams.orientation.rate_hz=20"];
    let setting = Setting::new(&tilted, "greedy");
    let file = setting.file("room.mcap");
    let recorder = setting.recorder(&file);
    std::thread::sleep(Duration::from_secs(7));
    let account = recorder.end().json();
    assert!(account["streams"]["heliostat/v1/demo/orientation"]["messages"].as_u64() > Some(50), "{account}");
    let _folder = setting.end();
    assert_replays(&file, "greedy");
}

#[test]
fn recordings_of_users_who_come_and_go_replay_also_when_the_recorder_is_killed() {
    let arrivals = [
        "--set",
        "streams.positions.rate_hz=50",
        "--set",
        "users.arrivals.rate_per_min=120",
        "--set",
        "users.arrivals.mean_stay_s=2",
        "--set",
        "users.arrivals.max_users=14",
    ];
    let setting = Setting::new(&arrivals, "fixed-point");
    let file = setting.file("room.mcap");
    let recorder = setting.recorder(&file);
    std::thread::sleep(Duration::from_secs(6));
    recorder.end().json();
    let killed = setting.file("killed.mcap");
    let mut recorder = setting.recorder(&killed);
    std::thread::sleep(Duration::from_secs(8));
    recorder.kill();
    let _folder = setting.end();
    assert_eq!(assert_replays(&file, "fixed-point")["complete"], true);
    assert_eq!(assert_replays(&killed, "fixed-point")["complete"], false);
}

#[test]
fn a_playback_through_the_controller_of_the_recorded_room_leaves_the_room_as_it_is() {
    let setting = Setting::new(&[], "fixed-point");
    let file = setting.file("running.mcap");
    setting.recorder(&file).end();
    let [room_at, controller_at] = &setting.endpoints;
    // The playback sees the controller only, and the room has the sources of the recording.
    let played = Process::heliostat(&["replay", &file.to_string_lossy(), "--connect", controller_at]).wait();
    assert!(played.refusal().contains("no controller answered a played report"), "{}", played.errors);
    wait_until("an array that follows after the playback", || {
        Process::heliostat(&["status", "--connect", room_at]).wait().output.contains("array        following")
    });
}
