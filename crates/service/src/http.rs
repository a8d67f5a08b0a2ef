//! The HTTP server below the metrics page and the live page.
//!
//! Each server runs on one thread of its own, so that no client can delay the rest of the process.
//! Every wait for a client is bounded by [`Limits`]: for a request's headers, for its body, for the
//! next request, and for the client to read an answer. When all places are taken, the connection that
//! has waited longest for its client ends. Reads take a part of the places only, so that an order never waits behind
//! viewers.

use std::io;
use std::net::{SocketAddr, TcpListener};
use std::pin::Pin;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use axum::Router;
use axum::http::StatusCode;
use axum::middleware::from_fn_with_state;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use socket2::SockRef;
use tokio::net::TcpStream;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};
use tokio_io_timeout::TimeoutStream;
use tower_http::limit::RequestBodyLimitLayer;
use tower_http::timeout::TimeoutLayer;

use crate::stop::Stop;
use crate::waiting::{self, Answers, Connections};

/// Bytes that hyper buffers for each direction of a connection; also the longest head of a request.
const BUFFER_MAX: usize = 16 * 1024;
/// Bytes that the operating system buffers for a client that does not read. A bounded buffer makes
/// such a client show within seconds; this size still fills 25 Mbit/s over 80 ms.
const SEND_BUFFER: usize = 256 * 1024;
/// Pause after a connection could not be accepted, for example because files are used up.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// What one client can cost.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Longest wait for the headers of a request, the first and every further one of a connection.
    pub headers: Duration,
    /// Longest time from the headers of a request to the start of its answer. The request's body
    /// has to arrive in it; the status is 408 otherwise.
    pub answer: Duration,
    /// A connection ends when its client reads nothing for this long while there is something to read.
    pub stall: Duration,
    /// Longest body of a request in bytes; the status is 413 beyond it.
    pub body_bytes: usize,
    /// Connections at the same time; for a further one the oldest ends that waits for its client. If all
    /// are being answered, the further one waits.
    pub connections: usize,
    /// Reads, as GET, that are answered at the same time; the status is 503 beyond it. Below `connections`, so that a
    /// request with an effect finds a place.
    pub reads: usize,
    /// Longest wait at the end for answers that are being sent.
    pub shutdown: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            headers: Duration::from_secs(5),
            answer: Duration::from_secs(5),
            stall: Duration::from_secs(5),
            body_bytes: 4096,
            connections: 400,
            reads: 200,
            shutdown: Duration::from_secs(1),
        }
    }
}

/// A running server; dropping it ends it.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    stop: Stop,
    thread: Option<JoinHandle<()>>,
}

/// Serves a router on a thread of the given name, until `stop` is requested or the server is dropped.
///
/// A handler that streams without end has to watch `stop` itself. A handler must not block; see
/// [`unblock`].
///
/// # Errors
/// What the operating system says where the socket cannot be used or no thread can be started.
pub fn serve(name: &str, listener: TcpListener, router: Router, limits: Limits, stop: Stop) -> io::Result<Server> {
    let address = listener.local_addr()?;
    SockRef::from(&listener).set_send_buffer_size(SEND_BUFFER)?;
    listener.set_nonblocking(true)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build()?;
    let listener = {
        let _inside = runtime.enter();
        tokio::net::TcpListener::from_std(listener)?
    };
    let router = router
        .layer(RequestBodyLimitLayer::new(limits.body_bytes))
        .layer(TimeoutLayer::with_status_code(StatusCode::REQUEST_TIMEOUT, limits.answer))
        // Outermost: the limit recognises its own error at its depth alone.
        .layer(from_fn_with_state(Arc::new(Semaphore::new(limits.reads)), waiting::note));
    let until = stop.clone();
    let serve = move || runtime.block_on(accept(listener, router, limits, until));
    let thread = std::thread::Builder::new().name(name.to_owned()).spawn(serve)?;
    Ok(Server { address, stop, thread: Some(thread) })
}

/// Runs what blocks on a thread of its own, for a handler.
///
/// Not on the runtime's blocking threads: Zenoh panics on any thread of a current-thread runtime.
///
/// # Errors
/// No thread can be started, or the work panicked.
pub async fn unblock<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> io::Result<T> {
    let (sender, result) = oneshot::channel();
    // A handler that gave up waiting needs no result.
    std::thread::Builder::new().name("handler".into()).spawn(move || drop(sender.send(work())))?;
    result.await.map_err(io::Error::other)
}

impl Server {
    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.request();
        if let Some(thread) = self.thread.take() {
            // A panic there has been reported by the panic handler.
            let _ = thread.join();
        }
    }
}

/// Accepts connections until the end is requested, then waits for the answers under way.
async fn accept(listener: tokio::net::TcpListener, router: Router, limits: Limits, stop: Stop) {
    let free = Arc::new(Semaphore::new(limits.connections));
    let graceful = GracefulShutdown::new();
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new())
        .header_read_timeout(limits.headers)
        .max_buf_size(BUFFER_MAX)
        // Scripts often compare the names of headers with regard to case.
        .title_case_headers(true);
    let mut connections = Connections::default();
    loop {
        let next = tokio::select! {
            () = stop.requested() => break,
            next = next_connection(&listener, &free, &mut connections) => next,
        };
        let Ok((stream, place)) = next else {
            tokio::time::sleep(ACCEPT_PAUSE).await;
            continue;
        };
        let answers = Answers::default();
        let (router, noted) = (TowerToHyperService::new(router.clone()), answers.clone());
        let service = service_fn(move |mut request: hyper::Request<Incoming>| {
            request.extensions_mut().insert(noted.clone());
            router.call(request)
        });
        let connection = http.serve_connection(TokioIo::new(bounded(stream, limits.stall)), service);
        let connection = graceful.watch(connection);
        let task = tokio::spawn(async move {
            // An error is a client that is gone or broke a limit; the next one is served all the same.
            let _ = connection.await;
            drop(place);
        });
        connections.add(answers, task.abort_handle());
    }
    drop(listener);
    // Whatever is not finished by then ends with the runtime.
    let _ = tokio::time::timeout(limits.shutdown, graceful.shutdown()).await;
}

/// The next connection, with a place for it.
async fn next_connection(
    listener: &tokio::net::TcpListener,
    free: &Arc<Semaphore>,
    connections: &mut Connections,
) -> io::Result<(TcpStream, OwnedSemaphorePermit)> {
    let (stream, _) = listener.accept().await?;
    let place = match Arc::clone(free).try_acquire_owned() {
        Ok(place) => place,
        Err(_) => {
            connections.end_waiting();
            Arc::clone(free).acquire_owned().await.map_err(io::Error::other)?
        }
    };
    Ok((stream, place))
}

/// The connection with a limit on how long a write may wait for the client.
fn bounded(stream: TcpStream, stall: Duration) -> Pin<Box<TimeoutStream<TcpStream>>> {
    // Without the option answers are only slower.
    let _ = stream.set_nodelay(true);
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(stall));
    Box::pin(stream)
}
