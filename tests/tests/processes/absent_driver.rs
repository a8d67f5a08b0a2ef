//! Commands without a driver: the controller reports it, and so do viewers.

use heliostat_bus::private_endpoint;
use heliostat_proto::{NodeKind, Stamp, UserReport, UserState};
use heliostat_service::clock::utc_ns;
use heliostat_tests::{Process, RoomObserver, encoded, wait_until};

const PROBLEM: &str = "no driver receives the commands";

/// Publishes the positions of five users like a tracker.
fn report(observer: &RoomObserver, sequence: u64) {
    let user = |user: u32| UserState { user, position_m: [0.5 * user as f32 - 1.0, 0.0, 0.85], ..UserState::default() };
    let stamp = Stamp { source: 7, sequence, time_ns: utc_ns() };
    let users = (0..5).map(user).collect();
    observer.publish(&observer.room().users(), &encoded(&UserReport { stamp, tick: sequence, users }));
}

#[test]
fn commands_without_a_driver_are_reported_until_one_is_there() {
    let (at, driver_at) = (private_endpoint().unwrap(), private_endpoint().unwrap());
    let controller = Process::controller("flat", &driver_at, &at, &["--json"]);
    let observer = RoomObserver::connect("demo", &[&at]);
    let ui = Process::heliostat(&["ui", "--plain", "--no-ui", "--connect", &at]);
    let mut sequence = 0;
    let mut until = |what: &str, condition: &dyn Fn() -> bool| {
        wait_until(what, || {
            sequence += 1;
            report(&observer, sequence);
            condition()
        });
    };
    let absent = || observer.counter(NodeKind::Controller, "driver_absent");
    until("a report of the absence", &|| absent() == 1);
    let status = observer.status(NodeKind::Controller).expect("a status");
    assert!(status.last_problem.starts_with(PROBLEM), "{}", status.last_problem);
    until("the state of the controller", &|| {
        observer.status(NodeKind::Controller).is_some_and(|status| status.state == PROBLEM)
    });
    until("a note of the viewer", &|| ui.errors().contains(PROBLEM));

    // The simulator drives its mirrors; the reports of the test end.
    let room = Process::heliostat(&["sim-node", "--listen", &driver_at, "--exit-with-parent"]);
    wait_until("the end of the absence", || absent() == 0);
    wait_until("commands", || observer.counter(NodeKind::Controller, "commands") > 0);
    // The room is there until the end, so that the absence does not return.
    let ended = controller.end();
    drop(room);
    assert_eq!(ended.errors.matches("no driver receives the commands: there is").count(), 1, "{}", ended.errors);
    assert_eq!(ended.json()["driver_absent"], false);
}
