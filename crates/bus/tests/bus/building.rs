//! Two linked routers that serve two rooms with keys, with the configurations that `keys router` writes.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use heliostat_bus::*;
use heliostat_proto::{NodeKind, Room};
use tempfile::TempDir;
use zenoh::Wait;

use crate::common::{self, LIMIT, wait_until};

const ROOMS: [&str; 2] = ["studio", "foyer"];

/// Keys of two rooms, and two routers that are linked.
struct Building {
    folder: TempDir,
    routers: Vec<zenoh::Session>,
    /// The port of each room at each router.
    ports: [[u16; 2]; 2],
}

impl Building {
    fn new(protocol: Protocol) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for name in ROOMS {
            let room = Room::new(name).expect("a valid name");
            keys::init(&room, &folder.path().join(name), &keys::Terms::of_days(1, &[])).expect("an empty folder");
        }
        let (mut routers, mut ports) = (Vec::new(), [[0; 2]; 2]);
        for index in 0..2 {
            let out = folder.path().join(format!("router-{index}"));
            let first_port = pair_of_free_ports();
            let peers = if index == 0 { Vec::new() } else { vec![format!("127.0.0.1:{}", ports[0][0])] };
            let folders = ROOMS.map(|name| folder.path().join(name)).to_vec();
            let router = BuildingRouter { folders, installed: out.clone(), protocol, first_port, peers };
            let endpoints = router.write(&out).expect("keys of both rooms");
            assert_eq!(endpoints.iter().map(|endpoint| endpoint.room.to_string()).collect::<Vec<_>>(), ROOMS);
            ports[index] = [endpoints[0].port, endpoints[1].port];
            let config =
                zenoh::Config::from_file(out.join("router.json5")).expect("the written configuration is valid");
            routers.push(zenoh::open(config).wait().expect("the router opens"));
        }
        Self { folder, routers, ports }
    }

    /// A client of a router at the port of a room, with the keys of `holder`.
    fn open(&self, protocol: &str, (holder, role): (&str, AccessRole), port: u16) -> Result<Bus, BusError> {
        let identity = Identity::load(&self.folder.path().join(holder), &[role]).expect("keys of each role");
        let config = BusConfig::new(identity.room().clone()).secured_by(identity);
        let config = config.connect_to(&format!("{protocol}/127.0.0.1:{port}"));
        let limit = if self.is_port_of(holder, port) { LIMIT } else { Duration::from_secs(2) };
        Bus::open(&BusConfig { role: Role::Client, ..config.reaching(Reach::Within(limit)) })
    }

    fn is_port_of(&self, room: &str, port: u16) -> bool {
        let index = ROOMS.iter().position(|name| *name == room).expect("a room of the building");
        self.ports.iter().any(|ports| ports[index] == port)
    }

    fn close(self) {
        self.routers.into_iter().for_each(common::close);
    }
}

#[test]
fn a_peer_is_an_address_that_the_certificates_name_in_any_spelling() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let room = Room::new("studio").expect("a valid name");
    let keys_folder = folder.path().join("studio");
    let terms = keys::Terms::of_days(1, &["2001:db8::1".to_owned()]);
    keys::init(&room, &keys_folder, &terms).expect("an empty folder");
    let written = |peer: &str| {
        let out = folder.path().join("router");
        let (folders, peers) = (vec![keys_folder.clone()], vec![peer.to_owned()]);
        BuildingRouter { folders, installed: out.clone(), protocol: Protocol::Tls, first_port: 7448, peers }.write(&out)
    };
    assert!(written("[2001:0DB8:0::1]:7448").is_ok());
    assert!(written("[2001:db8::2]:7448").is_err());
}

/// A free port whose successor is free too, for TCP and for UDP.
fn pair_of_free_ports() -> u16 {
    let is_free = |port: u16| {
        let address = ("0.0.0.0", port);
        std::net::TcpListener::bind(address).is_ok() && std::net::UdpSocket::bind(address).is_ok()
    };
    let mut port = free_loopback_port().expect("a free port");
    while port == u16::MAX || !is_free(port) || !is_free(port + 1) {
        port = free_loopback_port().expect("a free port");
    }
    port
}

/// The keys that a session receives.
fn everything(bus: &Bus) -> (Arc<Mutex<BTreeSet<String>>>, Subscription) {
    let keys: Arc<Mutex<BTreeSet<String>>> = Arc::default();
    let kept = Arc::clone(&keys);
    let keep = move |key: &str, _: &[u8]| {
        kept.lock().expect("no callback panics").insert(key.to_owned());
    };
    let subscription = bus.subscribe_keyed(&bus.room().everything(), keep).expect("a valid pattern");
    (keys, subscription)
}

/// Publishes on a key until `is_so`.
fn publish_until(bus: &Bus, key: &str, mut is_so: impl FnMut() -> bool) {
    let publisher = bus.publisher(key, Class::RealTimeBlock).expect("a valid key");
    wait_until(key, || {
        publisher.put(b"content").expect("the session is open");
        is_so()
    });
}

fn messages_pass_between_the_routers(protocol: Protocol, name: &str) {
    let _turn = common::turn();
    let building = Building::new(protocol);
    let [at_first, at_second] = building.ports;
    for (index, room) in ROOMS.into_iter().enumerate() {
        let array = building.open(name, (room, AccessRole::Driver), at_first[index]).expect("the router answers");
        let standby =
            building.open(name, (room, AccessRole::Controller), at_second[index]).expect("the router answers");
        let (received, _subscription) = everything(&array);
        let command = array.room().command();
        publish_until(&standby, &command, || received.lock().expect("no callback panics").contains(&command));
        let (received, _subscription) = everything(&standby);
        let telemetry = array.room().telemetry();
        publish_until(&array, &telemetry, || received.lock().expect("no callback panics").contains(&telemetry));
        let _token = array.announce(&array.room().alive(NodeKind::Driver, 7)).expect("a valid key");
        let pattern = array.room().alive_of(NodeKind::Driver);
        wait_until("liveliness passes between the routers", || {
            !standby.alive(&pattern, LIMIT).expect("a valid pattern").is_empty()
        });
        // A controller has no right to re-arm, at either router.
        let rearm = array.room().rearm();
        standby.publisher(&rearm, Class::RealTimeBlock).expect("a valid key").put(b"content").expect("open");
        let (received, _subscription) = everything(&array);
        publish_until(&standby, &command, || received.lock().expect("no callback panics").contains(&command));
        assert!(!received.lock().expect("no callback panics").contains(&rearm), "a controller re-arms in {room}");
    }
    building.close();
}

#[test]
fn messages_of_each_room_pass_between_two_routers_within_the_rights_of_their_senders() {
    messages_pass_between_the_routers(Protocol::Tls, "tls");
}

#[test]
fn two_routers_are_linked_by_quic_too() {
    messages_pass_between_the_routers(Protocol::Quic, "quic");
}

#[test]
fn keys_of_one_room_open_no_session_at_the_port_of_another_and_give_no_right_in_it() {
    let _turn = common::turn();
    let building = Building::new(Protocol::Tls);
    let [[studio, foyer], _] = building.ports;
    assert!(building.open("tls", ("studio", AccessRole::Operator), foyer).is_err());
    // A session of the studio publishes on keys of the foyer.
    let folder = building.folder.path().join("studio");
    let router = format!("tls/127.0.0.1:{studio}");
    let foreign = common::foreign(LIMIT, Some((&folder, AccessRole::Operator)), &folder, &router);
    let foreign = foreign.expect("the keys of the studio");
    let array = building.open("tls", ("foyer", AccessRole::Driver), foyer).expect("the router answers");
    let operator = building.open("tls", ("foyer", AccessRole::Operator), foyer).expect("the router answers");
    let (received, _subscription) = everything(&array);
    let keys = [array.room().stop(), array.room().rearm(), array.room().command()];
    for key in &keys {
        foreign.put(key.as_str(), b"content").wait().expect("the session is open");
    }
    let control = array.room().simulator_control();
    publish_until(&operator, &control, || received.lock().expect("no callback panics").contains(&control));
    assert_eq!(*received.lock().expect("no callback panics"), BTreeSet::from([control]));
    drop(foreign);
    building.close();
}

#[test]
fn a_router_is_refused_two_folders_of_one_room_and_a_path_that_ends_an_endpoint() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let studio = folder.path().join("studio");
    let room = Room::new("studio").expect("a valid name");
    keys::init(&room, &studio, &keys::Terms::of_days(1, &[])).expect("an empty folder");
    let write = |folders: Vec<std::path::PathBuf>, installed: &str, first_port| {
        let installed = Path::new(installed).to_path_buf();
        let router = BuildingRouter { folders, installed, protocol: Protocol::Tls, first_port, peers: Vec::new() };
        router.write(&folder.path().join("router")).expect_err("an unusable plan").to_string()
    };
    assert!(write(vec![studio.clone(), studio.clone()], "/etc/keys", 7448).contains("one folder for each room"));
    assert!(write(vec![studio], "/etc/keys;1", 7448).contains("without the characters"));
    assert!(write(Vec::new(), "/etc/keys", 7448).contains("no endpoint"));
    assert!(!folder.path().join("router").exists(), "a refused plan writes nothing");
}

#[test]
fn a_router_is_refused_a_peer_that_its_keys_do_not_name() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let studio = folder.path().join("studio");
    let room = Room::new("studio").expect("a valid name");
    let terms = |hosts: [&str; 2]| keys::Terms::of_days(1, &hosts.map(str::to_owned));
    for wrong in ["https://host-a", "host-a:7448", "[::1]", ""] {
        let refusal = keys::init(&room, &studio, &terms(["host-b", wrong])).expect_err("no host").to_string();
        assert!(refusal.starts_with(&format!("\"{wrong}\" is no host: expected a name")), "{refusal}");
        assert!(!studio.exists(), "{wrong:?} writes nothing");
    }
    keys::init(&room, &studio, &terms(["host-a.example.org", "fd00::1"])).expect("an empty folder");
    let write = |peer: &str| {
        let (folders, peers) = (vec![studio.clone()], vec![peer.to_owned()]);
        let installed = folder.path().join("installed");
        let router = BuildingRouter { folders, installed, protocol: Protocol::Tls, first_port: 7448, peers };
        router.write(&folder.path().join("router"))
    };
    for known in ["Host-A.example.org:7448", "[fd00::1]:7448", "127.0.0.1:7448"] {
        write(known).expect("a host of the keys");
    }
    let refusal = write("host-x:7448").expect_err("a host without a certificate").to_string();
    assert!(refusal.contains("name no \"host-x\"") && refusal.contains("host-a.example.org"), "{refusal}");
}

#[test]
fn the_files_of_a_router_are_renewed_by_writing_them_again() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (studio, out) = (folder.path().join("studio"), folder.path().join("router"));
    keys::init(&Room::new("studio").expect("a valid name"), &studio, &keys::Terms::of_days(1, &[])).expect("new keys");
    let (folders, installed, protocol) = (vec![studio.clone()], out.clone(), Protocol::Tls);
    let router = BuildingRouter { folders, installed, protocol, first_port: 7448, peers: Vec::new() };
    router.write(&out).expect("keys of the room");
    let until = keys::end_after(2);
    let advice = keys::renew(&studio, &out, until).expect_err("no folder of keys").to_string();
    assert!(advice.contains("write these files again with heliostat keys router"), "{advice}");
    let certificate = || std::fs::read_to_string(out.join("studio-router.pem")).expect("a certificate");
    let before = certificate();
    keys::renew(&studio, &studio, until).expect("a folder of keys");
    router.write(&out).expect("the renewed keys");
    assert_ne!(certificate(), before);
}
