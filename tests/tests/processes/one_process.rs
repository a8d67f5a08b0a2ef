//! A controller that drives an array in its process: the array follows, stops and keeps its stop, other
//! controllers may command it, and no stop waits for a policy.

use std::net::SocketAddr;
use std::path::PathBuf;

use heliostat_bus::{BusConfig, free_loopback_endpoint, free_loopback_port, private_endpoint};
use heliostat_proto::messages::fault;
use heliostat_proto::{ArrayState, EmergencyStop, MirrorTelemetry, NodeKind, Rearm, Room, Stamp, StopAction};
use heliostat_service::clock::utc_ns;
use heliostat_tests::faults::{LoopbackBoard, Proxy, Tracker};
use heliostat_tests::{Process, RoomObserver, encoded, fetch_metrics, wait_until};
use serde_json::Value;

const ROOM: &str = "one-process";
const MIRRORS: [&str; 4] = ["--set", "mirrors.rows=2", "--set", "mirrors.columns=2"];

/// A board, a tracker, an observer, and the files of the array.
struct Setting {
    board: LoopbackBoard,
    folder: tempfile::TempDir,
    /// The tracker, which also the second controller reaches.
    of_tracker: String,
    /// In front of the tracker, for the first controller.
    proxy: Proxy,
    /// The array's session.
    of_array: String,
    of_observer: String,
    observer: RoomObserver,
    _tracker: Tracker,
}

impl Setting {
    fn new() -> Self {
        let board = LoopbackBoard::start(4);
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("array.toml"), board.configuration()).expect("a file");
        let of_tracker = free_loopback_endpoint().expect("an endpoint");
        let [of_array, of_observer] = [(); 2].map(|()| private_endpoint().expect("an endpoint"));
        let room = BusConfig::new(Room::new(ROOM).expect("a name"));
        let tracker = Tracker::start(&room.clone().listen_at(&of_tracker));
        let observer = RoomObserver::join(&room.listen_at(&of_observer));
        let proxy = Proxy::start(&of_tracker);
        Self { board, folder, of_tracker, proxy, of_array, of_observer, observer, _tracker: tracker }
    }

    fn file(&self, name: &str) -> String {
        PathBuf::from(self.folder.path()).join(name).display().to_string()
    }

    /// The controller with the array.
    fn start(&self, more: &[&str]) -> Process {
        let (file, state) = (self.file("array.toml"), self.file("state"));
        let sessions = ["--connect", self.proxy.endpoint(), "--connect", &self.of_observer];
        let array = ["--driver", &file, "--driver-listen", &self.of_array, "--state", &state, "--start-armed"];
        let flags = ["controller", "--room", ROOM, "--exit-with-parent", "--json"];
        Process::heliostat(&[&flags[..], &MIRRORS, &sessions, &array, more].concat())
    }

    fn telemetry(&self) -> MirrorTelemetry {
        wait_until("telemetry", || self.observer.telemetry().is_some());
        self.observer.telemetry().expect("received")
    }

    /// Waits until the array has accepted twenty more commands and follows them.
    fn wait_until_followed(&self) {
        let before = self.telemetry().counters.accepted;
        wait_until("accepted commands", || {
            let array = self.telemetry();
            array.counters.accepted >= before + 20 && array.state == ArrayState::Following
        });
    }

    fn stop(&self, sequence: u64) {
        let order = EmergencyStop {
            stamp: Stamp { source: 77, sequence, time_ns: utc_ns() },
            action: StopAction::Stop,
            operator: "ann".into(),
            reason: "smoke".into(),
        };
        self.observer.publish(&self.observer.room().stop(), &encoded(&order));
    }

    fn rearm(&self, sequence: u64) {
        let stamp = Stamp { source: 5, sequence, time_ns: utc_ns() };
        let order = Rearm { stamp, stop_source: 77, stop_sequence: sequence, ..Rearm::default() };
        self.observer.publish(&self.observer.room().rearm(), &encoded(&order));
    }

    /// Waits until the board has executed the stop.
    fn wait_until_stopped(&self) {
        wait_until("a stopped array", || {
            let array = self.telemetry();
            array.state == ArrayState::Stopped && array.faults & fault::STOP == 0
        });
    }
}

#[test]
fn the_array_follows_stops_and_keeps_its_stop_over_a_restart() {
    let setting = Setting::new();
    let process = setting.start(&[]);
    setting.wait_until_followed();
    wait_until("mirrors that turn", || !setting.board.longest_pause().is_zero());
    setting.stop(1);
    setting.wait_until_stopped();
    let summary = process.end().json();
    // The copies of the commands on the link of both sessions are no commands.
    let refused = summary["driver"]["refused"].as_object().expect("counts").clone();
    let unexpected: Vec<(&String, &Value)> = refused.iter().filter(|(name, _)| *name != "command:stopped").collect();
    assert!(unexpected.is_empty(), "{summary}");
    assert!(summary["driver"]["commands"].as_u64() >= Some(20), "{summary}");

    let ended = setting.observer.safety().map(|safety| safety.stamp.source);
    let restarted = setting.start(&[]);
    wait_until("a restarted array that knows its stop", || {
        setting.observer.safety().is_some_and(|safety| {
            let is_new = Some(safety.stamp.source) != ended;
            is_new && safety.stopped && safety.stop_source == 77 && safety.reason == "smoke"
        })
    });
    setting.wait_until_stopped();
    wait_until("a release", || {
        setting.rearm(1);
        setting.telemetry().state != ArrayState::Stopped
    });
    setting.wait_until_followed();
    assert!(restarted.end().json()["driver"]["commands"].as_u64() > Some(0));
}

#[test]
fn the_metrics_of_the_controller_say_whether_the_stop_of_its_array_is_recorded() {
    let setting = Setting::new();
    let address = SocketAddr::from(([127, 0, 0, 1], free_loopback_port().expect("a free port")));
    let process = setting.start(&["--metrics-listen", &address.to_string()]);
    wait_until("the metric", || {
        fetch_metrics(address).contains(&format!("heliostat_stop_recorded{{room=\"{ROOM}\"}} 1"))
    });
    process.end().json();
}

#[test]
fn another_controller_takes_the_array_over_by_the_contract() {
    let setting = Setting::new();
    let first = setting.start(&[]);
    setting.wait_until_followed();
    let epoch = setting.telemetry().epoch;
    let sessions = ["--connect", &setting.of_tracker, "--connect", &setting.of_array];
    let flags = ["controller", "--room", ROOM, "--exit-with-parent", "--json"];
    let second = Process::heliostat(&[&flags[..], &MIRRORS, &sessions].concat());
    wait_until("a controller that stands by", || second.errors().contains("stand"));
    // The first controller receives no reports, so that it commands no longer.
    setting.proxy.partition();
    wait_until("a higher epoch", || setting.telemetry().epoch > epoch);
    setting.wait_until_followed();
    let summary = second.end().json();
    assert!(summary["epoch"].as_u64() > Some(epoch), "{summary}");
    first.end();
}

#[test]
fn a_stop_does_not_wait_for_a_policy_that_does_not_return() {
    let setting = Setting::new();
    // A decision takes 5 s. It runs on the thread that receives the report.
    let search = ["--set", "control.search_time_us=5e6", "--set", "control.search_evaluations=100000000"];
    let _process = setting.start(&[&search[..], &["--policy", "pso"]].concat());
    let unanswered = || setting.observer.counter(NodeKind::Controller, "unanswered");
    let is_stopped_during_a_decision = |sequence| {
        let before = unanswered();
        wait_until("a decision that takes long", || unanswered() > before);
        let commands = setting.observer.command().0;
        setting.stop(sequence);
        setting.wait_until_stopped();
        let is_during = setting.observer.command().0 == commands;
        wait_until("a release", || {
            setting.rearm(sequence);
            setting.telemetry().state != ArrayState::Stopped
        });
        is_during
    };
    // A decision may end just after the stop.
    assert!((1..=3).any(is_stopped_during_a_decision), "each stop waited for a decision");
}
