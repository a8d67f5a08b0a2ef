//! The limits of the HTTP server, against clients that are slow, idle or silent.

use std::convert::Infallible;
use std::io::{Error, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::{Body, Bytes};
use axum::routing::{get, post};
use heliostat_service::http::{self, Limits, Server};
use heliostat_service::{Exporter, Page, Stop};

/// How long anything may take that takes a fraction of a second on an idle machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// Limits that a test waits for, and that no pause of a busy machine reaches.
fn limits() -> Limits {
    let limit = Duration::from_secs(3);
    Limits { headers: limit, answer: limit, stall: limit, ..Limits::default() }
}

fn start(router: Router, limits: Limits) -> Server {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a free port");
    http::serve("test", listener, router, limits, Stop::default()).expect("the server starts")
}

fn hello() -> Router {
    let echo = |body: Bytes| async move { body };
    Router::new().route("/", get(async || "hello")).route("/echo", post(echo))
}

fn connect(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).expect("the server listens");
    stream.set_read_timeout(Some(PATIENCE)).expect("a limit");
    stream
}

/// Sends bytes and reads until the server closes the connection. A server that closes it before it has read
/// everything resets it.
fn exchange(mut stream: &TcpStream, bytes: &str) -> String {
    let sent = stream.write_all(bytes.as_bytes());
    let mut answer = Vec::new();
    let read = stream.read_to_end(&mut answer).map(drop);
    let is_closed = |error: &Error| matches!(error.kind(), ErrorKind::ConnectionReset | ErrorKind::BrokenPipe);
    for error in [sent, read].into_iter().filter_map(Result::err) {
        assert!(is_closed(&error), "the server closes in good time: {error}");
    }
    String::from_utf8(answer).expect("a text")
}

fn get_root(address: SocketAddr) -> String {
    let agent: ureq::Agent = ureq::Agent::config_builder().timeout_global(Some(PATIENCE)).build().into();
    let mut answer = agent.get(format!("http://{address}/")).call().expect("an answer");
    answer.body_mut().read_to_string().expect("a text")
}

#[test]
fn headers_that_do_not_arrive_end_the_connection() {
    let server = start(hello(), limits());
    let (silent, slow) = (connect(server.address()), connect(server.address()));
    assert_eq!(exchange(&silent, ""), "");
    assert_eq!(exchange(&slow, "GET / HTTP/1.1\r\nHost: loc"), "");
}

#[test]
fn a_connection_without_a_further_request_is_closed() {
    let server = start(hello(), limits());
    let answer = exchange(&connect(server.address()), "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert!(answer.starts_with("HTTP/1.1 200") && answer.ends_with("hello"), "{answer}");
}

#[test]
fn a_body_that_does_not_arrive_is_answered_with_408() {
    let server = start(hello(), limits());
    let post = "POST /echo HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\nfew";
    let answer = exchange(&connect(server.address()), post);
    assert!(answer.starts_with("HTTP/1.1 408"), "{answer}");
}

#[test]
fn a_body_beyond_the_limit_is_answered_with_413() {
    let server = start(hello(), limits());
    let announced = "POST /echo HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5000\r\n\r\n";
    assert!(exchange(&connect(server.address()), announced).starts_with("HTTP/1.1 413"));
    let chunk = format!("1000\r\n{}\r\n", "x".repeat(0x1000));
    let head = "POST /echo HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n";
    let answer = exchange(&connect(server.address()), &format!("{head}{chunk}1\r\nx\r\n0\r\n\r\n"));
    assert!(answer.starts_with("HTTP/1.1 413"), "{answer}");
}

#[test]
fn three_slow_posts_block_nobody() {
    let server = start(hello(), Limits { answer: PATIENCE, ..limits() });
    let slow = [(); 3].map(|()| {
        let mut stream = connect(server.address());
        let head = "POST /echo HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\nfew";
        stream.write_all(head.as_bytes()).expect("the server reads");
        stream
    });
    let begun = Instant::now();
    assert_eq!(get_root(server.address()), "hello");
    assert!(begun.elapsed() < PATIENCE / 2, "the answer waited for the slow ones");
    drop(slow);
}

#[test]
fn connections_beyond_the_limit_wait_for_a_place() {
    let server = start(hello(), Limits { connections: 2, ..limits() });
    let idle = [(); 2].map(|()| connect(server.address()));
    // A place is free again once the idle connections have been closed.
    assert_eq!(get_root(server.address()), "hello");
    drop(idle);
}

#[test]
fn a_page_of_metrics_outlasts_250_idle_connections() {
    let exporter = Exporter::open(([127, 0, 0, 1], 0).into()).expect("a free port");
    let mut page = Page::new(&[("room", "a")]);
    page.counter("heliostat_ticks", "Ticks", &[], 7);
    exporter.publish(page);
    let idle: Vec<TcpStream> = (0..250).map(|_| connect(exporter.address())).collect();
    let mut answer = ureq::get(format!("http://{}/metrics", exporter.address())).call().expect("an answer");
    assert!(answer.body_mut().read_to_string().expect("a text").contains("heliostat_ticks_total{room=\"a\"} 7\n"));
    drop(idle);
}

#[test]
fn reads_that_are_never_answered_leave_a_place_for_an_order() {
    let hour = Duration::from_secs(3600);
    let (sender, asked) = mpsc::channel();
    let unanswered = move || {
        // The receiver may have ended with the test.
        let _ = sender.send(());
        std::future::pending::<&'static str>()
    };
    let router = Router::new().route("/", get(unanswered)).route("/order", post(async || "done"));
    let places = Limits { connections: 6, reads: 3, headers: hour, answer: hour, stall: hour, ..limits() };
    let server = start(router, places);
    let read = || {
        let mut stream = connect(server.address());
        // A server that ends the connection meanwhile resets it.
        let _ = stream.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n");
        stream
    };
    let held = [(); 3].map(|()| {
        let stream = read();
        asked.recv_timeout(PATIENCE).expect("the server begins an answer");
        stream
    });
    let further: Vec<TcpStream> = (0..12).map(|_| read()).collect();
    let order = "POST /order HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
    let ordered = exchange(&connect(server.address()), order);
    assert!(ordered.ends_with("done"), "{ordered}");
    let refused = exchange(&connect(server.address()), "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert!(refused.starts_with("HTTP/1.1 503") && refused.contains("too many requests"), "{refused}");
    drop((held, further));
}

/// Tells when it is dropped.
struct Tell(mpsc::Sender<()>);

impl Drop for Tell {
    fn drop(&mut self) {
        // The receiver may have ended with the test.
        let _ = self.0.send(());
    }
}

#[test]
fn a_client_that_does_not_read_is_dropped() {
    let (sender, dropped) = mpsc::channel();
    let endless = move || {
        let tell = Tell(sender.clone());
        let stream = futures_util::stream::repeat_with(move || {
            let _held = &tell;
            Ok::<_, Infallible>(Bytes::from_static(&[b'x'; 65_536]))
        });
        std::future::ready(Body::from_stream(stream))
    };
    let server = start(Router::new().route("/", get(endless)), limits());
    let (mut reads, mut deaf) = (connect(server.address()), connect(server.address()));
    for client in [&mut reads, &mut deaf] {
        client.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").expect("the server reads");
    }
    let (mut buffer, begun) = (vec![0; 1 << 20], Instant::now());
    while dropped.try_recv().is_err() {
        assert!(begun.elapsed() < PATIENCE, "the server keeps a client that does not read");
        reads.read_exact(&mut buffer).expect("a client that reads is kept");
    }
    reads.read_exact(&mut buffer).expect("a client that reads is kept");
    drop(server);
}

#[test]
fn the_end_lets_answers_finish_and_closes_the_port() {
    let (sender, asked) = mpsc::channel();
    let slow = move || {
        // The receiver may have ended with the test.
        let _ = sender.send(());
        async {
            tokio::time::sleep(Duration::from_millis(200)).await;
            "finished"
        }
    };
    let server = start(Router::new().route("/", get(slow)), Limits { headers: PATIENCE, ..Limits::default() });
    let address = server.address();
    let (mut asks, idle) = (connect(address), connect(address));
    asks.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").expect("the server reads");
    asked.recv_timeout(PATIENCE).expect("the server reads the request");
    let begun = Instant::now();
    drop(server);
    assert!(begun.elapsed() < PATIENCE / 2, "the end waited for an idle connection");
    assert!(exchange(&asks, "").ends_with("finished"));
    assert!(TcpStream::connect(address).is_err(), "the port is closed");
    drop(idle);
}

#[test]
fn half_sent_requests_that_hold_every_place_make_room_for_a_complete_one() {
    let hour = Duration::from_secs(3600);
    let server = start(hello(), Limits { connections: 3, headers: hour, answer: hour, stall: hour, ..limits() });
    let answered = exchange_one(&connect(server.address()), "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert!(answered.ends_with("hello"), "{answered}");
    let half_sent =
        ["", "GET / HTTP/1.1\r\nHost: loc", "POST /echo HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\nfew"];
    let held: Vec<TcpStream> = half_sent
        .iter()
        .cycle()
        .take(12)
        .map(|text| {
            let mut stream = connect(server.address());
            stream.write_all(text.as_bytes()).expect("the server listens");
            stream
        })
        .collect();
    assert_eq!(get_root(server.address()), "hello");
    drop(held);
}

/// Sends a request and reads its answer, of a known end, on a connection that stays open.
fn exchange_one(mut stream: &TcpStream, bytes: &str) -> String {
    stream.write_all(bytes.as_bytes()).expect("the server reads");
    let mut answer = String::new();
    while !answer.ends_with("hello") {
        let mut chunk = [0; 256];
        let count = stream.read(&mut chunk).expect("an answer");
        assert!(count > 0, "the connection was closed after {answer:?}");
        answer.push_str(&String::from_utf8_lossy(&chunk[..count]));
    }
    answer
}
