//! The emergency stop in a store that outlives the process, and what an unknown state means.
//!
//! Each array has one record. A missing, unreadable or damaged record means that the last state is
//! unknown; the array then starts stopped. If a state cannot be written, the record is emptied, which
//! has the same meaning. The store itself is the caller's: see [`StopStore`].

use heliostat_proto::array_keys::array_name;
use heliostat_proto::{Nanos, Room};
use thiserror::Error;

use crate::latch::{Latch, LatchedStop};

/// Longest record in bytes: two texts at their limit for each stop, each character escaped.
pub const RECORD_MAX: u64 = 1024 * 1024;

/// Where the text of a record is kept, such as a file.
pub trait StopStore {
    /// Its name in messages, such as the path of the file.
    fn name(&self) -> String;

    /// The record; `None` if there is none.
    ///
    /// # Errors
    /// The problem, if a record cannot be read, or is longer than [`RECORD_MAX`].
    fn read(&mut self) -> Result<Option<String>, String>;

    /// Replaces the record at once, and returns when the new one is permanent.
    ///
    /// # Errors
    /// The problem; the old record may remain.
    fn replace(&mut self, text: &str) -> Result<(), String>;

    /// Empties the record, which needs no space.
    ///
    /// # Errors
    /// The problem; the old record may remain.
    fn empty(&mut self) -> Result<(), String>;
}

/// A state that could not be written.
#[derive(Debug, Error)]
#[error("cannot record the emergency stop in {name}: {problem}; {consequence}")]
pub struct RecordError {
    name: String,
    problem: String,
    consequence: &'static str,
}

/// The record of one array.
#[derive(Debug)]
pub struct StopRecord<S> {
    store: Option<S>,
    /// The state that was written last, or for which this was tried.
    tried: Latch,
    /// Why the present state is not in the store.
    problem: Option<String>,
}

impl<S: StopStore> StopRecord<S> {
    /// Opens the record; returns the latch with which the array starts.
    /// `start_armed` declares a start without a record safe.
    ///
    /// An array whose state cannot be recorded starts stopped too: otherwise a later stop would be
    /// lost at the next start.
    pub fn open(mut store: S, start_armed: bool, now_ns: Nanos) -> (Self, Latch) {
        let stopped = |reason: String| Latch::stopped(LatchedStop::without_sender(&reason, now_ns));
        let name = store.name();
        let mut latch = match store.read() {
            Ok(Some(text)) => match Latch::parse(&text) {
                Ok(latch) => latch,
                Err(error) => stopped(format!("the last state is unknown: {name}: {error}")),
            },
            Ok(None) if start_armed => Latch::default(),
            Ok(None) => stopped(format!("the last state is unknown: there is no {name}")),
            Err(problem) => stopped(format!("the last state is unknown: cannot read {name}: {problem}")),
        };
        latch = latch.restored(now_ns);
        let mut record = Self { store: Some(store), tried: latch.clone(), problem: None };
        if let Err(error) = record.write(&latch)
            && latch.stop().is_none()
        {
            latch = stopped(error.to_string());
        }
        (record, latch)
    }

    /// A record that keeps nothing; each start is stopped, for this reason.
    pub fn without_store(reason: &str, now_ns: Nanos) -> (Self, Latch) {
        let stop = LatchedStop::without_sender(&format!("the last state is unknown: {reason}"), now_ns);
        let latch = Latch::stopped(stop);
        (Self { store: None, tried: latch.clone(), problem: None }, latch)
    }

    /// Writes the state if it differs from the one written last; `again` repeats a write that
    /// failed, and writes a stop again whose record was lost or changed meanwhile.
    ///
    /// # Errors
    /// [`RecordError`]: the present state is not in the store.
    pub fn keep(&mut self, latch: &Latch, again: bool) -> Result<(), RecordError> {
        let is_due = *latch != self.tried || (again && (self.problem.is_some() || self.is_lost(latch)));
        if is_due { self.write(latch) } else { Ok(()) }
    }

    /// Whether the store no longer has the stops. A lost record without a stop needs no care: it makes
    /// the next start a stopped one, or the first.
    fn is_lost(&mut self, latch: &Latch) -> bool {
        let Some(store) = self.store.as_mut().filter(|_| latch.stop().is_some()) else { return false };
        store.read().ok().flatten().is_none_or(|text| text != latch.to_toml())
    }

    /// Why the present state is not in the store.
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }

    fn write(&mut self, latch: &Latch) -> Result<(), RecordError> {
        self.tried = latch.clone();
        self.problem = None;
        let Some(store) = &mut self.store else { return Ok(()) };
        let Err(problem) = store.replace(&latch.to_toml()) else { return Ok(()) };
        let consequence = match store.empty() {
            Ok(()) => "the next start is stopped; free the disk, or make the folder writable",
            Err(_) => "the next start may not know of this state: repair the disk before a restart",
        };
        let error = RecordError { name: store.name(), problem, consequence };
        self.problem = Some(error.to_string());
        Err(error)
    }
}

/// Name of the file that keeps the stop of an array.
pub fn file_name(room: &Room, array: usize) -> String {
    // The name of a room contains no full stop.
    let of_array = if array == 0 { String::new() } else { format!(".{}", array_name(array)) };
    format!("{room}{of_array}.stop.toml")
}

/// Why an array starts stopped, and how it is released; `None` if it does not.
pub fn advice(room: &Room, latch: &Latch) -> Option<String> {
    let all = latch.stops().iter().map(|stop| advice_of(room, stop));
    all.reduce(|all, one| format!("{all}\n{one}"))
}

fn advice_of(room: &Room, stop: &LatchedStop) -> String {
    // Escaped: both texts can come from any process of the room.
    let [operator, reason] = [&stop.operator, &stop.reason].map(|text| text.escape_debug().to_string());
    let by = if operator.is_empty() { operator } else { format!(" by {operator}") };
    format!(
        "the array starts stopped{by}: {reason}. When its mirrors may move, re-arm it: \
         heliostat rearm --room {room}, with an endpoint of this driver"
    )
}
