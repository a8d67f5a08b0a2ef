//! A TCP proxy between two processes whose link can be interrupted without closing it.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

/// Longest delay between a change of the proxy's state and its effect.
const POLL: Duration = Duration::from_millis(5);

/// State that the threads of a proxy share.
#[derive(Default)]
struct State {
    /// Whether every connection is interrupted.
    is_partitioned: AtomicBool,
    /// Open connections, each with its own interruption that never ends.
    connections: Mutex<Vec<(TcpStream, Arc<AtomicBool>)>>,
    ended: AtomicBool,
}

/// A proxy in front of one endpoint. While it is interrupted, the proxy reads no bytes: none are
/// lost, as when TCP retransmits.
pub struct Proxy {
    endpoint: String,
    state: Arc<State>,
}

impl Proxy {
    /// A proxy in front of an endpoint `tcp/HOST:PORT`.
    ///
    /// # Panics
    /// When no port is free, or the endpoint has another form.
    pub fn start(target: &str) -> Self {
        let target = target.strip_prefix("tcp/").expect("a TCP endpoint").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let endpoint = format!("tcp/{}", listener.local_addr().expect("a bound socket has an address"));
        listener.set_nonblocking(true).expect("a socket can be set");
        let state: Arc<State> = Arc::default();
        let accepting = Arc::clone(&state);
        thread::spawn(move || accept(&listener, &target, &accepting));
        Self { endpoint, state }
    }

    /// The endpoint to connect to.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// Interrupts both directions of all connections, and accepts no new one.
    pub fn partition(&self) {
        self.state.is_partitioned.store(true, Ordering::SeqCst);
    }

    /// Ends an interruption.
    pub fn heal(&self) {
        self.state.is_partitioned.store(false, Ordering::SeqCst);
    }

    /// Interrupts the present connections for ever, without closing them; new ones are not affected.
    pub fn abandon_connections(&self) {
        for (_, abandoned) in self.state.connections.lock().expect("no thread panics").iter() {
            abandoned.store(true, Ordering::SeqCst);
        }
    }

    /// Closes the present connections; new ones are not affected.
    pub fn close_connections(&self) {
        for (stream, _) in self.state.connections.lock().expect("no thread panics").drain(..) {
            // It may be closed already.
            let _ = stream.shutdown(Shutdown::Both);
        }
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.state.ended.store(true, Ordering::SeqCst);
        self.close_connections();
    }
}

fn accept(listener: &TcpListener, target: &str, state: &Arc<State>) {
    while !state.ended.load(Ordering::SeqCst) {
        thread::sleep(POLL);
        if state.is_partitioned.load(Ordering::SeqCst) {
            continue;
        }
        let Ok((near, _)) = listener.accept() else { continue };
        let Ok(far) = TcpStream::connect(target) else { continue };
        let abandoned = Arc::new(AtomicBool::new(false));
        let copy = |stream: &TcpStream| stream.try_clone().expect("a socket can be copied");
        let ends = [(copy(&near), copy(&far)), (copy(&far), copy(&near))];
        let mut connections = state.connections.lock().expect("no thread panics");
        connections.extend([near, far].map(|stream| (stream, Arc::clone(&abandoned))));
        for (from, to) in ends {
            let (state, abandoned) = (Arc::clone(state), Arc::clone(&abandoned));
            thread::spawn(move || pump(from, to, &state, &abandoned));
        }
    }
}

/// Copies bytes until one of the sockets is closed.
fn pump(mut from: TcpStream, mut to: TcpStream, state: &State, abandoned: &AtomicBool) {
    let mut bytes = vec![0; 64 * 1024];
    from.set_nonblocking(false).expect("a socket can be set");
    from.set_read_timeout(Some(POLL)).expect("a socket can be set");
    to.set_nodelay(true).expect("a socket can be set");
    while !state.ended.load(Ordering::SeqCst) {
        if abandoned.load(Ordering::SeqCst) || state.is_partitioned.load(Ordering::SeqCst) {
            thread::sleep(POLL);
            continue;
        }
        match from.read(&mut bytes) {
            Ok(0) => break,
            Ok(count) if to.write_all(&bytes[..count]).is_ok() => {}
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Ok(_) | Err(_) => break,
        }
    }
    for stream in [from, to] {
        // It may be closed already.
        let _ = stream.shutdown(Shutdown::Both);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A proxy in front of a socket that answers each byte with the next one.
    fn counting() -> (Proxy, TcpStream) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let proxy = Proxy::start(&format!("tcp/{}", listener.local_addr().unwrap()));
        thread::spawn(move || {
            for mut stream in listener.incoming().map_while(Result::ok) {
                thread::spawn(move || {
                    let mut byte = [0];
                    while stream.read_exact(&mut byte).is_ok() && stream.write_all(&[byte[0] + 1]).is_ok() {}
                });
            }
        });
        let stream = TcpStream::connect(proxy.endpoint().strip_prefix("tcp/").unwrap()).unwrap();
        (proxy, stream)
    }

    /// Longest wait for an answer that comes, and the wait for one that does not.
    const LIMITS: [Duration; 2] = [Duration::from_secs(60), Duration::from_millis(300)];

    /// Time within which the threads of a proxy see an order.
    const SEEN: Duration = Duration::from_millis(500);

    fn answer(stream: &mut TcpStream, byte: u8, limit: Duration) -> Option<u8> {
        let mut read = [0];
        stream.set_read_timeout(Some(limit)).unwrap();
        stream.write_all(&[byte]).ok()?;
        stream.read_exact(&mut read).ok().map(|()| read[0])
    }

    #[test]
    fn an_interruption_loses_no_byte_and_abandoned_connections_stay_open() {
        let (proxy, mut stream) = counting();
        let [long, short] = LIMITS;
        assert_eq!(answer(&mut stream, 1, long), Some(2));
        proxy.partition();
        thread::sleep(SEEN);
        assert_eq!(answer(&mut stream, 2, short), None);
        proxy.heal();
        let mut read = [0];
        stream.set_read_timeout(Some(long)).unwrap();
        stream.read_exact(&mut read).unwrap();
        assert_eq!(read, [3], "the byte of before");
        proxy.abandon_connections();
        thread::sleep(SEEN);
        assert_eq!(answer(&mut stream, 5, short), None);
        let mut new = TcpStream::connect(proxy.endpoint().strip_prefix("tcp/").unwrap()).unwrap();
        assert_eq!(answer(&mut new, 7, long), Some(8));
        proxy.close_connections();
        assert_eq!(answer(&mut new, 7, long), None);
    }
}
