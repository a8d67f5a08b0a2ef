//! `heliostat doctor` on the command line: the checks of the policy and of the controller.

use std::process::Command;
use std::time::Duration;

use heliostat_bus::{Bus, BusConfig, Class, keys, private_endpoint};
use heliostat_proto::{NodeKind, Room, RoomGeometry, encode};
use heliostat_scenario::Scenario;
use heliostat_service::Stop;
use serde_json::Value;

/// The check of the policy with these flags.
fn policy(flags: &[&str]) -> Value {
    check("policy", flags)
}

/// The check of this name with these flags.
fn check(name: &str, flags: &[&str]) -> Value {
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat"));
    let output =
        command.args(["doctor", "--json", "--port", "17833"]).args(flags).output().expect("the program starts");
    let report: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    let checks = report["checks"].as_array().expect("a list");
    checks.iter().find(|check| check["name"] == name).expect("a check of this name").clone()
}

fn text<'a>(check: &'a Value, part: &str) -> &'a str {
    check[part].as_str().expect("text")
}

#[test]
fn the_file_of_a_policy_is_named() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/actors/ddpg-specular.onnx");
    let own = policy(&["--model", file]);
    assert_eq!(text(&own, "verdict"), "ok");
    assert!(!text(&own, "found").contains("default"), "{own}");
    assert!(text(&own, "found").starts_with(&format!("{file} fits the scenario, engine ")), "{own}");
    let default = policy(&[]);
    assert!(text(&default, "found").starts_with("fixed-point fits the scenario (default"), "{default}");
    let built_in = policy(&["--policy", "ddpg"]);
    assert!(text(&built_in, "found").starts_with("ddpg fits the scenario, engine "), "{built_in}");
}

#[test]
fn the_certificate_that_ends_first_has_a_line_and_is_a_warning_in_its_last_days() {
    let room = Room::new("studio").expect("a valid name");
    for (days, verdict) in [(5, "warn"), (90, "ok")] {
        let folder = tempfile::tempdir().expect("a folder");
        keys::init(&room, folder.path(), &keys::Terms::of_days(days, &[])).expect("new keys");
        let certificate = check("certificate", &["--tls", folder.path().to_str().expect("a plain path")]);
        assert_eq!(text(&certificate, "verdict"), verdict, "{certificate}");
        assert!(text(&certificate, "found").ends_with(&format!("days left {days}")), "{certificate}");
        assert_eq!(text(&certificate, "advice").contains("heliostat keys renew"), verdict == "warn", "{certificate}");
    }
}

#[test]
fn a_policy_worse_than_flat_mirrors_is_a_warning() {
    let worse = policy(&["--policy", "ddpg-raw"]);
    assert_eq!(text(&worse, "verdict"), "warn", "{worse}");
    assert!(text(&worse, "advice").contains("worse than flat mirrors"), "{worse}");
}

#[test]
fn a_room_whose_controller_does_not_answer_has_a_line_that_says_so() {
    let endpoint = private_endpoint().expect("a free address");
    let room = Room::new("doctor-alone").expect("a valid name");
    let bus = Bus::open(&BusConfig::new(room).listen_at(&endpoint)).expect("a session");
    let controller = check("controller", &["--room", "doctor-alone", "--connect", &endpoint]);
    assert_eq!(text(&controller, "verdict"), "warn");
    assert_eq!(text(&controller, "found"), "no controller answers");
    assert!(text(&controller, "advice").contains("start heliostat controller, or add its endpoint"), "{controller}");
    bus.close().expect("closed");
}

#[test]
fn an_endpoint_without_a_process_beside_one_with_a_process_is_a_warning() {
    let [there, absent] = [(); 2].map(|()| private_endpoint().expect("a free address"));
    let room = Room::new("doctor-half").expect("a valid name");
    let bus = Bus::open(&BusConfig::new(room).listen_at(&there)).expect("a session");
    let endpoint = check("endpoint", &["--room", "doctor-half", "--connect", &there, "--connect", &absent]);
    assert_eq!(text(&endpoint, "verdict"), "warn");
    assert_eq!(text(&endpoint, "found"), format!("no process of a room answers at {absent}"));
    bus.close().expect("closed");
}

#[test]
fn a_room_whose_processes_connect_to_the_doctor_is_checked() {
    let endpoint = private_endpoint().expect("a free address");
    let room = Room::new("doctor-listens").expect("a valid name");
    let bus = Bus::open(&BusConfig::new(room).connect_to(&endpoint)).expect("a session");
    let driver = check("driver", &["--room", "doctor-listens", "--listen", &endpoint]);
    assert_eq!(text(&driver, "found"), "no driver in room \"doctor-listens\" publishes the capabilities of an array");
    bus.close().expect("closed");
}

#[test]
fn a_scenario_that_is_not_that_of_the_running_room_fails() {
    let endpoint = private_endpoint().expect("a free address");
    let room = Room::new("doctor-other").expect("a valid name");
    let bus = Bus::open(&BusConfig::new(room).listen_at(&endpoint)).expect("a session");
    let publisher = bus.publisher(&bus.room().geometry(NodeKind::SimNode), Class::LowDrop).expect("a valid key");
    let room = Scenario::builtin("hall").and_then(|hall| hall.with_overrides(&["room.height_m=3.5"]));
    let scenario = room.expect("a valid height").geometry_toml();
    let mut payload = Vec::new();
    encode(&RoomGeometry { scenario, ..RoomGeometry::default() }, &mut payload).expect("a sound message");
    let end = Stop::default();
    let until = end.clone();
    let announcer = std::thread::spawn(move || {
        while !until.wait_for(Duration::from_millis(50)) {
            publisher.put(&payload).expect("the session is open");
        }
    });
    let check = check("room", &["--room", "doctor-other", "--connect", &endpoint]);
    end.request();
    announcer.join().expect("no panic");
    assert_eq!(text(&check, "verdict"), "fail");
    assert_eq!(text(&check, "found"), "room.height_m is 3.5 in the room and 3.0 in the given scenario");
    bus.close().expect("closed");
}
