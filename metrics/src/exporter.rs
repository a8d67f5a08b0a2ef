//! Serves the newest page under `/metrics`.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use thiserror::Error;
use tiny_http::{Header, Method, Response, Server};

use crate::page::Page;

const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Why metrics cannot be served.
#[derive(Debug, Error)]
pub enum MetricsError {
    /// The address is taken, or none of this machine.
    #[error(
        "cannot serve metrics at {address}: {problem}; give --metrics-listen an address of this machine with a free port"
    )]
    Listen {
        /// Where.
        address: SocketAddr,
        /// The operating system's account.
        problem: String,
    },
}

/// The flag by which a process is told to serve its metrics.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct MetricsArgs {
    /// Serve metrics in the OpenMetrics format at http://ADDRESS/metrics; with port 0, at a free one, which the log names
    #[arg(long, value_name = "ADDRESS")]
    pub metrics_listen: Option<SocketAddr>,
}

impl MetricsArgs {
    /// The exporter that the flag asks for, if it does.
    ///
    /// # Errors
    /// [`MetricsError`].
    pub fn open(&self) -> Result<Option<Exporter>, MetricsError> {
        self.metrics_listen.map(Exporter::open).transpose()
    }
}

/// A server of pages; it ends when dropped.
pub struct Exporter {
    newest: Arc<Mutex<Page>>,
    server: Arc<Server>,
    thread: Option<JoinHandle<()>>,
}

impl Exporter {
    /// Listens at an address.
    ///
    /// # Errors
    /// [`MetricsError`].
    pub fn open(address: SocketAddr) -> Result<Self, MetricsError> {
        let failed = |problem: String| MetricsError::Listen { address, problem };
        let server = Arc::new(Server::http(address).map_err(|error| failed(error.to_string()))?);
        let newest = Arc::new(Mutex::new(Page::default()));
        let (requests, pages) = (Arc::clone(&server), Arc::clone(&newest));
        let serve = move || {
            for request in requests.incoming_requests() {
                let path = request.url().split('?').next().unwrap_or_default();
                let answer = match (request.method(), path) {
                    (Method::Get | Method::Head, "/metrics") => {
                        let page = pages.lock().unwrap_or_else(PoisonError::into_inner).clone();
                        let kind = Header::from_bytes("Content-Type", CONTENT_TYPE).expect("a constant header is one");
                        Response::from_string(page.text()).with_header(kind)
                    }
                    _ => Response::from_string("metrics are at /metrics\n").with_status_code(404),
                };
                // Whoever asked may be gone.
                let _ = request.respond(answer);
            }
        };
        let thread = std::thread::Builder::new().name("metrics".into()).spawn(serve);
        let thread = Some(thread.map_err(|error| failed(error.to_string()))?);
        tracing::info!("metrics at http://{}/metrics", server.server_addr());
        Ok(Self { newest, server, thread })
    }

    /// Where it listens.
    pub fn address(&self) -> Option<SocketAddr> {
        self.server.server_addr().to_ip()
    }

    /// Replaces the page.
    pub fn publish(&self, page: Page) {
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner) = page;
    }
}

impl Drop for Exporter {
    fn drop(&mut self) {
        self.server.unblock();
        if let Some(thread) = self.thread.take() {
            // A panic there has told itself.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::TcpStream;
    use std::time::{Duration, Instant};

    use super::*;

    fn get(address: SocketAddr, path: &str) -> String {
        let mut stream = TcpStream::connect(address).expect("the exporter listens");
        write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").expect("it reads");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("it answers");
        answer
    }

    #[test]
    fn the_newest_page_is_served_and_nothing_else() {
        let exporter = Exporter::open(([127, 0, 0, 1], 0).into()).expect("a free port");
        let address = exporter.address().expect("it listens on TCP");
        for count in [1, 2] {
            let mut page = Page::new(&[("room", "a")]);
            page.counter("heliostat_ticks", "Ticks", &[], count);
            exporter.publish(page);
        }
        let answer = get(address, "/metrics");
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        assert!(answer.contains(CONTENT_TYPE) && answer.contains("heliostat_ticks_total{room=\"a\"} 2\n"), "{answer}");
        assert!(get(address, "/").starts_with("HTTP/1.1 404"));
        let taken = Exporter::open(address).err().expect("one listener a port").to_string();
        assert!(taken.contains(&address.to_string()), "{taken}");
        drop(exporter);
        // The server closes its port a moment after it was told to.
        let deadline = Instant::now() + Duration::from_secs(20);
        while TcpStream::connect(address).is_ok() {
            assert!(Instant::now() < deadline, "it ended");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}
