//! The page on an address: its files, live data as server-sent events, and orders.
//!
//! | path | method | what |
//! | --- | --- | --- |
//! | `/` and its files | GET | the page |
//! | `/room.json` | GET | what stands still: plan, names of policies, whether processes can be killed, the past minute |
//! | `/live` | GET | events `figures` ten times a second and `frame` five times a second, JSON |
//! | `/order` | POST | an [`Order`] as JSON; 202 when it was sent to somebody who hears it, 422 with the reason when it has no sense, 503 when nobody hears it |

use std::io::{self, Read, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;
use tiny_http::{Header, Method, Request, Response};

use crate::assets::{self, JAVASCRIPT};
use crate::figures::SumFigures;
use crate::guard::{self, refusal};
use crate::latency::BUDGET_US;
use crate::orders::{Operator, Order};
use crate::scene::{Painter, Plan};
use crate::{UiError, View};

/// The port of the page unless told otherwise.
pub const DEFAULT_PORT: u16 = 7480;
/// Between two figures.
const FIGURES_EVERY: Duration = Duration::from_millis(100);
/// Between two frames of a small array.
const FRAME_EVERY: Duration = Duration::from_millis(200);
/// A frame of a large array may take this long a mirror, so that a page is sent a megabyte a second at most.
const FRAME_A_MIRROR: Duration = Duration::from_micros(100);
/// Threads that answer requests; an order may wait for the network while others are served.
const WORKERS: usize = 3;
/// Most pages that are kept live at once.
const READERS_MAX: usize = 16;
/// Longest order in bytes.
const ORDER_MAX: u64 = 4096;
const JSON: &str = "application/json";
const TEXT: &str = "text/plain; charset=utf-8";

/// The flags by which a process is told where to serve the page.
#[derive(Clone, Debug, clap::Args)]
pub struct PageArgs {
    /// Serve no page
    #[arg(long)]
    no_ui: bool,
    /// Port of the page; a taken one is replaced by a free one, and 0 is any
    #[arg(long, value_name = "PORT", default_value_t = DEFAULT_PORT)]
    ui_port: u16,
    /// Address of the page; anything but 127.0.0.1 lets others see the room and press its buttons
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    ui_listen: IpAddr,
}

/// What the page shows and does.
pub struct Page {
    /// The room.
    pub view: Arc<View>,
    /// Who carries out orders.
    pub operator: Operator,
    /// Name of the room in the keys.
    pub room: String,
    /// Names of the policies that the controller knows.
    pub policies: Vec<String>,
}

struct Shared {
    page: Page,
    painter: Painter,
    http: tiny_http::Server,
    readers: AtomicUsize,
    ended: AtomicBool,
}

/// A page that is being served; dropping it ends that.
pub struct Server {
    address: SocketAddr,
    replaced: Option<u16>,
    shared: Arc<Shared>,
}

impl PageArgs {
    /// Serves the page unless the flags forbid it.
    ///
    /// # Errors
    /// [`UiError::CannotListen`] where the address is not one of this machine, [`UiError::Threads`].
    pub fn serve(&self, page: impl FnOnce() -> Result<Page, UiError>) -> Result<Option<Server>, UiError> {
        if self.no_ui { Ok(None) } else { Server::start(page()?, self.ui_listen, self.ui_port).map(Some) }
    }
}

impl Server {
    /// Serves a page at an address, at the port or else at a free one.
    ///
    /// # Errors
    /// [`UiError::CannotListen`] where no port can be had there, [`UiError::Threads`].
    pub fn start(page: Page, address: IpAddr, port: u16) -> Result<Self, UiError> {
        let refused = |problem| UiError::CannotListen { address, problem };
        let bind = |port| TcpListener::bind((address, port));
        let listener = bind(port).or_else(|_| bind(0)).map_err(refused)?;
        let bound = listener.local_addr().map_err(refused)?;
        let http =
            tiny_http::Server::from_listener(listener, None).map_err(io::Error::other).map_err(UiError::Threads)?;
        let painter = Painter::new(Arc::clone(&page.view));
        let (readers, ended) = (AtomicUsize::new(0), AtomicBool::new(false));
        let shared = Arc::new(Shared { page, painter, http, readers, ended });
        for _ in 0..WORKERS {
            let shared = Arc::clone(&shared);
            let work = move || {
                while let Ok(request) = shared.http.recv() {
                    shared.answer(request);
                }
            };
            std::thread::Builder::new().name("page".into()).spawn(work).map_err(UiError::Threads)?;
        }
        let replaced = (port != 0 && bound.port() != port).then_some(port);
        Ok(Self { address: bound, replaced, shared })
    }

    /// What to open in a browser.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }
}

impl std::fmt::Display for Server {
    /// Where the page is, and why it is not where it was wanted.
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.replaced {
            Some(port) => write!(formatter, "the page is at {} (port {port} is taken)", self.url()),
            None => write!(formatter, "the page is at {}", self.url()),
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::Relaxed);
        (0..WORKERS).for_each(|_| self.shared.http.unblock());
    }
}

/// What the page asks for once.
#[derive(Serialize)]
struct RoomJson {
    #[serde(flatten)]
    plan: Plan,
    policies: Vec<String>,
    owns_processes: bool,
    budget_us: u64,
    history: Vec<(f64, SumFigures)>,
}

impl Shared {
    fn answer(self: &Arc<Self>, mut request: Request) {
        let reads = matches!(request.method(), Method::Get | Method::Head);
        if let Some(why) = refusal(reads, header(&request, "Host"), header(&request, "Origin")) {
            return respond(request, 403, TEXT, why);
        }
        let path = request.url().split('?').next().unwrap_or_default().to_owned();
        match (request.method(), path.as_str()) {
            (Method::Post, "/order") => {
                let (status, text) = self.order(&mut request);
                respond(request, status, TEXT, &text);
            }
            (Method::Get, "/live") => self.live(request),
            (Method::Get, "/room.json") => match serde_json::to_string(&self.room()) {
                Ok(room) => respond(request, 200, JSON, &room),
                Err(error) => respond(request, 500, TEXT, &error.to_string()),
            },
            (Method::Get, "/plotly.js") => respond(request, 200, JAVASCRIPT, assets::plotly()),
            (Method::Get, path) => match assets::find(path) {
                Some(asset) => respond(request, 200, asset.media, asset.text),
                None => respond(request, 404, TEXT, "there is no such file\n"),
            },
            _ => respond(request, 405, TEXT, "GET the page, or POST an order to /order\n"),
        }
    }

    fn room(&self) -> RoomJson {
        let page = &self.page;
        RoomJson {
            plan: page.view.plan(&page.room),
            policies: page.policies.clone(),
            owns_processes: page.operator.owns_processes(),
            budget_us: BUDGET_US,
            history: page.view.history(),
        }
    }

    /// Reads an order and sends it: status and text of the answer.
    fn order(&self, request: &mut Request) -> (u16, String) {
        // A form of another page could send no JSON without asking first.
        if !header(request, "Content-Type").is_some_and(|media| media.starts_with(JSON)) {
            return (415, format!("wanted an order as {JSON}\n"));
        }
        let order: Result<Order, _> = serde_json::from_reader(request.as_reader().take(ORDER_MAX));
        let order = match order {
            Ok(order) => order,
            Err(error) => return (422, format!("no order: {error}\n")),
        };
        match self.page.operator.send(&order) {
            Ok(()) => (202, String::new()),
            Err(error @ UiError::Unheard(_)) => (503, error.to_string()),
            Err(error) => (422, error.to_string()),
        }
    }

    /// Keeps a page live on a thread of its own, until it is closed.
    fn live(self: &Arc<Self>, request: Request) {
        if self.readers.fetch_add(1, Ordering::Relaxed) >= READERS_MAX {
            self.readers.fetch_sub(1, Ordering::Relaxed);
            return respond(request, 503, TEXT, "too many pages are open\n");
        }
        let shared = Arc::clone(self);
        let stream = move || {
            // Whoever closes the page ends this by closing the connection.
            let _ = shared.stream(&mut request.into_writer());
            shared.readers.fetch_sub(1, Ordering::Relaxed);
        };
        if std::thread::Builder::new().name("live".into()).spawn(stream).is_err() {
            self.readers.fetch_sub(1, Ordering::Relaxed);
        }
    }

    fn stream(&self, to: &mut dyn Write) -> io::Result<()> {
        let policy: String = guard::HEADERS.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
        write!(to, "HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\n")?;
        write!(to, "{policy}Connection: close\r\n\r\n")?;
        let mirrors = u32::try_from(self.page.view.model.mirrors.len()).unwrap_or(u32::MAX);
        let frame_every = FRAME_EVERY.max(FRAME_A_MIRROR.saturating_mul(mirrors));
        let mut framed: Option<Instant> = None;
        while !self.ended.load(Ordering::Relaxed) {
            event(to, "figures", &self.page.view.figures())?;
            if framed.is_none_or(|at| at.elapsed() >= frame_every) {
                framed = Some(Instant::now());
                event(to, "frame", &self.painter.frame())?;
            }
            to.flush()?;
            std::thread::sleep(FIGURES_EVERY);
        }
        Ok(())
    }
}

fn event(to: &mut dyn Write, name: &str, data: &impl Serialize) -> io::Result<()> {
    write!(to, "event: {name}\ndata: ")?;
    serde_json::to_writer(&mut *to, data)?;
    write!(to, "\n\n")
}

fn header<'a>(request: &'a Request, name: &'static str) -> Option<&'a str> {
    request.headers().iter().find(|header| header.field.equiv(name)).map(|header| header.value.as_str())
}

fn respond(request: Request, status: u16, media: &str, text: &str) {
    let fixed = [("Content-Type", media), ("Cache-Control", "no-store")];
    let headers = fixed.into_iter().chain(guard::HEADERS);
    let headers = headers.filter_map(|(name, value)| Header::from_bytes(name, value).ok());
    let response = headers.fold(Response::from_string(text).with_status_code(status), Response::with_header);
    // Whoever asked may be gone by now.
    let _ = request.respond(response);
}
