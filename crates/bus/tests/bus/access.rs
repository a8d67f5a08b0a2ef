//! Rights of every role over real connections: peer to peer, and through a router with the
//! generated configuration.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime};

use crate::common::{self, Keys, LIMIT, ROOM, router, wait_until};
use heliostat_bus::*;
use heliostat_proto::{NodeKind, Room};
use zenoh::Wait;

/// Every key of the contract, and a key outside of it.
const KEYS: [&str; 38] = [
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
    "geometry/controller",
    "controller/belief",
    "controller/memory",
    "geometry/sim-node",
    "geometry/driver",
    "orientation",
    "branches",
    "leds",
    "status/driver-1",
    "mirrors-1/command",
    "mirrors-15/telemetry",
    "mirrors-1/capabilities",
    "mirrors-1/calibration",
    "mirrors-1/safety",
    "mirrors-1/stop",
    "mirrors/stops",
    "mirrors-1/stops",
    "mirrors/stop-repetition",
    "mirrors-1/stop-repetition",
    "something/else",
];

/// The keys on which every role may publish besides those of [`RIGHTS`].
const RIGHTS_OF_ALL: &str = "mirrors/stop-repetition mirrors-1/stop-repetition";

/// The keys on which each role may publish, written down independently of the program.
const RIGHTS: [(AccessRole, &str); 8] = [
    (AccessRole::Tracker, "users channel obstacles orientation branches leds mirrors/stop status/tracker"),
    (
        AccessRole::Controller,
        "mirrors/command mirrors-1/command mirrors/stop status/controller geometry/controller controller/belief \
         controller/memory",
    ),
    (
        AccessRole::Driver,
        "mirrors/telemetry mirrors/capabilities mirrors/safety mirrors-15/telemetry mirrors-1/capabilities \
         mirrors-1/safety mirrors/stops mirrors-1/stops mirrors/stop status/driver status/driver-1",
    ),
    (
        AccessRole::Simulator,
        "users channel obstacles orientation branches leds truth mirrors/telemetry mirrors/capabilities mirrors/safety \
         mirrors-15/telemetry mirrors-1/capabilities mirrors-1/safety mirrors/stops mirrors-1/stops mirrors/stop \
         status/sim-node status/tracker geometry/sim-node",
    ),
    (AccessRole::Operator, "mirrors/stop mirrors/rearm sim/control controller/control status/viewer"),
    (AccessRole::Calibrator, "mirrors/calibration mirrors-1/calibration mirrors/stop status/viewer"),
    (
        AccessRole::Checker,
        "mirrors/command mirrors/calibration mirrors-1/command mirrors-1/calibration mirrors/rearm \
         mirrors/stop status/viewer",
    ),
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
    is_connected: Arc<AtomicBool>,
    _subscription: Subscription,
}

impl Received {
    fn everything(bus: &Bus) -> Self {
        let (keys, is_connected): (Arc<Mutex<BTreeSet<String>>>, Arc<AtomicBool>) = Default::default();
        let (kept, connected) = (Arc::clone(&keys), Arc::clone(&is_connected));
        let prefix = format!("heliostat/v1/{}/", bus.room());
        let keep = move |key: &str, payload: &[u8]| {
            if payload == PROBE {
                return connected.store(true, Ordering::SeqCst);
            }
            kept.lock().expect("no callback panics").insert(key.strip_prefix(&prefix).unwrap_or(key).to_owned());
        };
        let subscription = bus.subscribe_keyed(&bus.room().everything(), keep).expect("a valid pattern");
        Self { keys, is_connected, _subscription: subscription }
    }

    /// The keys that arrive when the sender publishes on every one.
    fn from(&self, sender: &Bus) -> BTreeSet<String> {
        let publisher = |key: &str| {
            let key = format!("heliostat/v1/{}/{key}", sender.room());
            sender.publisher(&key, Class::RealTimeBlock).expect("a valid key")
        };
        let stop = publisher("mirrors/stop");
        let others: Vec<Publisher> =
            KEYS.iter().filter(|key| **key != "mirrors/stop").map(|key| publisher(key)).collect();
        self.is_connected.store(false, Ordering::SeqCst);
        wait_until("a probe arrives", || {
            stop.put(PROBE).expect("the session is open");
            self.is_connected.load(Ordering::SeqCst)
        });
        // Messages of one class keep their order: all that may arrive arrives before the stop. A session that a
        // busy machine has closed meanwhile opens again, and what was sent by then is lost.
        let mut sent = None::<Instant>;
        wait_until("the stop arrives", || {
            if sent.is_none_or(|at| at.elapsed() > AGAIN) {
                sent = Some(Instant::now());
                for publisher in others.iter().chain([&stop]) {
                    publisher.put(b"content").expect("the session is open");
                }
            }
            self.keys.lock().expect("no callback panics").contains("mirrors/stop")
        });
        std::mem::take(&mut *self.keys.lock().expect("no callback panics"))
    }
}

/// Time after which messages that did not arrive are sent again.
const AGAIN: Duration = Duration::from_secs(10);

/// Payload of a stop that shows that a connection works.
const PROBE: &[u8] = b"probe";

fn words(text: &str) -> BTreeSet<String> {
    text.split_whitespace().map(str::to_owned).collect()
}

/// The keys of a role, with those of every role.
fn all_rights(own: &str) -> BTreeSet<String> {
    words(own).into_iter().chain(words(RIGHTS_OF_ALL)).collect()
}

#[test]
fn a_listening_peer_accepts_from_each_role_only_its_own_keys() {
    let _turn = common::turn();
    let keys = Keys::new();
    let endpoint = common::tls_endpoint();
    let driver = keys.open(AccessRole::Driver, |config| config.listen_at(&endpoint));
    let received = Received::everything(&driver);
    for (role, rights) in RIGHTS {
        let sender = keys.open(role, |config| config.connect_to(&endpoint));
        assert_eq!(received.from(&sender), all_rights(rights), "{role}");
        sender.close().expect("the session closes");
    }
}

#[test]
fn a_connecting_peer_accepts_from_each_role_only_its_own_keys() {
    let _turn = common::turn();
    let keys = Keys::new();
    for (role, rights) in RIGHTS {
        let endpoint = common::tls_endpoint();
        let sender = keys.open(role, |config| config.listen_at(&endpoint));
        let viewer = keys.open(AccessRole::Viewer, |config| config.connect_to(&endpoint));
        assert_eq!(Received::everything(&viewer).from(&sender), all_rights(rights), "{role}");
    }
}

#[test]
fn a_router_forwards_from_each_role_only_its_own_keys() {
    let _turn = common::turn();
    let keys = Keys::new();
    let (router, endpoint) = router(keys.folder());
    let viewer = keys.client(AccessRole::Viewer, &endpoint);
    let received = Received::everything(&viewer);
    for (role, rights) in RIGHTS {
        let sender = keys.client(role, &endpoint);
        assert_eq!(received.from(&sender), all_rights(rights), "{role}");
        sender.close().expect("the session closes");
    }
    common::close(router);
}

#[test]
fn every_role_receives_every_key_of_its_room() {
    let _turn = common::turn();
    let keys = Keys::new();
    let (router, router_endpoint) = router(keys.folder());
    for (role, _) in RIGHTS {
        let endpoint = common::tls_endpoint();
        // The roles that may publish between them every key.
        let publishing = [AccessRole::Simulator, AccessRole::Checker, AccessRole::Operator];
        let expected: BTreeSet<String> = RIGHTS
            .iter()
            .filter(|(sender, _)| publishing.contains(sender))
            .flat_map(|(_, keys)| all_rights(keys))
            .collect();
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
                found.extend(received.from(&sender));
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
    let of_array = room.array(2).driver_alive(source);
    let all = NodeKind::ALL.iter().map(|node| room.alive(*node, source)).chain([of_array.clone()]);
    let tokens: Vec<Token> = all.map(|key| holder.announce(&key).expect("a valid key")).collect();
    let mut expected: BTreeSet<String> = nodes.iter().map(|node| room.alive(*node, source)).collect();
    expected.extend(nodes.contains(&NodeKind::Driver).then_some(of_array));
    let present = || -> BTreeSet<String> {
        observer.alive(&room.all_alive(), Duration::from_secs(1)).expect("a valid pattern").into_iter().collect()
    };
    let deadline = Instant::now() + LIMIT;
    while !expected.is_subset(&present()) {
        assert!(Instant::now() < deadline, "{role}: {:?} in place of {expected:?}", present());
    }
    // On a busy machine an answer may come after its time.
    while present() != expected {
        assert!(Instant::now() < deadline, "{role}: {:?} in place of {expected:?}", present());
    }
    drop(tokens);
    while !present().is_empty() {
        assert!(Instant::now() < deadline, "{role}: withdrawn tokens are present: {:?}", present());
    }
}

#[test]
fn each_role_is_present_only_as_its_own_kind_of_process() {
    let _turn = common::turn();
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
fn only_the_roles_that_drive_mirrors_answer_queries() {
    let _turn = common::turn();
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
            let room = answering.room();
            let keys = [room.capabilities(), room.safety(), room.telemetry(), room.array(1).safety()];
            let serve = |key: &String| answering.serve(key, |answer| answer.extend(b"answer")).expect("a valid key");
            let _services = keys.each_ref().map(serve);
            let is_driver = matches!(role, AccessRole::Driver | AccessRole::Simulator);
            // Both are connected when a message passes.
            Received::everything(&asking).from(&answering);
            let ask = |key: &String| asking.fetch(key, Duration::from_secs(1)).expect("a valid key").len();
            if is_driver {
                wait_until("answers of a driver", || keys.each_ref().map(ask) == [1, 1, 0, 1]);
            } else {
                assert_eq!(keys.each_ref().map(ask), [0; 4], "{role}");
            }
        }
    }
    common::close(router);
}

/// Payload of a session without rights.
const FOREIGN: &[u8] = b"foreign";

/// Publishes, subscribes and announces by a session without rights; nothing of it has an effect.
fn expect_no_right(foreign: &zenoh::Session, receiving: &Bus, member: &Bus, name: &str) {
    let room = receiving.room();
    let found: Arc<Mutex<BTreeSet<String>>> = Arc::default();
    let kept = Arc::clone(&found);
    let keep = move |sample: zenoh::sample::Sample| {
        // Its own payloads come back to it within its process.
        if *sample.payload().to_bytes() != *FOREIGN {
            kept.lock().expect("no callback panics").insert(sample.key_expr().to_string());
        }
    };
    let _subscription = foreign.declare_subscriber(room.everything()).callback(keep).wait().expect("a valid pattern");
    let _token = foreign.liveliness().declare_token(room.alive(NodeKind::Driver, 9)).wait().expect("a valid key");
    let received = Received::everything(receiving);
    for key in KEYS {
        foreign.put(format!("heliostat/v1/{room}/{key}"), FOREIGN).wait().expect("the session is open");
    }
    // What both members publish after that arrives, and nothing else does.
    assert_eq!(received.from(member), all_rights("mirrors/stop status/viewer"), "{name}");
    Received::everything(member).from(receiving);
    assert_eq!(receiving.alive(&room.all_alive(), Duration::from_secs(1)), Ok(Vec::new()), "{name}");
    assert_eq!(*found.lock().expect("no callback panics"), BTreeSet::new(), "{name}");
}

#[test]
fn a_certificate_of_the_authority_with_another_name_gives_no_right() {
    let _turn = common::turn();
    let keys = Keys::new();
    let (router, router_endpoint) = router(keys.folder());
    let endpoint = common::tls_endpoint();
    let driver = keys.open(AccessRole::Driver, |config| config.listen_at(&endpoint));
    let viewer = keys.open(AccessRole::Viewer, |config| config.connect_to(&endpoint));
    let clients =
        [keys.client(AccessRole::Driver, &router_endpoint), keys.client(AccessRole::Viewer, &router_endpoint)];
    // The name of another room, and names that only resemble a role of this one.
    for name in ["heliostat-hall-operator", "heliostat-lab-operators", "heliostat-lab-*", "HELIOSTAT-LAB-OPERATOR"] {
        let folder = keys.of_name(name);
        let open =
            |endpoint| common::foreign(LIMIT, Some((folder.path(), AccessRole::Operator)), keys.folder(), endpoint);
        expect_no_right(&open(&endpoint).expect("the authority signed it"), &driver, &viewer, name);
        expect_no_right(&open(&router_endpoint).expect("the authority signed it"), &clients[0], &clients[1], name);
    }
    common::close(router);
}

#[test]
fn without_a_valid_certificate_of_the_room_a_process_sends_and_receives_nothing() {
    let _turn = common::turn();
    let (keys, other) = (Keys::new(), Keys::new());
    let expired = keys.expired();
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
            let opened = common::foreign(common::REFUSAL_LIMIT, identity, authority.folder(), endpoint);
            assert!(opened.is_err(), "a process {name} opens a session at {endpoint}");
        }
    }
    // Without TLS the listener opens no session either, and the error says what it expects.
    let plain = BusConfig::new(Room::new(ROOM).expect("a valid name")).connect_to(&endpoint.replace("tls/", "tcp/"));
    let refused = Bus::open(&plain.reaching(Reach::Within(Duration::from_secs(1)))).err().expect("no session");
    assert!(matches!(refused, BusError::Untrusted { .. }), "{refused}");
    let advice = format!("give --tls DIR, the folder of its room's keys, and --connect {endpoint}");
    assert!(refused.to_string().contains(&advice), "{refused}");
    // The same listeners accept a member of the room.
    for (received, sender) in received.iter().zip([
        keys.open(AccessRole::Viewer, |config| config.connect_to(&endpoint)),
        keys.client(AccessRole::Viewer, &router_endpoint),
    ]) {
        assert_eq!(received.from(&sender), all_rights("mirrors/stop status/viewer"));
    }
    common::close(router);
}

#[test]
fn a_process_does_not_connect_to_a_listener_with_an_expired_or_foreign_certificate() {
    let _turn = common::turn();
    let (keys, other) = (Keys::new(), Keys::new());
    let expired = keys.expired();
    for (folder, host, expected) in [
        (other.folder(), "127.0.0.1", "another authority than"),
        (expired.folder(), "127.0.0.1", "the certificate of 127.0.0.1 expired on 20"),
        // Its certificate is valid for other hosts.
        (keys.folder(), "127.0.0.2", "the certificate of 127.0.0.2 names localhost, 127.0.0.1, ::1: issue it with"),
    ] {
        let endpoint = common::tls_endpoint().replace("127.0.0.1", host);
        let _listener = common::foreign_listener(folder, AccessRole::Driver, &endpoint);
        let viewer = keys.config(AccessRole::Viewer).connect_to(&endpoint);
        let error = Bus::open(&viewer.clone().reaching(Reach::Within(Duration::from_secs(5))));
        let error = error.err().expect("the certificate of the listener is refused");
        assert!(matches!(error, BusError::Untrusted { .. }), "{error}");
        assert!(error.to_string().contains(&endpoint) && error.to_string().contains(expected), "{error}");
        // A session that waits for its peer finds the same.
        let waiting = Bus::open(&viewer).expect("it waits");
        let mut found = None;
        wait_until(&format!("a reason is found at {host}"), || {
            found = waiting.connection_problem();
            found.is_some()
        });
        assert!(found.as_ref().is_some_and(|found| found.contains(expected)), "{found:?}");
    }
}

#[test]
fn an_endpoint_without_tls_or_without_a_process_is_told_apart() {
    let _turn = common::turn();
    let keys = Keys::new();
    let plain = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let endpoint = format!("tls/{}", plain.local_addr().expect("bound"));
    std::thread::spawn(move || {
        for mut stream in plain.incoming().map_while(Result::ok) {
            // The other side may have gone.
            std::io::Write::write_all(&mut stream, b"no TLS record at all\n").ok();
        }
    });
    let open = |endpoint: &str| {
        let viewer = keys.config(AccessRole::Viewer).connect_to(endpoint);
        Bus::open(&viewer.reaching(Reach::Within(Duration::from_secs(3)))).err().expect("no session")
    };
    let error = open(&endpoint);
    assert!(error.to_string().contains("the TLS handshake failed"), "{error}");
    assert!(matches!(open(&common::tls_endpoint()), BusError::CannotReach { .. }));
}

#[test]
fn a_connection_ends_when_its_certificate_expires() {
    let _turn = common::turn();
    let keys = Keys::new();
    let brief = keys.until(SystemTime::now() + Duration::from_secs(12));
    let endpoint = common::tls_endpoint();
    let driver = keys.open(AccessRole::Driver, |config| config.listen_at(&endpoint));
    let viewer = brief.open(AccessRole::Viewer, |config| config.connect_to(&endpoint));
    let _token = viewer.announce(&viewer.room().alive(NodeKind::Viewer, 1)).expect("a valid key");
    let present = || !driver.alive(&driver.room().all_alive(), Duration::from_secs(1)).expect("a valid key").is_empty();
    wait_until("a token arrives while the certificate is valid", present);
    wait_until("the connection ends with its certificate", || !present());
}
