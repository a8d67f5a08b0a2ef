//! Invalid payloads on every subscribed key: no process crashes, and each payload is counted by its
//! cause.

use heliostat_bus::private_endpoint;
use heliostat_proto::{
    ChannelReport, EmergencyStop, MirrorCommand, MirrorTelemetry, NodeKind, Obstacle, ObstacleReport, Stamp,
    UserChannel, UserReport, UserState,
};
use heliostat_tests::{Process, RoomObserver, encoded, wait_until};

/// An invalid number.
const NAN: [u8; 4] = f32::NAN.to_le_bytes();
/// A number that occurs once in each message of the test, to be replaced by NaN.
const MARK: f32 = 0.123_456_79;

/// Invalid variants of a valid payload, each with the cause under which it must be counted.
fn invalid_variants(valid: &[u8]) -> Vec<(&'static str, Vec<u8>)> {
    let mut wrong_version = valid.to_vec();
    wrong_version[0] = 9;
    let mut wrong_kind = valid.to_vec();
    wrong_kind[1] = 200;
    let mut trailing = valid.to_vec();
    trailing.push(0);
    let mut nan = valid.to_vec();
    let place = valid.windows(4).position(|bytes| bytes == MARK.to_le_bytes()).expect("the mark is there");
    nan[place..place + 4].copy_from_slice(&NAN);
    vec![
        ("wrong-version", wrong_version),
        ("wrong-kind", wrong_kind),
        ("trailing-bytes", trailing),
        ("not-finite", nan),
        ("truncated", valid[..valid.len() / 2].to_vec()),
        ("truncated", Vec::new()),
        ("oversized", vec![1; 2 << 20]),
        ("wrong-version", b"garbage".to_vec()),
    ]
}

/// A room, a controller, and an observer that has received commands.
fn running() -> (Process, Process, RoomObserver) {
    let (room, controller) = (private_endpoint().expect("a port"), private_endpoint().expect("a port"));
    let sim = Process::heliostat(&["sim-node", "--listen", &room, "--exit-with-parent", "--json"]);
    let central = Process::controller("nearest", &room, &controller, &["--json"]);
    let observer = RoomObserver::connect("demo", &[&room, &controller]);
    observer.wait_for_commands();
    (sim, central, observer)
}

#[test]
fn the_controller_counts_invalid_payloads_by_cause() {
    let (sim, central, observer) = running();
    let room = observer.room().clone();
    let real = observer.users().expect("received");
    let user = |user| UserState { user, position_m: [MARK, 0.0, 0.85], velocity_m_s: [0.0, 0.0], min_rate_bps: 1e6 };
    let channel = |user| UserChannel { user, los_gain: MARK, irs_gain: 0.0, sinr: 0.0 };
    let users = UserReport { users: vec![user(0), user(1)], ..real.clone() };
    let channels = ChannelReport { stamp: real.stamp, tick: real.tick, users: vec![channel(0)] };
    let obstacle = Obstacle { x_m: MARK, y_m: 0.0, radius_m: 0.3, height_m: 1.0 };
    let obstacles = ObstacleReport { stamp: real.stamp, obstacles: vec![obstacle] };

    let attacks = [
        ("users", room.users(), encoded(&users)),
        ("channel", room.channel(), encoded(&channels)),
        ("obstacles", room.obstacles(), encoded(&obstacles)),
    ];
    for (stream, key, valid) in &attacks {
        for (name, payload) in invalid_variants(valid) {
            let counter = format!("refused:{stream}:{name}");
            let before = observer.counter(NodeKind::Controller, &counter);
            observer.publish(key, &payload);
            wait_until(&counter, || observer.counter(NodeKind::Controller, &counter) > before);
        }
    }

    // Well-formed reports of the current source with invalid content.
    let later = |sequence: u64, users: Vec<UserState>| UserReport {
        stamp: Stamp { sequence: real.stamp.sequence + sequence, ..observer.users().expect("received").stamp },
        tick: real.tick,
        users,
    };
    let five: Vec<UserState> = (0..5).map(user).collect();
    // Each report is built when it is published, so that its stamp is current. After a pause of a busy machine
    // it is stale, and another one is published.
    let refuse = |name: &str, change: &dyn Fn(&mut UserReport)| {
        let counter = format!("refused:users:{name}");
        wait_until(&counter, || {
            let mut report = later(1_000_000, five.clone());
            change(&mut report);
            observer.publish(&room.users(), &encoded(&report));
            observer.counter(NodeKind::Controller, &counter) > 0
        });
    };
    refuse("duplicate-user", &|report| report.users[4].user = 0);
    refuse("stale", &|report| report.stamp.time_ns -= 10_000_000_000);
    refuse("from-future", &|report| report.stamp.time_ns += 10_000_000_000);
    refuse("outside-room", &|report| {
        report.users.iter_mut().for_each(|user| user.position_m = [99.0, 0.0, 0.85]);
    });
    refuse("out-of-order", &|report| report.stamp.sequence = 1);
    assert!(!observer.status(NodeKind::Controller).expect("received").last_problem.is_empty());

    observer.wait_for_commands();
    let summary = central.end().json();
    assert!(summary["refused"]["users:not-finite"].as_u64() > Some(0), "{summary}");
    sim.end().json();
}

#[test]
fn the_controller_counts_invalid_payloads_about_arrays_and_names_the_last() {
    let (sim, central, observer) = running();
    let room = observer.room().clone();
    let geometry = room.geometry(NodeKind::SimNode);
    // The cause is that of an empty payload; the controller decodes every topic by the same codec.
    let topics = [
        ("capabilities", "capabilities of mirrors", room.array(0).capabilities()),
        ("safety", "safety of mirrors", room.array(0).safety()),
        ("stop", "stop", room.stop()),
        ("stops", "stops of mirrors", room.array(0).stops()),
        ("geometry", "geometry", geometry),
    ];
    let problem = || observer.status(NodeKind::Controller).map(|status| status.last_problem).unwrap_or_default();
    for (topic, name, key) in &topics {
        let counter = format!("refused:{topic}:truncated");
        observer.publish(key, &[]);
        wait_until(&counter, || observer.counter(NodeKind::Controller, &counter) == 1);
        wait_until(name, || problem().starts_with(&format!("{name}: ")));
    }
    let valid = encoded(&EmergencyStop::default());
    for (name, payload) in [("wrong-version", vec![9, valid[1]]), ("trailing-bytes", [&valid[..], &[0]].concat())] {
        let counter = format!("refused:stop:{name}");
        observer.publish(&room.stop(), &payload);
        wait_until(&counter, || observer.counter(NodeKind::Controller, &counter) == 1);
    }
    observer.wait_for_commands();
    let summary = central.end().json();
    assert_eq!(summary["refused"]["stop:truncated"].as_u64(), Some(1), "{summary}");
    sim.end().json();
}

#[test]
fn a_refusal_of_telemetry_names_the_array_and_the_sizes() {
    let (sim, central, observer) = running();
    let key = observer.room().array(0).telemetry();
    wait_until("telemetry", || observer.telemetry().is_some());
    let real = observer.telemetry().expect("received");
    let sized = |roll, yaw| MirrorTelemetry {
        roll_commanded: vec![0.0; roll],
        yaw_commanded: vec![0.0; yaw],
        roll_measured: Vec::new(),
        yaw_measured: Vec::new(),
        ..real.clone()
    };
    let problem = || observer.status(NodeKind::Controller).map(|status| status.last_problem).unwrap_or_default();
    observer.publish(&key, &encoded(&sized(9, 9)));
    let expected = "telemetry of mirrors refused: it has 9 roll and 9 yaw angles, expected 100 of each";
    wait_until(expected, || problem().starts_with(expected));
    observer.publish(&key, &[1]);
    wait_until("the name of the array", || problem().starts_with("telemetry of mirrors: "));
    // Its owner is that of the array, which is the simulator here.
    let foreign = Stamp { source: real.stamp.source ^ 1, ..real.stamp };
    observer.publish(&key, &encoded(&MirrorTelemetry { stamp: foreign, ..sized(100, 100) }));
    let expected = format!("reports telemetry of mirrors in this room, which source {:016x} owns", real.stamp.source);
    wait_until(&expected, || problem().contains(&expected));
    central.end().json();
    sim.end().json();
}

#[test]
fn the_array_counts_invalid_commands_by_cause() {
    let (sim, central, observer) = running();
    let key = observer.room().command();
    let (_, real) = observer.command();
    let real = real.expect("received");
    let command = |mirrors: usize| MirrorCommand {
        epoch: real.epoch,
        sequence: real.sequence + 1_000_000,
        roll: vec![MARK; mirrors],
        yaw: vec![0.0; mirrors],
        ..observer.command().1.expect("received")
    };
    let counted = |name: &str| format!("refused:command:{name}");
    for (name, payload) in invalid_variants(&encoded(&command(100))) {
        let before = observer.counter(NodeKind::SimNode, &counted(name));
        observer.publish(&key, &payload);
        wait_until(&counted(name), || observer.counter(NodeKind::SimNode, &counted(name)) > before);
    }
    let mut expired = command(100);
    expired.time_ns -= 60_000_000_000;
    for (name, payload) in [
        ("wrong-mirror-count", command(99)),
        ("expired", expired),
        ("lower-epoch", MirrorCommand { epoch: 1, ..command(100) }),
        ("old-sequence", MirrorCommand { sequence: 1, ..command(100) }),
    ] {
        observer.publish(&key, &encoded(&payload));
        wait_until(&counted(name), || observer.counter(NodeKind::SimNode, &counted(name)) > 0);
    }
    observer.wait_for_commands();
    let summary = sim.end().json();
    assert!(summary["refused"]["command:wrong-mirror-count"].as_u64() > Some(0), "{summary}");
    central.end().json();
}
