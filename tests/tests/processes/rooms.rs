//! A room whose name is misspelt, at the endpoint of another one.

use heliostat_bus::private_endpoint;
use heliostat_tests::{Process, RoomObserver, wait_until};

#[test]
fn a_misspelt_room_is_answered_with_the_rooms_that_are_there() {
    let at = private_endpoint().expect("an endpoint");
    let _room = Process::heliostat(&["sim-node", "--room", "lab", "--listen", &at, "--exit-with-parent"]);
    let observer = RoomObserver::connect("lab", &[&at]);
    wait_until("telemetry", || observer.telemetry().is_some());
    let words = "room lba has no process here: rooms that are there: lab";
    let flags = ["--room", "lba", "--connect", &at];
    let commands: [&[&str]; 4] = [&["status"], &["doctor"], &["stop", "--timeout", "1"], &["rearm", "--timeout", "1"]];
    for command in commands {
        let ended = Process::heliostat(&[command, &flags].concat()).wait();
        assert!(!ended.status.success(), "{command:?}: {}", ended.output);
        let text = ended.output + &ended.errors;
        assert!(text.contains(words), "{command:?}: {text}");
    }
    let page = Process::heliostat(&[&["ui", "--plain", "--no-ui"][..], &flags].concat());
    wait_until("a note of the page", || page.errors().contains(words));
}
