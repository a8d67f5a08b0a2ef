//! Users who enter and leave while a controller process runs: each report is answered, and the
//! answer to the first report with a new user already serves it.

use heliostat_bus::{Bus, BusConfig, Class, Publisher, private_endpoint};
use heliostat_proto::{ChannelReport, MirrorCommand, NodeKind, Room, Stamp, UserChannel, UserReport, UserState};
use heliostat_service::clock::utc_ns;
use heliostat_tests::{Process, RoomObserver, encoded, wait_until};

/// A tracker that reports the users that a test names.
struct Crowd {
    users: Publisher,
    channel: Publisher,
    _bus: Bus,
    tick: u64,
}

impl Crowd {
    fn connect(endpoint: &str) -> Self {
        let config = BusConfig::new(Room::new("demo").expect("valid")).connect_to(endpoint);
        let bus = Bus::open(&config).expect("the bus opens");
        let publisher = |key: &str| bus.publisher(key, Class::RealTimeBlock).expect("the key is valid");
        let (users, channel) = (publisher(&bus.room().users()), publisher(&bus.room().channel()));
        Self { users, channel, _bus: bus, tick: 0 }
    }

    /// Publishes a tick; the channel report has the users in another order, and a stranger.
    fn report(&mut self, ids: &[u32]) -> u64 {
        self.tick += 1;
        let stamp = Stamp { source: 0x7ac3, sequence: self.tick, time_ns: utc_ns() };
        let user = |id: &u32| UserState {
            user: *id,
            position_m: [0.4 * (*id % 11) as f32 - 2.0, 1.5 - 0.5 * (*id % 7) as f32, 0.85],
            velocity_m_s: [0.0, 0.0],
            min_rate_bps: 1e6,
        };
        let gains = |id: &u32| UserChannel { user: *id, los_gain: 0.0, irs_gain: 0.0, sinr: 0.0 };
        let measured = ids.iter().rev().chain([&999]).map(gains).collect();
        let channel = ChannelReport { stamp, tick: self.tick, users: measured };
        let users = UserReport { stamp, tick: self.tick, users: ids.iter().map(user).collect() };
        self.channel.put(&encoded(&channel)).expect("the session is open");
        self.users.put(&encoded(&users)).expect("the session is open");
        self.tick
    }
}

/// Reports users and waits for the command that answers.
fn answer(crowd: &mut Crowd, observer: &RoomObserver, ids: &[u32]) -> MirrorCommand {
    let tick = crowd.report(ids);
    let answered = || observer.command().1.filter(|command| command.answers == tick);
    wait_until(&format!("the answer to tick {tick} with {} users", ids.len()), || answered().is_some());
    answered().expect("received")
}

#[test]
fn a_tracker_may_report_other_users_with_every_report() {
    let endpoint = private_endpoint().expect("an endpoint");
    // The first reports may wait for a policy that is not in the processor's caches, and a busy machine pauses.
    let patient = ["--set", "control.deadline_ms=60000", "--set", "control.report_age_max_ms=60000"];
    let controller = ["controller", "--listen", &endpoint, "--policy", "fixed-point", "--exit-with-parent", "--json"];
    let controller = Process::heliostat(&[&controller[..], &patient].concat());
    let observer = RoomObserver::connect("demo", &[&endpoint]);
    wait_until("a controller", || observer.status(NodeKind::Controller).is_some());
    let mut crowd = Crowd::connect(&endpoint);

    // The peers may find each other after the first reports.
    wait_until("a first answer", || {
        crowd.report(&[0, 1, 2]);
        observer.command().0 > 0
    });
    let sets: [&[u32]; 9] =
        [&[0, 1, 2], &[2, 0], &[9, 2, 17, 0], &[], &[5, 9, 6, 8, 7], &[], &[41], &[3, 41, 2], &[2, 3]];
    let (mut expected, mut last) = (Vec::new(), None);
    for ids in sets.iter().cycle().take(45) {
        let command = answer(&mut crowd, &observer, ids);
        if ids.is_empty() {
            assert_eq!(Some((&command.roll, &command.yaw)), last.as_ref().map(|(roll, yaw)| (roll, yaw)));
        }
        last = Some((command.roll.clone(), command.yaw.clone()));
        expected.push(command.answers);
    }
    assert!(expected.windows(2).all(|pair| pair[1] == pair[0] + 1), "{expected:?}");

    // A user on the other side of the room is served at once: the mirrors differ from the last ones.
    let before = answer(&mut crowd, &observer, &[0]);
    let after = answer(&mut crowd, &observer, &[65]);
    assert_ne!(before.roll, after.roll);

    let summary = controller.end().json();
    assert_eq!(summary["refused"].as_object().map(|refused| refused.len()), Some(0), "{summary}");
    // The first reports wait for the telemetry of an array, which this room has not.
    let count = |path: &str| summary.pointer(path).and_then(serde_json::Value::as_u64);
    let awaiting = count("/withheld/standby").unwrap_or_default();
    assert_eq!(count("/decisions"), count("/commands").map(|commands| commands + awaiting), "{summary}");
    assert_eq!(count("/decisions"), Some(crowd.tick), "{summary}");
}

/// The summary of a simulated room with fast arrivals, in lockstep with a controller.
fn simulated(policy: &str) -> serde_json::Value {
    let endpoint = private_endpoint().expect("an endpoint");
    let arrivals = [
        "--set",
        "users.arrivals.rate_per_min=120",
        "--set",
        "users.arrivals.mean_stay_s=2",
        "--set",
        "users.arrivals.max_users=14",
    ];
    let room = ["sim-node", "--lockstep", "1500", "--listen", &endpoint, "--json"];
    let room = Process::heliostat(&[&room[..], &arrivals].concat());
    let controller =
        ["controller", "--lockstep", "--policy", policy, "--connect", &endpoint, "--exit-with-parent", "--json"];
    let controller = Process::heliostat(&[&controller[..], &arrivals].concat());
    let summary = room.wait().json();
    let decided = controller.end().json();
    assert_eq!(decided["commands"].as_u64(), Some(1500), "{decided}");
    assert!(decided["fallbacks"].get("policy-failed").is_none(), "{decided}");
    summary
}

#[test]
fn every_report_of_a_simulated_room_with_fast_arrivals_is_answered() {
    for policy in ["fixed-point", "actor"] {
        let summary = simulated(policy);
        assert_eq!((summary["ticks"].as_u64(), summary["commands"].as_u64()), (Some(1500), Some(1500)), "{summary}");
        assert_eq!(summary["lost_ticks"].as_u64(), Some(0), "{summary}");
        let turnover = |name: &str| summary["turnover"][name].as_u64().expect("a count");
        assert!(turnover("entered") > 10 && turnover("left") > 10, "{summary}");
        assert_eq!(summary["hash"], simulated(policy)["hash"], "the same seed, the same run");
    }
}
