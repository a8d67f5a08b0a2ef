//! The geometry that room and controller announce: viewers draw it without a scenario file, and a
//! controller of another room reports the difference.

use heliostat_bus::private_endpoint;
use heliostat_proto::NodeKind;
use heliostat_tests::{Process, RoomObserver, wait_until};
use serde_json::Value;

const ROOM: [&str; 4] = ["--set", "mirrors.rows=4", "--set", "mirrors.columns=5"];

fn simulator(endpoint: &str, sets: &[&str]) -> Process {
    let fixed = ["sim-node", "--listen", endpoint, "--exit-with-parent"];
    Process::heliostat(&[&fixed, sets].concat())
}

fn controller(room: &str, endpoint: &str, sets: &[&str]) -> Process {
    Process::controller("flat", room, endpoint, &[&["--json"], sets].concat())
}

/// `heliostat ui` without a scenario.
fn viewer(endpoints: &[&str]) -> Process {
    let connect: Vec<&str> = endpoints.iter().flat_map(|endpoint| ["--connect", endpoint]).collect();
    page(&connect)
}

/// A page whose address is printed.
fn page(endpoints: &[&str]) -> Process {
    let ui = Process::heliostat(&[&["ui", "--plain", "--ui-port", "0"], endpoints].concat());
    wait_until("the address of the page", || ui.errors().contains("the page is at http://"));
    ui
}

/// The plan that the page draws.
fn plan(ui: &Process) -> Value {
    let errors = ui.errors();
    let rest = errors.split_once("the page is at ").expect("the address is printed").1;
    let url = format!("{}room.json", rest.split_whitespace().next().expect("an address"));
    let text = ureq::get(&url).call().expect("the page is served").body_mut().read_to_string().expect("text");
    serde_json::from_str(&text).expect("JSON")
}

fn mirrors(ui: &Process) -> usize {
    plan(ui)["mirrors_m"].as_array().expect("a list").len()
}

#[test]
fn a_viewer_without_a_scenario_draws_the_announced_room_and_follows_its_changes() {
    let (room_at, controller_at) = (private_endpoint().unwrap(), private_endpoint().unwrap());
    let room = simulator(&room_at, &[&ROOM[..], &["--set", "room.length_x_m=8"]].concat());
    let ui = viewer(&[&room_at, &controller_at]);
    wait_until("the announced room", || mirrors(&ui) == 20);
    assert_eq!((plan(&ui)["size_m"][0].as_f64(), plan(&ui)["geometry_source"].as_str()), (Some(8.0), Some("sim-node")));

    assert!(room.end().status.success());
    let _other = simulator(&room_at, &["--set", "mirrors.rows=3", "--set", "mirrors.columns=5"]);
    wait_until("the other room", || mirrors(&ui) == 15);
    let _controller = controller(&room_at, &controller_at, &ROOM);
    wait_until("a note that room and controller differ", || {
        ui.errors().contains("room and controller differ: mirrors.rows is 3 in the room and 4 in the controller")
    });
}

#[test]
fn a_viewer_draws_the_announcement_of_a_controller_without_a_simulator() {
    let (room_at, controller_at) = (private_endpoint().unwrap(), private_endpoint().unwrap());
    let _controller = controller(&room_at, &controller_at, &ROOM);
    let ui = viewer(&[&controller_at]);
    wait_until("the controller's room", || mirrors(&ui) == 20);
    assert_eq!(plan(&ui)["geometry_source"], "controller");
}

#[test]
fn a_viewer_of_a_room_without_announcements_says_that_it_draws_the_default_scenario() {
    let ui = page(&["--listen", &private_endpoint().unwrap()]);
    wait_until("a note about the default", || {
        ui.errors().contains("no process announces the geometry of the room: the picture shows the scenario specular")
    });
    assert_eq!((mirrors(&ui), plan(&ui)["geometry_source"].as_str()), (100, Some("default")));
}

#[test]
fn a_process_that_has_never_had_a_connection_names_the_endpoint_at_which_no_process_answers() {
    let endpoint = private_endpoint().unwrap();
    let problem = format!("no process answers at {endpoint}: start the process that listens there");
    let (ui, controller) = (viewer(&[&endpoint]), Process::heliostat(&["controller", "--connect", &endpoint]));
    wait_until("the endpoint in both logs", || [&ui, &controller].iter().all(|log| log.errors().contains(&problem)));
    let _room = simulator(&endpoint, &ROOM);
    wait_until("the room", || mirrors(&ui) == 20);
}

#[test]
fn a_controller_of_another_room_reports_the_first_key_that_differs_once() {
    let (room_at, controller_at) = (private_endpoint().unwrap(), private_endpoint().unwrap());
    let _room = simulator(&room_at, &["--set", "room.height_m=3.5"]);
    let controller = controller(&room_at, &controller_at, &[]);
    let observer = RoomObserver::connect("demo", &[&controller_at]);
    let problem = "room and controller differ: room.height_m is 3.5 in the room and 3.0 in this controller";
    wait_until("a report of the difference", || {
        observer.status(NodeKind::Controller).is_some_and(|status| status.last_problem.starts_with(problem))
    });
    assert_eq!(observer.counter(NodeKind::Controller, "geometry_differs"), 1);
    let decisions = observer.counter(NodeKind::Controller, "decisions");
    wait_until("further decisions", || observer.counter(NodeKind::Controller, "decisions") > decisions + 100);
    let ended = controller.end();
    assert_eq!(ended.errors.matches(problem).count(), 1, "{}", ended.errors);
    assert_eq!(ended.json()["geometry_differs"], true);
}
