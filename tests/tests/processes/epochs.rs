//! Forged and foreign messages, and several controllers in one room: commands continue.

use heliostat_bus::private_endpoint;
use heliostat_proto::{
    ArrayState, AxisLimits, Capabilities, MirrorCommand, MirrorTelemetry, NodeKind, NodeStatus, Stamp, UserReport,
};
use heliostat_tests::{Process, RoomObserver, encoded, wait_until};

/// A day in ms.
const DAY_MS: u64 = 86_400_000;

/// A room, and an observer that is connected to the room and to its controllers.
struct Setting {
    room_endpoint: String,
    controller_endpoints: [String; 2],
    room: Process,
}

impl Setting {
    fn new() -> Self {
        let free = || private_endpoint().expect("an endpoint");
        let room_endpoint = free();
        let room = Process::heliostat(&["sim-node", "--listen", &room_endpoint, "--exit-with-parent", "--json"]);
        Self { room_endpoint, controller_endpoints: [free(), free()], room }
    }

    fn controller(&self, index: usize) -> Process {
        self.controller_with(index, &[])
    }

    fn controller_with(&self, index: usize, more: &[&str]) -> Process {
        let all = [&["--json"], more].concat();
        Process::controller("nearest", &self.room_endpoint, &self.controller_endpoints[index], &all)
    }

    /// An observer of the room and its first controller, after the first commands.
    fn observer(&self) -> RoomObserver {
        let observer = RoomObserver::connect("demo", &[&self.room_endpoint, &self.controller_endpoints[0]]);
        wait_for_accepted(&observer);
        wait_until("a command and a user report", || observer.command().0 > 0 && observer.users().is_some());
        observer
    }
}

fn telemetry(observer: &RoomObserver) -> MirrorTelemetry {
    observer.telemetry().expect("received")
}

/// Waits until the array has accepted twenty more commands and follows them.
fn wait_for_accepted(observer: &RoomObserver) {
    wait_until("telemetry", || observer.telemetry().is_some());
    let before = telemetry(observer).counters.accepted;
    wait_until("accepted commands", || {
        let array = telemetry(observer);
        array.counters.accepted >= before + 20 && array.state == ArrayState::Following
    });
}

fn counter(observer: &RoomObserver, name: &str) -> u64 {
    observer.counter(NodeKind::Controller, name)
}

fn last_problem(observer: &RoomObserver) -> String {
    observer.status(NodeKind::Controller).map(|status| status.last_problem).unwrap_or_default()
}

#[test]
fn a_controller_replaces_one_whose_clock_was_a_day_ahead() {
    let setting = Setting::new();
    let first = setting.controller(0);
    let observer = setting.observer();
    // The epoch that a controller chooses whose clock is ahead, within the rules of the array.
    let mut command = observer.command().1.expect("received");
    first.end();
    command = MirrorCommand { epoch: command.epoch + DAY_MS, sequence: 1, ..command };
    let apply = || {
        command.time_ns = telemetry(&observer).stamp.time_ns;
        observer.publish(&observer.room().command(), &encoded(&command));
        telemetry(&observer).epoch == command.epoch
    };
    wait_for_epoch(apply, &observer);
    let ahead = telemetry(&observer).epoch;

    let second = setting.controller(0);
    wait_until("an array that follows the second controller", || telemetry(&observer).epoch > ahead);
    wait_for_accepted(&observer);
    let summary = second.end().json();
    assert!(summary["epoch"].as_u64() > Some(ahead), "{summary}");
}

/// Waits for the epoch of a controller with a wrong clock. An array that bounds epochs refuses it,
/// and then there is nothing to replace.
fn wait_for_epoch(mut apply: impl FnMut() -> bool, observer: &RoomObserver) {
    let refused = || telemetry(observer).counters.rejected;
    let before = refused();
    wait_until("an epoch a day ahead, or its refusal", || apply() || refused() > before);
}

#[test]
fn foreign_capabilities_do_not_end_the_controller() {
    let setting = Setting::new();
    let mut controller = setting.controller(0);
    let observer = setting.observer();
    let foreign = Capabilities {
        stamp: Stamp { source: 666, sequence: 1, time_ns: 1 },
        hardware: "foreign".into(),
        rows: 3,
        columns: 3,
        ..Capabilities::default()
    };
    let key = observer.room().capabilities();
    for _ in 0..3 {
        observer.publish(&key, &encoded(&foreign));
        std::thread::sleep(std::time::Duration::from_millis(300));
    }
    assert!(controller.is_running());
    wait_for_accepted(&observer);
    wait_until("the count of foreign announcements", || counter(&observer, "refused:array:foreign-source") >= 3);
    assert_eq!(counter(&observer, "array_unfit"), 0);
    controller.end().json();
}

#[test]
fn an_array_that_does_not_fit_receives_no_commands_until_it_announces_other_capabilities() {
    let setting = Setting::new();
    let mut controller = setting.controller(0);
    let observer = setting.observer();
    let axis = AxisLimits { min_rad: -0.05, max_rad: 0.05, ..AxisLimits::default() };
    let narrow = Capabilities {
        stamp: Stamp { sequence: 1_000, ..telemetry(&observer).stamp },
        hardware: "narrow".into(),
        rows: 10,
        columns: 10,
        roll: axis,
        yaw: axis,
        ..Capabilities::default()
    };
    // The real driver announces its own every second, so the forged ones are repeated.
    let key = observer.room().capabilities();
    wait_until("a reported mismatch", || {
        assert!(controller.is_running());
        observer.publish(&key, &encoded(&narrow));
        last_problem(&observer).contains("the array receives no commands: the array \"narrow\" turns from")
    });
    wait_until("a withheld command", || counter(&observer, "fallback:withheld") > 0);
    assert!(controller.is_running());
    wait_until("a fit", || counter(&observer, "array_unfit") == 0);
    wait_for_accepted(&observer);
    controller.end().json();
}

#[test]
fn a_forged_command_in_the_epoch_of_the_controller_is_reported_and_answered_by_a_new_epoch() {
    let setting = Setting::new();
    let controller = setting.controller(0);
    let observer = setting.observer();
    let before = telemetry(&observer).epoch;
    let key = observer.room().command();
    // Within the bound of the array on steps of the sequence.
    let sequence = observer.command().1.expect("received").sequence + 900_000;
    wait_until("a forged command that is accepted", || {
        let forged = MirrorCommand { sequence, epoch: before, ..observer.command().1.expect("received") };
        observer.publish(&key, &encoded(&forged));
        telemetry(&observer).applied_sequence >= sequence || telemetry(&observer).epoch > before
    });
    wait_for_accepted(&observer);
    assert!(telemetry(&observer).epoch > before);
    wait_until("a report", || counter(&observer, "epoch:foreign-sequence") > 0);
    assert!(last_problem(&observer).contains("that it did not send"), "{}", last_problem(&observer));
    controller.end().json();
}

#[test]
fn a_controller_that_starts_beside_another_stands_by_and_takes_over_when_it_is_killed() {
    let setting = Setting::new();
    let mut first = setting.controller(0);
    let observer = setting.observer();
    let epoch = telemetry(&observer).epoch;
    let second = setting.controller(1);
    let of_second = RoomObserver::connect("demo", &[&setting.room_endpoint, &setting.controller_endpoints[1]]);
    let state = |observer: &RoomObserver| observer.status(NodeKind::Controller).map(|status| status.state);
    wait_until("a second controller in standby", || state(&of_second).is_some_and(|state| state == "standby"));
    wait_for_accepted(&observer);
    assert_eq!(telemetry(&observer).epoch, epoch, "the first one commands without interruption");

    first.kill();
    wait_until("an array that follows the second controller", || telemetry(&of_second).epoch > epoch);
    wait_for_accepted(&of_second);
    wait_until("a second controller that runs", || state(&of_second).is_some_and(|state| state == "running"));
    let summary = second.end().json();
    let events = |name: &str| summary["epoch_events"][name].as_u64();
    assert_eq!((events("stood-by"), events("took-over")), (Some(1), Some(1)), "{summary}");
    drop(setting.room);
}

#[test]
fn a_controller_that_ends_hands_over_to_the_standby_that_it_is_connected_to() {
    let setting = Setting::new();
    let first = setting.controller(0);
    let observer = setting.observer();
    let epoch = telemetry(&observer).epoch;
    let second = setting.controller_with(1, &["--standby", "--connect", &setting.controller_endpoints[0]]);
    let of_second = RoomObserver::connect("demo", &[&setting.room_endpoint, &setting.controller_endpoints[1]]);
    wait_until("a second controller in standby", || {
        of_second.status(NodeKind::Controller).is_some_and(|status| status.state == "standby")
    });
    let summary = first.end().json();
    // Its end waits for the takeover, which its telemetry shows.
    assert_eq!(summary["epoch_events"]["superseded"].as_u64(), Some(1), "{summary}");
    wait_until("a higher epoch", || of_second.telemetry().is_some_and(|array| array.epoch > epoch));
    wait_for_accepted(&of_second);
    wait_until("a controller alone that misses no standby", || {
        let status = of_second.status(NodeKind::Controller).expect("received");
        [NodeStatus::STANDBY, "peers", NodeStatus::STANDBY_MISSING].map(|name| status.counter(name)) == [Some(0); 3]
    });
    let summary = second.end().json();
    assert_eq!(summary["epoch_events"]["took-over"].as_u64(), Some(1), "{summary}");
    drop(setting.room);
}

#[test]
fn lost_reports_are_counted_by_stream() {
    let setting = Setting::new();
    let controller = setting.controller(0);
    let observer = setting.observer();
    let before = counter(&observer, "missed:users");
    // Numbers that no message has: a report of the source with a higher number than the next.
    wait_until("missed reports", || {
        let real = observer.users().expect("received");
        let forged = UserReport { stamp: Stamp { sequence: real.stamp.sequence + 50, ..real.stamp }, ..real };
        observer.publish(&observer.room().users(), &encoded(&forged));
        counter(&observer, "missed:users") >= before + 30
    });
    let summary = controller.end().json();
    assert!(summary["missed"]["users"].as_u64() >= Some(30), "{summary}");
}
