//! What cannot be opened, and what is said about it.

use std::time::{Duration, Instant};

use heliostat_bus::*;
use heliostat_proto::{Room, RoomError};

fn config() -> BusConfig {
    BusConfig::new(Room::new("test").expect("a plain name"))
}

fn refusal(config: &BusConfig) -> BusError {
    Bus::open(config).err().expect("this cannot be opened")
}

#[test]
fn endpoints_are_checked_before_anything_starts() {
    assert_eq!(refusal(&config()), BusError::NoEndpoint);
    for (endpoint, problem) in [
        ("127.0.0.1:7447", "it has no protocol before a '/'"),
        ("", "it has no protocol before a '/'"),
        ("tcp/127.0.0.1", "it has no port"),
        ("tcp/:7447", "it has no host"),
        ("tcp/127.0.0.1:74470", "\"74470\" is no port"),
        ("tcp/127.0.0.1:http", "\"http\" is no port"),
        ("quic/127.0.0.1:7447", "protocol \"quic\" is not built in"),
    ] {
        let wanted = BusError::InvalidEndpoint { endpoint: endpoint.into(), problem: problem.into() };
        assert_eq!(refusal(&config().listen_at(endpoint)), wanted);
        assert_eq!(refusal(&config().connect_to(endpoint)), wanted);
    }
}

#[test]
fn an_endpoint_in_use_is_named() {
    let endpoint = free_loopback_endpoint().expect("a free port");
    let first = Bus::open(&config().listen_at(&endpoint)).expect("a free port");
    let error = refusal(&config().listen_at(&endpoint));
    assert_eq!(error, BusError::EndpointInUse { endpoint: endpoint.clone() });
    assert!(error.to_string().contains("stop it, or listen at another port"), "{error}");
    drop(first);
}

#[test]
fn an_address_of_another_machine_cannot_be_listened_at() {
    let endpoint = "tcp/192.0.2.1:7447";
    let error = refusal(&config().listen_at(endpoint));
    assert!(matches!(&error, BusError::CannotListen { endpoint: named, .. } if named == endpoint), "{error}");
}

#[test]
fn nobody_there_is_an_error_where_somebody_is_required() {
    let endpoint = free_loopback_endpoint().expect("a free port");
    let limit = Duration::from_millis(300);
    let start = Instant::now();
    let error = refusal(&config().connect_to(&endpoint).reaching(Reach::Within(limit)));
    assert_eq!(error, BusError::CannotReach { endpoints: endpoint.clone(), waited_ms: 300 });
    assert!(start.elapsed() >= limit, "it gives up only after the limit");
    let client = BusConfig { role: Role::Client, ..config().connect_to(&endpoint).reaching(Reach::Within(limit)) };
    assert!(matches!(refusal(&client), BusError::CannotReach { .. }));
}

#[test]
fn a_client_needs_a_router() {
    let client = BusConfig { role: Role::Client, ..config() };
    assert_eq!(refusal(&client), BusError::ClientWithoutRouter);
    let listening =
        BusConfig { role: Role::Client, ..config().listen_at(DEFAULT_ENDPOINT).connect_to(DEFAULT_ENDPOINT) };
    assert_eq!(refusal(&listening), BusError::ClientWithoutRouter);
}

#[test]
fn what_is_no_key_is_refused_by_name() {
    let endpoint = free_loopback_endpoint().expect("a free port");
    let bus = Bus::open(&config().listen_at(&endpoint)).expect("a free port");
    for bad in ["", "/a", "a//b", "a/"] {
        let error = bus.publisher(bad, Class::Control).err().expect("this is no key");
        assert!(matches!(&error, BusError::Refused { action: "publish on", key, .. } if key == bad), "{error}");
        assert!(matches!(bus.subscribe(bad, |_| {}), Err(BusError::Refused { action: "subscribe to", .. })));
        assert!(matches!(bus.announce(bad), Err(BusError::Refused { .. })));
        assert!(matches!(bus.alive(bad, Duration::from_secs(1)), Err(BusError::Refused { .. })));
    }
}

#[test]
fn a_publisher_outlives_its_session_only_to_say_so() {
    let endpoint = free_loopback_endpoint().expect("a free port");
    let bus = Bus::open(&config().listen_at(&endpoint)).expect("a free port");
    let publisher = bus.publisher("some/key", Class::Control).expect("a sound key");
    bus.close().expect("closes");
    assert!(matches!(publisher.put(b"late"), Err(BusError::Refused { action: "publish on", .. })));
}

#[test]
fn flags_become_a_configuration() {
    let none = BusArgs::default();
    assert_eq!(none.config(), Err(BusError::NoEndpoint));
    assert_eq!(none.config_or_listen().map(|config| config.listen), Ok(vec![DEFAULT_ENDPOINT.to_owned()]));
    assert_eq!(none.config_or_connect().map(|config| config.connect), Ok(vec![DEFAULT_ENDPOINT.to_owned()]));
    let some = BusArgs { connect: vec!["tcp/10.0.0.1:7447".into()], ..BusArgs::default() };
    assert_eq!(some.config_or_listen(), some.config());
    let room = BusArgs { room: "a/b".into(), ..some };
    assert!(matches!(room.config(), Err(BusError::Room(RoomError::BadCharacter { found: '/', .. }))));
}

#[test]
fn free_ports_differ_and_are_none_that_systems_give_out() {
    let ports: Vec<u16> = (0..20).map(|_| free_loopback_port().expect("a free port")).collect();
    // Linux gives out those from 32768 unless told otherwise, others those from 49152; such a port may go to any outgoing connection before it is listened at.
    assert!(ports.iter().all(|port| *port < 32_768), "{ports:?}");
    assert!(ports.iter().any(|port| *port != ports[0]), "chosen at random: {ports:?}");
}
