//! Processes that are killed, restarted, or find another process in their role.

use std::path::Path;

use heliostat_bus::private_endpoint;
use heliostat_proto::NodeKind;
use heliostat_tests::{Process, RoomObserver, programs, wait_until};

/// The endpoints of a room and a controller.
struct Setting {
    room_endpoint: String,
    controller_endpoint: String,
}

impl Setting {
    fn new() -> Self {
        Self {
            room_endpoint: private_endpoint().expect("an endpoint"),
            controller_endpoint: private_endpoint().expect("an endpoint"),
        }
    }

    fn room(&self) -> Process {
        Process::heliostat(&["sim-node", "--listen", &self.room_endpoint, "--exit-with-parent", "--json"])
    }

    fn controller(&self, more: &[&str]) -> Process {
        let all = [&["--json"], more].concat();
        Process::controller("fixed-point", &self.room_endpoint, &self.controller_endpoint, &all)
    }

    fn observer(&self) -> RoomObserver {
        RoomObserver::connect("demo", &[&self.room_endpoint, &self.controller_endpoint])
    }
}

#[test]
fn the_controller_serves_a_simulator_that_comes_back() {
    let setting = Setting::new();
    let mut room = setting.room();
    let controller = setting.controller(&[]);
    let observer = setting.observer();
    observer.wait_for_commands();
    let first = observer.users().expect("received").stamp.source;

    room.kill();
    let socket = setting.room_endpoint.trim_start_matches("unixsock-stream/");
    let left = [socket.to_owned(), format!("{socket}.lock")].into_iter().find(|file| Path::new(file).exists());
    assert_eq!(left, None, "of the killed process");
    let room = setting.room();
    wait_until("reports of the new simulator", || observer.users().is_some_and(|report| report.stamp.source != first));
    observer.wait_for_commands();
    let summary = room.end().json();
    assert!(summary["commands"].as_u64() > Some(0), "{summary}");
    let summary = controller.end().json();
    assert_eq!(summary["sources"].as_u64(), Some(2), "{summary}");
}

#[test]
fn a_second_simulator_in_the_room_is_refused() {
    let setting = Setting::new();
    let _room = setting.room();
    let observer = setting.observer();
    wait_until("the first simulator", || observer.users().is_some());
    let elsewhere = private_endpoint().expect("an endpoint");
    let second = Process::heliostat(&["sim-node", "--listen", &elsewhere, "--connect", &setting.room_endpoint]).wait();
    assert!(second.refusal().contains("another simulator is in room \"demo\""), "{}", second.errors);
}

#[test]
fn reports_of_two_unconnected_simulators_are_not_mixed() {
    let setting = Setting::new();
    let _room = setting.room();
    // A pause of a busy machine is no end of the first source.
    let controller = setting.controller(&["--set", "control.source_timeout_ms=60000"]);
    let observer = setting.observer();
    observer.wait_for_commands();
    let owner = observer.users().expect("received").stamp.source;

    // The second one is connected to the controller only: peers do not forward messages.
    let second =
        Process::heliostat(&["sim-node", "--connect", &setting.controller_endpoint, "--exit-with-parent", "--json"]);
    wait_until("foreign reports that are counted and named", || {
        observer.counter(NodeKind::Controller, "refused:users:foreign-source") > 20
    });
    let problem = || observer.status(NodeKind::Controller).expect("received").last_problem;
    wait_until("the name of the second source", || problem().contains("a second source"));
    observer.wait_for_commands();
    let answered = observer.telemetry().expect("received");
    assert!(answered.applied_sequence > 0 && observer.users().expect("received").stamp.source == owner);
    second.end();
    let summary = controller.end().json();
    assert_eq!(summary["sources"].as_u64(), Some(1), "{summary}");
}

#[test]
fn a_full_standard_error_does_not_stop_the_demo() {
    let full = std::fs::File::options().write(true).open("/dev/full").expect("a device without space");
    let mut demo = std::process::Command::new(programs().join("heliostat"));
    demo.args(["demo", "--seconds", "0.5", "--json", "--no-ui", "--policy", "flat"]).stderr(full);
    let ended = demo.output().expect("the program starts");
    assert!(ended.status.success(), "{:?}", ended.status);
    let summary: serde_json::Value = serde_json::from_slice(&ended.stdout).expect("one JSON object");
    assert!(summary["commands"].as_u64() > Some(0), "{summary}");
}
