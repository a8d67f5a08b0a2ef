//! A room with two arrays across processes: a command for each, one stop for all, one driver each.

use std::path::Path;
use std::time::Duration;

use heliostat_bus::{BusConfig, Class, private_endpoint};
use heliostat_proto::{ArrayState, MirrorCommand, NodeKind, Room};
use heliostat_service::Stop;
use heliostat_tests::faults::users_at_rest;
use heliostat_tests::{Process, encoded, wait_until};

use room::{Observer, RequestAtEnd, drive, scenario_file};

mod page;
mod room;

/// The programs of a simulated room with two arrays.
fn simulated(room: &str, folder: &Path) -> (Process, Process, [String; 2]) {
    let file = scenario_file(folder);
    let endpoints = [private_endpoint().expect("an endpoint"), private_endpoint().expect("an endpoint")];
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
        observer.commands.iter().zip(&observer.telemetry).all(|(command, telemetry)| {
            let both = command.get().zip(telemetry.get());
            both.is_some_and(|(command, telemetry)| telemetry.roll_commanded == command.roll)
        })
    });
    let commands = observer.commands.each_ref().map(|command| command.get().expect("waited for"));
    assert_eq!(commands.each_ref().map(|command| command.roll.len()), [6, 8]);
    let turned = |command: &MirrorCommand| command.yaw.iter().any(|angle| angle.abs() > 0.01);
    assert!(commands.iter().all(turned), "{commands:?}");

    let order =
        |order: &str| Process::heliostat(&[order, "--room", "stopped", "--connect", &of_sim, "--json"]).wait().json();
    let stopped = order("stop");
    assert_eq!(stopped["array"], "stopped");
    assert_eq!(stopped["unrecorded"], serde_json::json!([]), "{stopped}");
    assert_eq!(stopped["stops"][0]["reason"], "command line", "{stopped}");
    wait_until("two arrays that are stopped", || observer.states() == [ArrayState::Stopped; 2]);
    assert_eq!(order("rearm")["array"], "released");
    wait_until("two arrays that follow again", || observer.states() == [ArrayState::Following; 2]);
}

#[test]
fn the_second_array_of_a_simulated_room_keeps_every_rule() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, endpoint) = (scenario_file(folder.path()), private_endpoint().expect("an endpoint"));
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
    let observer = Observer::join("checked", &[&endpoint]);
    wait_until("telemetry of both arrays", || observer.states().len() == 2);
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
    let (file, endpoint) = (scenario_file(folder), private_endpoint().expect("an endpoint"));
    // Both other processes connect to the recorder, so that it receives the first tick.
    let of_recorder = private_endpoint().expect("an endpoint");
    let shared = ["--scenario", &file, "--seed", seed, "--room", "paced"];
    let flags = ["record", "--exit-with-parent", "--out", recording, "--listen", &of_recorder];
    let recorder = Process::heliostat(&[&flags[..], &shared].concat());
    let flags = ["sim-node", "--lockstep", "200", "--listen", &endpoint, "--connect", &of_recorder, "--json"];
    let sim = Process::heliostat_without_loss(&[&flags[..], &shared].concat());
    wait_until("a recorder connected to the room", || recorder.has_noted(NodeKind::SimNode));
    let flags = ["controller", "--lockstep", "--policy", "greedy", "--connect", &endpoint, "--connect", &of_recorder];
    let controller =
        Process::heliostat_without_loss(&[&flags[..], &["--exit-with-parent", "--json"], &shared].concat());
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

    // Played back into a controller process: both arrays are answered as recorded.
    let file = scenario_file(folder.path());
    let of_player = private_endpoint().expect("an endpoint");
    let player = Process::heliostat(&["replay", &recording("first.mcap"), "--listen", &of_player, "--json"]);
    let flags = ["controller", "--lockstep", "--policy", "greedy", "--room", "paced", "--scenario", &file];
    let _controller = Process::heliostat(&[&flags[..], &["--connect", &of_player, "--exit-with-parent"]].concat());
    let playback = player.wait().json();
    assert_eq!((playback["same"].as_u64(), playback["different"].as_u64()), (Some(400), Some(0)), "{playback}");
}

#[test]
fn two_drivers_share_a_room_and_the_end_of_one_leaves_the_other_commanded() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = scenario_file(folder.path());
    let endpoints: Vec<String> = (0..3).map(|_| private_endpoint().expect("an endpoint")).collect();
    let [first, second, of_controller] = &endpoints[..] else { unreachable!("three endpoints") };
    let config = || BusConfig::new(Room::new("driven").expect("a valid name"));
    let stops = [Stop::default(), Stop::default()];
    std::thread::scope(|scope| {
        let _end = RequestAtEnd(stops.to_vec());
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
            // A busy machine delays the check of a command.
            "--set",
            "control.validity_ms=10000",
            "--exit-with-parent",
        ]);
        let observer = Observer::join("driven", &[first, second, of_controller]);
        let tracker = observer.bus.publisher(&observer.bus.room().users(), Class::RealTimeDrop).expect("a valid key");
        let mut tick = 0;
        let mut until = |what: &str, is_so: &dyn Fn() -> bool| {
            wait_until(what, || {
                tick += 1;
                tracker.put(&encoded(&users_at_rest(7, tick))).expect("the session is open");
                std::thread::sleep(Duration::from_millis(10));
                is_so()
            });
        };
        until("two arrays that follow", &|| observer.states() == [ArrayState::Following; 2]);
        // A second driver of an array finds the first one, and not that of the other array.
        let refused =
            drive(1, config().connect_to(first).connect_to(second), folder.path().to_owned(), &Stop::default());
        assert!(refused.as_ref().is_err_and(|error| error.contains("driver-1/")), "{refused:?}");

        until("a status of each driver under its own key", &|| {
            let [first, second] = observer.drivers.each_ref().map(|status| status.get().map(|it| it.stamp.source));
            first.is_some() && second.is_some() && first != second
        });

        stops[1].request();
        let mut drivers = drivers.into_iter();
        let first_driver = drivers.next().expect("two drivers");
        let accepted = drivers.next().expect("two drivers").join().expect("no panic").expect("a driver that ends");
        assert!(accepted > 0);
        let lost = observer.commands(1);
        until("a report of the array that left", &|| observer.controller_counter("driver_absent") == 1);
        assert_eq!(observer.controller_counter("driver_absent:mirrors-1"), 1);
        assert_eq!(observer.controller_counter("driver_absent:mirrors"), 0);
        let absence = "no driver receives the commands to mirrors-1";
        until("a status that names the absence", &|| {
            let status = observer.controller.get().expect("a status");
            status.last_problem.starts_with(absence) && status.state == absence
        });
        until("no more commands to the array that left", &|| observer.commands(0) > lost + 200);
        let (before, others) = (observer.commands(1), observer.commands(0));
        until("commands to the first array alone", &|| observer.commands(0) > others + 50);
        assert_eq!(observer.commands(1), before);
        until("a first array that follows", &|| observer.states()[0] == ArrayState::Following);
        stops[0].request();
        assert!(first_driver.join().expect("no panic").expect("a driver that ends") > 250);
    });
}
