//! How long it takes, across processes: that nothing is missing from the account, and that the account is that of the messages seen.
//!
//! Times are printed, and held to one another with wide margins only: this runs on machines that do other things too.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use heliostat_bus::{Bus, BusConfig, free_loopback_endpoint};
use heliostat_controller::observation::{OBSERVATION_VERSION, ObservationEncoder, USERS_CAPACITY};
use heliostat_controller::policy::actor_file::{INPUT_NAME, OUTPUT_NAME, key};
use heliostat_onnx::graph::{Ends, Graph};
use heliostat_proto::{ArrayState, MirrorCommand, NodeKind, Room, UserReport, codec};
use heliostat_scenario::Scenario;
use heliostat_tests::{Process, Witness, wait_until};
use serde_json::Value;

/// Everything that was said, in the order in which it was heard.
#[derive(Default)]
struct Heard {
    reports: Vec<u64>,
    commands: Vec<MirrorCommand>,
}

/// Hears every report and command of a room.
struct Listener {
    heard: Arc<Mutex<Heard>>,
    _bus: Bus,
    _subscriptions: [heliostat_bus::Subscription; 2],
}

impl Listener {
    fn connect(room: &str, endpoints: &[&str]) -> Self {
        let room = Room::new(room).unwrap();
        let config = endpoints.iter().fold(BusConfig::new(room.clone()), |config, at| config.connect_to(at));
        let bus = Bus::open(&config).unwrap();
        let heard: Arc<Mutex<Heard>> = Arc::default();
        let (on_report, on_command) = (Arc::clone(&heard), Arc::clone(&heard));
        let reports = bus.subscribe(&room.users(), move |payload| {
            let report: UserReport = codec::decode(payload).unwrap();
            on_report.lock().unwrap().reports.push(report.tick);
        });
        let commands = bus.subscribe(&room.command(), move |payload| {
            on_command.lock().unwrap().commands.push(codec::decode(payload).unwrap());
        });
        Self { heard, _subscriptions: [reports.unwrap(), commands.unwrap()], _bus: bus }
    }

    fn commands(&self) -> usize {
        self.heard.lock().unwrap().commands.len()
    }
}

/// One pair at a time: seven pairs at once on two processors measure each other.
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
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        let endpoints = [free_loopback_endpoint().unwrap(), free_loopback_endpoint().unwrap()];
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

    fn witness(&self) -> Witness {
        Witness::connect("demo", &self.endpoints())
    }

    /// Ends both; the room's and the controller's summary.
    fn end(self) -> (Value, Value) {
        let room = self.room.end().json();
        (room, self.controller.end().json())
    }
}

fn number(value: &Value, path: &str) -> f64 {
    value.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("no number at {path} in {value}"))
}

fn show(name: &str, times: &Value) {
    let at = |quantile: &str| number(times, &format!("/{quantile}"));
    let (p50, p90, p99) = (at("p50"), at("p90"), at("p99"));
    println!("{name:<10} p50 {p50:8.1}  p90 {p90:8.1}  p99 {p99:8.1}  max {:8.1} us", at("max"));
}

/// The controller's summary.
fn counts_order_and_stages(controller_flags: &[&str]) -> Value {
    let pair = Pair::start(&[], controller_flags);
    let listener = Listener::connect("demo", &pair.endpoints());
    wait_until("300 commands", || listener.commands() >= 300);
    let (room, controller) = pair.end();
    let heard = listener.heard.lock().unwrap();

    // Order: sequence numbers and ticks only rise, in one epoch.
    assert!(heard.commands.windows(2).all(|pair| pair[0].sequence < pair[1].sequence), "commands out of order");
    assert!(heard.commands.windows(2).all(|pair| pair[0].answers < pair[1].answers), "answers out of order");
    assert!(heard.commands.windows(2).all(|pair| pair[0].epoch == pair[1].epoch), "two epochs");
    assert!(heard.reports.windows(2).all(|pair| pair[0] < pair[1]), "reports out of order");

    // Matching: a command answers a report that went out, and no report is answered twice.
    let first = heard.reports[0];
    let answered = heard.commands.iter().map(|command| command.answers).filter(|tick| *tick >= first);
    let known = answered.filter(|tick| heard.reports.binary_search(tick).is_ok()).count();
    let all = heard.commands.iter().filter(|command| command.answers >= first).count();
    assert!(known + 2 >= all, "{all} commands, but only {known} answer a report that was heard");

    // Counts: what was heard is part of what both sides say was sent and taken, and nothing was lost.
    let commands = number(&controller, "/commands");
    assert!(heard.commands.len() as f64 <= commands, "{controller}");
    assert!(number(&room, "/loop_us/count") <= commands, "{room} {controller}");
    assert!(number(&room, "/loop_us/count") >= heard.commands.len() as f64 - 2.0, "{room}");
    // A report that was overtaken on a busy machine is shed, and one that a stalled link cannot take is dropped: no command answers these.
    let dropped = 0.1 * number(&room, "/ticks");
    assert!(number(&room, "/lost_ticks") <= number(&controller, "/shed") + dropped, "{room} {controller}");
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
    let blamed = controller["over_budget_by"].as_object().unwrap().values().filter_map(Value::as_u64).sum::<u64>();
    assert_eq!(blamed as f64, number(&controller, "/over_budget"), "each miss has its stage: {controller}");
    controller
}

#[test]
fn decided_in_the_callback_nothing_is_missing() {
    let summary =
        counts_order_and_stages(&["--policy", "fixed-point", "--decide-in", "callback", "--keep-warm", "off"]);
    assert_eq!(number(&summary, "/rehearsals"), 0.0, "{summary}");
}

#[test]
fn decided_on_a_thread_that_keeps_warm_nothing_is_missing() {
    let summary = counts_order_and_stages(&["--policy", "actor", "--decide-in", "thread", "--keep-warm", "1000"]);
    assert!(number(&summary, "/rehearsals") > 0.0, "{summary}");
}

#[test]
fn decided_in_the_callback_beside_a_thread_that_keeps_warm_nothing_is_missing() {
    let summary = counts_order_and_stages(&["--policy", "nearest", "--decide-in", "callback", "--keep-warm", "1000"]);
    assert!(number(&summary, "/rehearsals") > 0.0, "{summary}");
}

#[test]
fn a_slow_policy_is_rehearsed_for_each_report_and_nothing_is_missing() {
    let summary = counts_order_and_stages(&["--policy", "actor"]);
    let (rehearsals, decisions) = (number(&summary, "/rehearsals"), number(&summary, "/decisions"));
    // Two before each report, less where it comes too soon for that.
    assert!((0.2 * decisions..=2.0 * decisions).contains(&rehearsals), "{summary}");
}

#[test]
fn one_process_serves_rooms_that_do_not_mix() {
    let endpoint = free_loopback_endpoint().unwrap();
    let rooms = ["north", "south", "west"];
    // The controller listens, since three rooms come to it; the rooms have different mirrors-to-people geometry by their seeds.
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
    let witnesses = rooms.map(|room| Witness::connect(room, &[&endpoint]));
    witnesses.iter().for_each(Witness::wait_for_commands);

    // One room falls silent; the others go on.
    sims.remove(0).kill();
    wait_until("a silence that is counted", || witnesses[0].counter(NodeKind::Controller, "fallback:silence") == 1);
    witnesses[1..].iter().for_each(Witness::wait_for_commands);
    assert_eq!(witnesses[1].counter(NodeKind::Controller, "fallback:silence"), 0);

    let answered: Vec<f64> = sims.into_iter().map(|sim| number(&sim.end().json(), "/commands")).collect();
    let summary = controller.end().json();
    let of = |room: &str| number(&summary, &format!("/rooms/{room}/commands"));
    for (room, answered) in rooms[1..].iter().zip(answered) {
        assert!(of(room) >= answered && answered > 0.0, "{room}: {summary}");
    }
    assert_eq!(rooms.map(of).iter().sum::<f64>(), number(&summary, "/commands"));
    assert_eq!(summary["refused"], serde_json::json!({}), "nothing strayed into another room: {summary}");
}

#[test]
fn a_missing_channel_stream_is_answered_as_configured() {
    // One channel report at the start, and none for a hundred seconds.
    let rare = ["--set", "streams.channel.rate_hz=0.01"];
    for (answer, moves) in [("fallback", true), ("hold", false)] {
        let set = format!("control.when_channel_missing={answer}");
        let pair = Pair::start(&rare, &["--set", &set, "--policy", "nearest"]);
        let witness = pair.witness();
        wait_until("missing channel reports", || {
            witness.counter(NodeKind::Controller, "fallback:channel-missing") > 50
        });
        let before = witness.counter(NodeKind::Controller, "commands");
        wait_until("more of them", || witness.counter(NodeKind::Controller, "fallback:channel-missing") > 150);
        let after = witness.counter(NodeKind::Controller, "commands");
        assert_eq!(after > before, moves, "{answer}: {before} then {after} commands");
        pair.end();
    }
}

#[test]
fn stale_reports_are_answered_as_configured() {
    let old = ["--set", "streams.positions.latency_ms=300", "--set", "control.report_age_max_ms=100"];
    for (answer, commands) in [("hold", false), ("park", true)] {
        let set = format!("control.when_stale={answer}");
        let flags: Vec<&str> = old[2..].iter().copied().chain(["--set", &set, "--policy", "nearest"]).collect();
        let pair = Pair::start(&old, &flags);
        let witness = pair.witness();
        wait_until("stale reports", || witness.counter(NodeKind::Controller, "fallback:stale-report") > 50);
        assert_eq!(witness.counter(NodeKind::Controller, "commands") > 0, commands, "{answer}");
        if let (_, Some(command)) = witness.command() {
            assert!(command.roll.iter().chain(&command.yaw).all(|angle| *angle == 0.0), "parked is flat");
        }
        pair.end();
    }
}

#[test]
fn when_the_room_falls_silent_the_last_good_is_repeated_if_so_configured() {
    let mut pair = Pair::start(&[], &["--set", "control.when_silent=last-good", "--policy", "nearest"]);
    let witness = pair.witness();
    witness.wait_for_commands();
    pair.room.kill();
    let last = witness.users().unwrap().tick;
    let mut repeated = None;
    wait_until("a repeated command", || {
        repeated = witness.command().1.filter(|command| command.answers == 0);
        repeated.is_some()
    });
    assert!(repeated.unwrap().yaw.iter().any(|angle| *angle != 0.0), "the mirrors stay where they were at tick {last}");
    wait_until("a silence that is counted", || witness.counter(NodeKind::Controller, "fallback:silence") == 1);
    let summary = pair.controller.end().json();
    assert!(summary["commands"].as_u64() > summary["decisions"].as_u64(), "{summary}");
}

/// An actor that fits the default room; `layers` lead from the current angles, of shape (1, 2 M), to its answer, whose node comes last.
fn actor(layers: impl FnOnce(&mut Graph, &str, usize)) -> Vec<u8> {
    let scenario = Scenario::builtin("specular").unwrap();
    let encoder = ObservationEncoder::new(USERS_CAPACITY, scenario.mirror_count());
    let mut graph = Graph::default();
    let angles = graph.slice(INPUT_NAME, 1, encoder.angles());
    layers(&mut graph, &angles, encoder.angles().len());
    let metadata = [
        (key::OBSERVATION_VERSION, OBSERVATION_VERSION.to_string()),
        (key::USERS_MAX, USERS_CAPACITY.to_string()),
        (key::MIRRORS, scenario.mirror_count().to_string()),
        (key::MODE, scenario.channel.mode.name().to_owned()),
        (key::GEOMETRY, scenario.geometry_hash()),
    ];
    let (input, output) = ((INPUT_NAME, encoder.len()), (OUTPUT_NAME, encoder.angles().len()));
    graph.finish(&Ends { name: "test", input, output }, &metadata.map(|(key, value)| (key.to_owned(), value)))
}

/// Answers with what is no number: the logarithm of the current angles less 100.
fn nonsense(graph: &mut Graph, angles: &str, _: usize) {
    let far = graph.scalar(-100.0);
    let below = graph.node("Add", &[angles, &far]);
    graph.node("Log", &[&below]);
}

/// Answers after some tenths of a second, with small angles: a few products of large matrices that depend on the input.
fn ponderous(graph: &mut Graph, angles: &str, outputs: usize) {
    const SIZE: usize = 1000;
    let column = graph.constant("column", &[SIZE, 1], &vec![0.01; SIZE]);
    let row = graph.constant("row", &[outputs, SIZE], &vec![0.01; outputs * SIZE]);
    let spread = graph.node("MatMul", &[angles, &row]);
    let mut matrix = graph.node("MatMul", &[&column, &spread]);
    for _ in 0..16 {
        let product = graph.node("MatMul", &[&matrix, &matrix]);
        matrix = graph.node("Tanh", &[&product]);
    }
    let first = graph.slice(&matrix, 0, 0..1);
    let few = graph.slice(&first, 1, 0..outputs);
    let turned = graph.scalar(0.1);
    let turned = graph.node("Add", &[&few, &turned]);
    graph.node("Tanh", &[&turned]);
}

#[test]
fn an_actor_that_gives_no_numbers_is_answered_as_configured() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("nonsense.onnx");
    std::fs::write(&file, actor(nonsense)).unwrap();
    for (answer, cause, moves) in [("fixed-point", "policy-failed", true), ("hold", "held", false)] {
        let set = format!("control.fallback={answer}");
        let pair = Pair::start(&[], &["--set", &set, "--model", file.to_str().unwrap()]);
        let witness = pair.witness();
        wait_until("failures", || witness.counter(NodeKind::Controller, &format!("fallback:{cause}")) > 50);
        assert_eq!(witness.counter(NodeKind::Controller, "commands") > 0, moves, "{answer}");
        if let (_, Some(command)) = witness.command() {
            assert!(command.roll.iter().chain(&command.yaw).all(|angle| angle.is_finite()), "{answer}");
        }
        let (_, controller) = pair.end();
        assert_eq!(
            number(&controller, &format!("/fallbacks/{cause}")),
            number(&controller, "/decisions"),
            "{controller}"
        );
    }
}

#[test]
fn a_policy_that_is_too_slow_is_late_and_what_piles_up_is_shed() {
    // The oracle takes several reports' time for one answer.
    let slow = [
        "--policy",
        "oracle",
        "--decide-in",
        "thread",
        "--set",
        "control.when_late=last-good",
        "--set",
        "control.deadline_ms=0.5",
    ];
    let pair = Pair::start(&["--set", "streams.positions.rate_hz=1000"], &slow);
    let witness = pair.witness();
    let counter = |name: &str| witness.counter(NodeKind::Controller, name);
    wait_until("late decisions and shed reports", || counter("fallback:late") > 20 && counter("shed") > 20);
    let (_, controller) = pair.end();
    let (commands, decisions) = (number(&controller, "/commands"), number(&controller, "/decisions"));
    let late = number(&controller, "/fallbacks/late");
    assert!(commands > 0.0 && late <= decisions / 2.0 + 1.0, "the policy must come to decide: {controller}");
    // Never queued without bound: no report that is answered has waited longer than a few decisions take.
    let (waited, infer) = (number(&controller, "/stages_us/wait/max"), number(&controller, "/stages_us/infer/max"));
    show("wait", &controller["stages_us"]["wait"]);
    assert!(waited < 5.0 * infer, "{controller}");
}

#[test]
fn where_the_policy_does_not_answer_the_last_command_is_repeated_or_the_array_parked() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("ponderous.onnx");
    std::fs::write(&file, actor(ponderous)).unwrap();
    for (answer, flat) in [("last-good", false), ("park", true)] {
        let set = format!("control.when_unanswered={answer}");
        let pair = Pair::start(&[], &["--model", file.to_str().unwrap(), "--set", &set]);
        let witness = pair.witness();
        let is_flat = |command: &MirrorCommand| command.roll.iter().chain(&command.yaw).all(|angle| *angle == 0.0);
        wait_until(&format!("a command in the policy's stead: {answer}"), || {
            witness.command().1.is_some_and(|command| command.answers == 0 && is_flat(&command) == flat)
        });
        // The policy comes back, and its later commands are numbered on.
        let first = witness.command().1.unwrap().sequence;
        wait_until("an answer of the policy", || {
            witness.command().1.is_some_and(|command| command.answers > 0 && command.sequence > first)
        });
        assert_eq!(witness.counter(NodeKind::SimNode, "refused:command:old-sequence"), 0, "{answer}");
        pair.end();
    }
}

#[test]
fn a_policy_that_does_not_answer_is_seen_and_the_array_holds_meanwhile() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("ponderous.onnx");
    std::fs::write(&file, actor(ponderous)).unwrap();
    let pair = Pair::start(&[], &["--model", file.to_str().unwrap(), "--decide-in", "thread"]);
    let witness = pair.witness();
    wait_until("looks in vain", || witness.counter(NodeKind::Controller, "unanswered") > 0);
    let problem = witness.status(NodeKind::Controller).unwrap().last_problem;
    assert!(problem.contains("no answer"), "{problem}");
    wait_until("a command", || witness.command().0 > 0);
    // What it commanded expires before anything comes in its place.
    wait_until("mirrors that hold", || {
        witness.telemetry().is_some_and(|telemetry| telemetry.state == ArrayState::Holding)
    });
    wait_until("shed reports", || witness.counter(NodeKind::Controller, "shed") > 0);
    pair.end();
}
