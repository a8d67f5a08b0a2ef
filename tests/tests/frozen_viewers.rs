//! Viewers that stop reading, or whose link is cut: array and controller continue without delay.
//!
//! The array ends the connection to a silent viewer when the viewer's lease expires. At that time
//! data for the viewer are still waiting. Closing such a connection must not block the threads that
//! receive commands and stops.

use std::sync::Mutex;
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, BusConfig, Class, Publisher, Subscription};
use heliostat_needs::needs;
use heliostat_proto::{ArrayState, EmergencyStop, MirrorTelemetry, NodeKind, Stamp, StopAction, codec};
use heliostat_service::clock::utc_ns;
use heliostat_tests::faults::{Array, FaultRoom, Launch, Link, Setup};
use heliostat_tests::{Pauses, Process, encoded, wait_until};
use tempfile::TempDir;

/// Setting of the viewers: in ms, the time after which the others end a silent connection.
const VIEWER_LEASE: &str = "transport/link/tx/lease=2000";

/// The lease and 10 s, the time for which Zenoh by default waits to close a connection.
const WATCHED: Duration = Duration::from_secs(13);

/// Time between two stops.
const STOP_EVERY: Duration = Duration::from_millis(400);

/// Time limit for the median stop.
const STOP_LIMIT: Duration = Duration::from_millis(100);

/// Time limit for every stop, on a machine that also runs other tests.
const SLOWEST_STOP: Duration = Duration::from_millis(1000);

/// A pause of the machine above this time explains late stops and lost commands.
const PAUSE_MAX: Duration = Duration::from_millis(150);

/// Scenes that are played, while a pause of the machine explains what was observed.
const SCENES_MAX: usize = 4;

/// Only one of these tests runs at a time: each measures delays.
static ALONE: Mutex<()> = Mutex::new(());

/// A session that orders stops and receives telemetry.
struct Operator {
    telemetry: Receiver<(Instant, MirrorTelemetry)>,
    stops: Publisher,
    sequence: u64,
    _subscription: Subscription,
    _bus: Bus,
}

/// What an operator observed during a time.
#[derive(Debug)]
struct Observed {
    /// User reports.
    reported: u64,
    /// Those for which no command arrived in time.
    lost: u64,
    /// Times from the order of a stop to telemetry that reports it.
    stops: Vec<Duration>,
}

impl Observed {
    fn median_stop(&self) -> Duration {
        let mut stops = self.stops.clone();
        stops.sort_unstable();
        stops[stops.len() / 2]
    }

    fn slowest_stop(&self) -> Duration {
        self.stops.iter().copied().max().expect("at least one stop")
    }
}

impl Operator {
    fn join(config: &BusConfig) -> Self {
        let bus = Bus::open(config).expect("the bus opens");
        let (sender, telemetry) = channel();
        let on_telemetry = move |payload: &[u8]| {
            if let Ok(message) = codec::decode::<MirrorTelemetry>(payload) {
                let _ = sender.send((Instant::now(), message));
            }
        };
        let subscription = bus.subscribe(&config.room.telemetry(), on_telemetry).expect("the key is valid");
        let stops = bus.publisher(&config.room.stop(), Class::RealTimeBlock).expect("the key is valid");
        wait_until("an array that receives stops", || stops.has_subscribers().expect("the session is open"));
        Self { telemetry, stops, sequence: 0, _subscription: subscription, _bus: bus }
    }

    /// Stops and re-arms the array again and again.
    fn observe(&mut self, duration: Duration) -> Observed {
        let end = Instant::now() + duration;
        let before = self.wait_for(ArrayState::Following, Instant::now()).1;
        let mut stops = Vec::new();
        while Instant::now() < end {
            let ordered = self.order(StopAction::Stop);
            stops.push(self.wait_for(ArrayState::Stopped, ordered).0 - ordered);
            let ordered = self.order(StopAction::Rearm);
            self.wait_for(ArrayState::Following, ordered);
            thread::sleep(STOP_EVERY);
        }
        let after = self.wait_for(ArrayState::Following, Instant::now()).1;
        assert_eq!(before.epoch, after.epoch, "the controller is the same");
        let arrived = |telemetry: &MirrorTelemetry| telemetry.counters.accepted + telemetry.counters.stopped;
        let reported = after.answers - before.answers;
        let lost = reported.saturating_sub(arrived(&after) - arrived(&before));
        Observed { reported, lost, stops }
    }

    fn order(&mut self, action: StopAction) -> Instant {
        self.sequence += 1;
        let stamp = Stamp { source: 1, sequence: self.sequence, time_ns: utc_ns() };
        let order = EmergencyStop { stamp, action, operator: "test".into(), reason: "frozen viewers".into() };
        let payload = encoded(&order);
        let ordered = Instant::now();
        self.stops.put(&payload).expect("the session is open");
        ordered
    }

    /// The first telemetry in this state after an instant.
    fn wait_for(&self, state: ArrayState, since: Instant) -> (Instant, MirrorTelemetry) {
        let limit = Duration::from_secs(60);
        loop {
            let (arrived, message) = self.telemetry.recv_timeout(limit).expect("telemetry arrives");
            if arrived >= since && message.state == state {
                return (arrived, message);
            }
        }
    }
}

/// A room, its operator and viewers that receive everything.
struct Scene {
    _room: FaultRoom,
    operator: Operator,
    viewers: Vec<Process>,
    _files: TempDir,
}

impl Scene {
    /// Starts viewers, in a namespace if there is a link to one.
    fn start(viewers: usize, link: Option<&Link>) -> Self {
        let mut setup = Setup::new(Array::Simulated).over_tcp();
        let session = setup.session();
        let mut endpoints = session.connect.clone();
        if let Some(link) = link {
            let port = |endpoint: &String| endpoint.rsplit_once(':').expect("an endpoint ends in a port").1.to_owned();
            let outside = endpoints.iter().map(|endpoint| format!("tcp/{}:{}", link.host_address(), port(endpoint)));
            endpoints = outside.collect();
            setup.of_array = Launch::default().flags(&["--listen", &endpoints[0], "--insecure"]);
            setup.of_controller = Launch::default().flags(&["--listen", &endpoints[1], "--insecure"]);
        }
        let room = setup.start();
        let operator = Operator::join(&session);
        let wrapper = link.map(Link::wrapper).unwrap_or_default();
        let files = tempfile::tempdir().expect("a folder");
        let viewer = |number: usize| {
            let file = files.path().join(format!("{number}.mcap")).display().to_string();
            let (room, ends) = (session.room.to_string(), &endpoints);
            let arguments = ["record", "--room", &room, "--connect", &ends[0], "--connect", &ends[1], "--out", &file];
            Process::heliostat_under(&wrapper, &[("HELIOSTAT_ZENOH", VIEWER_LEASE)], &arguments)
        };
        let viewers: Vec<_> = (0..viewers).map(viewer).collect();
        wait_until("viewers connected to array and controller", || {
            viewers.iter().all(|viewer| viewer.has_noted(NodeKind::SimNode) && viewer.has_noted(NodeKind::Controller))
        });
        Self { _room: room, operator, viewers, _files: files }
    }

    /// Observes the room before and after an accident, and compares.
    ///
    /// # Errors
    /// What the accident delays.
    fn undergo(mut self, accident: impl FnOnce(&[Process])) -> Result<(), String> {
        let before = self.operator.observe(WATCHED);
        accident(&self.viewers);
        let after = self.operator.observe(WATCHED);
        println!(
            "lost {} before, {} after; slowest stop {:.1?} before, {:.1?} after; median {:.1?} and {:.1?}",
            before.lost,
            after.lost,
            before.slowest_stop(),
            after.slowest_stop(),
            before.median_stop(),
            after.median_stop()
        );
        // Each stop costs about one command, and a busy machine loses some without any accident. A close that
        // blocks for Zenoh's 10 s loses three quarters.
        if after.lost > before.lost + after.reported / 4 {
            return Err(format!("commands are lost: {after:?}, and before {before:?}"));
        }
        // A slow machine is slow before the accident too.
        if after.median_stop() > STOP_LIMIT.max(2 * before.median_stop()) {
            return Err(format!("stops are late: {after:?}, and before {before:?}"));
        }
        if after.slowest_stop() > SLOWEST_STOP {
            return Err(format!("a stop is late: {after:?}"));
        }
        Ok(())
    }
}

/// Plays a scene, and another one where a pause of the machine explains what the first one shows.
fn play(viewers: usize, link: Option<&Link>, accident: impl Fn(&[Process])) {
    for scene in 1..=SCENES_MAX {
        let pauses = Pauses::start();
        let Err(problem) = Scene::start(viewers, link).undergo(&accident) else { return };
        let longest = pauses.longest();
        assert!(longest > PAUSE_MAX && scene < SCENES_MAX, "{problem}");
        println!("played again, the machine paused for {longest:?}: {problem}");
        if let Some(link) = link {
            link.heal();
        }
    }
}

fn freeze(viewers: &[Process]) {
    viewers.iter().for_each(|viewer| viewer.signal("STOP"));
}

#[test]
fn three_frozen_viewers_delay_neither_commands_nor_stops() {
    let _alone = ALONE.lock();
    play(3, None, freeze);
}

#[test]
fn fifteen_frozen_viewers_delay_neither_commands_nor_stops() {
    let _alone = ALONE.lock();
    play(15, None, freeze);
}

#[needs("network-namespaces")]
#[test]
fn four_viewers_without_a_link_delay_neither_commands_nor_stops() {
    let _alone = ALONE.lock();
    let link = Link::create();
    play(4, Some(&link), |_| link.cut());
}
