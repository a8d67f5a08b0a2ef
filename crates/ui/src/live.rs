//! Live data for open pages, as server-sent events.
//!
//! Each event `figures` has the id of the page that [`crate::server`] serves. If it changes, another
//! server or another room is behind the address, and an open page loads itself again.
//!
//! One thread computes each event once, for all pages, and only while a page is open. A page that
//! reads slowly skips to the newest event; the server drops one that does not read at all.

use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::{Duration, Instant};

use axum::body::Bytes;
use heliostat_service::Stop;
use serde::Serialize;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

use crate::event_log::EventLog;
use crate::figures::Figures;
use crate::order_log::OrderFigures;
use crate::page::Page;
use crate::scene::FrameBuilder;
use crate::stop_state::{StopFigures, StopPhase};

/// Time between two `figures` events.
const FIGURES_EVERY: Duration = Duration::from_millis(100);
/// Without a reader, the log of events and the history of sum rates are updated once in so many rounds.
const UNREAD_ROUNDS: u32 = 10;
/// Time between two `frame` events of a small array.
const FRAME_EVERY: Duration = Duration::from_millis(100);
/// Minimum time between two frames, for each mirror. A mirror takes up to 100 bytes of JSON, so
/// this limits the data rate to 1 MB/s for each page.
const FRAME_TIME_PER_MIRROR: Duration = Duration::from_micros(100);
/// Maximum number of open pages.
pub(crate) const READERS_MAX: usize = 16;

/// The newest events, as JSON.
#[derive(Clone, Debug, Default)]
struct Events {
    figures: String,
    frame: String,
    /// Increases with each frame; 0 before the first.
    frame_number: u64,
    /// The log of events.
    log: String,
    /// Increases with each of its changes.
    log_number: u64,
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
    /// Why the server ends, in a sentence.
    ended: Arc<OnceLock<String>>,
}

/// The events for one page; dropping it admits another page.
pub(crate) struct Reader {
    newest: watch::Receiver<Events>,
    frame_number: u64,
    log_number: u64,
    stop: Stop,
    /// `None` after the last event.
    ended: Option<Arc<OnceLock<String>>>,
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
            ended: Arc::default(),
        });
        let thread = Arc::clone(&feed);
        thread::Builder::new().name("live".into()).spawn(move || thread.work(&page))?;
        Ok(feed)
    }

    /// A reader for one more page; `None` if too many are open.
    pub fn reader(&self) -> Option<Reader> {
        let permit = Arc::clone(&self.permits).try_acquire_owned().ok()?;
        Some(Reader {
            newest: self.newest.subscribe(),
            frame_number: 0,
            log_number: 0,
            stop: self.stop.clone(),
            ended: Some(Arc::clone(&self.ended)),
            _permit: permit,
        })
    }

    /// Gives this sentence to the readers as their last event, once the server stops.
    pub fn end(&self, sentence: &str) {
        self.ended.get_or_init(|| sentence.to_owned());
    }

    fn work(&self, page: &Page) {
        let view = &page.view;
        let frames = FrameBuilder::new(Arc::clone(view));
        let mut last_frame: Option<Instant> = None;
        let mut log = EventLog::default();
        let mut round = 0_u32;
        while !self.stop.wait_for(FIGURES_EVERY) {
            // Follows the array without a reader too, so that a page that opens later sees it.
            let stop = page.operator.stop_figures();
            let has_readers = self.newest.receiver_count() > 0;
            round = round.wrapping_add(1);
            // Without a reader the log of events goes on, at a low rate.
            if !has_readers && !round.is_multiple_of(UNREAD_ROUNDS) {
                continue;
            }
            let (figures, orders) = (view.figures(), page.operator.answers(view));
            let changed = log.note(&figures, &page.operator.kept(), &stop).then(|| log.json());
            if let Some(log) = changed {
                self.newest.send_if_modified(|events| {
                    (events.log, events.log_number) = (log, events.log_number + 1);
                    // The figures below wake the readers.
                    false
                });
            }
            if !has_readers {
                continue;
            }
            let figures = if stop.phase == StopPhase::Released { figures.after_release() } else { figures };
            let figures = json(&LiveFigures { figures, page: &page.id(), orders, stop });
            let mirrors = u32::try_from(view.shown_room().model.mirrors.len()).unwrap_or(u32::MAX);
            let frame_every = FRAME_EVERY.max(FRAME_TIME_PER_MIRROR.saturating_mul(mirrors));
            let is_due = last_frame.is_none_or(|at| at.elapsed() >= frame_every);
            let frame = is_due.then(|| {
                last_frame = Some(Instant::now());
                json(&frames.frame())
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
    /// Waits for the next events, as server-sent events; `None` after the last one of a server that stops.
    pub async fn next(&mut self) -> Option<Bytes> {
        let Some(events) = self.changed().await else {
            return self.last().map(|sentence| format!("event: ended\ndata: {sentence}\n\n").into());
        };
        let mut text = format!("event: figures\ndata: {}\n\n", events.figures);
        if std::mem::replace(&mut self.log_number, events.log_number) != events.log_number {
            text += &format!("event: log\ndata: {}\n\n", events.log);
        }
        if std::mem::replace(&mut self.frame_number, events.frame_number) != events.frame_number {
            text += &format!("event: frame\ndata: {}\n\n", events.frame);
        }
        Some(text.into())
    }

    /// Waits for the next events, as one JSON object; `None` if the server stops without a reason.
    pub async fn once(mut self) -> Option<String> {
        let Some(Events { figures, frame, log, .. }) = self.changed().await else {
            return self.last().map(|sentence| format!("{{\"ended\":{sentence}}}"));
        };
        let parts = [("figures", figures), ("frame", frame), ("log", log)];
        let parts = parts.into_iter().filter(|(_, json)| !json.is_empty());
        let parts: Vec<String> = parts.map(|(name, json)| format!("\"{name}\":{json}")).collect();
        Some(format!("{{{}}}", parts.join(",")))
    }

    /// Why the server stops, as JSON; once.
    fn last(&mut self) -> Option<String> {
        let ended = self.ended.take()?;
        ended.get().map(json)
    }

    async fn changed(&mut self) -> Option<Events> {
        tokio::select! {
            // The thread may publish once more after the stop: no figures follow the last event.
            biased;
            () = self.stop.requested() => return None,
            changed = self.newest.changed() => changed.ok()?,
        }
        Some(self.newest.borrow_and_update().clone())
    }
}

fn json(data: &impl Serialize) -> String {
    // Serialization of these types cannot fail: they hold only numbers, texts and lists.
    serde_json::to_string(data).unwrap_or_default()
}
