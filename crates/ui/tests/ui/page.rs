//! The live page against clients that are slow, idle or do not read.

use std::collections::BTreeSet;
use std::error::Error;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, BusConfig, private_endpoint};
use heliostat_proto::Room;
use heliostat_scenario::Scenario;
use heliostat_ui::floor::FloorMap;
use heliostat_ui::{Operator, Page, Place, Rights, Server, UiError, View};
use serde_json::Value;

/// Time limit for an action that takes some seconds on an idle machine.
const TIME_LIMIT: Duration = Duration::from_secs(60);
/// Maximum number of open pages, as in `live.rs`.
const READERS_MAX: usize = 16;

/// A page of a room without messages.
struct Setting {
    server: Server,
    _bus: Bus,
}

impl Setting {
    fn new(room: &str) -> Self {
        Self::at(room, &Place::loopback(0))
    }

    fn at(room: &str, place: &Place) -> Self {
        Self::start(room, place).unwrap()
    }

    fn start(room: &str, place: &Place) -> Result<Self, UiError> {
        Self::with_rights(room, place, Rights::All)
    }

    fn with_rights(room: &str, place: &Place, rights: Rights) -> Result<Self, UiError> {
        // 1024 mirrors make frames large enough to fill the socket buffers soon.
        let set = ["rows=32", "columns=32", "width_m=0.1", "height_m=0.04", "gap_m=0.005"];
        let set = set.map(|text| format!("mirrors.{text}"));
        let scenario = Scenario::builtin("specular").unwrap().with_overrides(&set).unwrap();
        let endpoint = private_endpoint().unwrap();
        let bus = Bus::open(&BusConfig::new(Room::new(room).unwrap()).listen_at(&endpoint)).unwrap();
        let view = Arc::new(View::open(&bus, Some(&scenario)).unwrap());
        let operator = Operator::new(&bus, &view, None).unwrap().with_rights(rights);
        let page = Page { view, operator, room: room.to_owned(), policies: Box::new(|_| Vec::new()), network: None };
        Ok(Self { server: Server::start(page, place)?, _bus: bus })
    }

    fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// Sends a request and leaves the answer unread.
    fn send(&self, request: &str) -> TcpStream {
        let mut stream = TcpStream::connect(self.address()).unwrap();
        stream.set_read_timeout(Some(TIME_LIMIT)).unwrap();
        let address = self.address();
        let (line, rest) = request.split_once('\n').unwrap_or((request, "\r\n"));
        write!(stream, "{line} HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\n{rest}").unwrap();
        stream
    }

    /// The status line of the answer to `GET /live`, and a reader of the rest.
    fn live(&self) -> (String, BufReader<TcpStream>) {
        let mut answer = BufReader::new(self.send("GET /live"));
        let mut status = String::new();
        answer.read_line(&mut status).unwrap();
        (status, answer)
    }

    /// Fetches the page.
    fn page(&self) -> String {
        let agent: ureq::Agent = ureq::Agent::config_builder().timeout_global(Some(TIME_LIMIT)).build().into();
        agent.get(self.server.url()).call().unwrap().body_mut().read_to_string().unwrap()
    }
}

fn await_events(answer: &mut BufReader<TcpStream>) {
    for expected in ["event: figures", "event: frame"] {
        let found = answer.lines().map_while(Result::ok).any(|line| line == expected);
        assert!(found, "no \"{expected}\" arrived");
    }
}

#[test]
fn the_server_drops_clients_that_do_not_read() {
    let setting = Setting::new("unread");
    // These clients read the status line and nothing after it.
    let stalled: Vec<_> = (0..READERS_MAX).map(|_| setting.live()).collect();
    assert!(stalled.iter().all(|(status, _)| status.starts_with("HTTP/1.1 200")));
    assert!(setting.live().0.starts_with("HTTP/1.1 503"));
    let begun = Instant::now();
    let mut answer = loop {
        let (status, answer) = setting.live();
        if status.starts_with("HTTP/1.1 200") {
            break answer;
        }
        assert!(begun.elapsed() < TIME_LIMIT, "clients that do not read are not dropped: {status}");
        std::thread::sleep(Duration::from_millis(50));
    };
    await_events(&mut answer);
    drop(stalled);
}

#[test]
fn the_end_of_a_server_is_the_last_event_of_an_open_page() {
    let setting = Setting::new("ended");
    let (_, mut answer) = setting.live();
    await_events(&mut answer);
    setting.server.end("The demo has ended after its 20 s.");
    let lines: Vec<String> = answer.lines().map_while(Result::ok).collect();
    let last = lines.iter().rposition(|line| line.starts_with("event: ")).expect("an event");
    let data = "data: \"The demo has ended after its 20 s.\"";
    assert_eq!((lines[last].as_str(), lines[last + 1].as_str()), ("event: ended", data));
}

#[test]
fn closing_a_page_admits_another() {
    let setting = Setting::new("closed");
    let mut open: Vec<_> = (0..READERS_MAX).map(|_| setting.live()).collect();
    assert!(open.iter().all(|(status, _)| status.starts_with("HTTP/1.1 200")));
    assert!(setting.live().0.starts_with("HTTP/1.1 503"));
    open.pop();
    let begun = Instant::now();
    while !setting.live().0.starts_with("HTTP/1.1 200") {
        assert!(begun.elapsed() < TIME_LIMIT, "a closed page still counts as open");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn the_page_of_another_origin_gets_no_event_stream() {
    let setting = Setting::new("foreign");
    let status = |headers: &str| {
        let mut status = String::new();
        BufReader::new(setting.send(&format!("GET /live\n{headers}\r\n"))).read_line(&mut status).unwrap();
        status
    };
    for loaded in [
        "Fetch-Site: cross-site\r\nSec-Fetch-Dest: image",
        "Fetch-Site: cross-site\r\nSec-Fetch-Mode: navigate\r\nSec-Fetch-Dest: iframe",
        "Fetch-Site: none\r\nSec-Fetch-Dest: document\r\nSec-Purpose: prefetch",
    ] {
        assert!(status(&format!("Sec-{loaded}\r\n")).starts_with("HTTP/1.1 403"), "{loaded}");
    }
    assert!(status("Sec-Fetch-Site: same-origin\r\nSec-Fetch-Dest: empty\r\n").starts_with("HTTP/1.1 200"));
}

#[test]
fn three_slow_orders_do_not_block_the_page() {
    let setting = Setting::new("slow");
    let order = "POST /order\nContent-Type: application/json\r\nContent-Length: 100\r\n\r\n{";
    let slow = [(); 3].map(|()| setting.send(order));
    assert!(setting.page().contains("<title>Heliostat</title>"));
    for mut client in slow {
        let mut answer = String::new();
        client.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 408"), "the answer to an incomplete order: {answer}");
    }
}

#[test]
fn idle_connections_do_not_block_the_page() {
    let setting = Setting::new("idle");
    let idle: Vec<TcpStream> = (0..250).map(|_| TcpStream::connect(setting.address()).unwrap()).collect();
    assert!(setting.page().contains("<title>Heliostat</title>"));
    let (status, mut answer) = setting.live();
    assert!(status.starts_with("HTTP/1.1 200"), "{status}");
    await_events(&mut answer);
    drop(idle);
}

#[test]
fn an_order_beyond_the_limit_is_refused() {
    let setting = Setting::new("large");
    let order = "POST /order\nContent-Type: application/json\r\nContent-Length: 4097\r\n\r\n";
    let mut answer = String::new();
    setting.send(order).read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 413"), "{answer}");
}

#[test]
fn stopping_the_server_ends_the_event_streams() {
    let setting = Setting::new("end");
    let (_, mut answer) = setting.live();
    await_events(&mut answer);
    let begun = Instant::now();
    drop(setting.server);
    assert!(begun.elapsed() < TIME_LIMIT / 2, "the server waits for an open page");
    answer.read_to_end(&mut Vec::new()).unwrap();
}

#[test]
fn a_page_on_a_network_answers_only_with_its_token() {
    let setting = Setting::at("token", &Place { address: IpAddr::V4(Ipv4Addr::UNSPECIFIED), ..Place::loopback(0) });
    let answer = |request: &str| {
        let mut answer = String::new();
        setting.send(request).read_to_string(&mut answer).unwrap();
        answer
    };
    let close = "Connection: close\r\n";
    for path in ["/", "/page.js", "/room.json", "/live", "/?token=", "/?token=0123456789abcdef0123456789abcdef"] {
        let refused = answer(&format!("GET {path}\n{close}\r\n"));
        assert!(refused.starts_with("HTTP/1.1 401"), "{path}: {refused}");
    }
    let stop = "Content-Type: application/json\r\nContent-Length: 16\r\nConnection: close\r\n";
    let refused = answer(&format!("POST /order\n{stop}\r\n{{\"order\":\"stop\"}}"));
    assert!(refused.starts_with("HTTP/1.1 401"), "an order without token: {refused}");

    let url = setting.server.url();
    let (_, token) = url.split_once("?token=").expect("the printed URL holds the token");
    let admitted = answer(&format!("GET /?token={token}\n{close}\r\n"));
    assert!(admitted.starts_with("HTTP/1.1 303"), "{admitted}");
    let cookie = admitted.lines().find_map(|line| line.strip_prefix("Set-Cookie: ")).expect("a cookie");
    assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"), "{cookie}");
    let cookie = cookie.split(';').next().unwrap();
    assert!(answer(&format!("GET /\nCookie: {cookie}\r\n{close}\r\n")).starts_with("HTTP/1.1 200"));
    let ordered = answer(&format!("POST /order\nCookie: {cookie}\r\n{stop}\r\n{{\"order\":\"stop\"}}"));
    assert!(ordered.starts_with("HTTP/1.1 503"), "an order that no array receives: {ordered}");
    assert!(
        answer(&format!("GET /room.json\nAuthorization: Bearer {token}\r\n{close}\r\n")).starts_with("HTTP/1.1 200")
    );
}

#[test]
fn a_page_with_keys_requires_a_token_on_a_loopback_address_too() {
    let setting = Setting::at("keys", &Place { authenticated: true, ..Place::loopback(0) });
    let mut answer = String::new();
    setting.send("GET /\nConnection: close\r\n\r\n").read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 401"), "{answer}");
    assert!(setting.server.url().contains("?token="));
}

#[test]
fn a_default_port_in_use_is_replaced_and_one_that_was_asked_for_is_refused() {
    let [first, second] =
        ["first", "second"].map(|room| Setting::at(room, &Place { port: None, ..Place::loopback(0) }));
    assert_ne!(first.address().port(), second.address().port());
    let shown = second.server.to_string();
    assert!(shown.ends_with(&format!("http://{}/ (port 7480 is in use)", second.address())), "{shown}");
    let refused = Setting::start("third", &Place::loopback(first.address().port()));
    let expected = format!("the page cannot be served at {}: ", first.address());
    assert!(refused.is_err_and(|error| error.to_string().starts_with(&expected)));
}

#[test]
fn a_token_file_guards_a_page_on_any_address() {
    let file = std::env::temp_dir().join(format!("heliostat-token-{}", std::process::id()));
    let start = |text: &str| {
        std::fs::write(&file, text).unwrap();
        Setting::start("file", &Place { token_file: Some(file.clone()), ..Place::loopback(0) })
    };
    for unusable in ["", "short", "0123456789abcdef 0123456789abcdef", "0123456789abcdef;"] {
        let refusal = start(unusable).err().expect("no token");
        let cause = refusal.source().expect("the problem of the file").to_string();
        assert!(cause.contains("expected at least 16"), "{unusable:?}: {cause}");
    }
    let setting = start("0123456789abcdefXYZ\n").unwrap();
    std::fs::remove_file(&file).unwrap();
    assert!(setting.server.url().ends_with("/?token=0123456789abcdefXYZ"));
}

#[test]
fn an_absent_token_file_is_made_and_the_next_server_keeps_its_token() {
    let file = std::env::temp_dir().join(format!("heliostat-new-token-{}", std::process::id()));
    // A test that was interrupted may have left one.
    drop(std::fs::remove_file(&file));
    let url = || {
        let setting = Setting::at("kept", &Place { token_file: Some(file.clone()), ..Place::loopback(0) });
        setting.server.url()
    };
    let token = |url: String| url.split_once("?token=").expect("a token").1.to_owned();
    let [first, second] = [url(), url()].map(token);
    let kept = std::fs::read_to_string(&file).unwrap();
    std::fs::remove_file(&file).unwrap();
    assert_eq!((first.as_str(), second.as_str()), (kept.trim(), kept.trim()));
}

#[test]
fn a_page_with_the_rights_of_a_viewer_refuses_a_rearm_at_once_and_tells_the_buttons_why() {
    let setting = Setting::with_rights("viewer", &Place::loopback(0), Rights::StopOnly).unwrap();
    let answer = |request: &str| {
        let mut answer = String::new();
        setting.send(request).read_to_string(&mut answer).unwrap();
        answer
    };
    let reason = Rights::StopOnly.limit().expect("a reason");
    let order = r#"{"order":"rearm","stops":["0000000000000003/4"]}"#;
    let length = order.len();
    let head = format!("Content-Type: application/json\r\nContent-Length: {length}\r\nConnection: close\r\n");
    let refused = answer(&format!("POST /order\n{head}\r\n{order}"));
    assert!(refused.starts_with("HTTP/1.1 422") && refused.contains(reason), "{refused}");
    let room = answer("GET /room.json\nConnection: close\r\n\r\n");
    assert!(room.contains(&format!("\"stop_only\":\"{reason}\"")), "{room}");
    let events = answer("GET /events.json\nConnection: close\r\n\r\n");
    assert!(events.contains("\"state\":\"refused\"") && events.contains(reason), "{events}");
}

/// The fields of an object that the guide to the page lists.
fn documented(object: &str) -> BTreeSet<String> {
    let object = format!("`{object}`");
    let field = |line: &str| {
        let mut cells = line.split('|').map(str::trim).skip(1);
        (cells.next()? == object).then_some(())?;
        Some(cells.next()?.trim_matches('`').to_owned())
    };
    include_str!("../../../../docs/page-json.md").lines().filter_map(field).collect()
}

#[test]
fn the_guide_lists_every_field_of_the_json_that_the_page_serves() {
    // A refused order is an event of the log, and such rights have a field of their own.
    let setting = Setting::with_rights("json", &Place::loopback(0), Rights::StopOnly).unwrap();
    let body = |request: &str| {
        let mut answer = String::new();
        setting.send(request).read_to_string(&mut answer).unwrap();
        answer.split_once("\r\n\r\n").expect("a body").1.to_owned()
    };
    let json = |path: &str| -> Value {
        serde_json::from_str(&body(&format!("GET {path}\nConnection: close\r\n\r\n"))).expect("JSON")
    };
    let head = "Content-Type: application/json\r\nContent-Length: 19\r\nConnection: close\r\n";
    body(&format!("POST /order\n{head}\r\n{{\"order\":\"release\"}}"));
    let begun = Instant::now();
    let mut events = loop {
        let events = json("/events.json");
        if events["log"].is_array() {
            break events;
        }
        assert!(begun.elapsed() < TIME_LIMIT, "no event of the log: {events}");
    };
    // The last answer of a server has this field alone.
    events["ended"] = Value::Null;
    let floor = FloorMap { columns: 1, rows: 1, rate_mbps: vec![0.0], max_mbps: 0.0 };
    let served = [
        ("room.json", &json("/room.json")),
        ("events.json", &events),
        ("figures", &events["figures"]),
        ("frame", &events["frame"]),
        ("log", &events["log"][0]),
        ("floor.json", &serde_json::to_value(floor).expect("numbers")),
    ];
    for (object, value) in served {
        let fields: BTreeSet<String> = value.as_object().expect("an object").keys().cloned().collect();
        assert_eq!(documented(object), fields, "{object}: docs/page-json.md has the left ones");
    }
}
