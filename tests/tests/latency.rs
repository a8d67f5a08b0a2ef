//! Timing across processes: the statistics of a controller cover every message that was observed.
//!
//! Times are printed, and compared with each other with wide margins only: the machine may run
//! other work.

use std::sync::{Arc, Mutex, MutexGuard};

use heliostat_bus::{Bus, BusConfig, private_endpoint};
use heliostat_core::observation::{ObservationEncoder, USERS_CAPACITY};
use heliostat_core::policy::actor_file::{ANGLES, INPUT_NAME, room_entries};
use heliostat_onnx::graph::{Ends, Graph};
use heliostat_proto::{ArrayState, MirrorCommand, NodeKind, Room, UserReport, codec};
use heliostat_scenario::Scenario;
use heliostat_service::locks::lock;
use heliostat_tests::{Process, RoomObserver, number, wait_until};
use serde_json::Value;

/// Reports and commands in the order of arrival.
#[derive(Default)]
struct Received {
    reports: Vec<u64>,
    commands: Vec<MirrorCommand>,
}

/// Receives every report and command of a room.
struct Listener {
    received: Arc<Mutex<Received>>,
    _bus: Bus,
    _subscriptions: [heliostat_bus::Subscription; 2],
}

impl Listener {
    fn connect(room: &str, endpoints: &[&str]) -> Self {
        let room = Room::new(room).unwrap();
        let config = endpoints.iter().fold(BusConfig::new(room.clone()), |config, at| config.connect_to(at));
        let bus = Bus::open(&config).unwrap();
        let received: Arc<Mutex<Received>> = Arc::default();
        let (on_report, on_command) = (Arc::clone(&received), Arc::clone(&received));
        let reports = bus.subscribe(&room.users(), move |payload| {
            let report: UserReport = codec::decode(payload).unwrap();
            on_report.lock().unwrap().reports.push(report.tick);
        });
        let commands = bus.subscribe(&room.command(), move |payload| {
            on_command.lock().unwrap().commands.push(codec::decode(payload).unwrap());
        });
        Self { received, _subscriptions: [reports.unwrap(), commands.unwrap()], _bus: bus }
    }

    fn commands(&self) -> usize {
        self.received.lock().unwrap().commands.len()
    }
}

/// One pair at a time: concurrent pairs would disturb each other's times.
static TURN: Mutex<()> = Mutex::new(());

/// A room and a controller on endpoints of their own.
struct Pair {
    _turn: MutexGuard<'static, ()>,
    room: Process,
    controller: Process,
    endpoints: [String; 2],
}

impl Pair {
    fn start(room_flags: &[&str], controller_flags: &[&str]) -> Self {
        let turn = lock(&TURN);
        let endpoints = [private_endpoint().unwrap(), private_endpoint().unwrap()];
        let common = ["--exit-with-parent", "--json"];
        let room: Vec<&str> =
            ["sim-node", "--listen", &endpoints[0]].iter().chain(&common).chain(room_flags).copied().collect();
        let controller = ["controller", "--connect", &endpoints[0], "--listen", &endpoints[1]];
        let controller: Vec<&str> = controller.iter().chain(&common).chain(controller_flags).copied().collect();
        Self { _turn: turn, room: Process::heliostat(&room), controller: Process::heliostat(&controller), endpoints }
    }

    fn endpoints(&self) -> [&str; 2] {
        [&self.endpoints[0], &self.endpoints[1]]
    }

    fn observer(&self) -> RoomObserver {
        RoomObserver::connect("demo", &self.endpoints())
    }

    /// Ends both; returns the summaries of the room and the controller.
    fn end(self) -> (Value, Value) {
        let room = self.room.end().json();
        (room, self.controller.end().json())
    }
}

fn show(name: &str, times: &Value) {
    let at = |quantile: &str| number(times, &format!("/{quantile}"));
    let (p50, p90, p99) = (at("p50"), at("p90"), at("p99"));
    println!("{name:<10} p50 {p50:8.1}  p90 {p90:8.1}  p99 {p99:8.1}  max {:8.1} us", at("max"));
}

/// A policy whose time budget makes its decisions slow on every machine.
const SLOW: &str = "pso";

/// Runs until 300 commands.
fn counts_order_and_stages(controller_flags: &[&str]) {
    // A busy machine delays reports and commands.
    let patient = ["--set", "control.validity_ms=10000", "--set", "control.report_age_max_ms=10000"];
    let pair = Pair::start(&[], &[controller_flags, &patient].concat());
    let listener = Listener::connect("demo", &pair.endpoints());
    wait_until("300 commands", || listener.commands() >= 300);
    let (room, controller) = pair.end();
    let received = listener.received.lock().unwrap();

    // Order: sequence numbers and ticks only rise, in one epoch.
    assert!(received.commands.windows(2).all(|pair| pair[0].sequence < pair[1].sequence), "commands out of order");
    assert!(received.commands.windows(2).all(|pair| pair[0].answers < pair[1].answers), "answers out of order");
    assert!(received.commands.windows(2).all(|pair| pair[0].epoch == pair[1].epoch), "two epochs");
    assert!(received.reports.windows(2).all(|pair| pair[0] < pair[1]), "reports out of order");

    // Matching: a command answers a published report, and no report is answered twice.
    let first = received.reports[0];
    let answered = received.commands.iter().map(|command| command.answers).filter(|tick| *tick >= first);
    let known = answered.filter(|tick| received.reports.binary_search(tick).is_ok()).count();
    let all = received.commands.iter().filter(|command| command.answers >= first).count();
    assert!(known + 2 >= all, "{all} commands, but only {known} answer a report that was received");

    // The received messages are a part of those that both processes count, and none is lost.
    let commands = number(&controller, "/commands");
    assert!(received.commands.len() as f64 <= commands, "{controller}");
    assert!(number(&room, "/loop_us/count") <= commands, "{room} {controller}");
    assert!(number(&room, "/loop_us/count") >= received.commands.len() as f64 - 2.0, "{room}");
    // A busy machine drops superseded reports, and a stalled link drops reports: these have no
    // command.
    let dropped = 0.1 * number(&room, "/ticks");
    assert!(number(&room, "/lost_ticks") <= number(&controller, "/dropped") + dropped, "{room} {controller}");
    assert_eq!(number(&controller, "/unsent"), 0.0, "{controller}");

    // No stage is missing, and together they are the decision.
    let count = number(&controller, "/decision_us/count");
    assert_eq!(count, commands, "{controller}");
    let mut stages = 0.0;
    for stage in ["wait", "decode", "observe", "infer", "safe", "publish"] {
        let times = &controller["stages_us"][stage];
        show(stage, times);
        assert_eq!(number(times, "/count"), count, "{stage}: {controller}");
        stages += number(times, "/p50");
    }
    show("decision", &controller["decision_us"]);
    show("loop", &room["loop_us"]);
    show("age", &controller["age_us"]);
    let (decision, round) = (number(&controller, "/decision_us/p50"), number(&room, "/loop_us/p50"));
    assert!((0.3..3.0).contains(&(stages / decision)), "stages {stages} us, decision {decision} us: {controller}");
    assert!(decision < 1.5 * round, "the decision is a part of the loop: {decision} us of {round} us");
    let attributed = controller["over_budget_by"].as_object().unwrap().values().filter_map(Value::as_u64).sum::<u64>();
    assert_eq!(attributed as f64, number(&controller, "/over_budget"), "each miss has its stage: {controller}");
}

#[test]
fn every_decision_in_the_callback_is_counted() {
    counts_order_and_stages(&["--policy", "fixed-point"]);
}

#[test]
fn every_decision_of_an_actor_is_counted() {
    counts_order_and_stages(&["--policy", "actor"]);
}

#[test]
fn every_decision_of_a_slow_policy_is_counted() {
    counts_order_and_stages(&["--policy", SLOW]);
}

#[test]
fn one_process_serves_rooms_that_do_not_mix() {
    let endpoint = private_endpoint().unwrap();
    let rooms = ["north", "south", "west"];
    // The controller listens, since three rooms connect to it; the rooms have different users by their
    // seeds.
    let controller = Process::heliostat(&[
        "controller",
        "--listen",
        &endpoint,
        "--room",
        rooms[0],
        "--also-room",
        "south,west",
        "--policy",
        "nearest",
        // A pause of a busy machine is no silence.
        "--set",
        "control.report_age_max_ms=5000",
        "--exit-with-parent",
        "--json",
    ]);
    let start = |(index, room): (usize, &&str)| {
        let seed = (index + 1).to_string();
        Process::heliostat(&[
            "sim-node",
            "--connect",
            &endpoint,
            "--room",
            room,
            "--seed",
            &seed,
            "--exit-with-parent",
            "--json",
        ])
    };
    let mut sims: Vec<Process> = rooms.iter().enumerate().map(start).collect();
    let observers = rooms.map(|room| RoomObserver::connect(room, &[&endpoint]));
    observers.iter().for_each(RoomObserver::wait_for_commands);

    // One room stops; the others continue.
    sims.remove(0).kill();
    wait_until("a silence that is counted", || observers[0].counter(NodeKind::Controller, "fallback:silence") > 0);
    observers[1..].iter().for_each(RoomObserver::wait_for_commands);
    assert_eq!(observers[1].counter(NodeKind::Controller, "fallback:silence"), 0);

    let answered: Vec<f64> = sims.into_iter().map(|sim| number(&sim.end().json(), "/commands")).collect();
    let summary = controller.end().json();
    let of = |room: &str| number(&summary, &format!("/rooms/{room}/commands"));
    for (room, answered) in rooms[1..].iter().zip(answered) {
        assert!(of(room) >= answered && answered > 0.0, "{room}: {summary}");
    }
    assert_eq!(rooms.map(of).iter().sum::<f64>(), number(&summary, "/commands"));
    assert_eq!(summary["refused"], serde_json::json!({}), "no message reached another room: {summary}");
}

#[test]
fn a_missing_channel_stream_triggers_the_configured_action() {
    // One channel report at the start, and none for a hundred seconds.
    let rare = ["--set", "streams.channel.rate_hz=0.01"];
    for (answer, moves) in [("fallback", true), ("hold", false)] {
        let set = format!("control.when_channel_missing={answer}");
        let pair = Pair::start(&rare, &["--set", &set, "--policy", "nearest"]);
        let observer = pair.observer();
        wait_until("missing channel reports", || {
            observer.counter(NodeKind::Controller, "fallback:channel-missing") > 50
        });
        let before = observer.counter(NodeKind::Controller, "commands");
        wait_until("more of them", || observer.counter(NodeKind::Controller, "fallback:channel-missing") > 150);
        let after = observer.counter(NodeKind::Controller, "commands");
        assert_eq!(after > before, moves, "{answer}: {before} then {after} commands");
        pair.end();
    }
}

#[test]
fn stale_reports_trigger_the_configured_action() {
    let old = ["--set", "streams.positions.latency_ms=300", "--set", "control.report_age_max_ms=100"];
    for (answer, commands) in [("hold", false), ("park", true)] {
        let set = format!("control.when_stale={answer}");
        let flags: Vec<&str> = old[2..].iter().copied().chain(["--set", &set, "--policy", "nearest"]).collect();
        let pair = Pair::start(&old, &flags);
        let observer = pair.observer();
        wait_until("stale reports", || observer.counter(NodeKind::Controller, "fallback:stale-report") > 50);
        assert_eq!(observer.counter(NodeKind::Controller, "commands") > 0, commands, "{answer}");
        if let (_, Some(command)) = observer.command() {
            assert!(command.roll.iter().chain(&command.yaw).all(|angle| *angle == 0.0), "parked is flat");
        }
        pair.end();
    }
}

#[test]
fn the_last_command_is_repeated_for_a_silent_room_if_so_configured() {
    let mut pair = Pair::start(&[], &["--set", "control.when_silent=last-good", "--policy", "nearest"]);
    let observer = pair.observer();
    observer.wait_for_commands();
    pair.room.kill();
    let last = observer.users().unwrap().tick;
    let mut repeated = None;
    wait_until("a repeated command", || {
        repeated = observer.command().1.filter(|command| command.answers == 0);
        repeated.is_some()
    });
    assert!(repeated.unwrap().yaw.iter().any(|angle| *angle != 0.0), "the mirrors stay where they were at tick {last}");
    wait_until("a silence that is counted", || observer.counter(NodeKind::Controller, "fallback:silence") > 0);
    let summary = pair.controller.end().json();
    assert!(summary["commands"].as_u64() > summary["decisions"].as_u64(), "{summary}");
}

/// An actor for the default room; `layers` map the presence of the last user, once for each of 2 M
/// angles, to the output, whose node comes last.
fn actor(layers: impl FnOnce(&mut Graph, &str, usize)) -> Vec<u8> {
    let scenario = Scenario::builtin("specular").unwrap();
    let encoder = ObservationEncoder::new(USERS_CAPACITY, scenario.mirror_count());
    let mut graph = Graph::default();
    let (inputs, outputs) = (encoder.len(), encoder.angles().len());
    let mut weights = vec![0.0; inputs * outputs];
    let last = encoder.mask().start + scenario.users.count - 1;
    weights[last * outputs..][..outputs].fill(1.0);
    let weights = graph.constant("weights", &[inputs, outputs], &weights);
    let present = graph.node("MatMul", &[INPUT_NAME, &weights]);
    layers(&mut graph, &present, outputs);
    let (input, output) = ((INPUT_NAME, inputs), (ANGLES, outputs));
    graph.finish(&Ends { name: "test", input, output }, &room_entries(&scenario, USERS_CAPACITY))
}

/// Outputs NaN where the last user is absent: 0 times 1/0.
fn nan_output(graph: &mut Graph, present: &str, _: usize) {
    let [one, zero] = [1.0, 0.0].map(|value| graph.scalar(value));
    let inverse = graph.node("Div", &[&one, present]);
    graph.node("Mul", &[&inverse, &zero]);
}

/// Outputs small angles after more than the time limit of a policy, 0.1 s, also on a fast processor.
fn slow(graph: &mut Graph, present: &str, outputs: usize) {
    const WIDTH: usize = 10_000;
    const LAYERS: usize = 30_000;
    let wide = graph.constant("wide", &[outputs, WIDTH], &vec![1e-3; outputs * WIDTH]);
    let mut value = graph.node("MatMul", &[present, &wide]);
    for _ in 0..LAYERS {
        value = graph.node("Tanh", &[&value]);
    }
    let narrow = graph.constant("narrow", &[WIDTH, outputs], &vec![1e-4; WIDTH * outputs]);
    let value = graph.node("MatMul", &[&value, &narrow]);
    graph.node("Tanh", &[&value]);
}

#[test]
fn an_actor_with_nan_output_triggers_the_configured_fallback() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("nan.onnx");
    std::fs::write(&file, actor(nan_output)).unwrap();
    for (answer, cause, moves) in [("fixed-point", "policy-failed", true), ("hold", "held", false)] {
        let set = format!("control.fallback={answer}");
        // The room has one user fewer than the controller's scenario, in which the actor is tried.
        let fewer = ["--set", "users.count=4"];
        let pair = Pair::start(&fewer, &["--set", &set, "--model", file.to_str().unwrap()]);
        let observer = pair.observer();
        wait_until("failures", || observer.counter(NodeKind::Controller, &format!("fallback:{cause}")) > 50);
        assert_eq!(observer.counter(NodeKind::Controller, "commands") > 0, moves, "{answer}");
        if let (_, Some(command)) = observer.command() {
            assert!(command.roll.iter().chain(&command.yaw).all(|angle| angle.is_finite()), "{answer}");
        }
        let (_, controller) = pair.end();
        // A decision that a busy machine makes late does not ask the policy. It repeats the last
        // command, and is held where there is none.
        let late = controller.pointer("/fallbacks/late").and_then(Value::as_f64).filter(|_| moves).unwrap_or(0.0);
        // The first decisions wait for telemetry.
        let awaiting = controller.pointer("/withheld/standby").and_then(Value::as_f64).unwrap_or(0.0);
        let failed = number(&controller, &format!("/fallbacks/{cause}"));
        assert_eq!(failed + late + awaiting, number(&controller, "/decisions"), "{controller}");
        // No command is credited to the policy.
        assert_eq!(number(&controller, "/policies/ddpg/commands"), 0.0, "{controller}");
        assert_eq!(number(&controller, "/policies/ddpg/fallbacks") > 0.0, moves, "{controller}");
    }
}

#[test]
fn a_slow_policy_misses_deadlines_and_superseded_reports_are_dropped() {
    // One decision takes five report intervals.
    let slow = [
        "--policy",
        SLOW,
        "--set",
        "control.search_time_us=5000",
        "--set",
        "control.when_late=last-good",
        "--set",
        "control.deadline_ms=0.5",
    ];
    let pair = Pair::start(&["--set", "streams.positions.rate_hz=1000"], &slow);
    let observer = pair.observer();
    let counter = |name: &str| observer.counter(NodeKind::Controller, name);
    wait_until("missed deadlines and dropped reports", || counter("fallback:late") > 20 && counter("dropped") > 20);
    let (_, controller) = pair.end();
    let (commands, decisions) = (number(&controller, "/commands"), number(&controller, "/decisions"));
    let late = number(&controller, "/fallbacks/late");
    assert!(commands > 0.0 && late <= decisions / 2.0 + 1.0, "the policy must decide sometimes: {controller}");
    // The queue is bounded: no answered report has waited longer than a few decisions.
    let (waited, infer) = (number(&controller, "/stages_us/wait/max"), number(&controller, "/stages_us/infer/max"));
    show("wait", &controller["stages_us"]["wait"]);
    assert!(waited < 5.0 * infer, "{controller}");
}

#[test]
fn a_policy_without_an_answer_is_reported_and_the_array_holds() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("slow.onnx");
    std::fs::write(&file, actor(slow)).unwrap();
    // A command is valid for less time than a policy may take before it times out.
    let brief = ["--set", "control.validity_ms=50"];
    let pair = Pair::start(&[], &[&["--model", file.to_str().unwrap()], &brief[..]].concat());
    let observer = pair.observer();
    wait_until("unanswered checks", || observer.counter(NodeKind::Controller, "unanswered") > 0);
    wait_until("the name of the problem", || {
        observer.status(NodeKind::Controller).is_some_and(|status| status.last_problem.contains("has timed out"))
    });
    wait_until("a command", || observer.command().0 > 0);
    // The last command expires before the next one.
    wait_until("holding mirrors", || {
        observer.telemetry().is_some_and(|telemetry| telemetry.state == ArrayState::Holding)
    });
    wait_until("dropped reports", || observer.counter(NodeKind::Controller, "dropped") > 0);
    // Whenever the policy answers again, its commands continue the sequence.
    let first = observer.command().1.unwrap().sequence;
    wait_until("a later command", || observer.command().1.is_some_and(|command| command.sequence > first));
    assert_eq!(observer.counter(NodeKind::SimNode, "refused:command:old-sequence"), 0);
    pair.end();
}
