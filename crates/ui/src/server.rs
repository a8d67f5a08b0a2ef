//! The HTTP server of the page: its files, live data as server-sent events, and orders.
//!
//! | path | method | content |
//! | --- | --- | --- |
//! | `/` and its files | GET | the page |
//! | `/room.json` | GET | the static data, and the sum rates of the last 90 s with what the mirrors followed then, JSON |
//! | `/live` | GET | events `figures` (10 a second) and `frame` (at most 10 a second), `log` where it changes, and `ended` as the last one, JSON |
//! | `/floor.json` | GET | the rate over the floor, JSON; `?mirrors=0` without the mirrors |
//! | `/events.json` | GET | the next events as one JSON object, for a browser without a free connection |
//! | `/order` | POST | an [`Order`] as JSON |
//! | `/check` | POST | nothing; its status is that of an order from the same page |
//!
//! The page uses relative paths, so it can be served below a path of another host. The answer to an order is 202 with its number if it was published to a subscriber, and 503 if there is none.
//! The events `figures` have the answers of the receivers under these numbers. An
//! invalid order, or one that the certificate of the page does not permit, is answered with 422 and the reason. With keys, and on any other than a loopback address, each
//! request without the token is answered with 401.
//!
//! The limits of [`heliostat_service::http`] hold for every client.

use std::convert::Infallible;
use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, Method, StatusCode, Uri};
use axum::middleware::from_fn_with_state;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use heliostat_service::Stop;
use heliostat_service::http::{self, Limits};
use heliostat_service::process::machine_name;
use serde::Serialize;

use crate::UiError;
use crate::assets;
use crate::floor::FloorMaps;
use crate::guard::{self, Guard, PublicAddress};
use crate::latency::BUDGET_US;
use crate::live::{Feed, READERS_MAX, Reader};
use crate::order::Order;
use crate::page::{NetworkFile, Page, PolicyChoice};
use crate::scene::Plan;
use crate::sums::PastSum;
use crate::token::{self, Gate, Token};

/// Default port of the page.
const DEFAULT_PORT: u16 = 7480;
/// Ports that are tried from the default one on.
const DEFAULT_PORTS: u16 = 100;
/// Maximum length of an order in bytes.
const ORDER_MAX: usize = 4096;
const JSON: &str = "application/json";
const TEXT: &str = "text/plain; charset=utf-8";
const EVENTS: &str = "text/event-stream";

/// The flags for the address of the page.
#[derive(Clone, Debug, clap::Args)]
pub struct PageArgs {
    /// Do not serve the page
    #[arg(long)]
    no_ui: bool,
    /// Port of the page; 0 selects a free one, and one in use is refused. Without this flag 7480, or
    /// the next free port
    #[arg(long, value_name = "PORT")]
    ui_port: Option<u16>,
    /// IP address of the page, without a port (see --ui-port); with --tls, and on any other than a
    /// loopback address, a browser needs the token in the URL that is printed
    #[arg(long, value_name = "ADDRESS", value_parser = ip_address, default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    ui_listen: IpAddr,
    /// File with the token of the page, made with a random one if absent; without this flag, a random
    /// token at each start where the page requires one
    #[arg(long, value_name = "FILE")]
    ui_token_file: Option<PathBuf>,
    /// Address at which a proxy serves the page, for example `https://mirrors.example.org`: orders from
    /// there are accepted. May be repeated. The proxy must ask for a password, or use --ui-token-file
    #[arg(long = "ui-origin", value_name = "URL")]
    ui_origins: Vec<PublicAddress>,
}

/// Where a page is served, and to which browsers.
#[derive(Clone, Debug)]
pub struct Place {
    /// Address at which it listens. On any other than a loopback address it requires a token.
    pub address: IpAddr,
    /// Port; 0 selects a free one, and `None` the default port or the next free one.
    pub port: Option<u16>,
    /// File with the token, made if absent; `None` for a random one at each start.
    pub token_file: Option<PathBuf>,
    /// Whether the page requires a token on a loopback address too: with the keys of an operator,
    /// every user of this machine could otherwise give orders.
    pub authenticated: bool,
    /// Addresses at which a proxy serves it.
    pub public: Vec<PublicAddress>,
}

impl Place {
    /// A port of 127.0.0.1.
    pub fn loopback(port: u16) -> Self {
        Self {
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            port: Some(port),
            token_file: None,
            authenticated: false,
            public: Vec::new(),
        }
    }

    fn token(&self) -> Result<Option<Token>, UiError> {
        match &self.token_file {
            Some(file) => Token::kept_in(file).map(Some),
            None if self.address.is_loopback() && !self.authenticated => Ok(None),
            None => Token::random().map(Some),
        }
    }

    /// Listens at the port; without one at the default port, or at the next free one.
    fn listener(&self) -> Result<TcpListener, UiError> {
        let address = self.address;
        let bind = |port| TcpListener::bind((address, port));
        let bound = match self.port {
            Some(port) => bind(port),
            None => {
                let mut ports = DEFAULT_PORT..DEFAULT_PORT + DEFAULT_PORTS;
                ports.find_map(|port| bind(port).ok()).map_or_else(|| bind(0), Ok)
            }
        };
        bound.map_err(|problem| match (self.port, problem.kind()) {
            (Some(port), ErrorKind::AddrInUse | ErrorKind::PermissionDenied) => {
                UiError::PortRefused { at: SocketAddr::new(address, port), problem }
            }
            _ => UiError::CannotListen { address, problem },
        })
    }
}

fn ip_address(text: &str) -> Result<IpAddr, String> {
    let in_brackets = text.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
    in_brackets
        .unwrap_or(text)
        .parse::<IpAddr>()
        .map_err(|_| "expected an IP address without a port, for example 0.0.0.0; --ui-port has the port".into())
}

/// The state that all handlers share.
#[derive(Clone)]
struct Shared {
    page: Arc<Page>,
    feed: Arc<Feed>,
    floor: Arc<FloorMaps>,
}

/// A page that is being served; dropping it ends the server.
pub struct Server {
    http: http::Server,
    /// For the last event of open pages.
    feed: Arc<Feed>,
    /// An address at which a browser opens the page.
    opened_at: String,
    /// The default port was in use, and another one replaced it.
    is_replaced: bool,
    token: Option<Arc<Token>>,
    public: Vec<PublicAddress>,
}

impl PageArgs {
    /// Serves the page unless the flags forbid it; `authenticated` for a session with keys.
    ///
    /// # Errors
    /// As [`Server::start`].
    pub fn serve(
        &self,
        authenticated: bool,
        page: impl FnOnce() -> Result<Page, UiError>,
    ) -> Result<Option<Server>, UiError> {
        if self.no_ui {
            return Ok(None);
        }
        let token_file = self.ui_token_file.clone();
        let public = self.ui_origins.clone();
        let place = Place { address: self.ui_listen, port: self.ui_port, token_file, authenticated, public };
        Server::start(page()?, &place).map(Some)
    }
}

impl Server {
    /// Serves a page at an address and a port; without a port at the default one, or at the next free one.
    ///
    /// # Errors
    /// [`UiError::PortRefused`] if the port is in use; [`UiError::CannotListen`] if the address does not belong to
    /// this machine; [`UiError::Token`]; [`UiError::TokenFile`]; [`UiError::Threads`].
    pub fn start(page: Page, place: &Place) -> Result<Self, UiError> {
        let address = place.address;
        let token = place.token()?.map(Arc::new);
        let listener = place.listener()?;
        let cannot_listen = |problem| UiError::CannotListen { address, problem };
        let bound = listener.local_addr().map_err(cannot_listen)?.port();
        let stop = Stop::default();
        let floor = Arc::new(FloorMaps::new(Arc::clone(&page.view)));
        let page = Arc::new(page);
        let feed = Feed::start(Arc::clone(&page), stop.clone()).map_err(UiError::Threads)?;
        let gate = token.clone().map(|token| Gate { token, port: bound });
        let at = SocketAddr::new(address, bound);
        let guard = Guard::new(at, machine_name(), place.public.clone());
        let opened_at = guard.address().to_owned();
        let router = router(Shared { page, feed: Arc::clone(&feed), floor }, gate, guard);
        let limits = Limits { body_bytes: ORDER_MAX, ..Limits::default() };
        let served = http::serve("page", listener, router, limits, stop.clone());
        let http = served.inspect_err(|_| stop.request()).map_err(UiError::Threads)?;
        let is_replaced = place.port.is_none() && bound != DEFAULT_PORT;
        Ok(Self { http, feed, opened_at, is_replaced, token, public: place.public.clone() })
    }

    /// Ends the server. Open pages show this sentence, which says that it has ended and why.
    pub fn end(self, sentence: &str) {
        self.feed.end(sentence);
    }

    /// The address at which it listens.
    pub fn address(&self) -> SocketAddr {
        self.http.address()
    }

    /// The URL to open in a browser, without a token. A page on all addresses of this machine has its name there.
    pub fn url_without_token(&self) -> &str {
        &self.opened_at
    }

    /// The URL to open in a browser, with the token if the page requires one.
    pub fn url(&self) -> String {
        format!("{}{}", self.opened_at, self.query())
    }

    fn query(&self) -> String {
        self.token.as_ref().map(|token| format!("?token={}", token.as_str())).unwrap_or_default()
    }
}

impl std::fmt::Display for Server {
    /// The URL of the page, the default port if it was in use, and the public addresses.
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "the page is at {}", self.url())?;
        if self.address().ip().is_unspecified() {
            write!(formatter, " and at each address of this machine")?;
        }
        if self.is_replaced {
            write!(formatter, " (port {DEFAULT_PORT} is in use)")?;
        }
        self.public.iter().try_for_each(|public| write!(formatter, ", through a proxy at {public}{}", self.query()))
    }
}

fn router(shared: Shared, gate: Option<Gate>, guard: Guard) -> Router {
    let router = Router::new()
        .route("/order", post(order))
        .route("/check", post(async || StatusCode::NO_CONTENT))
        .route("/live", get(live))
        .route("/events.json", get(events))
        .route("/room.json", get(room))
        .route("/floor.json", get(floor))
        .fallback(file)
        .method_not_allowed_fallback(other_method)
        .with_state(shared);
    let guarded = match gate {
        Some(gate) => router.layer(from_fn_with_state(gate, token::check)),
        None => router,
    };
    guarded.layer(from_fn_with_state(Arc::new(guard), guard::check_origin))
}

/// The static data of the page, and the past sum rates.
#[derive(Serialize)]
struct RoomJson {
    /// As in the events `figures`.
    page: String,
    #[serde(flatten)]
    plan: Plan,
    policies: Vec<PolicyChoice>,
    controls_processes: bool,
    /// Why only the stop button acts; absent where every button does.
    #[serde(skip_serializing_if = "Option::is_none")]
    stop_only: Option<&'static str>,
    network: Option<NetworkFile>,
    /// The largest number of users of the room; `null` where no scenario is given.
    users_max: Option<usize>,
    budget_us: u64,
    history: Vec<(f64, PastSum)>,
}

async fn room(State(Shared { page, .. }): State<Shared>) -> Response {
    // The policies are tried against the room.
    match http::unblock(move || room_json(&page)).await {
        Ok(Ok(room)) => reply(StatusCode::OK, JSON, room),
        Ok(Err(error)) => reply(StatusCode::INTERNAL_SERVER_ERROR, TEXT, error.to_string()),
        Err(error) => reply(StatusCode::INTERNAL_SERVER_ERROR, TEXT, error.to_string()),
    }
}

fn room_json(page: &Page) -> serde_json::Result<String> {
    let room = RoomJson {
        page: page.id(),
        plan: page.view.plan(&page.room),
        policies: (page.policies)(&page.view.served_room()),
        controls_processes: page.operator.controls_processes(),
        stop_only: page.operator.rights().limit(),
        network: page.network.clone(),
        users_max: page.view.users_max(),
        budget_us: BUDGET_US,
        history: page.view.history(),
    };
    serde_json::to_string(&room)
}

async fn floor(State(Shared { floor, .. }): State<Shared>, uri: Uri) -> Response {
    let with_mirrors = uri.query() != Some("mirrors=0");
    // A map takes some milliseconds of computation.
    match http::unblock(move || floor.map(with_mirrors)).await {
        Ok(Some(map)) => match serde_json::to_string(&map) {
            Ok(map) => reply(StatusCode::OK, JSON, map),
            Err(error) => reply(StatusCode::INTERNAL_SERVER_ERROR, TEXT, error.to_string()),
        },
        Ok(None) => reply(StatusCode::SERVICE_UNAVAILABLE, TEXT, "no report of the room is recent: expected a room\n"),
        Err(error) => reply(StatusCode::INTERNAL_SERVER_ERROR, TEXT, error.to_string()),
    }
}

/// Streams the events to a page until its connection closes.
async fn live(State(Shared { feed, .. }): State<Shared>) -> Response {
    let Some(reader) = feed.reader() else { return too_many_pages() };
    let next = async |mut reader: Reader| {
        let events = reader.next().await?;
        Some((Ok::<_, Infallible>(events), reader))
    };
    reply(StatusCode::OK, EVENTS, Body::from_stream(futures_util::stream::unfold(reader, next)))
}

/// The next events of the stream.
async fn events(State(Shared { feed, .. }): State<Shared>) -> Response {
    let Some(reader) = feed.reader() else { return too_many_pages() };
    match reader.once().await {
        Some(events) => reply(StatusCode::OK, JSON, events),
        None => reply(StatusCode::SERVICE_UNAVAILABLE, TEXT, "the page ends\n"),
    }
}

fn too_many_pages() -> Response {
    let problem = format!("too many open pages: expected at most {READERS_MAX} browsers; close one\n");
    reply(StatusCode::SERVICE_UNAVAILABLE, TEXT, problem)
}

async fn order(State(Shared { page, .. }): State<Shared>, headers: HeaderMap, body: Bytes) -> Response {
    let media = headers.get(CONTENT_TYPE).and_then(|media| media.to_str().ok());
    // A form of another origin cannot send JSON without a preflight request.
    if !media.is_some_and(|media| media.starts_with(JSON)) {
        return reply(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            TEXT,
            format!("invalid Content-Type: expected an order as {JSON}\n"),
        );
    }
    let order: Order = match serde_json::from_slice(&body) {
        Ok(order) => order,
        Err(error) => return reply(StatusCode::UNPROCESSABLE_ENTITY, TEXT, format!("invalid order: {error}\n")),
    };
    // Sending blocks while it waits for a subscriber.
    match http::unblock(move || page.operator.send(&order, &page.view)).await {
        Ok(Ok(id)) => reply(StatusCode::ACCEPTED, JSON, format!("{{\"id\":{id}}}")),
        Ok(Err(error @ (UiError::NoReceiver(_) | UiError::StopUnconfirmed { .. }))) => {
            reply(StatusCode::SERVICE_UNAVAILABLE, TEXT, error.to_string())
        }
        Ok(Err(error)) => reply(StatusCode::UNPROCESSABLE_ENTITY, TEXT, error.to_string()),
        Err(error) => reply(StatusCode::INTERNAL_SERVER_ERROR, TEXT, error.to_string()),
    }
}

async fn file(method: Method, uri: Uri) -> Response {
    if method != Method::GET && method != Method::HEAD {
        return other_method().await;
    }
    match assets::find(uri.path()) {
        Some(asset) => reply(StatusCode::OK, asset.media, asset.text),
        None => reply(StatusCode::NOT_FOUND, TEXT, "no such file: expected a file of the page; open /\n"),
    }
}

async fn other_method() -> Response {
    reply(StatusCode::METHOD_NOT_ALLOWED, TEXT, "invalid method: expected GET for the page, or POST for /order\n")
}

fn reply(status: StatusCode, media: &'static str, body: impl Into<Body>) -> Response {
    (status, [(CONTENT_TYPE, media)], body.into()).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_with_a_port_is_refused_with_the_flag_for_the_port() {
        for address in ["::1", "[::1]", "127.0.0.1"] {
            assert_eq!(ip_address(address).map(|address| address.is_loopback()), Ok(true), "{address}");
        }
        let refused = ip_address("127.0.0.1:7480").expect_err("a port is no part of it");
        assert!(refused.ends_with("--ui-port has the port"), "{refused}");
    }
}
