//! The tracker in Python: the controller answers its reports, and its process ends when it should. The
//! tutorial of an own room: its commands together control an array.

use std::fs;
use std::path::Path;
use std::process::{Command, ExitStatus};
use std::time::{Duration, Instant};

use heliostat_bus::{BusConfig, Role, private_endpoint};
use heliostat_needs::needs;
use heliostat_proto::{ArrayState, Room};
use heliostat_tests::{Process, PythonExample, RoomObserver, python, wait_until, workspace};

/// Waits for the end of an example.
fn end(example: &mut PythonExample) -> ExitStatus {
    let mut status = None;
    wait_until("the end of the tracker", || {
        status = example.process().try_wait().expect("the process can be waited for");
        status.is_some()
    });
    status.expect("waited for")
}

#[needs("python-package")]
#[test]
fn a_controller_answers_a_tracker_in_python_whose_users_enter_and_leave() {
    let python = python();
    let (of_controller, of_viewer) = (private_endpoint().unwrap(), private_endpoint().unwrap());
    let flags = ["controller", "--room", "tracked", "--listen", &of_controller, "--policy", "fixed-point"];
    let _controller = Process::heliostat(&[&flags[..], &["--set", "users.count=3", "--exit-with-parent"]].concat());
    let room = BusConfig::new(Room::new("tracked").unwrap());
    let viewer = RoomObserver::join(&room.listen_at(&of_viewer).connect_to(&of_controller));
    let flags = ["--room", "tracked", "--connect", &of_controller, "--connect", &of_viewer, "--seconds", "600"];
    let mut tracker = PythonExample::start(&python, "tracker.py", &flags);
    let (mut answered, mut counts) = (Vec::new(), Vec::new());
    wait_until("reports of two and of three users, and answers to twenty reports", || {
        let (users, command) = (viewer.users(), viewer.command().1);
        if let Some(report) = &users {
            let ids: Vec<u32> = report.users.iter().map(|user| user.user).collect();
            assert!(ids == [0, 1, 2] || ids == [0, 2], "{report:?}");
            assert!(report.users.iter().all(|user| user.position_m[0].hypot(user.position_m[1]) < 1.01), "{report:?}");
            counts.push(ids.len());
        }
        answered.extend(command.map(|command| command.answers));
        answered.dedup();
        answered.len() >= 20 && counts.contains(&2) && counts.contains(&3)
    });
    assert!(answered.is_sorted(), "the commands answer the ticks in their order: {answered:?}");
    // Ctrl-C closes the session: without that a session of Zenoh can keep the process alive.
    // A key that Python loses in native code is pressed again.
    let id = tracker.process().id().to_string();
    let mut pressed = None;
    wait_until("the end of the tracker", || {
        if pressed.is_none_or(|at: Instant| at.elapsed() > Duration::from_secs(10)) {
            let sent = Command::new("kill").args(["-INT", &id]).status();
            assert!(sent.expect("there is a kill command").success());
            pressed = Some(Instant::now());
        }
        tracker.process().try_wait().expect("the process can be waited for").is_some()
    });
    assert!(end(&mut tracker).success(), "Ctrl-C is an orderly end");
}

/// The tutorial with free ports, and with the path of a scenario file.
fn tutorial(file: &Path) -> (String, [String; 2]) {
    let page = fs::read_to_string(workspace().join("docs/tutorials/own-room.md")).expect("the tutorial is there");
    let scenario = page.split("<<'END'\n").nth(1).and_then(|rest| rest.split("END\n").next()).expect("a scenario");
    fs::write(file, scenario).expect("writable");
    let endpoints = [(); 2].map(|()| private_endpoint().unwrap());
    let named = ["tcp/127.0.0.1:17701", "tcp/127.0.0.1:17702"];
    let page = named.iter().zip(&endpoints).fold(page, |page, (named, free)| page.replace(named, free));
    (page.replace("room.toml", file.to_str().expect("a plain path")), endpoints)
}

#[needs("python-package")]
#[test]
fn the_commands_of_the_tutorial_control_an_array() {
    let python = python();
    let folder = tempfile::tempdir().expect("a folder");
    let (page, [of_controller, _]) = tutorial(&folder.path().join("own.toml"));
    let words = |start: &str| -> Vec<String> {
        let line = page.lines().find(|line| line.starts_with(start)).unwrap_or_else(|| panic!("no {start}"));
        line.split(' ').skip(start.split(' ').count() - 1).map(str::to_owned).collect()
    };
    let heliostat = |start: &str, further: &[&str]| {
        let words = words(start);
        Process::heliostat(&words.iter().map(String::as_str).chain(further.iter().copied()).collect::<Vec<_>>())
    };
    let example = |file: &str| {
        let words = words(&format!("python3 examples/{file}"));
        PythonExample::start(&python, file, &words[1..].iter().map(String::as_str).collect::<Vec<_>>())
    };
    let _controller = heliostat("heliostat controller", &["--exit-with-parent"]);
    let _page = heliostat("heliostat ui", &["--plain", "--no-ui"]);
    let (_tracker, _driver) = (example("tracker.py"), example("driver.py"));
    // Through the controller, as the operator's commands; it waits until the controller listens.
    let room = BusConfig::new(Room::new("own").unwrap()).connect_to(&of_controller);
    let operator = RoomObserver::join(&BusConfig { role: Role::Client, ..room });
    let is_array = |state| operator.telemetry().is_some_and(|telemetry| telemetry.state == state);
    wait_until("an array that is stopped", || is_array(ArrayState::Stopped));
    let released = heliostat("heliostat rearm", &["--timeout", "100"]).wait();
    assert!(released.output.contains("are released"), "{} {}", released.output, released.errors);
    wait_until("an array that follows", || is_array(ArrayState::Following));
    let checked = heliostat("heliostat doctor", &["--json"]).wait().last_json();
    let checks = checked["checks"].as_array().expect("a list of checks");
    let driver = checks.iter().filter(|check| check["name"] == "driver");
    let verdicts: Vec<_> = driver.map(|check| check["verdict"].as_str().expect("text")).collect();
    assert_eq!(verdicts, ["ok"], "the example has the range of the scenario: {checked}");
    let stopped = heliostat("heliostat stop", &["--timeout", "100"]).wait();
    assert!(stopped.status.success(), "{} {}", stopped.output, stopped.errors);
    let released = heliostat("heliostat rearm", &["--timeout", "100"]).wait();
    assert!(released.output.contains("are released"), "{} {}", released.output, released.errors);
    wait_until("an array that follows", || is_array(ArrayState::Following));
    let accepted = || operator.telemetry().map_or(0, |telemetry| telemetry.counters.accepted);
    let before = accepted();
    wait_until("twenty commands that the driver accepts", || accepted() >= before + 20);
}
