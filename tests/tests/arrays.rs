//! A room with two arrays across processes: a command for each, one stop for all, one driver each.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use heliostat_array::Kit;
use heliostat_bus::{Bus, BusConfig, Class, Subscription, free_loopback_endpoint};
use heliostat_driver::run::{self, Settings};
use heliostat_driver::stop_record::StopRecordSettings;
use heliostat_proto::{ArrayState, MirrorCommand, MirrorTelemetry, Room, Stamp, UserReport, UserState, decode, encode};
use heliostat_scenario::Scenario;
use heliostat_service::Stop;
use heliostat_service::clock::utc_ns;
use heliostat_sim::mirrors::SimulatedMirrors;
use heliostat_tests::{Process, wait_until};

/// Six mirrors on one wall, then eight on another.
const TWO: &str =
    "name = \"two\"\n[[mirrors]]\nrows = 2\ncolumns = 3\n[[mirrors]]\nrows = 2\ncolumns = 4\nwall = \"-x\"\n";

fn scenario_file(folder: &Path) -> String {
    let file = folder.join("two.toml");
    std::fs::write(&file, TWO).expect("a writable folder");
    file.to_str().expect("a path in UTF-8").to_owned()
}

/// The latest command and telemetry of each array, and how many commands there were.
#[derive(Clone, Debug, Default)]
struct Latest {
    commands: BTreeMap<usize, (u64, MirrorCommand)>,
    telemetry: BTreeMap<usize, MirrorTelemetry>,
}

struct Observer {
    bus: Bus,
    latest: Arc<Mutex<Latest>>,
    _subscriptions: Vec<Subscription>,
}

impl Observer {
    fn join(room: &str, endpoints: &[&str]) -> Self {
        let config = BusConfig::new(Room::new(room).expect("a valid name"));
        let config = endpoints.iter().fold(config, |config, endpoint| config.connect_to(endpoint));
        let bus = Bus::open(&config).expect("the bus opens");
        let latest: Arc<Mutex<Latest>> = Arc::default();
        let mut subscriptions = Vec::new();
        for array in [0, 1] {
            let keys = bus.room().array(array);
            let kept = Arc::clone(&latest);
            subscriptions.push(bus.subscribe(&keys.command(), move |payload| {
                let mut latest = kept.lock().expect("no callback panics");
                let count = latest.commands.get(&array).map_or(0, |(count, _)| *count);
                latest.commands.insert(array, (count + 1, decode(payload).expect("a sound command")));
            }));
            let kept = Arc::clone(&latest);
            subscriptions.push(bus.subscribe(&keys.telemetry(), move |payload| {
                let telemetry = decode(payload).expect("sound telemetry");
                kept.lock().expect("no callback panics").telemetry.insert(array, telemetry);
            }));
        }
        let subscriptions = subscriptions.into_iter().collect::<Result<_, _>>().expect("valid keys");
        Self { bus, latest, _subscriptions: subscriptions }
    }

    fn latest(&self) -> Latest {
        self.latest.lock().expect("no callback panics").clone()
    }

    fn states(&self) -> Vec<ArrayState> {
        self.latest().telemetry.values().map(|telemetry| telemetry.state).collect()
    }

    /// Commands so far to an array.
    fn commands(&self, array: usize) -> u64 {
        self.latest().commands.get(&array).map_or(0, |(count, _)| *count)
    }
}

/// The programs of a simulated room with two arrays.
fn simulated(room: &str, folder: &Path) -> (Process, Process, [String; 2]) {
    let file = scenario_file(folder);
    let endpoints = [free_loopback_endpoint().expect("a free port"), free_loopback_endpoint().expect("a free port")];
    let shared = ["--scenario", &file, "--room", room, "--listen"];
    let sim = [&["sim-node"], &shared[..], &[&endpoints[0], "--exit-with-parent"]].concat();
    let policy = ["--connect", &endpoints[0], "--policy", "fixed-point", "--exit-with-parent"];
    let controller = [&["controller"], &shared[..], &[&endpoints[1]], &policy[..]].concat();
    (Process::heliostat(&sim), Process::heliostat(&controller), endpoints)
}

#[test]
fn each_array_follows_its_own_commands_and_one_stop_stops_both() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_sim, _controller, [of_sim, of_controller]) = simulated("stopped", folder.path());
    let observer = Observer::join("stopped", &[&of_sim, &of_controller]);
    wait_until("two arrays that follow", || observer.states() == [ArrayState::Following; 2]);
    wait_until("commands to both that telemetry shows", || {
        let Latest { commands, telemetry } = observer.latest();
        let shows = |(array, (_, command)): (&usize, &(u64, MirrorCommand))| {
            telemetry.get(array).is_some_and(|telemetry| telemetry.roll_commanded == command.roll)
        };
        commands.len() == 2 && commands.iter().all(shows)
    });
    let commands = observer.latest().commands;
    assert_eq!([&commands[&0], &commands[&1]].map(|(_, command)| command.roll.len()), [6, 8]);
    let turned = |array: usize| commands[&array].1.yaw.iter().any(|angle| angle.abs() > 0.01);
    assert!(turned(0) && turned(1), "{commands:?}");

    let order =
        |order: &str| Process::heliostat(&[order, "--room", "stopped", "--connect", &of_sim, "--json"]).wait().json();
    assert_eq!(order("stop")["array"], "stopped");
    wait_until("two arrays that are stopped", || observer.states() == [ArrayState::Stopped; 2]);
    assert_eq!(order("rearm")["array"], "released");
    wait_until("two arrays that follow again", || observer.states() == [ArrayState::Following; 2]);
}

#[test]
fn the_second_array_of_a_simulated_room_keeps_every_rule() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, endpoint) = (scenario_file(folder.path()), free_loopback_endpoint().expect("a free port"));
    let _sim = Process::heliostat(&[
        "sim-node",
        "--scenario",
        &file,
        "--room",
        "checked",
        "--listen",
        &endpoint,
        "--exit-with-parent",
    ]);
    let check = |arguments: &[&str]| {
        let flags = ["driver", "check", "--json", "--connect", &endpoint];
        Process::heliostat(&[&flags[..], arguments].concat()).wait().output
    };
    for named in [&["--room", "checked", "--array", "1"][..], &["heliostat/v1/checked/mirrors-1/command"]] {
        let report: serde_json::Value = serde_json::from_str(&check(named)).expect("a report");
        let findings = report["findings"].as_array().expect("a list");
        assert!(findings.len() > 15 && findings.iter().all(|finding| finding["verdict"] == "kept"), "{report}");
        assert_eq!(report["mirrors"], 8);
    }
}

/// The hash of a run in lockstep, recorded to a file.
fn lockstep(folder: &Path, seed: &str, recording: &str) -> String {
    let (file, endpoint) = (scenario_file(folder), free_loopback_endpoint().expect("a free port"));
    // Both other processes connect to the recorder, so that it receives the first tick.
    let of_recorder = free_loopback_endpoint().expect("a free port");
    let shared = ["--scenario", &file, "--seed", seed, "--room", "paced"];
    let flags = ["record", "--exit-with-parent", "--out", recording, "--listen", &of_recorder];
    let recorder = Process::heliostat(&[&flags[..], &shared].concat());
    let flags = ["sim-node", "--lockstep", "200", "--listen", &endpoint, "--connect", &of_recorder, "--json"];
    let sim = Process::heliostat(&[&flags[..], &shared].concat());
    std::thread::sleep(Duration::from_secs(2));
    let flags = ["controller", "--lockstep", "--policy", "greedy", "--connect", &endpoint, "--connect", &of_recorder];
    let controller = Process::heliostat(&[&flags[..], &["--exit-with-parent", "--json"], &shared].concat());
    let summary = sim.wait().json();
    controller.end();
    recorder.end();
    assert_eq!(summary["commands"].as_u64(), Some(400), "two for each tick: {summary}");
    summary["hash"].as_str().expect("a hash").to_owned()
}

#[test]
fn two_arrays_in_lockstep_are_the_same_again_and_a_recording_is_verified() {
    let folder = tempfile::tempdir().expect("a folder");
    let recording = |name: &str| folder.path().join(name).to_str().expect("a path in UTF-8").to_owned();
    let first = lockstep(folder.path(), "7", &recording("first.mcap"));
    assert_eq!(first, lockstep(folder.path(), "7", &recording("second.mcap")));
    assert_ne!(first, lockstep(folder.path(), "8", &recording("third.mcap")));
    let verified = Process::heliostat(&["replay", &recording("first.mcap"), "--verify", "--json"]).wait().json();
    let (same, different) = (verified["same"].as_u64(), verified["different"].as_u64());
    assert!(same > Some(200) && different == Some(0), "commands to both arrays: {verified}");
}

/// Drives one of two arrays until `stop`, with simulated mirrors in place of hardware.
fn drive(array: usize, config: BusConfig, folder: PathBuf, stop: &Stop) -> Result<u64, String> {
    let scenario = Scenario::from_toml(TWO).expect("valid");
    let model = scenario.channel_model().expect("a model");
    let mirrors = SimulatedMirrors::new(&scenario.actuator, &model.mirrors.arrays()[array], 1, array as u32);
    let record = StopRecordSettings { directory: Some(folder), start_armed: true };
    let settings = Settings { record, array, ..Settings::new(config) };
    run::run(Kit::new(mirrors), &settings, stop).map(|summary| summary.commands).map_err(|error| error.to_string())
}

/// Users at rest, as a tracker would report them.
fn report(tick: u64) -> Vec<u8> {
    let at = |user: u32| [user as f32 - 2.0, 0.5 * user as f32 - 1.0, 0.85];
    let user = |user: u32| UserState { user, position_m: at(user), velocity_m_s: [0.0; 2], min_rate_bps: 1e6 };
    let stamp = Stamp { source: 7, sequence: tick, time_ns: utc_ns() };
    let mut payload = Vec::new();
    encode(&UserReport { stamp, tick, users: (0..5).map(user).collect() }, &mut payload).expect("a sound report");
    payload
}

#[test]
fn two_drivers_share_a_room_and_the_end_of_one_leaves_the_other_commanded() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = scenario_file(folder.path());
    let endpoints: Vec<String> = (0..3).map(|_| free_loopback_endpoint().expect("a free port")).collect();
    let [first, second, of_controller] = &endpoints[..] else { unreachable!("three endpoints") };
    let config = || BusConfig::new(Room::new("driven").expect("a valid name"));
    let stops = [Stop::default(), Stop::default()];
    std::thread::scope(|scope| {
        let drivers: Vec<_> = [first, second]
            .into_iter()
            .zip(&stops)
            .enumerate()
            .map(|(array, (endpoint, stop))| {
                let (config, folder) = (config().listen_at(endpoint), folder.path().to_owned());
                scope.spawn(move || drive(array, config, folder, stop))
            })
            .collect();
        let _controller = Process::heliostat(&[
            "controller",
            "--scenario",
            &file,
            "--room",
            "driven",
            "--connect",
            first,
            "--connect",
            second,
            "--listen",
            of_controller,
            "--policy",
            "fixed-point",
            "--exit-with-parent",
        ]);
        let observer = Observer::join("driven", &[first, second, of_controller]);
        let tracker = observer.bus.publisher(&observer.bus.room().users(), Class::RealTimeDrop).expect("a valid key");
        let mut tick = 0;
        let mut until = |what: &str, is_so: &dyn Fn() -> bool| {
            wait_until(what, || {
                tick += 1;
                tracker.put(&report(tick)).expect("the session is open");
                std::thread::sleep(Duration::from_millis(10));
                is_so()
            });
        };
        until("two arrays that follow", &|| observer.states() == [ArrayState::Following; 2]);
        // A second driver of an array finds the first one, and not that of the other array.
        let refused =
            drive(1, config().connect_to(first).connect_to(second), folder.path().to_owned(), &Stop::default());
        assert!(refused.as_ref().is_err_and(|error| error.contains("driver-1/")), "{refused:?}");

        stops[1].request();
        let mut drivers = drivers.into_iter();
        let first_driver = drivers.next().expect("two drivers");
        let accepted = drivers.next().expect("two drivers").join().expect("no panic").expect("a driver that ends");
        assert!(accepted > 0);
        let lost = observer.commands(1);
        until("no more commands to the array that left", &|| observer.commands(0) > lost + 200);
        let (before, others) = (observer.commands(1), observer.commands(0));
        until("commands to the first array alone", &|| observer.commands(0) > others + 50);
        assert_eq!(observer.commands(1), before);
        assert_eq!(observer.latest().telemetry[&0].state, ArrayState::Following);
        stops[0].request();
        assert!(first_driver.join().expect("no panic").expect("a driver that ends") > 250);
    });
}
