//! Orders whose values no room can use: the simulator refuses them by name, applies the other
//! fields, and its ticks go on.

use std::time::Instant;

use heliostat_bus::private_endpoint;
use heliostat_proto::{ControllerControl, FaultKind, MirrorFault, NodeKind, SimulatorControl, Stamp};
use heliostat_tests::{Process, RoomObserver, encoded, wait_until};

fn tick(observer: &RoomObserver) -> u64 {
    observer.users().map_or(0, |report| report.tick)
}

/// Waits until the room has published so many more ticks, and prints the time.
fn wait_for_ticks(observer: &RoomObserver, what: &str, more: u64) {
    let (from, begun) = (tick(observer), Instant::now());
    wait_until(what, || tick(observer) >= from + more);
    println!("{what}: {more} ticks after {} ms", begun.elapsed().as_millis());
}

fn forced(observer: &RoomObserver) -> usize {
    observer.truth().map_or(0, |truth| truth.users.iter().filter(|user| user.forced).count())
}

#[test]
fn values_beyond_their_domain_are_refused_and_the_room_goes_on() {
    let endpoint = private_endpoint().expect("a port");
    let sim = Process::heliostat(&["sim-node", "--listen", &endpoint, "--exit-with-parent", "--json"]);
    let observer = RoomObserver::connect("demo", &[&endpoint]);
    wait_until("the first truth", || observer.truth().is_some());
    let fault = |fault, seconds| MirrorFault { fault, seconds, ..MirrorFault::default() };
    let base = SimulatorControl { stamp: Stamp::default(), ..SimulatorControl::default() };
    let orders = [
        ("power", SimulatorControl { power_w: Some(3e38), ..base.clone() }),
        ("power", SimulatorControl { power_w: Some(1e-38), ..base.clone() }),
        ("speed", SimulatorControl { speed_m_s: Some([1e9, 1e9]), ..base.clone() }),
        ("speed", SimulatorControl { speed_m_s: Some([1e-38, 3e38]), ..base.clone() }),
        ("duration", SimulatorControl { faults: vec![fault(FaultKind::Late, 3e38)], ..base.clone() }),
        ("duration", SimulatorControl { faults: vec![fault(FaultKind::Offline, 3e38)], ..base.clone() }),
        ("duration", SimulatorControl { faults: vec![fault(FaultKind::Reboot, 3e38)], ..base }),
    ];
    for (index, (name, order)) in orders.into_iter().enumerate() {
        let users = 1 + index % 2;
        let counter = format!("refused:control:{name}");
        let before = observer.counter(NodeKind::SimNode, &counter);
        let order = SimulatorControl { forced_users: Some(users as u32), ..order };
        observer.publish(&observer.room().simulator_control(), &encoded(&order));
        wait_for_ticks(&observer, name, 100);
        wait_until("the valid field", || forced(&observer) == users);
        wait_until(&counter, || observer.counter(NodeKind::SimNode, &counter) > before);
    }
    wait_until("the refusals in the log", || sim.errors().contains("refused: control: "));
    sim.end().json();
}

#[test]
fn the_largest_order_does_not_stop_the_ticks_of_a_large_array() {
    let endpoint = private_endpoint().expect("a port");
    let size =
        ["mirrors.rows=64", "mirrors.columns=64", "mirrors.width_m=0.02", "mirrors.height_m=0.02", "mirrors.gap_m=0"];
    let mut arguments = vec!["sim-node", "--listen", &endpoint, "--exit-with-parent", "--json"];
    size.iter().for_each(|set| arguments.extend(["--set", set]));
    let sim = Process::heliostat(&arguments);
    let observer = RoomObserver::connect("demo", &[&endpoint]);
    wait_until("the first tick", || tick(&observer) > 0);
    let stuck = MirrorFault { fault: FaultKind::Stuck, share: 1.0, ..MirrorFault::default() };
    let order = SimulatorControl { faults: vec![stuck; 256], ..SimulatorControl::default() };
    observer.publish(&observer.room().simulator_control(), &encoded(&order));
    wait_for_ticks(&observer, "256 faults of 4096 mirrors", 20);
    sim.end().json();
}

#[test]
fn control_characters_of_a_message_do_not_reach_a_log_or_a_summary() {
    let endpoint = private_endpoint().expect("a port");
    let sim = Process::heliostat(&["sim-node", "--listen", &endpoint, "--exit-with-parent"]);
    let at_controller = private_endpoint().expect("a port");
    let controller = Process::controller("nearest", &endpoint, &at_controller, &[]);
    let observer = RoomObserver::connect("demo", &[&endpoint, &at_controller]);
    observer.wait_for_commands();
    let policy = "x\u{1b}[2J\u{1b}]0;owned\u{7}\u{9b}31m\r\nlast problem none";
    let order = ControllerControl { policy: policy.into(), ..ControllerControl::default() };
    observer.publish(&observer.room().controller_control(), &encoded(&order));
    wait_until("the refusal in the log", || controller.errors().contains("owned"));
    let (controller, sim) = (controller.end(), sim.end());
    for text in [controller.errors, controller.output, sim.errors, sim.output] {
        let control = text.chars().any(|character| character.is_control() && character != '\n');
        assert!(!control && !text.contains("\nlast problem none"), "{text:?}");
    }
}
