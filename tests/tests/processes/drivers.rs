//! Drivers across processes: the simulated array and one in Python keep the contract, and the
//! controller drives both.

use std::time::{Duration, Instant};

use heliostat_bus::{BusConfig, private_endpoint};
use heliostat_needs::needs;
use heliostat_proto::{ArrayState, MirrorCommand, MirrorTelemetry, Rearm, Room};
use heliostat_tests::faults::users_at_rest;
use heliostat_tests::{Process, PythonExample, RoomObserver, encoded, python, wait_until};
use serde_json::Value;

/// The example driver of 2 x 3 mirrors.
fn python_driver(python: &str, room: &str, endpoints: &[&str]) -> PythonExample {
    let own = ["--room", room, "--rows", "2", "--columns", "3", "--seconds", "600"];
    let connect = endpoints.iter().flat_map(|endpoint| ["--connect", endpoint]);
    PythonExample::start(python, "driver.py", &own.into_iter().chain(connect).collect::<Vec<_>>())
}

/// A check that has begun.
fn check(arguments: &[&str]) -> Process {
    Process::heliostat(&[&["driver", "check", "--json", "--wait", "100"], arguments].concat())
}

/// Verdicts by rule.
fn verdicts(check: Process) -> Vec<(String, String)> {
    let ended = check.wait();
    assert!(ended.status.success(), "{} {}", ended.output, ended.errors);
    let report: Value = serde_json::from_str(&ended.output).expect("the report is JSON");
    let text = |finding: &Value, name: &str| finding[name].as_str().expect("a text").to_owned();
    let findings = report["findings"].as_array().expect("a list").iter();
    findings.map(|finding| (text(finding, "rule"), text(finding, "verdict"))).collect()
}

#[test]
fn the_simulated_array_keeps_every_rule() {
    let endpoint = private_endpoint().unwrap();
    let check = check(&["--connect", &endpoint, "heliostat/v1/sim/mirrors/command"]);
    wait_until("a check that waits", || check.errors().contains("waits for a driver of array 0 in room \"sim\""));
    let _room = Process::heliostat(&["sim-node", "--room", "sim", "--listen", &endpoint, "--exit-with-parent"]);
    let verdicts = verdicts(check);
    assert!(verdicts.len() > 15 && verdicts.iter().all(|(_, verdict)| verdict == "kept"), "{verdicts:?}");
}

#[test]
fn a_configuration_that_no_device_can_have_ends_the_driver_at_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("array.toml");
    for (address, expected) in [
        ("serial:/dev/ttyUSB0@250000", "invalid speed \"250000\""),
        ("serial:.", "expected a serial port"),
        ("tcp:127.0.0.1:board", "expected a number from 1 to 65535"),
    ] {
        let board = format!(
            "kind = \"servo-board\"\naddress = \"{address}\"\nmin_deg = -30.0\nmax_deg = 30.0\nmirrors = [0]\n"
        );
        std::fs::write(&file, format!("rows = 1\ncolumns = 1\n[[boards]]\n{board}")).expect("a file");
        let endpoint = private_endpoint().expect("an endpoint");
        let ended =
            Process::heliostat(&["driver", "run", "--config", &file.display().to_string(), "--listen", &endpoint])
                .wait();
        assert_eq!(ended.status.code(), Some(2), "{}", ended.errors);
        assert!(ended.errors.contains(expected), "{}", ended.errors);
    }
}

#[test]
fn a_check_of_an_empty_room_is_refused() {
    let endpoint = private_endpoint().unwrap();
    let ended =
        Process::heliostat(&["driver", "check", "--room", "empty", "--wait", "1", "--listen", &endpoint]).wait();
    assert!(ended.refusal().contains("no driver in room \"empty\""), "{}", ended.errors);
    let ended =
        Process::heliostat(&["driver", "check", "--room", "empty", "--wait", "1", "--connect", &endpoint]).wait();
    let expected =
        format!("no driver in room \"empty\": this process is not connected: no process answers at {endpoint}");
    assert!(ended.refusal().contains(&expected), "{}", ended.errors);
}

#[test]
fn a_check_of_an_array_that_the_simulated_room_lacks_names_those_that_it_has() {
    let endpoint = private_endpoint().unwrap();
    let _room = Process::heliostat(&["sim-node", "--room", "one", "--listen", &endpoint, "--exit-with-parent"]);
    let flags = ["driver", "check", "--room", "one", "--array", "2", "--wait", "100", "--connect", &endpoint];
    let ended = Process::heliostat(&flags).wait();
    let expected = "no array 2 in room \"one\": expected --array with one of 0";
    assert!(ended.refusal().contains(expected), "{}", ended.errors);
}

#[needs("python-package")]
#[test]
fn a_driver_in_python_keeps_every_rule() {
    let python = python();
    let endpoint = private_endpoint().unwrap();
    let _driver = python_driver(&python, "python", &[&endpoint]);
    let verdicts = verdicts(check(&["--listen", &endpoint, "--room", "python"]));
    assert!(verdicts.iter().all(|(_, verdict)| verdict == "kept"), "{verdicts:?}");
}

/// Whether telemetry acknowledges this command.
fn acknowledges(telemetry: &MirrorTelemetry, command: &MirrorCommand) -> bool {
    (telemetry.epoch, telemetry.applied_sequence, telemetry.answers)
        == (command.epoch, command.sequence, command.answers)
        && telemetry.roll_commanded == command.roll
        && telemetry.yaw_commanded == command.yaw
}

#[needs("python-package")]
#[test]
fn a_driver_in_python_follows_the_controller() {
    let python = python();
    let (of_controller, of_tracker) = (private_endpoint().unwrap(), private_endpoint().unwrap());
    // A busy machine delays the check of a command.
    let set = ["--set", "mirrors.rows=2", "--set", "mirrors.columns=3", "--set", "control.validity_ms=10000"];
    let flags = ["controller", "--room", "driven", "--listen", &of_controller, "--policy", "fixed-point"];
    let _controller = Process::heliostat(&[&flags[..], &set, &["--exit-with-parent"]].concat());
    let room = BusConfig::new(Room::new("driven").unwrap());
    let tracker = RoomObserver::join(&room.listen_at(&of_tracker).connect_to(&of_controller));
    let _driver = python_driver(&python, "driven", &[&of_controller, &of_tracker]);
    // Its first start is stopped, by a stop without sender.
    let rearm = encoded(&Rearm::default());
    wait_until("a released array", || {
        tracker.publish(&tracker.room().rearm(), &rearm);
        tracker.telemetry().is_some_and(|telemetry| telemetry.state == ArrayState::Parked)
    });
    let (mut tick, mut acknowledged) = (0, 0);
    wait_until("ten commands that the driver acknowledges by number, tick and angles", || {
        tick += 1;
        tracker.publish(&tracker.room().users(), &encoded(&users_at_rest(7, tick)));
        // Telemetry comes after its interval, and later on a busy machine. A first report may have no receiver.
        let acknowledging = || {
            let both = tracker.telemetry().zip(tracker.command().1);
            both.filter(|(telemetry, command)| command.answers == tick && acknowledges(telemetry, command))
        };
        let published = Instant::now();
        while acknowledging().is_none() && published.elapsed() < Duration::from_secs(2) {
            std::thread::sleep(Duration::from_millis(10));
        }
        if let Some((telemetry, command)) = acknowledging() {
            assert_eq!(telemetry.state, ArrayState::Following, "{telemetry:?}");
            assert!(telemetry.counters.accepted > 0 && telemetry.counters.rejected == 0, "{telemetry:?}");
            assert!(command.roll.iter().chain(&command.yaw).any(|angle| angle.abs() > 0.01), "{command:?}");
            acknowledged += 1;
        }
        acknowledged >= 10
    });
}
