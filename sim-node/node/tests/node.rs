//! The simulator on the bus: closed loop, orders, two simulators, lockstep. Several
//! sessions of the test process take the place of processes.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use heliostat_array::calibration_file::{AxisCorrections, CalibrationFile};
use heliostat_bus::{Bus, BusConfig, Class, Subscription, Token, free_loopback_endpoint};
use heliostat_driver::session::SessionError;
use heliostat_proto::gauges::OracleRate;
use heliostat_proto::{
    FaultKind, Message, MirrorCommand, MirrorFault, NodeKind, NodeStatus, Room, RoomTruth, SimulatorControl,
    UserReport, decode, encode,
};
use heliostat_scenario::Scenario;
use heliostat_service::{MetricsArgs, Stop};
use heliostat_sim_node::{NodeError, Pace, Settings, Summary, run as node};

fn settings(room: &str, endpoint: &str, pace: Pace) -> Settings {
    let scenario = Scenario::builtin("specular").unwrap();
    Settings {
        scenario,
        bus: BusConfig::new(Room::new(room).unwrap()).listen_at(endpoint),
        pace,
        metrics: MetricsArgs::default(),
        calibration: None,
        record: None,
    }
}

fn live(milliseconds: u64) -> Pace {
    Pace::Live { duration: Some(Duration::from_millis(milliseconds)) }
}

fn run(settings: &Settings) -> Result<Summary, NodeError> {
    node::run(settings, &Stop::default())
}

/// Longest run that a test ends when it has seen enough.
const LONGEST_MS: u64 = 120_000;

/// Starts a simulator that runs until a stop is requested.
fn start(settings: Settings) -> (JoinHandle<Result<Summary, NodeError>>, Stop) {
    let stop = Stop::default();
    let until = stop.clone();
    (std::thread::spawn(move || node::run(&settings, &until)), stop)
}

fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < Duration::from_secs(60), "{what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Waits until a simulator is in the room of a session.
fn wait_for_simulator(bus: &Bus) {
    let tokens = bus.room().alive_of(NodeKind::SimNode);
    wait_until("a simulator that announces itself", || !bus.alive(&tokens, Duration::from_secs(1)).unwrap().is_empty());
}

/// Keeps the latest message of a key.
fn latest<T: Message + Send + 'static>(bus: &Bus, key: &str) -> (Arc<Mutex<Option<T>>>, Subscription) {
    let latest: Arc<Mutex<Option<T>>> = Arc::default();
    let kept = Arc::clone(&latest);
    let subscription = bus.subscribe(key, move |payload| *kept.lock().unwrap() = Some(decode(payload).unwrap()));
    (latest, subscription.unwrap())
}

/// A minimal controller: answers every report with angles that depend only on the report.
struct Answerer {
    _bus: Bus,
    _declared: (Subscription, Token),
}

impl Answerer {
    fn start(room: &str, endpoint: &str, epoch: u64) -> Self {
        let bus = Bus::open(&BusConfig::new(Room::new(room).unwrap()).connect_to(endpoint)).unwrap();
        let keys = bus.room().clone();
        let commands = bus.publisher(&keys.command(), Class::RealTimeDrop).unwrap();
        let sequence = AtomicU64::new(0);
        let subscription = bus.subscribe(&keys.users(), move |payload| {
            let report: UserReport = decode(payload).unwrap();
            let lean = report.users[0].position_m[0] / 10.0;
            let command = MirrorCommand {
                epoch,
                sequence: sequence.fetch_add(1, Ordering::Relaxed) + 1,
                answers: report.tick,
                time_ns: report.stamp.time_ns,
                validity_ms: 10_000,
                roll: vec![lean; 100],
                yaw: vec![-lean; 100],
            };
            let mut payload = Vec::new();
            encode(&command, &mut payload).unwrap();
            commands.put(&payload).unwrap();
        });
        let declared = (subscription.unwrap(), bus.announce(&keys.alive(NodeKind::Controller, epoch)).unwrap());
        Self { _bus: bus, _declared: declared }
    }
}

#[test]
fn every_tick_is_answered_in_the_closed_loop() {
    let closed_loop = |_| {
        let endpoint = free_loopback_endpoint().unwrap();
        let _controller = Answerer::start("closed", &endpoint, 1);
        let summary = run(&settings("closed", &endpoint, live(2000))).unwrap();
        // On a busy machine ticks are skipped; none are added.
        assert!(summary.ticks <= 201, "{summary:?}");
        summary
    };
    // A pause of a busy machine loses the ticks on their way, and most of a run.
    let summary = (0..5).map(closed_loop).find(|summary| summary.lost_ticks == 0 && summary.ticks >= 100);
    let summary = summary.expect("a run that loses no tick");
    assert_eq!(summary.commands + summary.unattended_ticks, summary.ticks, "{summary:?}");
    assert_eq!(summary.loop_us.count, summary.commands);
    assert!(summary.truth_samples > 20 && summary.ratio_to_oracle.unwrap() > 0.0, "{summary:?}");
    assert!(!summary.refused.keys().any(|name| name.starts_with("command:")), "{summary:?}");
    println!("loop: {:?}; truth {:.0} us", summary.loop_us, summary.truth_us_mean);
}

#[test]
fn ticks_without_a_controller_are_unattended_and_not_lost() {
    let endpoint = free_loopback_endpoint().unwrap();
    let summary = run(&settings("empty", &endpoint, live(300))).unwrap();
    assert_eq!((summary.lost_ticks, summary.commands, summary.ratio_to_oracle), (0, 0, None));
    assert_eq!(summary.unattended_ticks, summary.ticks);
}

#[test]
fn valid_orders_of_an_operator_change_the_room_and_invalid_ones_are_counted() {
    let endpoint = free_loopback_endpoint().unwrap();
    let (node, stop) = start(settings("orders", &endpoint, live(LONGEST_MS)));
    let bus = Bus::open(&BusConfig::new(Room::new("orders").unwrap()).connect_to(&endpoint)).unwrap();
    let keys = bus.room().clone();
    let seen = Arc::new(Mutex::new((Vec::new(), Vec::new())));
    let (truths, statuses) = (Arc::clone(&seen), Arc::clone(&seen));
    let _truth = bus.subscribe(&keys.truth(), move |payload| {
        truths.lock().unwrap().0.push(decode::<RoomTruth>(payload).unwrap());
    });
    let _status = bus.subscribe(&keys.status(NodeKind::SimNode), move |payload| {
        statuses.lock().unwrap().1.push(decode::<NodeStatus>(payload).unwrap());
    });
    let orders = bus.publisher(&keys.simulator_control(), Class::RealTimeBlock).unwrap();
    wait_until("a truth", || !seen.lock().unwrap().0.is_empty());
    let stuck = MirrorFault { fault: FaultKind::Stuck, share: 0.25, ..MirrorFault::default() };
    let order = SimulatorControl {
        forced_users: Some(2),
        power_w: Some(1.5),
        speed_m_s: Some([0.0, 1.0]),
        faults: vec![stuck],
        ..SimulatorControl::default()
    };
    let mut payload = Vec::new();
    encode(&order, &mut payload).unwrap();
    orders.put(&payload).unwrap();
    orders.put(&payload[..payload.len() - 1]).unwrap();
    let forced = |truth: &RoomTruth| truth.users.iter().filter(|user| user.forced).count();
    wait_until("two users whose direct path is blocked", || {
        seen.lock().unwrap().0.last().is_some_and(|truth| forced(truth) == 2)
    });
    wait_until("a status with the power", || {
        let power = ("power_w".to_owned(), 1.5);
        seen.lock().unwrap().1.last().is_some_and(|status| status.gauges.contains(&power))
    });
    wait_until("a count of the invalid order", || {
        let seen = seen.lock().unwrap();
        seen.1.last().is_some_and(|status| status.counter("refused:control:truncated") == Some(1))
    });
    stop.request();
    let summary = node.join().unwrap().unwrap();
    let (truths, statuses) = std::mem::take(&mut *seen.lock().unwrap());
    assert_eq!((forced(&truths[0]), forced(truths.last().unwrap())), (0, 2));
    let gauges = &statuses.last().unwrap().gauges;
    for expected in [("power_w", 1.5), ("forced_users", 2.0), ("faulty_mirrors", 25.0)] {
        assert!(gauges.contains(&(expected.0.to_owned(), expected.1)), "{expected:?} in {gauges:?}");
    }
    let users: Vec<u32> = OracleRate::all_of(statuses.last().unwrap()).iter().map(|rate| rate.user).collect();
    let present: Vec<u32> = truths.last().unwrap().users.iter().map(|user| user.user).collect();
    assert_eq!(users, present, "a rate of the oracle for each user");
    assert_eq!(summary.refused.get("control:speed"), Some(&1), "{summary:?}");
    assert_eq!(summary.refused.get("control:truncated"), Some(&1), "{summary:?}");
}

#[test]
fn a_second_simulator_in_the_room_is_refused_by_name() {
    let endpoint = free_loopback_endpoint().unwrap();
    let (node, stop) = start(settings("taken", &endpoint, live(LONGEST_MS)));
    let bus = Bus::open(&BusConfig::new(Room::new("taken").unwrap()).connect_to(&endpoint)).unwrap();
    wait_for_simulator(&bus);
    let second = |room: &str| Settings {
        bus: BusConfig::new(Room::new(room).unwrap()).connect_to(&endpoint),
        ..settings(room, &endpoint, live(100))
    };
    // On a busy machine the answer of the first one may come after the second for which the other waits.
    let mut refusal = None;
    wait_until("a refusal", || {
        refusal = run(&second("taken")).err();
        refusal.is_some()
    });
    let error = refusal.unwrap();
    let is_taken = matches!(&error, NodeError::Session(SessionError::RoomTaken(by)) if by.other == NodeKind::SimNode);
    assert!(is_taken, "{error}");
    assert!(run(&second("free")).is_ok(), "another room is another matter");
    let (report, _report) = latest::<UserReport>(&bus, &bus.room().users());
    let tick = || report.lock().unwrap().as_ref().map_or(0, |report| report.tick);
    wait_until("a report of the first one", || tick() > 0);
    let before = tick();
    wait_until("a first one that goes on", || tick() > before + 100);
    stop.request();
    node.join().unwrap().unwrap();
}

fn lockstep(room: &str, seed: u64, epoch: u64) -> Summary {
    let endpoint = free_loopback_endpoint().unwrap();
    let mut settings = settings(room, &endpoint, Pace::Lockstep { ticks: 150 });
    let overrides =
        [format!("seed={seed}"), "streams.channel.latency_ms=7".into(), "streams.positions.noise_m=0.01".into()];
    settings.scenario = settings.scenario.with_overrides(&overrides).unwrap();
    let _controller = Answerer::start(room, &endpoint, epoch);
    run(&settings).unwrap()
}

#[test]
fn lockstep_repeats_bit_for_bit_from_the_same_seed() {
    let (first, second, other) = (lockstep("step", 5, 1), lockstep("step", 5, 77), lockstep("step", 6, 1));
    assert_eq!((first.ticks, first.commands, first.lost_ticks), (150, 150, 0));
    assert_eq!(first.hash, second.hash);
    assert_eq!((first.sum_rate_mbps, first.qos_met), (second.sum_rate_mbps, second.qos_met));
    assert_ne!(first.hash, other.hash);
}

#[test]
fn a_calibration_is_in_use_from_the_start_or_refused_by_name() {
    let corrected = |rows: usize| {
        let none = AxisCorrections::none(10 * rows);
        let file = CalibrationFile { rows, columns: 10, roll: none.clone(), yaw: none };
        let endpoint = free_loopback_endpoint().unwrap();
        run(&Settings { calibration: Some(file), ..settings(&format!("corrected{rows}"), &endpoint, live(200)) })
    };
    assert!(corrected(10).is_ok());
    let error = corrected(9).unwrap_err();
    assert!(matches!(&error, NodeError::Calibration(cause) if cause.to_string().contains("90")), "{error:?}");
}

#[test]
fn another_process_with_mirrors_is_the_problem_of_the_status_as_long_as_it_is_in_the_room() {
    let endpoint = free_loopback_endpoint().unwrap();
    let (run, stop) = start(settings("rivals", &endpoint, live(LONGEST_MS)));
    let bus = Bus::open(&BusConfig::new(Room::new("rivals").unwrap()).connect_to(&endpoint)).unwrap();
    wait_for_simulator(&bus);
    let (status, _status) = latest::<NodeStatus>(&bus, &bus.room().status(NodeKind::SimNode));
    let counted = |expected: u64| {
        let entry = (NodeStatus::OTHER_PROCESSES.to_owned(), expected);
        status.lock().unwrap().as_ref().filter(|status| status.counters.contains(&entry)).cloned()
    };
    wait_until("a status without another process", || counted(0).is_some());
    let tokens = [bus.room().alive(NodeKind::SimNode, u64::MAX), bus.room().array(0).driver_alive(u64::MAX)];
    for (token, name) in tokens.iter().zip(["simulator", "driver"]) {
        let other = bus.announce(token).unwrap();
        wait_until("a status that counts the other process", || counted(1).is_some());
        let problem = counted(1).unwrap().last_problem;
        assert!(problem.starts_with(&format!("another {name} has joined the room")), "{problem}");
        drop(other);
        wait_until("a status without it", || counted(0).is_some());
    }
    stop.request();
    run.join().unwrap().unwrap();
}
