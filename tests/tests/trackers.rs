//! The tracker in Python: the controller answers its reports, and its process ends when it should.

use std::process::{Command, ExitStatus};

use heliostat_bus::{BusConfig, free_loopback_endpoint};
use heliostat_proto::Room;
use heliostat_tests::{Process, PythonExample, RoomObserver, python, wait_until};

/// Waits for the end of an example.
fn end(example: &mut PythonExample) -> ExitStatus {
    let mut status = None;
    wait_until("the end of the tracker", || {
        status = example.process().try_wait().expect("the process can be waited for");
        status.is_some()
    });
    status.expect("waited for")
}

#[test]
fn a_controller_answers_a_tracker_in_python_whose_users_enter_and_leave() {
    let Some(python) = python() else { return };
    let (of_controller, of_viewer) = (free_loopback_endpoint().unwrap(), free_loopback_endpoint().unwrap());
    let flags = ["controller", "--room", "tracked", "--listen", &of_controller, "--policy", "fixed-point"];
    let _controller = Process::heliostat(&[&flags[..], &["--set", "users.count=3", "--exit-with-parent"]].concat());
    let room = BusConfig::new(Room::new("tracked").unwrap());
    let viewer = RoomObserver::join(&room.listen_at(&of_viewer).connect_to(&of_controller));
    let endpoints = format!("{of_controller},{of_viewer}");
    let mut tracker = PythonExample::start(&python, "tracker.py", &["tracked", &endpoints, "60"]);
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
    let sent = Command::new("kill").args(["-INT", &tracker.process().id().to_string()]).status();
    assert!(sent.expect("there is a kill command").success());
    assert!(end(&mut tracker).success(), "Ctrl-C is an orderly end");
}

#[test]
fn a_tracker_in_python_ends_by_itself_without_a_controller() {
    let Some(python) = python() else { return };
    let nowhere = free_loopback_endpoint().unwrap();
    let mut tracker = PythonExample::start(&python, "tracker.py", &["alone", &nowhere, "0.5"]);
    assert!(end(&mut tracker).success());
}
