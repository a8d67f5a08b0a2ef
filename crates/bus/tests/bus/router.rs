//! Rooms that share a router, with the router configuration of deploy/.

use std::path::Path;
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use heliostat_bus::*;
use heliostat_proto::{NodeKind, Room};
use zenoh::Wait;

const LIMIT: Duration = Duration::from_secs(60);

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
    let deadline = Instant::now() + LIMIT;
    loop {
        assert!(Instant::now() < deadline, "no payload passes the router");
        foreign.put(b"of another room").expect("the session is open");
        own.put(b"of this room").expect("the session is open");
        if let Ok(payload) = receiver.recv_timeout(Duration::from_millis(50)) {
            assert_eq!(payload, b"of this room");
            break;
        }
    }
    let _token = lab.announce(&lab.room().alive(NodeKind::Driver, 7)).expect("a valid key");
    let pattern = controller.room().alive_of(NodeKind::Driver);
    while controller.alive(&pattern, LIMIT).expect("a valid pattern").is_empty() {
        assert!(Instant::now() < deadline, "liveliness does not pass the router");
    }
    router.close().wait().expect("the router closes");
}
