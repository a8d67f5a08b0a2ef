//! A calibration of a running room, its refinement in idle time, and the comparison of its files with the
//! room: each program is a process of its own.
//!
//! One complete calibration serves all tests. A simulated user carries the receiver from spot to spot, in real time:
//! a binary of its own, so that no browser delays the readings at a spot.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Instant;

use heliostat_array::calibration_file::{AxisCorrections, CalibrationFile};
use heliostat_bus::{BusConfig, private_endpoint};
use heliostat_needs::needs;
use heliostat_proto::messages::fault;
use heliostat_proto::{ArrayState, NodeKind, Room, UserReport};
use heliostat_service::clock::utc_ns;
use heliostat_tests::{Browser, Ended, PageServer, Process, RoomObserver, encoded, wait_until};
use serde_json::Value;

/// The room as it is described: 4 x 4 mirrors, 100 reports a second.
const WALL: &str = r#"
name = "wall"
mirrors = { rows = 4, columns = 4 }
users = { count = 1, trace = "walk.csv" }
blockage = { obstacles_per_m2 = 0.0 }
control = { validity_ms = 400.0, range_deg = 60.0 }

[streams]
positions = { rate_hz = 20.0, latency_ms = 100.0, noise_m = 0.03, velocity_noise_m_s = 0.1 }
channel = { rate_hz = 100.0, latency_ms = 100.0, noise_relative = 0.05 }
obstacles = { rate_hz = 0.0 }
"#;

/// Spots and the place of the verification: x and y in m.
const PLACES: [[f64; 2]; 4] = [[-1.5, 0.75], [1.4, 1.0], [0.2, -1.4], [-0.7, -0.4]];

/// A room whose true mirrors, LED and tracker are not as described.
const ROUGH: [&str; 4] = ["--set", "mismatch.level=\"rough\"", "--seed", "11"];

/// The files of a complete calibration.
struct Files {
    _folder: tempfile::TempDir,
    wall: PathBuf,
    readings: PathBuf,
    calibration: PathBuf,
    measured: PathBuf,
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a plain path")
}

/// The files, made by the first test that needs them.
fn files() -> &'static Files {
    static FILES: OnceLock<Files> = OnceLock::new();
    FILES.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        let files = Files {
            wall: at("wall.toml"),
            readings: at("readings.json"),
            calibration: at("calibration.toml"),
            measured: at("measured.toml"),
            _folder: folder,
        };
        fs::write(&files.wall, WALL).expect("writable");
        let mut walk = String::from("time,user,x,y,heading_deg\n");
        for (index, [x, y]) in PLACES.iter().chain([&PLACES[0]]).enumerate() {
            let begin = 11 * index;
            walk += &format!("{begin},0,{x},{y},90\n");
            if index < PLACES.len() {
                walk += &format!("{},0,{x},{y},90\n", begin + 9);
            }
        }
        fs::write(files.wall.with_file_name("walk.csv"), walk).expect("writable");
        let (_room, endpoint) = room(&files, &[]);
        let names = [&files.readings, &files.calibration, &files.measured].map(|path| text(path));
        let [readings, out, room_out] = names;
        let flags = ["--readings", readings, "--out", out, "--room-out", room_out, "--json"];
        let ended = calibrate(&files, &endpoint, &flags).wait();
        assert!(ended.status.success(), "{}{}", ended.output, ended.errors);
        files
    })
}

/// A simulated room with these flags, and its endpoint.
fn room(files: &Files, flags: &[&str]) -> (Process, String) {
    let endpoint = private_endpoint().expect("an endpoint");
    let own = ["sim-node", "--scenario", text(&files.wall), "--listen", &endpoint];
    (Process::heliostat(&[&own[..], &ROUGH, flags].concat()), endpoint)
}

fn calibrate(files: &Files, endpoint: &str, flags: &[&str]) -> Process {
    let own = ["calibrate", "--scenario", text(&files.wall), "--connect", endpoint];
    Process::heliostat(&[&own[..], flags].concat())
}

/// A refinement of the calibration whose results are in this folder.
fn refine(files: &Files, endpoint: &str, folder: &Path, flags: &[&str]) -> Process {
    let [out, room_out] = ["refined.toml", "remeasured.toml"].map(|name| folder.join(name));
    let (readings, base) = (text(&files.readings), text(&files.calibration));
    let own = ["--refine", readings, "--base", base, "--user", "0", "--out", text(&out), "--room-out", text(&room_out)];
    calibrate(files, endpoint, &[&own[..], flags].concat())
}

/// A controller of this scenario, an observer whose messages reach all processes, and the endpoints of both.
fn served(scenario: &Path, at_room: &str) -> (Process, RoomObserver, [String; 2]) {
    let [at_controller, at_observer] = [(); 2].map(|()| private_endpoint().expect("an endpoint"));
    let join = ["controller", "--scenario", text(scenario), "--policy", "greedy", "--connect", at_room];
    let controller = Process::heliostat(&[&join[..], &["--listen", &at_controller]].concat());
    let config = BusConfig::new(Room::new("demo").expect("a valid name")).listen_at(&at_observer);
    let observer = RoomObserver::join(&config.connect_to(at_room).connect_to(&at_controller));
    wait_until("an array that follows the controller", || {
        observer.telemetry().is_some_and(|array| array.state == ArrayState::Following)
    });
    (controller, observer, [at_controller, at_observer])
}

#[needs("browser")]
#[test]
fn the_page_says_that_a_calibration_commands_and_how_far_it_is() {
    let files = files();
    // Slow channel reports: the page shows each state for a while.
    let (_room, endpoint) = room(files, &["--set", "streams.channel.rate_hz=20"]);
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("calibration.toml");
    let of_calibration = private_endpoint().expect("an endpoint");
    let _calibration = calibrate(files, &endpoint, &["--out", text(&out), "--listen", &of_calibration]);
    let server = PageServer::start(&["--connect", &endpoint, "--connect", &of_calibration]);
    let browser = Browser::open_flat(&server.url());
    let sentence = || browser.text("#sentence");
    wait_until("a calibration on the page", || {
        sentence().starts_with("A calibration commands the mirrors: ")
            && browser.text("#chip-controller") == "calibration"
    });
    wait_until("its progress", || {
        let sentence = sentence();
        sentence.contains("spot ")
            && sentence.contains(" of 16 mirrors located, about ")
            && sentence.contains(" s of readings left")
    });
    assert!(!browser.text("#problem").contains("controller"), "{}", browser.text("#problem"));
}

#[test]
fn a_refinement_commands_only_while_the_receiver_is_alone_and_gives_the_room_back_at_once() {
    let files = files();
    // The receiver stays at the first spot, and channel reports are so slow that the spot takes minutes.
    let folder = tempfile::tempdir().expect("a folder");
    let standing = folder.path().join("walk.csv");
    let [x, y] = PLACES[0];
    fs::write(&standing, format!("time,user,x,y,heading_deg\n0,0,{x},{y},90\n9000,0,{x},{y},90\n")).expect("writable");
    let trace = format!("users.trace={}", text(&standing));
    let flags = ["--calibration", text(&files.calibration), "--set", "streams.channel.rate_hz=2", "--set", &trace];
    let (_room, endpoint) = room(files, &flags);
    let (_controller, observer, [at_controller, at_observer]) = served(&files.measured, &endpoint);
    let of_controller = observer.telemetry().expect("waited for").epoch;
    let others = ["--connect", &at_controller, "--connect", &at_observer];
    let mut refinement = refine(files, &endpoint, folder.path(), &others);
    // The epoch under which a calibration commands, as its own status says.
    let of_calibration = || {
        let status = observer.status(NodeKind::Controller)?;
        let is_calibration = status.state.starts_with("calibrating: spot 1 of 3");
        status
            .counter("epoch")
            .filter(|epoch| is_calibration && observer.telemetry().is_some_and(|array| array.epoch == *epoch))
    };
    let calibrating = |refinement: &mut Process| {
        let mut epoch = None;
        wait_until("a calibration that commands", || {
            assert!(refinement.is_running(), "{}", refinement.errors());
            epoch = of_calibration();
            epoch.is_some()
        });
        epoch.expect("waited for")
    };
    let first = calibrating(&mut refinement);
    assert!(first > of_controller, "a new epoch: {first} after {of_controller}");
    // A second tracker sees another user.
    let mut report = observer.users().expect("reports");
    report.stamp.source ^= 1;
    let enter = |report: &mut UserReport| {
        let holder = report.users[0];
        report.users.truncate(1);
        report.users.push(heliostat_proto::UserState { user: 5, ..holder });
        report.stamp.sequence += 1;
        report.stamp.time_ns = utc_ns();
        observer.publish(&observer.room().users(), &encoded(report));
    };
    let entered = Instant::now();
    wait_until("the controller in the lead", || {
        enter(&mut report);
        observer.telemetry().is_some_and(|array| array.epoch > first && array.state == ArrayState::Following)
    });
    println!("the controller leads {} ms after the first report of the user", entered.elapsed().as_millis());
    let of_controller = observer.telemetry().expect("waited for").epoch;
    let before = observer.telemetry().expect("waited for").counters.accepted;
    wait_until("a hundred commands of the controller", || {
        enter(&mut report);
        let array = observer.telemetry().expect("received before");
        assert_eq!(array.epoch, of_controller, "another commands while a second user is in the room");
        array.counters.accepted > before + 100
    });
    assert!(
        refinement.errors().contains("the mirrors are given back: another user is in the room"),
        "{}",
        refinement.errors()
    );
    let second = calibrating(&mut refinement);
    assert!(second > of_controller, "once the receiver is alone again");
    // The end of the process gives the room back too.
    refinement.signal("INT");
    wait_until("the controller in the lead", || observer.telemetry().is_some_and(|array| array.epoch > second));
    assert!(!folder.path().join("refined.toml").exists());
}

/// The result of a refinement of a room whose array uses this calibration.
fn refined(files: &Files, in_use: &CalibrationFile, folder: &Path) -> Ended {
    let file = folder.join("in-use.toml");
    fs::write(&file, in_use.to_toml()).expect("writable");
    let (_room, endpoint) = room(files, &["--calibration", text(&file)]);
    refine(files, &endpoint, folder, &["--json"]).wait()
}

#[test]
fn a_refinement_writes_its_files_exactly_when_it_names_a_mirror_that_has_turned() {
    let files = files();
    let base = CalibrationFile::parse(&fs::read_to_string(&files.calibration).expect("written")).expect("sound");
    for turned_deg in [0.0, 0.8] {
        let folder = tempfile::tempdir().expect("a folder");
        // A drive that turns further than the file says is a mirror that has turned in its mount.
        let mut turned = base.clone();
        turned.roll.offset_deg[5] += turned_deg;
        let ended = refined(files, &turned, folder.path());
        // It is printed, too, where the verification forbids to write the files.
        let last = ended.output.lines().last().unwrap_or_default();
        let result: Value = serde_json::from_str(last).unwrap_or_else(|_| panic!("no JSON: {}", ended.errors));
        // Whether it finds the mirror in real time depends on the machine; tests in virtual time show that it does.
        let changes = result["outcome"]["changes"].as_array().expect("a list");
        let has_turned = changes.iter().any(|change| !change["turned_deg"].is_null());
        let written = ["refined.toml", "remeasured.toml"].map(|name| folder.path().join(name).exists());
        let is_written = has_turned && ended.status.success();
        assert_eq!((written, result["calibration"].is_string()), ([is_written; 2], is_written), "{}", ended.output);
        assert_eq!(ended.errors.contains("Nothing is written"), has_turned && !is_written, "{}", ended.errors);
    }
}

#[test]
fn files_and_flags_are_refused_before_the_room_is_taken_from_its_controller() {
    let files = files();
    let (_room, at_room) = room(files, &[]);
    let (_controller, observer, _) = served(&files.wall, &at_room);
    let epoch = observer.telemetry().expect("telemetry").epoch;
    let folder = tempfile::tempdir().expect("a folder");
    let [damaged, out] = ["damaged.json", "out.toml"].map(|name| folder.path().join(name));
    fs::write(&damaged, "{\"of\": {").expect("writable");
    let absent = folder.path().join("absent/readings.json");
    let twice = ["--room-out", text(&out)];
    for flags in [["--readings", text(&damaged)], ["--readings", text(&absent)], ["--spots", "99,0,1"], twice] {
        let ended = calibrate(files, &at_room, &[&["--take-over", "--out", text(&out)], &flags[..]].concat()).wait();
        assert!(!ended.status.success() && !ended.errors.is_empty(), "{flags:?}: {}", ended.output);
    }
    let accepted = |observer: &RoomObserver| observer.telemetry().map(|array| (array.epoch, array.counters.accepted));
    let before = accepted(&observer);
    wait_until("a further command", || accepted(&observer) > before);
    assert_eq!(observer.telemetry().map(|array| array.epoch), Some(epoch), "the controller has led throughout");
}

/// Verdict, finding and advice of the checks of `heliostat doctor` with these flags.
#[test]
fn a_calibration_with_tilted_receivers_says_that_its_condition_is_not_met() {
    let folder = tempfile::tempdir().expect("a folder");
    let (out, endpoint) = (folder.path().join("calibration.toml"), private_endpoint().expect("an endpoint"));
    let flags = ["calibrate", "--scenario", "office", "--out", text(&out), "--connect", &endpoint];
    let stated = |changes: &[&str]| {
        let ended = Process::heliostat(&[&flags[..], changes].concat()).wait();
        ended.errors.contains("the calibration with a tilted receiver does not apply: users.orientation.model")
    };
    assert!(stated(&[]));
    assert!(!stated(&["--set", "users.orientation.model=up"]));
}

fn doctor(files: &Files, endpoints: &[&str], calibration: &Path) -> impl Fn(&str) -> [String; 3] + use<> {
    let mut flags = vec!["doctor", "--json", "--port", "17834", "--scenario", text(&files.measured)];
    endpoints.iter().for_each(|endpoint| flags.extend(["--connect", endpoint]));
    flags.extend(["--calibration", text(calibration), "--measured", text(&files.measured)]);
    let report: Value = serde_json::from_str(&Process::heliostat(&flags).wait().output).expect("one JSON object");
    move |name| {
        let checks = report["checks"].as_array().expect("a list");
        let check = checks.iter().find(|check| check["name"] == name).unwrap_or_else(|| panic!("no {name}: {report}"));
        ["verdict", "found", "advice"].map(|part| check[part].as_str().expect("text").to_owned())
    }
}

#[test]
fn the_doctor_compares_the_files_of_a_calibration_with_the_running_room() {
    let files = files();
    let good = {
        let (_room, endpoint) = room(files, &["--calibration", text(&files.calibration)]);
        let (_controller, _, [at_controller, _]) = served(&files.measured, &endpoint);
        doctor(files, &[&endpoint, &at_controller], &files.calibration)
    };
    for (name, part) in [
        ("calibration", "4 x 4 mirrors, written less than a day ago"),
        ("in use", "whether it is that of the file cannot be seen over the contract"),
        ("measured room", "4 x 4 mirrors"),
        ("served room", "the controller uses the measured room"),
    ] {
        let [verdict, found, _] = good(name);
        assert!(verdict == "ok" && found.contains(part), "{name}: {verdict} {found}");
    }
    // A driver without the calibration, a controller with the nominal room, and the file of another array.
    let (_room, endpoint) = room(files, &[]);
    let (_controller, _, [at_controller, _]) = served(&files.wall, &endpoint);
    let ends = [endpoint.as_str(), at_controller.as_str()];
    let bad = doctor(files, &ends, &files.calibration);
    let [verdict, found, advice] = bad("in use");
    assert_eq!(
        (verdict.as_str(), found.as_str()),
        ("warn", "the array uses no calibration: expected that of the file")
    );
    assert!(advice.starts_with(&format!("heliostat calibrate apply {} brings", text(&files.calibration))), "{advice}");
    let [verdict, found, advice] = bad("served room");
    assert!(verdict == "warn" && found.contains(" in the controller: expected "), "{verdict} {found}");
    assert_eq!(advice, format!("start the controller with --scenario {}", text(&files.measured)));
    let folder = tempfile::tempdir().expect("a folder");
    let other = folder.path().join("other.toml");
    let axis = AxisCorrections::none(4);
    fs::write(&other, CalibrationFile { rows: 2, columns: 2, roll: axis.clone(), yaw: axis }.to_toml())
        .expect("writable");
    let [verdict, found, advice] = doctor(files, &ends, &other)("calibration");
    assert!(
        verdict == "fail" && found.ends_with("2 x 2 mirrors: expected 4 x 4 mirrors, as the array announces"),
        "{found}"
    );
    assert!(advice.contains("--array N"), "{advice}");
}

/// What `heliostat calibrate apply` ends with for a file of 2 rows and this offset in roll.
fn apply(endpoint: &str, columns: usize, offset_deg: f64) -> Ended {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("calibration.toml");
    let yaw = AxisCorrections::none(2 * columns);
    let roll = AxisCorrections { offset_deg: vec![offset_deg; 2 * columns], ..yaw.clone() };
    fs::write(&file, CalibrationFile { rows: 2, columns, roll, yaw }.to_toml()).expect("writable");
    Process::heliostat(&["calibrate", "apply", text(&file), "--connect", endpoint, "--json"]).wait()
}

#[test]
fn a_calibration_is_applied_to_a_running_array_and_one_that_does_not_fit_is_refused_with_the_reason() {
    let endpoint = private_endpoint().expect("an endpoint");
    let size = ["--set", "mirrors.rows=2", "--set", "mirrors.columns=2"];
    let _room = Process::heliostat(&[&["sim-node", "--exit-with-parent", "--listen", &endpoint][..], &size].concat());
    let observer = RoomObserver::connect("demo", &[&endpoint]);
    wait_until("an array without a calibration", || observer.telemetry().is_some_and(|array| array.calibration == 0));
    let is_refused = || observer.telemetry().is_some_and(|array| array.faults & fault::CALIBRATION != 0);
    let applied = |former: u64| {
        let result = apply(&endpoint, 2, 0.5).json();
        assert_eq!(result["former"].as_u64(), Some(former));
        let sequence = result["calibration"].as_u64().expect("a number");
        assert!(sequence > former, "{result}");
        wait_until("the calibration in telemetry", || {
            observer.telemetry().is_some_and(|array| array.calibration == sequence) && !is_refused()
        });
        sequence
    };
    let in_use = applied(applied(0));
    // Refused before a message: another array, and a correction that no driver accepts.
    for (columns, offset_deg, reason) in
        [(3, 0.5, "2 x 3 mirrors: expected 2 x 2 mirrors, as the array announces"), (2, 20.0, "invalid roll offset")]
    {
        let ended = apply(&endpoint, columns, offset_deg);
        assert!(ended.status.code() == Some(2) && ended.errors.contains(reason), "{}", ended.errors);
        assert!(!is_refused());
    }
    // Refused by the driver, which alone knows the range of its hardware.
    for kept in ["the driver has refused the calibration, and keeps", "the array still uses"] {
        let ended = apply(&endpoint, 2, 8.0);
        let kept = format!("{kept} calibration {in_use}");
        assert!(ended.status.code() == Some(1) && ended.errors.contains(&kept), "{}", ended.errors);
        assert!(ended.errors.contains(": the corrected roll of mirror 0 is "), "{}", ended.errors);
        wait_until("the fault of the refusal", is_refused);
    }
    applied(in_use);
}

#[test]
fn without_a_driver_no_calibration_is_applied_and_nothing_is_sent() {
    let endpoint = private_endpoint().expect("an endpoint");
    let ended = apply(&endpoint, 2, 0.5);
    let expected = "Nothing was sent: give --connect the endpoint of the driver or of its router";
    assert!(ended.status.code() == Some(1) && ended.errors.contains(expected), "{}", ended.errors);
}
