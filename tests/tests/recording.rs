//! What a room says, recorded by one process and replayed by another.

use std::fs;
use std::path::{Path, PathBuf};

use heliostat_bus::free_loopback_endpoint;
use heliostat_tests::{Process, wait_until};
use serde_json::Value;
use tempfile::TempDir;

fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

/// A room, a controller and a recorder that hears both; gives the recorder's account.
fn record(folder: &TempDir, room_arguments: &[&str], controller_arguments: &[&str]) -> (PathBuf, Value) {
    let file = folder.path().join("room.mcap");
    let (room_at, recorder_at) = (free_loopback_endpoint().unwrap(), free_loopback_endpoint().unwrap());
    let room = Process::heliostat(&[&["sim-node", "--listen", &room_at, "--json"], room_arguments].concat());
    let recorder = Process::heliostat(&[
        "record",
        "--connect",
        &room_at,
        "--listen",
        &recorder_at,
        "--until-empty",
        "--json",
        "--out",
        &text(&file),
    ]);
    wait_until("the recorder hears the room", || recorder.errors().contains("sim-node is here"));
    let controller = Process::heliostat(
        &[
            &["controller", "--connect", &room_at, "--connect", &recorder_at, "--exit-with-parent", "--json"],
            controller_arguments,
        ]
        .concat(),
    );
    room.wait().json();
    // A status of its own is said at the end at the latest, and names the policy.
    controller.end().json();
    (file, recorder.wait().json())
}

fn replay(file: &Path, arguments: &[&str]) -> Process {
    Process::heliostat(&[&["replay", &text(file), "--json"], arguments].concat())
}

#[test]
fn a_lockstep_run_replays_bit_for_bit_and_a_changed_one_does_not() {
    let folder = TempDir::new().unwrap();
    let (file, account) = record(&folder, &["--lockstep", "150"], &["--lockstep", "--policy", "fixed-point"]);
    let streams = account["streams"].as_object().expect("streams by key");
    let users = &streams["heliostat/v1/demo/users"];
    assert_eq!((users["messages"].as_u64(), users["missing"].as_u64()), (Some(150), Some(0)), "{account}");
    assert_eq!(account["complete"], true);

    let verdict = replay(&file, &["--verify"]).wait().json();
    assert_eq!((verdict["same"].as_u64(), verdict["different"].as_u64()), (Some(150), Some(0)), "{verdict}");
    assert_eq!((&verdict["clock"], &verdict["policies"][0]), (&"lockstep".into(), &"fixed-point".into()));

    // Another policy decides otherwise, and the first difference is named.
    let ended = replay(&file, &["--verify", "--policy", "nearest"]).wait();
    assert!(ended.refusal().contains("does not replay as recorded: tick 1"), "{}", ended.errors);

    // A file that was cut replays up to its last whole chunk.
    let mut bytes = fs::read(&file).unwrap();
    let cut = folder.path().join("cut.mcap");
    bytes.truncate(bytes.len() / 2);
    fs::write(&cut, &bytes).unwrap();
    let verdict = replay(&cut, &["--verify"]).wait().json();
    assert_eq!((&verdict["complete"], &verdict["different"]), (&false.into(), &0.into()), "{verdict}");
    let same = verdict["same"].as_u64().unwrap();
    assert!((10..150).contains(&same), "half of a file holds about half of the commands: {same}");

    // Into a controller that runs by itself.
    let endpoint = free_loopback_endpoint().unwrap();
    let player = replay(&file, &["--listen", &endpoint]);
    let arguments =
        ["controller", "--lockstep", "--policy", "fixed-point", "--connect", &endpoint, "--exit-with-parent"];
    let controller = Process::heliostat(&arguments);
    let playback = player.wait().json();
    assert_eq!((playback["answered"].as_u64(), playback["same"].as_u64()), (Some(150), Some(150)), "{playback}");
    controller.end();
}

#[test]
fn a_live_recording_replays_once_it_has_settled() {
    let folder = TempDir::new().unwrap();
    let (file, account) = record(&folder, &["--seconds", "5"], &["--policy", "fixed-point"]);
    assert_eq!(account["problems"].as_array().map(Vec::len), Some(0), "{account}");
    let verdict = replay(&file, &["--verify"]).wait().json();
    assert_eq!(verdict["clock"], "live", "{verdict}");
    assert!(verdict["same"].as_u64() > Some(100) && verdict["different"] == 0, "{verdict}");
}

#[test]
fn the_golden_recording_replays() {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/golden.mcap");
    let verdict = replay(&golden, &["--verify"]).wait().json();
    assert!(verdict["same"].as_u64() >= Some(100), "{verdict}");
}

#[test]
fn a_recorder_says_what_is_wrong() {
    let folder = TempDir::new().unwrap();
    let taken = folder.path().join("taken.mcap");
    fs::write(&taken, "something").unwrap();
    let refused = Process::heliostat(&["record", "--seconds", "1", "--out", &text(&taken)]).wait();
    assert!(refused.refusal().contains("does not exist yet"), "{}", refused.errors);
    assert_eq!(fs::read_to_string(&taken).unwrap(), "something");
    let refused = replay(&taken, &["--verify"]).wait();
    assert!(refused.refusal().contains("cannot be read"), "{}", refused.errors);
}
