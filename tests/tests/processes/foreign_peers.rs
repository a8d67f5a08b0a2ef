//! TCP processes that are no Zenoh peers: they may not delay the end of a process.

use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use heliostat_bus::free_loopback_endpoint;
use heliostat_tests::{Process, wait_until};

/// Zenoh waits this long for the introduction of a connection; its close then waits 10 s at most.
const TIMEOUTS: (&str, &str) =
    ("HELIOSTAT_ZENOH", "transport/unicast/open_timeout=60000;transport/unicast/accept_timeout=60000");

/// Generous limit of an end that Zenoh would delay by 10 s.
const END_LIMIT: Duration = Duration::from_secs(9);

/// A process that accepts connections and sends these bytes; its endpoint, and the number of connections.
fn foreign_listener(greeting: &'static [u8]) -> (String, Arc<AtomicUsize>) {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a free port");
    let endpoint = format!("tcp/{}", listener.local_addr().expect("bound"));
    let connections = Arc::<AtomicUsize>::default();
    let count = Arc::clone(&connections);
    std::thread::spawn(move || {
        let mut kept = Vec::new();
        for mut stream in listener.incoming().map_while(Result::ok) {
            // The other side may have closed the connection because of the first bytes.
            let _ = stream.write_all(greeting);
            kept.push(stream);
            count.fetch_add(1, Ordering::SeqCst);
        }
    });
    (endpoint, connections)
}

/// Ends a process by SIGTERM; the time that it took.
fn end_of(process: Process) -> Duration {
    process.signal("TERM");
    let asked = Instant::now();
    let ended = process.wait();
    assert!(ended.status.success(), "{}", ended.errors);
    asked.elapsed()
}

#[test]
fn a_listener_that_is_no_zenoh_peer_does_not_delay_the_end_of_a_process() {
    // A frame of the length 65535 that never comes, and a text of another protocol.
    for greeting in [&b""[..], b"\xff\xff", b"HTTP/1.1 400 Bad Request\r\n\r\n"] {
        let (foreign, connections) = foreign_listener(greeting);
        let own = free_loopback_endpoint().expect("a free port");
        let arguments: [&[&str]; 3] = [
            &["controller", "--policy", "flat", "--connect", &foreign],
            &["sim-node", "--listen", &own, "--connect", &foreign],
            &["ui", "--plain", "--no-ui", "--connect", &foreign],
        ];
        for arguments in arguments {
            let before = connections.load(Ordering::SeqCst);
            let process = Process::heliostat_under::<&str>(&[], &[TIMEOUTS], arguments);
            wait_until("a connection", || connections.load(Ordering::SeqCst) > before);
            // Until it listens for signals.
            std::thread::sleep(Duration::from_secs(1));
            let took = end_of(process);
            assert!(took < END_LIMIT, "{arguments:?} with {greeting:?} ended after {took:?}");
        }
    }
}

#[test]
fn silent_connections_to_a_process_do_not_delay_its_end() {
    let endpoint = free_loopback_endpoint().expect("a free port");
    let room = Process::heliostat_under::<&str>(&[], &[TIMEOUTS], &["sim-node", "--listen", &endpoint]);
    let address = endpoint.strip_prefix("tcp/").expect("a TCP endpoint");
    let mut silent = Vec::new();
    wait_until("a connection", || TcpStream::connect(address).map(|stream| silent.push(stream)).is_ok());
    silent.extend((0..4).map(|_| TcpStream::connect(address).expect("it listens")));
    std::thread::sleep(Duration::from_millis(500));
    let took = end_of(room);
    assert!(took < END_LIMIT, "ended after {took:?}");
}
