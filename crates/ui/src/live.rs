//! Live data for open pages, as server-sent events.
//!
//! Each event `figures` has the id of the page that [`crate::server`] serves. If it changes, another
//! server or another room is behind the address, and an open page loads itself again.
//!
//! One thread computes each event once, for all pages, and only while a page is open. A page that
//! reads slowly skips to the newest event; the server drops one that does not read at all.

use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use axum::body::Bytes;
use heliostat_service::Stop;
use serde::Serialize;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

use crate::figures::Figures;
use crate::order_log::OrderFigures;
use crate::page::Page;
use crate::scene::FrameBuilder;
use crate::stop_state::StopFigures;

/// Time between two `figures` events.
const FIGURES_EVERY: Duration = Duration::from_millis(100);
/// Time between two `frame` events of a small array.
const FRAME_EVERY: Duration = Duration::from_millis(100);
/// Minimum time between two frames, for each mirror. A mirror takes up to 100 bytes of JSON, so
/// this limits the data rate to 1 MB/s for each page.
const FRAME_TIME_PER_MIRROR: Duration = Duration::from_micros(100);
/// Maximum number of open pages.
pub(crate) const READERS_MAX: usize = 16;

/// The newest events.
#[derive(Clone, Debug, Default)]
struct Events {
    figures: Bytes,
    frame: Bytes,
    /// Increases with each frame; 0 before the first.
    frame_number: u64,
}

/// The content of an event `figures`.
#[derive(Serialize)]
struct LiveFigures<'a> {
    #[serde(flatten)]
    figures: Figures,
    page: &'a str,
    /// Newest first.
    orders: Vec<OrderFigures>,
    stop: StopFigures,
}

/// Computes the events for all open pages until the server stops.
#[derive(Debug)]
pub(crate) struct Feed {
    newest: watch::Sender<Events>,
    permits: Arc<Semaphore>,
    stop: Stop,
}

/// The events for one page; dropping it admits another page.
pub(crate) struct Reader {
    newest: watch::Receiver<Events>,
    frame_number: u64,
    stop: Stop,
    _permit: OwnedSemaphorePermit,
}

impl Feed {
    /// Starts the thread.
    ///
    /// # Errors
    /// The error of the operating system if it starts no thread.
    pub fn start(page: Arc<Page>, stop: Stop) -> std::io::Result<Arc<Self>> {
        let feed = Arc::new(Self {
            newest: watch::Sender::new(Events::default()),
            permits: Arc::new(Semaphore::new(READERS_MAX)),
            stop,
        });
        let thread = Arc::clone(&feed);
        thread::Builder::new().name("live".into()).spawn(move || thread.work(&page))?;
        Ok(feed)
    }

    /// A reader for one more page; `None` if too many are open.
    pub fn reader(&self) -> Option<Reader> {
        let permit = Arc::clone(&self.permits).try_acquire_owned().ok()?;
        Some(Reader { newest: self.newest.subscribe(), frame_number: 0, stop: self.stop.clone(), _permit: permit })
    }

    fn work(&self, page: &Page) {
        let view = &page.view;
        let frames = FrameBuilder::new(Arc::clone(view));
        let mut last_frame: Option<Instant> = None;
        while !self.stop.wait_for(FIGURES_EVERY) {
            // Follows the array without a reader too, so that a page that opens later sees it.
            let stop = page.operator.stop_figures();
            if self.newest.receiver_count() == 0 {
                continue;
            }
            let orders = page.operator.answers(view);
            let figures = LiveFigures { figures: view.figures(), page: &page.id(), orders, stop };
            let figures = event("figures", &figures);
            let mirrors = u32::try_from(view.shown_room().model.mirrors.len()).unwrap_or(u32::MAX);
            let frame_every = FRAME_EVERY.max(FRAME_TIME_PER_MIRROR.saturating_mul(mirrors));
            let is_due = last_frame.is_none_or(|at| at.elapsed() >= frame_every);
            let frame = is_due.then(|| {
                last_frame = Some(Instant::now());
                event("frame", &frames.frame())
            });
            self.newest.send_modify(|events| {
                events.figures = figures;
                if let Some(frame) = frame {
                    events.frame = frame;
                    events.frame_number += 1;
                }
            });
        }
    }
}

impl Reader {
    /// Waits for the next events; `None` if the server stops.
    pub async fn next(&mut self) -> Option<Bytes> {
        tokio::select! {
            () = self.stop.requested() => return None,
            changed = self.newest.changed() => changed.ok()?,
        }
        let events = self.newest.borrow_and_update();
        if events.frame_number == self.frame_number {
            return Some(events.figures.clone());
        }
        self.frame_number = events.frame_number;
        Some([&events.figures[..], &events.frame[..]].concat().into())
    }
}

fn event(name: &str, data: &impl Serialize) -> Bytes {
    // Serialization of these types cannot fail: they hold only numbers, texts and lists.
    let data = serde_json::to_string(data).unwrap_or_default();
    format!("event: {name}\ndata: {data}\n\n").into()
}
