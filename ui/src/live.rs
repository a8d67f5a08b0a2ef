//! Live data for open pages, as server-sent events.
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

use crate::View;
use crate::scene::Painter;

/// Between two events with figures.
const FIGURES_EVERY: Duration = Duration::from_millis(100);
/// Between two frames of a small array.
const FRAME_EVERY: Duration = Duration::from_millis(200);
/// A frame of a large array may take this long for each mirror, so that a page is sent a megabyte a
/// second at most.
const FRAME_A_MIRROR: Duration = Duration::from_micros(100);
/// Most pages that are kept live at once.
const READERS_MAX: usize = 16;

/// The newest events.
#[derive(Clone, Debug, Default)]
struct Events {
    figures: Bytes,
    frame: Bytes,
    /// Increases with each frame; 0 before the first.
    frame_number: u64,
}

/// Computes events for the pages that are open, until the end is requested.
#[derive(Debug)]
pub(crate) struct Feed {
    newest: watch::Sender<Events>,
    places: Arc<Semaphore>,
    stop: Stop,
}

/// The events for one page; its place is free again when it is dropped.
pub(crate) struct Reader {
    newest: watch::Receiver<Events>,
    frame_number: u64,
    stop: Stop,
    _place: OwnedSemaphorePermit,
}

impl Feed {
    /// Starts the thread.
    ///
    /// # Errors
    /// No thread can be started.
    pub fn start(view: Arc<View>, stop: Stop) -> std::io::Result<Arc<Self>> {
        let feed = Arc::new(Self {
            newest: watch::Sender::new(Events::default()),
            places: Arc::new(Semaphore::new(READERS_MAX)),
            stop,
        });
        let thread = Arc::clone(&feed);
        thread::Builder::new().name("live".into()).spawn(move || thread.work(&view))?;
        Ok(feed)
    }

    /// A reader for one more page; nothing where too many are open.
    pub fn reader(&self) -> Option<Reader> {
        let place = Arc::clone(&self.places).try_acquire_owned().ok()?;
        Some(Reader { newest: self.newest.subscribe(), frame_number: 0, stop: self.stop.clone(), _place: place })
    }

    fn work(&self, view: &Arc<View>) {
        let painter = Painter::new(Arc::clone(view));
        let mirrors = u32::try_from(view.model.mirrors.len()).unwrap_or(u32::MAX);
        let frame_every = FRAME_EVERY.max(FRAME_A_MIRROR.saturating_mul(mirrors));
        let mut framed: Option<Instant> = None;
        while !self.stop.wait_for(FIGURES_EVERY) {
            if self.newest.receiver_count() == 0 {
                continue;
            }
            let figures = event("figures", &view.figures());
            let is_due = framed.is_none_or(|at| at.elapsed() >= frame_every);
            let frame = is_due.then(|| {
                framed = Some(Instant::now());
                event("frame", &painter.frame())
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
    /// The next events, once there are any; nothing when the end is requested.
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
    // Numbers, texts and lists always have a JSON form.
    let data = serde_json::to_string(data).unwrap_or_default();
    format!("event: {name}\ndata: {data}\n\n").into()
}
