//! Serves the newest page under `/metrics`, on a thread of its own.

use std::net::{SocketAddr, TcpListener};
use std::sync::{Arc, Mutex};
use std::time::SystemTime;

use axum::Router;
use axum::extract::State;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use axum::routing::get;
use heliostat_bus::CertificateEnds;
use thiserror::Error;

use crate::http::{self, Limits};
use crate::locks::lock;
use crate::page::Page;
use crate::stop::Stop;

const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

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
        /// What the operating system reports.
        problem: std::io::Error,
    },
}

/// The flag that says where a process serves its metrics.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct MetricsArgs {
    /// Serve metrics in the OpenMetrics format at http://ADDRESS/metrics; port 0 selects a free port, which the log names
    #[arg(long, value_name = "ADDRESS", value_parser = socket_address)]
    pub metrics_listen: Option<SocketAddr>,
}

/// The IP address and the port of a flag.
///
/// # Errors
/// What was expected.
pub fn socket_address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| "expected an IP address and a port, for example 127.0.0.1:9464 or [::1]:9464".into())
}

/// Adds the known ends of certificates to a page.
fn add_ends(CertificateEnds { own, router }: CertificateEnds, page: &mut Page) {
    let known = [
        (
            "heliostat_certificate_end_timestamp_seconds",
            "End of the certificate with which the process started, in s since 1970-01-01 UTC",
            own,
        ),
        (
            "heliostat_router_certificate_end_timestamp_seconds",
            "End of the certificate of the router beside the keys with which the process started, in s since 1970-01-01 UTC",
            router,
        ),
    ];
    for (name, help, end) in known {
        if let Some(end) = end.and_then(|end| end.duration_since(SystemTime::UNIX_EPOCH).ok()) {
            page.gauge(name, help, &[], end.as_secs_f64());
        }
    }
}

impl MetricsArgs {
    /// Opens an exporter where the flag is given, for a process that knows when these certificates end.
    ///
    /// # Errors
    /// [`MetricsError`].
    pub fn open(&self, certificate_ends: CertificateEnds) -> Result<Option<Exporter>, MetricsError> {
        let exporter = self.metrics_listen.map(Exporter::open).transpose()?;
        Ok(exporter.map(|exporter| Exporter { certificate_ends, ..exporter }))
    }
}

/// A server of the newest page; it ends when dropped.
#[derive(Debug)]
pub struct Exporter {
    /// `None` before the first one.
    newest: Arc<Mutex<Option<Page>>>,
    /// Each page has them.
    certificate_ends: CertificateEnds,
    server: http::Server,
}

impl Exporter {
    /// Listens at an address.
    ///
    /// # Errors
    /// [`MetricsError`].
    pub fn open(address: SocketAddr) -> Result<Self, MetricsError> {
        let failed = |problem| MetricsError::Listen { address, problem };
        let listener = TcpListener::bind(address).map_err(failed)?;
        let newest = Arc::new(Mutex::new(None::<Page>));
        let router = Router::new().route("/metrics", get(metrics)).fallback(elsewhere).with_state(Arc::clone(&newest));
        let server = http::serve("metrics", listener, router, Limits::default(), Stop::default()).map_err(failed)?;
        tracing::info!("metrics at http://{}/metrics", server.address());
        Ok(Self { newest, certificate_ends: CertificateEnds::default(), server })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// Replaces the page.
    pub fn publish(&self, mut page: Page) {
        add_ends(self.certificate_ends, &mut page);
        *lock(&self.newest) = Some(page);
    }
}

/// The newest page. A process that ends before its first one, as where its router does not answer, is not up.
async fn metrics(State(newest): State<Arc<Mutex<Option<Page>>>>) -> impl IntoResponse {
    let page = lock(&newest).clone();
    match page {
        Some(page) => ([(CONTENT_TYPE, OPEN_METRICS)], page.text()).into_response(),
        None => (StatusCode::SERVICE_UNAVAILABLE, "this process has not joined its room yet\n").into_response(),
    }
}

async fn elsewhere() -> impl IntoResponse {
    (StatusCode::NOT_FOUND, "metrics are at /metrics\n")
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::TcpStream;

    use super::*;

    #[test]
    fn an_address_has_a_port_and_no_name() {
        assert_eq!(socket_address("[::1]:9464").map(|address| address.port()), Ok(9464));
        for text in ["127.0.0.1", "localhost:9464", ":9464", "::1:9464x"] {
            let refused = socket_address(text).expect_err(text);
            assert!(refused.starts_with("expected an IP address and a port, for example"), "{refused}");
        }
    }

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
        let address = exporter.address();
        assert!(get(address, "/metrics").starts_with("HTTP/1.1 503"), "Prometheus counts it as down");
        for count in [1, 2] {
            let mut page = Page::new(&[("room", "a")]);
            page.counter("heliostat_ticks", "Ticks", &[], count);
            exporter.publish(page);
        }
        let answer = get(address, "/metrics");
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        assert!(answer.contains(OPEN_METRICS) && answer.contains("heliostat_ticks_total{room=\"a\"} 2\n"), "{answer}");
        assert!(get(address, "/").starts_with("HTTP/1.1 404"));
        let taken = Exporter::open(address).expect_err("one listener a port").to_string();
        assert!(taken.contains(&address.to_string()), "{taken}");
        drop(exporter);
        assert!(TcpStream::connect(address).is_err(), "the port is closed");
    }

    #[test]
    fn each_page_of_a_process_with_keys_has_the_ends_of_the_certificates_that_it_knows() {
        let flags = MetricsArgs { metrics_listen: Some(([127, 0, 0, 1], 0).into()) };
        let end = Some(SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(1_900_000_000));
        let [own, router] =
            ["", "router_"].map(|of| format!("heliostat_{of}certificate_end_timestamp_seconds{{room=\"a\"}} 1"));
        for ends in [
            CertificateEnds { own: end, router: end },
            CertificateEnds { own: end, router: None },
            CertificateEnds::default(),
        ] {
            let exporter = flags.open(ends).expect("a free port").expect("the flag is given");
            exporter.publish(Page::new(&[("room", "a")]));
            let answer = get(exporter.address(), "/metrics");
            let has = [&own, &router].map(|sample| answer.contains(sample.as_str()));
            assert_eq!(has, [ends.own.is_some(), ends.router.is_some()], "{answer}");
        }
    }
}
