//! The promise of the emergency stop across processes: no operator is told that a room is stopped
//! while a mirror can move, and a stop reaches each array, whenever it returns.

use std::path::Path;
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, BusConfig, Class, Publisher, free_loopback_endpoint};
use heliostat_proto::{
    ArrayState, EmergencyStop, LostDriver, MirrorTelemetry, NodeKind, NodeStatus, Rearm, Room, Stamp, StopReport,
    decode,
};
use heliostat_service::clock::utc_ns;
use heliostat_tests::faults::{Behaviour, LoopbackBoard, Tracker};
use heliostat_tests::{Ended, Latest, Process, TWO_ARRAYS, encoded, wait_until};

/// A controller, two drivers with a board each, and a tracker.
struct TwoArrays {
    room: String,
    folder: tempfile::TempDir,
    boards: [LoopbackBoard; 2],
    drivers: [Option<Process>; 2],
    endpoints: [String; 2],
    of_controller: String,
    scenario: String,
    controller: Process,
    bus: Bus,
    telemetry: [Latest<MirrorTelemetry>; 2],
    stops: [Latest<StopReport>; 2],
    status: Latest<NodeStatus>,
    /// Reports users, so that the controller commands.
    _tracker: Tracker,
}

impl TwoArrays {
    fn start(room: &str) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let boards = [LoopbackBoard::start(6), LoopbackBoard::start(8)];
        let scenario = folder.path().join("two.toml");
        std::fs::write(&scenario, TWO_ARRAYS).expect("a writable folder");
        for (array, board) in boards.iter().enumerate() {
            std::fs::write(config(folder.path(), array), board.configuration()).expect("a writable folder");
        }
        let endpoint = || free_loopback_endpoint().expect("a free port");
        let (endpoints, of_controller) = ([endpoint(), endpoint()], endpoint());
        let scenario = scenario.to_str().expect("a path in UTF-8").to_owned();
        let controller = start_controller(room, &scenario, &endpoints, &of_controller);
        let config = BusConfig::new(Room::new(room).expect("a valid name"));
        let config = config.connect_to(&endpoints[0]).connect_to(&endpoints[1]).connect_to(&of_controller);
        let bus = Bus::open(&config).expect("the bus opens");
        let mut room = Self {
            room: room.to_owned(),
            folder,
            boards,
            drivers: [None, None],
            endpoints,
            of_controller,
            scenario,
            controller,
            telemetry: [0, 1].map(|array| Latest::of(&bus, &bus.room().array(array).telemetry())),
            stops: [0, 1].map(|array| Latest::of(&bus, &bus.room().array(array).stops())),
            status: Latest::of(&bus, &bus.room().status(NodeKind::Controller)),
            bus,
            _tracker: Tracker::start(&config),
        };
        room.start_driver(0);
        room.start_driver(1);
        room.wait_for([ArrayState::Following; 2]);
        room
    }

    fn start_driver(&mut self, array: usize) {
        let (config, state) = (config(self.folder.path(), array), self.folder.path().display().to_string());
        let index = array.to_string();
        let flags = ["driver", "run", "--config", &config, "--state", &state, "--start-armed", "--array", &index];
        let own = ["--room", &self.room, "--listen", &self.endpoints[array], "--exit-with-parent"];
        self.drivers[array] = Some(Process::heliostat(&[&flags[..], &own].concat()));
    }

    fn driver(&mut self, array: usize) -> &mut Process {
        self.drivers[array].as_mut().expect("it was started")
    }

    fn states(&self) -> [Option<ArrayState>; 2] {
        self.telemetry.each_ref().map(|telemetry| telemetry.get().map(|telemetry| telemetry.state))
    }

    fn wait_for(&self, states: [ArrayState; 2]) {
        wait_until("the states of both arrays", || self.states() == states.map(Some));
    }

    /// The names of the stops that an array reports.
    fn operators(&self, array: usize) -> Vec<String> {
        let stops = self.stops[array].get().map(|report| report.stops).unwrap_or_default();
        stops.into_iter().map(|stop| stop.operator).collect()
    }

    /// Runs `heliostat stop` or `heliostat rearm`.
    fn order(&self, order: &str, flags: &[&str]) -> Ended {
        self.order_within("12", order, flags)
    }

    /// The same with a time limit in s.
    fn order_within(&self, seconds: &str, order: &str, flags: &[&str]) -> Ended {
        self.order_under(&[], seconds, order, flags)
    }

    /// The same under another program.
    fn order_under(&self, wrapper: &[&str], seconds: &str, order: &str, flags: &[&str]) -> Ended {
        let own = [order, "--room", &self.room, "--timeout", seconds];
        let [first, second] = &self.endpoints;
        let connect = ["--connect", first, "--connect", second, "--connect", &self.of_controller];
        Process::heliostat_under(wrapper, &[], &[&own[..], &connect, flags].concat()).wait()
    }
}

fn start_controller(room: &str, scenario: &str, endpoints: &[String; 2], own: &str) -> Process {
    let set = ["--set", "control.validity_ms=10000", "--policy", "fixed-point", "--exit-with-parent"];
    let flags = ["controller", "--scenario", scenario, "--room", room, "--listen", own];
    let connect = ["--connect", &endpoints[0], "--connect", &endpoints[1]];
    Process::heliostat(&[&flags[..], &connect, &set].concat())
}

fn config(folder: &Path, array: usize) -> String {
    folder.join(format!("array-{array}.toml")).display().to_string()
}

#[test]
fn a_room_with_an_absent_array_is_not_called_stopped_and_the_array_gets_the_stop_when_it_returns() {
    let mut room = TwoArrays::start("absent");
    room.driver(1).kill();
    let stopped = room.order("stop", &["--operator", "ann", "--reason", "person on the ladder"]);
    let refusal = stopped.refusal();
    assert!(
        refusal.contains(
            "array 1 does not answer: cut its power\nstopped by their reports: array 0\nThe stop was sent, and stays in force"
        ),
        "{refusal}"
    );
    assert!(!refusal.contains("array 0 "), "nothing is open there: {refusal}");
    wait_until("the first array stopped", || room.states()[0] == Some(ArrayState::Stopped));
    wait_until("its stop report", || room.operators(0) == ["ann"]);
    let name = room.stops[0].get().and_then(|report| report.stops.first().map(|stop| stop.name()));
    let named = format!("The stop is {}; to release it: `heliostat rearm ", name.expect("a stop with a name"));
    assert!(refusal.contains(&named), "{refusal}");
    // The command has ended; the controller holds the stop.
    room.start_driver(1);
    wait_until("the stop at the array that returned", || room.operators(1) == ["ann"]);
    wait_until("a controller that names the stop", || {
        let state = room.status.get().map(|status| status.state).unwrap_or_default();
        state.starts_with("withheld by the stop of ann (\"person on the ladder\") since ")
    });
    // The telemetry of the driver that was killed shows an array that follows.
    room.wait_for([ArrayState::Stopped; 2]);
    let accepted = room.telemetry[1].get().map_or(0, |telemetry| telemetry.counters.accepted);
    assert_eq!(accepted, 0, "it followed no command before the stop");
    assert!(room.order("stop", &[]).status.success(), "now every array has stopped");
    let released = room.order("rearm", &["--all"]);
    assert!(released.status.success(), "{}", released.errors);
    room.wait_for([ArrayState::Following; 2]);
}

#[test]
fn a_controller_that_starts_after_the_stop_holds_it_for_an_array_that_was_absent() {
    let mut room = TwoArrays::start("restarted");
    room.driver(1).kill();
    assert!(!room.order("stop", &["--operator", "ann"]).status.success());
    wait_until("the first array stopped", || room.operators(0) == ["ann"]);
    // The stop is known to the first array alone.
    room.controller.kill();
    room.controller = start_controller(&room.room, &room.scenario, &room.endpoints, &room.of_controller);
    room.start_driver(1);
    wait_until("the stop at the array that returned", || room.operators(1) == ["ann"]);
    room.wait_for([ArrayState::Stopped; 2]);
    let absent = room.order("rearm", &["--all"]);
    assert!(absent.status.success(), "{}", absent.errors);
    room.wait_for([ArrayState::Following; 2]);
}

#[test]
fn a_frozen_driver_is_named_and_stopped_as_soon_as_it_continues() {
    let mut room = TwoArrays::start("frozen");
    room.driver(1).signal("STOP");
    // Less than the lease of a connection.
    let stopped = room.order_within("4", "stop", &["--operator", "ann"]);
    assert!(stopped.refusal().contains("array 1 does not answer: cut its power"), "{}", stopped.errors);
    room.driver(1).signal("CONT");
    wait_until("the stop at the array that continued", || room.operators(1) == ["ann"]);
    room.wait_for([ArrayState::Stopped; 2]);
    room.boards[1].longest_pause();
    wait_until("stop reports of both devices", || {
        room.stops.iter().all(|stops| stops.get().is_some_and(|report| report.device_stopped))
    });
}

#[test]
fn a_driver_that_was_lost_before_the_stop_is_named_until_a_release() {
    let room = TwoArrays::start("lost");
    // Peers pass nothing on: neither driver of the second array sees the other one.
    let board = LoopbackBoard::start(8);
    let (config, state) = (config(room.folder.path(), 2), room.folder.path().join("third").display().to_string());
    std::fs::write(&config, board.configuration()).expect("a writable folder");
    let flags = ["driver", "run", "--config", &config, "--state", &state, "--start-armed", "--array", "1"];
    let listen = free_loopback_endpoint().expect("a free port");
    let own = ["--room", "lost", "--listen", &listen, "--connect", &room.of_controller, "--exit-with-parent"];
    let mut third = Process::heliostat(&[&flags[..], &own].concat());
    let beside = Bus::open(&BusConfig::new(room.bus.room().clone()).connect_to(&listen)).expect("the bus opens");
    let telemetry = Latest::<MirrorTelemetry>::of(&beside, &beside.room().array(1).telemetry());
    let status = || room.status.get().unwrap_or_default();
    wait_until("both drivers of the second array", || {
        ["source ", "mirrors-1"].iter().all(|part| status().last_problem.contains(part))
    });
    // One that ends at its start without a command has moved no mirror.
    wait_until("a command at the third driver", || telemetry.get().is_some_and(|found| found.counters.accepted > 0));
    third.kill();
    let lost = || LostDriver::all_of(&status());
    wait_until("the loss of one of them", || !lost().is_empty());
    let LostDriver { array, source, .. } = lost()[0];
    let line = format!("driver {source:016x} of mirrors-1 has left the room, and another one serves this array");
    wait_until("the journal", || room.controller.errors().contains(&line));
    let stopped = room.order_within("4", "stop", &[]);
    let (refusal, lost_one) = (stopped.refusal(), format!("driver {source:016x} was lost at "));
    let is_named = refusal.contains(&format!("array 1 is not confirmed: {lost_one}"));
    assert!(array == 1 && is_named && is_stopped_only(refusal, 0), "{refusal}");
    room.wait_for([ArrayState::Stopped; 2]);
    let released = room.order("rearm", &["--all"]);
    let is_named = released.errors.contains(&format!("array 1: {lost_one}"));
    assert!(released.status.success() && is_named, "{}", released.errors);
    wait_until("the release at the controller", || lost().is_empty());
    assert!(room.order("stop", &[]).status.success(), "the release has ended the loss");
}

/// Whether a refusal names this array as the one that has stopped, and nowhere else.
fn is_stopped_only(refusal: &str, array: usize) -> bool {
    let named = format!("array {array}");
    refusal.contains(&format!("\nstopped by their reports: {named}\n")) && refusal.matches(&named).count() == 1
}

#[test]
fn a_held_stop_that_an_array_never_confirms_ends_with_status_1_also_after_a_signal() {
    let mut room = TwoArrays::start("never");
    room.driver(1).kill();
    let flags = ["stop", "--hold", "--timeout", "1", "--room", "never", "--connect", &room.of_controller];
    let mut held = Process::heliostat(&flags);
    wait_until("the held stop", || held.errors().contains("the stop is held: end with Ctrl-C"));
    held.signal("INT");
    let ended = held.wait_mut();
    assert_eq!(ended.status.code(), Some(1), "{}", ended.errors);
    let named = "not every array has confirmed the stop: stopped by their reports: array 0; array 1 does not answer";
    assert!(ended.errors.contains(named), "{}", ended.errors);
}

#[test]
fn a_held_stop_states_that_an_array_that_returned_has_confirmed_it_and_that_one_no_longer_does() {
    let mut room = TwoArrays::start("returned");
    room.driver(1).kill();
    let [first, second] = &room.endpoints;
    let flags = ["stop", "--hold", "--timeout", "1", "--room", "returned", "--connect", &room.of_controller];
    let flags = [&flags[..], &["--connect", first, "--connect", second]].concat();
    // Both outputs in one, in their order.
    let mut held = Process::heliostat_under(&["sh", "-c", "exec \"$@\" 1>&2", "sh"], &[], &flags);
    wait_until("the held stop", || held.errors().contains("the stop is held: end with Ctrl-C"));
    let confirmed = "the arrays of room returned are stopped, confirmed after ";
    assert!(!held.errors().contains(confirmed), "{}", held.errors());
    room.start_driver(1);
    wait_until("the confirmation", || held.errors().contains(confirmed));
    room.driver(1).kill();
    let open =
        "not every array confirms the stop any longer: stopped by their reports: array 0; array 1 does not answer";
    wait_until("the end of the confirmation", || held.errors().contains(open));
    room.start_driver(1);
    wait_until("the second confirmation", || held.errors().contains("every array confirms the stop again"));
    held.signal("INT");
    let ended = held.wait_mut();
    assert!(ended.status.success(), "{}", ended.errors);
}

#[test]
fn an_array_whose_board_refuses_the_stop_or_hangs_up_is_named() {
    let room = TwoArrays::start("refusing");
    for behaviour in [Behaviour::RefusesStops, Behaviour::Absent] {
        room.boards[1].behave(behaviour);
        let stopped = room.order("stop", &[]);
        let open = "array 1 has latched the stop, but its device has not executed it";
        assert!(stopped.refusal().contains(open), "{behaviour:?}: {}", stopped.errors);
        assert!(is_stopped_only(&stopped.errors, 0), "{}", stopped.errors);
    }
    room.boards[1].behave(Behaviour::Prompt);
    let stopped = room.order("stop", &[]);
    assert!(stopped.status.success(), "{}", stopped.errors);
}

#[test]
fn the_stops_of_two_operators_are_listed_and_released_one_by_one() {
    let room = TwoArrays::start("operators");
    for operator in ["ann", "bob"] {
        let stopped = room.order("stop", &["--operator", operator, "--reason", "ladder"]);
        assert!(stopped.status.success(), "{}", stopped.errors);
        // Its own one, also beside that of the other operator.
        let own = stopped.output.lines().find(|line| line.starts_with("the stop: ")).unwrap_or_default();
        assert!(own.ends_with(&format!("of \"{operator}\": \"ladder\"")), "{}", stopped.output);
        let others = stopped.output.lines().filter(|line| line.starts_with("another stop: ")).count();
        assert_eq!(others, usize::from(operator == "bob"), "{}", stopped.output);
    }
    wait_until("both stops", || room.operators(0) == ["ann", "bob"] && room.operators(1) == ["ann", "bob"]);
    let several = room.order("rearm", &[]);
    let refusal = several.refusal();
    assert!(
        refusal.contains("2 stops are in force") && refusal.contains("of ann") && refusal.contains("--all"),
        "{refusal}"
    );
    let stops = room.stops[0].get().expect("a report").stops;
    let name = stops[1].name().to_string();
    let released = room.order("rearm", &["--stop", &name]);
    assert!(released.status.success(), "{}", released.errors);
    let (one, rest) = ("the named stop of room operators is released", "; the mirrors stay stopped by ");
    let is_precise = released.output.starts_with(one)
        && released.output.contains(&format!("{rest}{} of ann (\"ladder\") at array 0, 1", stops[0].name()));
    assert!(is_precise, "{}", released.output);
    wait_until("one stop", || room.operators(0) == ["ann"] && room.operators(1) == ["ann"]);
    room.wait_for([ArrayState::Stopped; 2]);
    let released = room.order("rearm", &["--all"]);
    assert!(released.status.success(), "{}", released.errors);
    room.wait_for([ArrayState::Following; 2]);
}

#[test]
fn an_order_whose_output_cannot_be_written_is_reported_on_standard_error() {
    let room = TwoArrays::start("full");
    let full = ["sh", "-c", "exec \"$0\" \"$@\" > /dev/full"];
    for (order, outcome) in [("stop", "stopped"), ("rearm", "released")] {
        let ended = room.order_under(&full, "12", order, &[]);
        assert_eq!(ended.status.code(), Some(1), "{}", ended.errors);
        let outcome = format!("the arrays of room full are {outcome}, confirmed after ");
        let is_complete = ended.errors.contains(&outcome) && ended.errors.contains("cannot write to standard output: ");
        assert!(is_complete, "{order}: {}", ended.errors);
    }
}

#[test]
fn a_stop_that_reaches_only_the_controller_reaches_the_arrays_through_it() {
    let room = TwoArrays::start("one-way");
    // This session is connected to the controller alone, and peers do not forward messages.
    let config = BusConfig::new(Room::new("one-way").expect("a valid name"));
    let bus = Bus::open(&config.connect_to(&room.of_controller)).expect("the bus opens");
    let publisher = bus.publisher(&bus.room().stop(), Class::RealTimeBlock).expect("a valid key");
    let stamp = Stamp { source: 0xabc, sequence: 1, time_ns: utc_ns() };
    let order = EmergencyStop { stamp, operator: "eve".into(), reason: "smoke".into(), ..EmergencyStop::default() };
    wait_until("the stop at both arrays", || {
        // The first messages of a session may find no subscriber.
        publisher.put(&encoded(&order)).expect("the session is open");
        room.operators(0) == ["eve"] && room.operators(1) == ["eve"]
    });
    drop(bus);
    let released = room.order("rearm", &[]);
    assert!(released.output.contains("0000000000000abc/1 of \"eve\""), "{} {}", released.output, released.errors);
    room.wait_for([ArrayState::Following; 2]);
}

#[test]
fn a_stop_goes_through_every_endpoint_and_an_interrupted_one_says_what_is_known() {
    let mut room = TwoArrays::start("apart");
    // The drivers have no link to each other.
    room.controller.kill();
    // Without --arrays the number is unknown, and what is known is printed beside the error.
    let unknown = room.order("stop", &["--json"]);
    assert!(unknown.refusal().contains("\nstopped by their reports: array 0, 1\n"), "{}", unknown.errors);
    let object = unknown.last_json();
    let error = object["error"].as_str().unwrap_or_default();
    assert!(error.contains("no process announces how many arrays"), "{object}");
    assert_eq!((&object["room"], &object["array"]), (&"apart".into(), &"unknown".into()), "{object}");
    assert_eq!(object["stopped"], serde_json::json!([0, 1]), "{object}");
    assert_eq!(
        (&object["stops"], object["unrecorded"].as_array()),
        (&object["in_force"], Some(&Vec::new())),
        "{object}"
    );
    let own =
        format!("{}/{}", object["stops"][0]["source"].as_str().unwrap_or_default(), object["stops"][0]["sequence"]);
    assert!(error.contains(&format!("The stop is {own}; to release it")), "{object}");
    let released = room.order("rearm", &["--stop", &own]);
    assert!(released.status.success(), "{} {}", released.output, released.errors);
    let stopped = room.order("stop", &["--arrays", "2"]);
    assert!(stopped.status.success(), "{}", stopped.errors);
    room.wait_for([ArrayState::Stopped; 2]);
    let released = room.order("rearm", &["--all"]);
    assert!(released.status.success(), "{} {}", released.output, released.errors);
    wait_until("both arrays released", || !room.states().contains(&Some(ArrayState::Stopped)));
    // One that never answers delays no order, and the second array is out of reach: the command waits for it.
    let silent = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let silent = format!("tcp/{}", silent.local_addr().expect("bound"));
    let flags = ["stop", "--room", &room.room, "--connect", &silent, "--connect", &room.endpoints[0]];
    let mut order = Process::heliostat(&[&flags[..], &["--arrays", "2", "--timeout", "60"]].concat());
    wait_until("the first array stopped", || room.states()[0] == Some(ArrayState::Stopped));
    order.signal("INT");
    let ended = order.wait_mut();
    let is_named = ["interrupted: the stop was given, and is not confirmed: ", "; array 1 does not answer"]
        .iter()
        .all(|part| ended.errors.contains(part));
    assert!(!ended.status.success() && is_named, "{}", ended.errors);
}

#[test]
fn a_held_stop_joins_through_a_process_and_an_interrupted_one_without_connection_says_what_is_known() {
    let room = TwoArrays::start("held");
    // Peers pass nothing on: the reports of the arrays come through the controller only.
    let flags = ["stop", "--hold", "--seconds", "1", "--room", &room.room, "--connect", &room.of_controller];
    let held = Process::heliostat(&flags).wait();
    assert!(held.output.contains("the arrays of room held are stopped, confirmed after "), "{}", held.errors);
    let absent = free_loopback_endpoint().expect("a free port");
    // The wait for a confirmation is longer than that of this test.
    let flags = ["stop", "--hold", "--room", &room.room, "--connect", &absent, "--timeout", "600", "--json"];
    let mut order = Process::heliostat(&flags);
    wait_until("the reason", || order.errors().contains(&format!("no process answers at {absent}")));
    order.signal("INT");
    let ended = order.wait_mut();
    assert_eq!(ended.status.code(), Some(130), "{}", ended.errors);
    assert!(ended.errors.contains("heliostat stop: interrupted: "), "{}", ended.errors);
    let object = ended.last_json();
    assert!(object["error"].as_str().is_some_and(|error| error.starts_with("interrupted: ")), "{object}");
}

#[test]
fn a_stop_at_an_endpoint_without_a_process_says_that_nothing_was_sent() {
    let endpoint = free_loopback_endpoint().expect("a free port");
    for (order, end) in
        [("stop", "To stop the mirrors now, cut their power"), ("rearm", "Each stop that is in force stays so")]
    {
        for client in [&["--client"][..], &[]] {
            let ended = Process::heliostat(&[&[order, "--connect", &endpoint][..], client].concat()).wait();
            let refusal = ended.refusal();
            let expected = format!("no process answers at {endpoint}. Nothing was sent");
            assert!(refusal.contains(&expected), "{order} {client:?}: {refusal}");
            assert!(refusal.trim().ends_with(end), "{refusal}");
        }
    }
    // A process of another kind accepts connections there.
    let other = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let endpoint = format!("tcp/{}", other.local_addr().expect("bound"));
    let ended = Process::heliostat(&["stop", "--connect", &endpoint]).wait();
    let refusal = ended.refusal();
    assert!(refusal.contains(&format!("{endpoint} does not answer as a process of a room within 2 s")), "{refusal}");
    assert!(refusal.contains("Nothing was sent") && refusal.trim().ends_with("cut their power"), "{refusal}");
}

/// Prints how long a stop takes from its publication to the report that the device has executed it.
#[test]
fn the_latency_of_a_stop_at_a_simulated_array_and_at_a_driver_is_printed() {
    let room = TwoArrays::start("latency");
    let driven = latencies(&room.bus, 0);
    let endpoint = free_loopback_endpoint().expect("a free port");
    let set = ["--set", "streams.positions.rate_hz=10", "--set", "streams.telemetry.rate_hz=10"];
    let flags = ["sim-node", "--room", "simulated", "--listen", &endpoint, "--exit-with-parent"];
    let _sim = Process::heliostat(&[&flags[..], &set].concat());
    let config = BusConfig::new(Room::new("simulated").expect("a valid name")).connect_to(&endpoint);
    let bus = Bus::open(&config).expect("the bus opens");
    let simulated = latencies(&bus, 0);
    for (name, mut times) in [("driver run", driven), ("simulated array at 10 reports/s", simulated)] {
        times.sort_unstable();
        let (p50, max) = (times[times.len() / 2], times[times.len() - 1]);
        eprintln!("{name}: p50 {:.2} ms, max {:.2} ms of {}", ms(p50), ms(max), times.len());
    }
}

fn ms(duration: Duration) -> f64 {
    1e3 * duration.as_secs_f64()
}

/// Times from a stop to the report of an array that its device has executed it.
fn latencies(bus: &Bus, array: usize) -> Vec<Duration> {
    let (sender, reports) = std::sync::mpsc::channel::<(Instant, StopReport)>();
    let _subscription = bus
        .subscribe(&bus.room().array(array).stops(), move |payload| {
            drop(sender.send((Instant::now(), decode(payload).expect("a sound report"))));
        })
        .expect("a valid key");
    let publisher = |key: String| bus.publisher(&key, Class::RealTimeBlock).expect("a valid key");
    let (stops, rearms) = (publisher(bus.room().stop()), publisher(bus.room().rearm()));
    let put = |publisher: &Publisher, payload: Vec<u8>| publisher.put(&payload).expect("the session is open");
    let until = |is: &dyn Fn(&StopReport) -> bool| loop {
        let (at, report) = reports.recv_timeout(Duration::from_secs(60)).expect("a report");
        if is(&report) {
            return at;
        }
    };
    until(&|_| true);
    let time = |sequence: u64| {
        let stamp = Stamp { source: 0xabc, sequence, time_ns: utc_ns() };
        let begun = Instant::now();
        put(&stops, encoded(&EmergencyStop { stamp, ..EmergencyStop::default() }));
        let stopped = until(&|report| report.device_stopped);
        let (stop_source, stop_sequence) = (stamp.source, stamp.sequence);
        put(&rearms, encoded(&Rearm { stamp, stop_source, stop_sequence, ..Rearm::default() }));
        until(&|report| report.stops.is_empty());
        // Not in step with the reports of the room.
        std::thread::sleep(Duration::from_millis(20 + 7 * (sequence % 13)));
        stopped - begun
    };
    (1..=60).map(time).collect()
}
