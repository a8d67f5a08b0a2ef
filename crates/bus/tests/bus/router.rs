//! Rooms that share a router, with the router configuration of deploy/.

use std::net::TcpListener;
use std::path::Path;
use std::sync::mpsc::channel;
use std::time::Duration;

use heliostat_bus::*;
use heliostat_proto::{NodeKind, Room};
use zenoh::Wait;

use crate::common::{LIMIT, wait_until};

fn client(room: &str, endpoint: &str) -> Bus {
    let room = Room::new(room).expect("a valid name");
    let config = BusConfig { role: Role::Client, ..BusConfig::new(room).connect_to(endpoint) };
    Bus::open(&config.reaching(Reach::Within(LIMIT))).expect("the router answers")
}

#[test]
fn clients_of_the_deployed_router_receive_messages_of_their_room_only() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/router/router.json5");
    let mut config = zenoh::Config::from_file(&file).expect("the router's configuration is valid");
    let endpoint = private_endpoint().expect("an endpoint");
    config.insert_json5("listen/endpoints", &format!("[{endpoint:?}]")).expect("a list of endpoints");
    let router = zenoh::open(config).wait().expect("the router opens");

    let (lab, atrium, controller) = (client("lab", &endpoint), client("atrium", &endpoint), client("lab", &endpoint));
    let (sender, receiver) = channel();
    let forward = move |payload: &[u8]| {
        let _ = sender.send(payload.to_vec());
    };
    let _subscription = controller.subscribe(&controller.room().users(), forward).expect("a valid key");
    let (own, foreign) = (
        lab.publisher(&lab.room().users(), Class::RealTimeDrop).expect("a valid key"),
        atrium.publisher(&atrium.room().users(), Class::RealTimeDrop).expect("a valid key"),
    );
    let mut received = None;
    wait_until("a payload passes the router", || {
        foreign.put(b"of another room").expect("the session is open");
        own.put(b"of this room").expect("the session is open");
        received = receiver.recv_timeout(Duration::from_millis(50)).ok();
        received.is_some()
    });
    assert_eq!(received, Some(b"of this room".to_vec()));
    let _token = lab.announce(&lab.room().alive(NodeKind::Driver, 7)).expect("a valid key");
    let pattern = controller.room().alive_of(NodeKind::Driver);
    wait_until("liveliness passes the router", || {
        !controller.alive(&pattern, LIMIT).expect("a valid pattern").is_empty()
    });
    router.close().wait().expect("the router closes");
}

#[test]
fn a_client_begins_with_the_router_that_answers_wherever_it_is_listed() {
    let absent = free_loopback_endpoint().expect("a free port");
    let frozen = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let frozen = format!("tcp/{}", frozen.local_addr().expect("bound"));
    let answering = private_endpoint().expect("an endpoint");
    let router = router(&answering);
    let room = Room::new("lab").expect("a valid name");
    let config = [absent, frozen, answering].iter().fold(BusConfig::new(room), |config, at| config.connect_to(at));
    let config = BusConfig { role: Role::Client, ..config }.reaching(Reach::Within(LIMIT));
    let client = Bus::open(&config).expect("one of three routers answers");
    assert!(client.wait_connected(LIMIT));
    router.close().wait().expect("the router closes");
}

fn router(endpoint: &str) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    let mut set = |key: &str, value: &str| config.insert_json5(key, value).expect("a valid setting");
    set("mode", "\"router\"");
    set("scouting/multicast/enabled", "false");
    set("listen/endpoints", &format!("[{endpoint:?}]"));
    zenoh::open(config).wait().expect("the router opens")
}

#[test]
fn a_client_that_has_lost_its_router_says_so_until_it_is_back() {
    let endpoint = free_loopback_endpoint().expect("a free port");
    let first = router(&endpoint);
    let client = client("lab", &endpoint);
    assert_eq!(client.lost_connection(), None);
    first.close().wait().expect("the router closes");
    let mut lost = None;
    wait_until("the loss is noticed", || {
        lost = client.lost_connection();
        lost.is_some()
    });
    assert!(lost.as_ref().is_some_and(|lost| lost.contains(&endpoint)), "{lost:?}");
    assert_eq!(client.lost_router().as_ref(), Some(&endpoint));
    let second = router(&endpoint);
    wait_until("the return is noticed", || client.lost_connection().is_none());
    second.close().wait().expect("the router closes");
}
