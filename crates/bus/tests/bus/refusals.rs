//! Sessions that cannot be opened, and their errors.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use heliostat_bus::*;
use heliostat_proto::{Room, RoomError};

use crate::common::Keys;

const ANY: [AccessRole; 9] = AccessRole::ALL;

fn config() -> BusConfig {
    BusConfig::new(Room::new("test").expect("a valid name"))
}

fn refusal(config: &BusConfig) -> BusError {
    Bus::open(config).err().expect("this configuration cannot be opened")
}

#[test]
fn endpoints_are_checked_before_a_session_opens() {
    assert_eq!(refusal(&config()), BusError::NoEndpoint);
    for (endpoint, problem) in [
        ("127.0.0.1:7447", "it has no protocol before a '/'"),
        ("", "it has no protocol before a '/'"),
        ("tcp/127.0.0.1", "it has no port"),
        ("tcp/[::1]", "it has no port"),
        ("tcp/:7447", "it has no host"),
        ("tcp/127.0.0.1:74470", "\"74470\" is not a port"),
        ("tcp/127.0.0.1:http", "\"http\" is not a port"),
        ("tcp/127.0.0.1:0", "its port is 0, which selects one that no other process knows"),
        ("udp/127.0.0.1:7447", "protocol \"udp\" is not built in"),
        ("quic/127.0.0.1", "it has no port"),
        ("quic/127.0.0.1:7447?rel=0", "its connection would not repeat lost messages; remove \"rel\""),
    ] {
        let expected = BusError::InvalidEndpoint { endpoint: endpoint.into(), problem: problem.into() };
        assert_eq!(refusal(&config().listen_at(endpoint)), expected);
        assert_eq!(refusal(&config().connect_to(endpoint)), expected);
    }
}

#[test]
fn an_endpoint_in_use_is_named() {
    for endpoint in [free_loopback_endpoint(), private_endpoint()] {
        let endpoint = endpoint.expect("an endpoint");
        let first = Bus::open(&config().listen_at(&endpoint)).expect("a free endpoint");
        let error = refusal(&config().listen_at(&endpoint));
        assert_eq!(error, BusError::EndpointInUse { endpoint: endpoint.clone() });
        assert!(error.to_string().contains("stop it, or listen at another endpoint"), "{error}");
        drop(first);
    }
}

#[test]
fn listening_at_an_address_of_another_machine_fails() {
    let endpoint = "tcp/192.0.2.1:7447";
    let error = refusal(&BusConfig { insecure: true, ..config().listen_at(endpoint) });
    assert!(matches!(&error, BusError::CannotListen { endpoint: named, .. } if named == endpoint), "{error}");
}

#[test]
fn an_endpoint_without_answer_is_an_error_after_the_limit() {
    let endpoint = free_loopback_endpoint().expect("a free port");
    let limit = Duration::from_millis(300);
    let start = Instant::now();
    let error = refusal(&config().connect_to(&endpoint).reaching(Reach::Within(limit)));
    assert_eq!(error, BusError::CannotReach { endpoints: endpoint.clone(), waited_ms: 300 });
    assert!(start.elapsed() >= limit, "the error comes only after the limit");
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
fn invalid_keys_are_refused_by_name() {
    let endpoint = free_loopback_endpoint().expect("a free port");
    let bus = Bus::open(&config().listen_at(&endpoint)).expect("a free port");
    for bad in ["", "/a", "a//b", "a/"] {
        let error = bus.publisher(bad, Class::RealTimeDrop).err().expect("the key is invalid");
        assert!(matches!(&error, BusError::Refused { action: "publish on", key, .. } if key == bad), "{error}");
        assert!(matches!(bus.subscribe(bad, |_| {}), Err(BusError::Refused { action: "subscribe to", .. })));
        assert!(matches!(bus.announce(bad), Err(BusError::Refused { .. })));
        assert!(matches!(bus.alive(bad, Duration::from_secs(1)), Err(BusError::Refused { .. })));
    }
}

#[test]
fn a_publisher_of_a_closed_session_returns_an_error() {
    let endpoint = free_loopback_endpoint().expect("a free port");
    let bus = Bus::open(&config().listen_at(&endpoint)).expect("a free port");
    let publisher = bus.publisher("some/key", Class::RealTimeDrop).expect("a valid key");
    bus.close().expect("the session closes");
    assert!(matches!(publisher.put(b"late"), Err(BusError::Refused { action: "publish on", .. })));
}

#[test]
fn flags_become_a_configuration() {
    let none = BusArgs::default();
    assert_eq!(none.config(&ANY), Err(BusError::NoEndpoint));
    assert_eq!(none.config_or_listen(&ANY).map(|config| config.listen), Ok(vec![DEFAULT_ENDPOINT.to_owned()]));
    assert_eq!(none.config_or_connect(&ANY).map(|config| config.connect), Ok(vec![DEFAULT_ENDPOINT.to_owned()]));
    let some = BusArgs { connect: vec!["tcp/10.0.0.1:7447".into()], ..BusArgs::default() };
    assert_eq!(some.config_or_listen(&ANY), some.config(&ANY));
    let room = BusArgs { room: Some("a/b".into()), ..some };
    assert!(matches!(room.config(&ANY), Err(BusError::Room(RoomError::BadCharacter { found: '/', .. }))));
}

#[test]
fn free_ports_differ_and_are_below_the_ephemeral_range() {
    let ports: Vec<u16> = (0..500).map(|_| free_loopback_port().expect("a free port")).collect();
    // The ephemeral range begins at 32768 on Linux by default and at 49152 elsewhere. Any outgoing
    // connection could take such a port before a process listens at it.
    assert!(ports.iter().all(|port| *port < 32_768), "{ports:?}");
    // A port is not listened at until its process is up, so that a later call would find it free again.
    let different: BTreeSet<u16> = ports.iter().copied().collect();
    assert_eq!(different.len(), ports.len(), "one process gets a port once: {ports:?}");
}

#[test]
fn a_private_key_that_is_empty_cut_or_of_another_encoding_is_refused_with_what_to_do() {
    let keys = Keys::new();
    let key = keys.folder().join("controller.key");
    let text = std::fs::read_to_string(&key).expect("a key");
    let load = |content: &[u8]| {
        std::fs::write(&key, content).expect("a file");
        Identity::load(keys.folder(), &[AccessRole::Controller])
    };
    let refused = |content: &[u8]| load(content).expect_err("refused").to_string();
    let (lines, utf16) = (text.lines().collect::<Vec<_>>(), text.encode_utf16().flat_map(u16::to_le_bytes));
    let empty = refused(b"");
    assert!(empty.contains("controller.key: it is empty") && empty.contains("heliostat keys issue"), "{empty}");
    let cut = refused(&text.as_bytes()[..text.len() / 2]);
    assert!(cut.contains("controller.key: it is cut") && cut.contains("expected a private key in PEM format"), "{cut}");
    assert!(refused(b"no key\n").contains("it holds no private key"));
    let short = [lines[0], lines[1], lines[lines.len() - 1]].join("\n");
    assert!(refused(short.as_bytes()).contains("its content is damaged"), "{}", refused(short.as_bytes()));
    let encoded: Vec<u8> = [0xff, 0xfe].into_iter().chain(utf16).collect();
    let encoded = refused(&encoded);
    assert!(encoded.contains("controller.key: it is text in UTF-16") && encoded.contains("keys issue"), "{encoded}");
    load(text.as_bytes()).expect("the key as it was made");
}

#[test]
fn a_private_key_of_another_certificate_is_refused_by_name() {
    let (own, other) = (Keys::new(), Keys::new());
    Identity::load(own.folder(), &[AccessRole::Operator]).expect("the key of the certificate");
    let key = |keys: &Keys| keys.folder().join("operator.key");
    std::fs::copy(key(&other), key(&own)).expect("a file");
    let refused = Identity::load(own.folder(), &[AccessRole::Operator]).expect_err("another key").to_string();
    assert!(refused.contains("operator.key is not the private key of"), "{refused}");
}

#[test]
fn keys_that_cannot_all_be_written_leave_nothing_and_the_next_attempt_succeeds() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (room, terms) = (Room::new("studio").expect("a valid name"), keys::Terms::of_days(1, &[]));
    let names = |folder: &std::path::Path| -> Vec<String> {
        let entries = folder.read_dir().expect("a folder");
        entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8")).collect()
    };
    // A folder where a file of the last role is begun.
    let in_the_way = folder.path().join(format!("{}.key.new", ANY[ANY.len() - 1]));
    std::fs::create_dir(&in_the_way).expect("a folder");
    std::fs::write(folder.path().join("notes.txt"), "").expect("a file");
    let refused = keys::init(&room, folder.path(), &terms).expect_err("refused").to_string();
    assert!(refused.contains(".key: ") && refused.contains("expected a folder that this user may write"), "{refused}");
    assert_eq!(names(folder.path()).len(), 2, "{:?}", names(folder.path()));
    std::fs::remove_dir(&in_the_way).expect("a folder");
    keys::init(&room, folder.path(), &terms).expect("the next attempt");

    // Without the key of the authority nothing can be issued.
    let machine = folder.path().join("machine");
    std::fs::remove_file(folder.path().join("ca.key")).expect("a file");
    let refused = keys::issue(AccessRole::Driver, folder.path(), &machine, &terms).expect_err("refused").to_string();
    assert!(refused.contains("ca.key: expected the folder of the authority"), "{refused}");
    let renewed = keys::renew(folder.path(), folder.path(), keys::end_after(1)).expect_err("refused").to_string();
    assert!(renewed.contains("--dir AUTHORITY") && renewed.contains("--out DIR"), "{renewed}");
    assert!(!machine.exists(), "no empty folder");
}

#[test]
fn a_renewal_that_cannot_be_written_leaves_the_old_key_beside_the_old_certificate() {
    let keys = Keys::new();
    let folder = keys.folder();
    let first = keys::list(folder).expect("certificates")[0].0;
    std::fs::create_dir(folder.join(format!("{first}.pem.new"))).expect("a folder");
    keys::renew(folder, folder, keys::end_after(1)).expect_err("refused");
    Identity::load(folder, &[first]).expect("the former keys");
    assert!(!folder.join(format!("{first}.key.new")).exists());
}

#[test]
fn the_end_of_the_certificate_of_the_router_is_known_where_the_folder_has_it() {
    let keys = Keys::new();
    let ends = || keys.config(AccessRole::Controller).certificate_ends();
    let both = ends();
    assert!(both.own.is_some() && both.own == both.router, "they were made together: {both:?}");
    std::fs::remove_file(keys.folder().join("router.key")).expect("a private key");
    assert_eq!(ends(), both, "its private key is not needed");
    std::fs::write(keys.folder().join("router.pem"), "damaged").expect("a file");
    assert_eq!(ends(), CertificateEnds { router: None, ..both }, "the process does not use it, and starts");
    assert_eq!(config().certificate_ends(), CertificateEnds::default(), "a session without keys");
}

#[test]
fn a_certificate_is_not_listed_as_valid_before_its_authority() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let room = Room::new("studio").expect("a valid name");
    let now = std::time::SystemTime::now();
    let day = Duration::from_secs(86_400);
    let later = keys::Terms { hosts: Vec::new(), from: now + 2 * day, until: now + 9 * day };
    keys::init(&room, folder.path(), &later).expect("an empty folder");
    // The certificates of the roles are valid at once, that of the authority is not.
    keys::renew(folder.path(), folder.path(), keys::end_after(9)).expect("the keys of all roles");
    let listed = keys::list(folder.path()).expect("certificates");
    assert!(!listed.is_empty() && listed.iter().all(|(_, certificate)| certificate.is_not_yet_valid()));
    let refused = Identity::load(folder.path(), &ANY).expect_err("refused").to_string();
    assert!(refused.contains("ca.pem: the certificate is not valid yet"), "{refused}");
}
