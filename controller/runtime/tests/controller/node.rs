//! The node on a real bus, in one process: commands come back, and hostile payloads are counted by
//! name.

use std::{
    sync::mpsc,
    thread,
    time::{Duration, Instant},
};

use heliostat_bus::{Bus, BusConfig, Class, free_loopback_endpoint};
use heliostat_controller::{
    config::{NodeConfig, Pace},
    node,
    report::summary::Summary,
};
use heliostat_core::policy::PolicyKind;
use heliostat_proto::{MirrorCommand, Room as RoomName, UserReport, decode, encode};
use heliostat_service::{MetricsArgs, Stop};

use crate::support::{Room, scenario};

const PATIENCE: Duration = Duration::from_secs(60);

/// A node in lockstep, and the bus of the room that it serves.
struct Rig {
    bus: Bus,
    room: Room,
    commands: mpsc::Receiver<MirrorCommand>,
    stop: Stop,
    node: thread::JoinHandle<anyhow::Result<Summary>>,
    _subscription: heliostat_bus::Subscription,
}

impl Rig {
    fn start() -> Self {
        let scenario = scenario(&[]);
        let room = Room::new(&scenario);
        let name = RoomName::new("node-test").unwrap();
        let endpoint = free_loopback_endpoint().unwrap();
        let bus = Bus::open(&BusConfig::new(name.clone()).listen_at(&endpoint)).unwrap();
        let (sender, commands) = mpsc::sync_channel(1000);
        let subscription = bus
            .subscribe(&name.command(), move |payload| sender.send(decode(payload).unwrap()).unwrap_or_default())
            .unwrap();
        let config = NodeConfig {
            force: Default::default(),
            scenario,
            bus: BusConfig::new(name).connect_to(&endpoint),
            also_rooms: Vec::new(),
            times_from_tick: 0,
            policy: PolicyKind::Nearest,
            model: None,
            pace: Pace::Lockstep,
            standby: None,
            run_for: Some(4 * PATIENCE),
            metrics: MetricsArgs::default(),
        };
        let stop = Stop::default();
        let stopped = stop.clone();
        let node = thread::spawn(move || node::run(&config, Vec::new(), &stopped));
        Self { bus, room, commands, stop, node, _subscription: subscription }
    }

    fn report(&mut self, tick: u64) -> Vec<u8> {
        let mut payload = Vec::new();
        encode::<UserReport>(&self.room.positions(tick), &mut payload).unwrap();
        payload
    }

    /// Reports ticks until one is answered: those before the node has subscribed are lost.
    fn connect(&mut self) -> u64 {
        let users = self.bus.publisher(&self.bus.room().users(), Class::RealTimeDrop).unwrap();
        let deadline = Instant::now() + PATIENCE;
        for tick in 1.. {
            users.put(&self.report(tick)).unwrap();
            if let Ok(command) = self.commands.recv_timeout(Duration::from_millis(50)) {
                return command.answers;
            }
            assert!(Instant::now() < deadline, "no command arrives");
        }
        unreachable!("the deadline comes first")
    }

    fn finish(self) -> Summary {
        self.stop.request();
        self.node.join().unwrap().unwrap()
    }
}

#[test]
fn hostile_payloads_are_counted_by_name_and_decisions_continue() {
    let mut rig = Rig::start();
    let answered = rig.connect();
    let name = rig.bus.room().clone();
    let sound = rig.report(answered + 100);
    let (mut other_version, mut trailing) = (sound.clone(), sound.clone());
    other_version[0] = 9;
    trailing.push(0);
    let users = rig.bus.publisher(&name.users(), Class::RealTimeBlock).unwrap();
    for payload in [&other_version[..], &trailing[..], &sound[..sound.len() / 2], b"", &[1, 77, 3]] {
        users.put(payload).unwrap();
        thread::sleep(Duration::from_millis(20));
    }
    for key in [name.channel(), name.obstacles(), name.telemetry()] {
        // A sound payload, but not of this key; and more bytes than any payload may have.
        let publisher = rig.bus.publisher(&key, Class::RealTimeBlock).unwrap();
        publisher.put(&sound).unwrap();
        publisher.put(&vec![1; 1_100_000]).unwrap();
        thread::sleep(Duration::from_millis(20));
    }
    users.put(&rig.report(answered + 200)).unwrap();
    let command = rig.commands.iter().find(|command| command.answers == answered + 200).unwrap();
    assert_eq!(command.roll.len(), 9);

    let summary = rig.finish();
    let count = |name: &str| summary.refused.get(name).copied().unwrap_or(0);
    assert_eq!((count("users:wrong-version"), count("users:trailing-bytes")), (1, 1));
    assert_eq!((count("users:truncated"), count("users:wrong-kind")), (2, 1));
    for stream in ["channel", "obstacles", "telemetry"] {
        assert_eq!(count(&format!("{stream}:wrong-kind")), 1, "{:?}", summary.refused);
        assert_eq!(count(&format!("{stream}:oversized")), 1, "{:?}", summary.refused);
    }
    assert!(!summary.last_problem.is_empty());
    assert_eq!(summary.commands, summary.decision_us.count);
    assert_eq!((summary.epoch, summary.policy.as_str(), summary.unsent), (1, "nearest", 0));
}
