//! Commands without a driver: the controller reports it, and so do viewers.

use heliostat_bus::private_endpoint;
use heliostat_proto::NodeKind;
use heliostat_tests::faults::users_at_rest;
use heliostat_tests::{Process, RoomObserver, encoded, wait_until};

const PROBLEM: &str = "no driver receives the commands";

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
            observer.publish(&observer.room().users(), &encoded(&users_at_rest(7, sequence)));
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
