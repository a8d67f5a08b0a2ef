//! Rights of every role over real connections: peer to peer, and through a router with the
//! generated configuration.

mod common;

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use common::{Keys, LIMIT, ROOM, router};
use heliostat_bus::*;
use heliostat_proto::{NodeKind, Room};

/// Every key of the contract, and a key outside of it.
const KEYS: [&str; 19] = [
    "users",
    "channel",
    "obstacles",
    "mirrors/command",
    "mirrors/telemetry",
    "status/controller",
    "status/sim-node",
    "status/driver",
    "status/tracker",
    "status/viewer",
    "truth",
    "mirrors/capabilities",
    "mirrors/stop",
    "mirrors/calibration",
    "sim/control",
    "controller/control",
    "mirrors/rearm",
    "mirrors/safety",
    "something/else",
];

/// The keys on which each role may publish, written down independently of the program.
const RIGHTS: [(AccessRole, &str); 8] = [
    (AccessRole::Tracker, "users channel obstacles mirrors/stop status/tracker"),
    (AccessRole::Controller, "mirrors/command mirrors/stop status/controller"),
    (AccessRole::Driver, "mirrors/telemetry mirrors/capabilities mirrors/safety mirrors/stop status/driver"),
    (
        AccessRole::Simulator,
        "users channel obstacles truth mirrors/telemetry mirrors/capabilities mirrors/safety mirrors/stop \
         status/sim-node status/tracker",
    ),
    (AccessRole::Operator, "mirrors/stop mirrors/rearm sim/control controller/control status/viewer"),
    (AccessRole::Calibrator, "mirrors/calibration mirrors/stop status/viewer"),
    (AccessRole::Checker, "mirrors/command mirrors/calibration mirrors/rearm mirrors/stop status/viewer"),
    (AccessRole::Viewer, "mirrors/stop status/viewer"),
];

/// Kinds of process as which each role may be present.
const PRESENCE: [(AccessRole, &[NodeKind]); 8] = [
    (AccessRole::Tracker, &[NodeKind::Tracker]),
    (AccessRole::Controller, &[NodeKind::Controller]),
    (AccessRole::Driver, &[NodeKind::Driver]),
    (AccessRole::Simulator, &[NodeKind::SimNode, NodeKind::Tracker]),
    (AccessRole::Operator, &[NodeKind::Viewer]),
    (AccessRole::Calibrator, &[NodeKind::Viewer]),
    (AccessRole::Checker, &[NodeKind::Viewer]),
    (AccessRole::Viewer, &[NodeKind::Viewer]),
];

/// Keys that a session received, without the prefix of the room.
struct Received {
    keys: Arc<Mutex<BTreeSet<String>>>,
    _subscription: Subscription,
}

impl Received {
    fn everything(bus: &Bus) -> Self {
        let keys: Arc<Mutex<BTreeSet<String>>> = Arc::default();
        let kept = Arc::clone(&keys);
        let prefix = format!("heliostat/v1/{}/", bus.room());
        let keep = move |key: &str, _: &[u8]| {
            kept.lock().expect("no callback panics").insert(key.strip_prefix(&prefix).unwrap_or(key).to_owned());
        };
        Self { keys, _subscription: bus.subscribe_keyed(&bus.room().everything(), keep).expect("a valid pattern") }
    }

    /// Waits until the key arrives, and takes all keys so far.
    fn take_after(&self, last: &str) -> BTreeSet<String> {
        let deadline = Instant::now() + LIMIT;
        while !self.keys.lock().expect("no callback panics").contains(last) {
            assert!(Instant::now() < deadline, "{last} does not arrive");
            std::thread::sleep(Duration::from_millis(5));
        }
        std::mem::take(&mut *self.keys.lock().expect("no callback panics"))
    }
}

fn words(text: &str) -> BTreeSet<String> {
    text.split_whitespace().map(str::to_owned).collect()
}

/// Publishes on every key, the stop last: messages of one class keep their order, so all that may
/// arrive has arrived before the stop.
fn publish_everything(bus: &Bus) {
    let room = bus.room().clone();
    let publisher =
        |key: &str| bus.publisher(&format!("heliostat/v1/{room}/{key}"), Class::RealTimeBlock).expect("a valid key");
    let stop = publisher("mirrors/stop");
    let deadline = Instant::now() + LIMIT;
    while !stop.has_subscribers().expect("the session is open") {
        assert!(Instant::now() < deadline, "no subscriber of the stop is known");
        std::thread::sleep(Duration::from_millis(5));
    }
    for key in KEYS.iter().filter(|key| **key != "mirrors/stop") {
        publisher(key).put(b"content").expect("the session is open");
    }
    stop.put(b"content").expect("the session is open");
}

fn expect_rights(sender: &Bus, receiver: &Received, role: AccessRole, keys: &str) {
    publish_everything(sender);
    assert_eq!(receiver.take_after("mirrors/stop"), words(keys), "{role}");
}

#[test]
fn a_listening_peer_accepts_from_each_role_only_its_own_keys() {
    let keys = Keys::new();
    let endpoint = common::tls_endpoint();
    let driver = keys.open(AccessRole::Driver, |config| config.listen_at(&endpoint));
    let received = Received::everything(&driver);
    for (role, rights) in RIGHTS {
        let sender = keys.open(role, |config| config.connect_to(&endpoint));
        expect_rights(&sender, &received, role, rights);
        sender.close().expect("the session closes");
    }
}

#[test]
fn a_connecting_peer_accepts_from_each_role_only_its_own_keys() {
    let keys = Keys::new();
    for (role, rights) in RIGHTS {
        let endpoint = common::tls_endpoint();
        let sender = keys.open(role, |config| config.listen_at(&endpoint));
        let viewer = keys.open(AccessRole::Viewer, |config| config.connect_to(&endpoint));
        expect_rights(&sender, &Received::everything(&viewer), role, rights);
    }
}

#[test]
fn a_router_forwards_from_each_role_only_its_own_keys() {
    let keys = Keys::new();
    let (router, endpoint) = router(keys.folder());
    let viewer = keys.client(AccessRole::Viewer, &endpoint);
    let received = Received::everything(&viewer);
    for (role, rights) in RIGHTS {
        let sender = keys.client(role, &endpoint);
        expect_rights(&sender, &received, role, rights);
        sender.close().expect("the session closes");
    }
    common::close(router);
}

#[test]
fn every_role_receives_every_key_of_its_room() {
    let keys = Keys::new();
    let (router, router_endpoint) = router(keys.folder());
    for (role, _) in RIGHTS {
        let endpoint = common::tls_endpoint();
        // The roles that may publish between them every key.
        let publishing = [AccessRole::Simulator, AccessRole::Checker, AccessRole::Operator];
        let expected: BTreeSet<String> =
            RIGHTS.iter().filter(|(sender, _)| publishing.contains(sender)).flat_map(|(_, keys)| words(keys)).collect();
        let peer = keys.open(role, |config| config.listen_at(&endpoint));
        let client = keys.client(role, &router_endpoint);
        for (receiver, connect) in [(&peer, false), (&client, true)] {
            let received = Received::everything(receiver);
            let mut found = BTreeSet::new();
            for sender in publishing {
                let sender = if connect {
                    keys.client(sender, &router_endpoint)
                } else {
                    keys.open(sender, |config| config.connect_to(&endpoint))
                };
                publish_everything(&sender);
                found.extend(received.take_after("mirrors/stop"));
            }
            assert_eq!(found, expected, "{role}, through a router: {connect}");
        }
    }
    common::close(router);
}

/// Announces every kind of process, and expects that `observer` finds the tokens of the role.
fn expect_presence(holder: &Bus, observer: &Bus, role: AccessRole, nodes: &[NodeKind]) {
    let room = holder.room().clone();
    let source = role as u64 + 1;
    let tokens: Vec<Token> =
        NodeKind::ALL.iter().map(|node| holder.announce(&room.alive(*node, source)).expect("a valid key")).collect();
    let expected: BTreeSet<String> = nodes.iter().map(|node| room.alive(*node, source)).collect();
    let present = || -> BTreeSet<String> {
        observer.alive(&room.all_alive(), Duration::from_secs(1)).expect("a valid pattern").into_iter().collect()
    };
    let deadline = Instant::now() + LIMIT;
    while !expected.is_subset(&present()) {
        assert!(Instant::now() < deadline, "{role}: {:?} in place of {expected:?}", present());
    }
    assert_eq!(present(), expected, "{role}");
    drop(tokens);
    while !present().is_empty() {
        assert!(Instant::now() < deadline, "{role}: withdrawn tokens are present: {:?}", present());
    }
}

#[test]
fn each_role_is_present_only_as_its_own_kind_of_process() {
    let keys = Keys::new();
    let (router, router_endpoint) = router(keys.folder());
    let endpoint = common::tls_endpoint();
    let listening = keys.open(AccessRole::Viewer, |config| config.listen_at(&endpoint));
    let client = keys.client(AccessRole::Viewer, &router_endpoint);
    for (role, nodes) in PRESENCE {
        expect_presence(&keys.open(role, |config| config.connect_to(&endpoint)), &listening, role, nodes);
        expect_presence(&keys.client(role, &router_endpoint), &client, role, nodes);
    }
    common::close(router);
}

#[test]
fn only_the_roles_that_drive_mirrors_answer_queries_of_their_capabilities() {
    let keys = Keys::new();
    let (router, router_endpoint) = router(keys.folder());
    for (role, _) in RIGHTS {
        let endpoint = common::tls_endpoint();
        let peers = [
            keys.open(role, |config| config.listen_at(&endpoint)),
            keys.open(AccessRole::Controller, |config| config.connect_to(&endpoint)),
        ];
        let clients = [keys.client(role, &router_endpoint), keys.client(AccessRole::Controller, &router_endpoint)];
        for [answering, asking] in [peers, clients] {
            let key = answering.room().capabilities();
            let _service = answering.serve(&key, |answer| answer.extend(b"capabilities")).expect("a valid key");
            // A query of the answering role shows that the connection carries queries.
            let is_driver = matches!(role, AccessRole::Driver | AccessRole::Simulator);
            let received = Received::everything(&asking);
            publish_everything(&answering);
            received.take_after("mirrors/stop");
            let ask = || asking.fetch(&key, Duration::from_secs(1)).expect("a valid key");
            let deadline = Instant::now() + LIMIT;
            let mut answers = ask();
            while is_driver && answers.is_empty() {
                assert!(Instant::now() < deadline, "{role} does not answer");
                answers = ask();
            }
            assert_eq!(answers.len(), usize::from(is_driver), "{role}");
        }
    }
    common::close(router);
}

#[test]
fn a_certificate_gives_no_right_in_another_room() {
    let (lab, hall) = (Keys::new(), Keys::of_room("hall"));
    // Both rooms trust one authority: the worst case, since each room normally has its own.
    hall.adopt(&lab);
    let endpoint = common::tls_endpoint();
    let driver = lab.open(AccessRole::Driver, |config| config.listen_at(&endpoint));
    let received = Received::everything(&driver);
    let foreign = zenoh_session(hall.folder(), AccessRole::Operator, &endpoint).expect("the certificate is accepted");
    let control = lab.open(AccessRole::Viewer, |config| config.connect_to(&endpoint));
    for key in KEYS {
        zenoh::Wait::wait(foreign.put(format!("heliostat/v1/{ROOM}/{key}"), b"foreign")).expect("the session is open");
    }
    expect_rights(&control, &received, AccessRole::Viewer, "mirrors/stop status/viewer");
}

fn zenoh_session(folder: &Path, role: AccessRole, endpoint: &str) -> Result<zenoh::Session, zenoh::Error> {
    common::foreign(Some((folder, role)), folder, endpoint)
}

#[test]
fn without_a_valid_certificate_of_the_room_a_process_sends_and_receives_nothing() {
    let (keys, other, expired) = (Keys::new(), Keys::new(), Keys::new());
    expired.adopt(&keys);
    expired.expire();
    let (router, router_endpoint) = router(keys.folder());
    let endpoint = common::tls_endpoint();
    let driver = keys.open(AccessRole::Driver, |config| config.listen_at(&endpoint));
    let member = keys.client(AccessRole::Driver, &router_endpoint);
    let received = [Received::everything(&driver), Received::everything(&member)];
    for (name, identity, authority) in [
        ("without a certificate", None, &keys),
        ("with a certificate of another authority", Some((other.folder(), AccessRole::Operator)), &keys),
        ("with an expired certificate", Some((expired.folder(), AccessRole::Operator)), &keys),
        ("with another authority", Some((other.folder(), AccessRole::Operator)), &other),
    ] {
        for endpoint in [&endpoint, &router_endpoint] {
            let opened = common::foreign(identity, authority.folder(), endpoint);
            assert!(opened.is_err(), "a process {name} opens a session at {endpoint}");
        }
    }
    // Without TLS the listener does not answer either.
    let plain = BusConfig::new(Room::new(ROOM).expect("a valid name")).connect_to(&endpoint.replace("tls/", "tcp/"));
    assert!(Bus::open(&plain.reaching(Reach::Within(Duration::from_secs(1)))).is_err());
    // The same listeners accept a member of the room.
    for (received, sender) in received.iter().zip([
        keys.open(AccessRole::Viewer, |config| config.connect_to(&endpoint)),
        keys.client(AccessRole::Viewer, &router_endpoint),
    ]) {
        expect_rights(&sender, received, AccessRole::Viewer, "mirrors/stop status/viewer");
    }
    common::close(router);
}

#[test]
fn a_process_does_not_connect_to_a_listener_with_an_expired_or_foreign_certificate() {
    let (keys, other, expired) = (Keys::new(), Keys::new(), Keys::new());
    expired.adopt(&keys);
    expired.expire();
    for (folder, role) in [(other.folder(), AccessRole::Driver), (expired.folder(), AccessRole::Driver)] {
        let endpoint = common::tls_endpoint();
        let _listener = common::foreign_listener(folder, role, &endpoint);
        let viewer =
            keys.config(AccessRole::Viewer).connect_to(&endpoint).reaching(Reach::Within(Duration::from_secs(2)));
        let error = Bus::open(&viewer).err().expect("the certificate of the listener is refused");
        assert!(matches!(error, BusError::CannotReach { .. }), "{error}");
    }
}

#[test]
fn a_connection_ends_when_its_certificate_expires() {
    let keys = Keys::new();
    let brief = Keys::new();
    brief.adopt(&keys);
    brief.expire_in(Duration::from_secs(4));
    let endpoint = common::tls_endpoint();
    let driver = keys.open(AccessRole::Driver, |config| config.listen_at(&endpoint));
    let viewer = brief.open(AccessRole::Viewer, |config| config.connect_to(&endpoint));
    let _token = viewer.announce(&viewer.room().alive(NodeKind::Viewer, 1)).expect("a valid key");
    let present = || !driver.alive(&driver.room().all_alive(), Duration::from_secs(1)).expect("a valid key").is_empty();
    let deadline = Instant::now() + LIMIT;
    while !present() {
        assert!(Instant::now() < deadline, "the certificate is valid, but the connection carries nothing");
    }
    while present() {
        assert!(Instant::now() < deadline, "the connection outlives its certificate");
        std::thread::sleep(Duration::from_millis(100));
    }
}
