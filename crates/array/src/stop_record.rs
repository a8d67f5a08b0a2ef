//! The emergency stop in a store that outlives the process, and what an unknown state means.
//!
//! Each array has one record. A missing, unreadable or damaged record means that the last state is
//! unknown; the array then starts stopped. The release of another device means the same. If a state
//! cannot be written, the record is emptied, with the same meaning. The store itself is the caller's:
//! see [`StopStore`].
//!
//! A store can block, such as a disk. A thread that obeys stops therefore writes nothing: it takes a
//! [`RecordTask`] from a [`RecordPlan`] and passes it to another thread. Reports that name a stop wait for
//! its record, but not for ever.

use std::path::{Path, PathBuf};

use heliostat_proto::array_keys::array_name;
use heliostat_proto::{Capabilities, Nanos, Room, StopReport, cut};
use thiserror::Error;

use crate::latch::{Latch, LatchedStop};

/// Longest record in bytes: two texts at their limit for each stop, each character escaped.
pub const RECORD_MAX: u64 = 1024 * 1024;

/// Longest time that reports wait for the record of the state they name, in ns.
const REPORT_WAIT_NS: u64 = 250_000_000;

/// Longest time that the end of a driver waits for the record of a stop, in ns.
pub const END_WAIT_NS: u64 = 5_000_000_000;

/// The folder of the records of a driver that is given none, by environment variables: `$STATE_DIRECTORY`,
/// which systemd sets, else `heliostat` in `$XDG_STATE_HOME` or in `~/.local/state`; `None` without these.
pub fn default_folder(variable: impl Fn(&str) -> Option<String>) -> Option<PathBuf> {
    let set = |name: &str| variable(name).filter(|value| !value.is_empty());
    // systemd separates several folders by colons.
    let of_unit = set("STATE_DIRECTORY").and_then(|list| list.split(':').next().map(PathBuf::from));
    of_unit.or_else(|| {
        let folder = set("XDG_STATE_HOME").map(PathBuf::from);
        folder.or_else(|| Some(Path::new(&set("HOME")?).join(".local/state"))).map(|state| state.join("heliostat"))
    })
}

/// The problem of a record whose store has not answered for so long, while a stop is in force.
const STOP_LATE: &str = "the emergency stop is not recorded yet: its disk does not answer; do not restart the driver";

/// The same while none is.
const RELEASE_LATE: &str =
    "the release is not recorded yet: its disk does not answer; the next start of the driver may be stopped";

/// The problem of a record whose store answers, and of which each state is old when it is written.
const STOP_BEHIND: &str = "the emergency stop is not recorded yet: stops arrive faster than the disk records them; end \
                           the process that sends them, and do not restart the driver";

/// The same while no stop is in force.
const RELEASE_BEHIND: &str = "the release is not recorded yet: stops and releases arrive faster than the disk records \
                              them; end the process that sends them";

/// The line of a log after a write that ends a failure.
const RECORDED: &str = "the emergency stop is recorded again: the next start of the driver has its present state";

/// The last line of a driver that ends while messages still arrive, of which none is known to be missing in the record.
pub const END_UNSETTLED: &str = "stops arrived until the end of the driver: the last ones may not be recorded";

/// Where the text of a record is kept, such as a file.
pub trait StopStore {
    /// Its name in messages, such as the path of the file.
    fn name(&self) -> String;

    /// The device whose stops it keeps, as [`device_of`] names it; empty if that is unknown.
    fn device(&self) -> &str {
        ""
    }

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

/// A write or a check of the record, for a thread that may wait for the store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordTask {
    latch: Latch,
    /// Written even if the store has it: the state is new, or its last write failed.
    is_due: bool,
    /// Whether the last write failed.
    follows_failure: bool,
}

impl RecordTask {
    /// Writes the state, or checks that the store still has its stops and writes them again if not; the
    /// result is for [`RecordPlan::finish`].
    pub fn run<S: StopStore>(&self, store: &mut S) -> Result<(), RecordError> {
        if self.is_due || self.is_lost(store) { write(store, &self.latch) } else { Ok(()) }
    }

    /// The line of a log about its result: why the state is not in the store, or that it is there after a failure.
    pub fn line(&self, result: &Result<(), RecordError>) -> Option<String> {
        match result {
            Err(error) => Some(error.to_string()),
            Ok(()) => self.follows_failure.then(|| RECORDED.to_owned()),
        }
    }

    /// Whether the store no longer has the stops. A lost record without a stop needs no care: it makes
    /// the next start a stopped one, or the first.
    fn is_lost<S: StopStore>(&self, store: &mut S) -> bool {
        if self.latch.stop().is_none() {
            return false;
        }
        let found = store.read().ok().flatten();
        found.is_none_or(|text| text != self.latch.to_toml_of(store.device()))
    }
}

/// Which write of a record is due, and what became of the last one; without the store, which may
/// block.
#[derive(Clone, Debug)]
pub struct RecordPlan {
    /// The state that was written last, or for which this was tried.
    tried: Latch,
    /// Why the present state is not in the store.
    problem: Option<String>,
    /// The task that was handed out and is not finished, and when this was, in local time.
    running: Option<(RecordTask, u64)>,
    /// Since when the present state, or one before it, is not in the store, in local time.
    unrecorded_ns: Option<u64>,
    has_store: bool,
}

impl RecordPlan {
    /// The next write or check of the record, if one is due and none is under way. `again` repeats a write
    /// that failed, and checks the store.
    pub fn poll(&mut self, latch: &Latch, again: bool, local_ns: u64) -> Option<RecordTask> {
        if !self.has_store {
            return None;
        }
        // Also under a flood of stops, each of which is new when the one before it is written.
        self.unrecorded_ns = (*latch != self.tried).then(|| self.unrecorded_ns.unwrap_or(local_ns));
        let is_due = *latch != self.tried || (again && self.problem.is_some());
        let is_check = again && latch.stop().is_some();
        if self.running.is_some() || !(is_due || is_check) {
            return None;
        }
        let task = RecordTask { latch: latch.clone(), is_due, follows_failure: self.problem.is_some() };
        self.running = Some((task.clone(), local_ns));
        Some(task)
    }

    /// The task that was handed out has ended; returns [its line](RecordTask::line) of a log.
    pub fn finish(&mut self, result: &Result<(), RecordError>) -> Option<String> {
        let (task, _) = self.running.take()?;
        let line = task.line(result);
        self.tried = task.latch;
        self.problem = result.as_ref().err().map(ToString::to_string);
        line
    }

    /// Until when a report that names this state waits for its record, in local time; `None` if it does
    /// not wait. A store that takes longer does not delay it any more.
    pub fn holds_until(&self, latch: &Latch) -> Option<u64> {
        let since_ns = self.unrecorded_ns.filter(|_| *latch != self.tried)?;
        Some(since_ns.saturating_add(REPORT_WAIT_NS))
    }

    /// Whether nothing is left to be written of this state.
    pub fn is_settled(&self, latch: &Latch) -> bool {
        !self.has_store || (*latch == self.tried && self.running.as_ref().is_none_or(|(task, _)| !task.is_due))
    }

    /// Why this state is not in the store.
    pub fn problem(&self, latch: &Latch, local_ns: u64) -> Option<&str> {
        let is_silent = self.running.as_ref().is_some_and(|(_, since_ns)| is_over(*since_ns, local_ns));
        let late = match (latch.stop().is_some(), is_silent) {
            (true, true) => STOP_LATE,
            (true, false) => STOP_BEHIND,
            (false, true) => RELEASE_LATE,
            (false, false) => RELEASE_BEHIND,
        };
        self.problem.as_deref().or(self.is_late(latch, local_ns).then_some(late))
    }

    /// Whether no stop is known to be missing in the store. A release whose write takes long leaves none out.
    pub fn is_recorded(&self, latch: &Latch, local_ns: u64) -> bool {
        self.problem.is_none() && (latch.stop().is_none() || !self.is_late(latch, local_ns))
    }

    fn is_late(&self, latch: &Latch, local_ns: u64) -> bool {
        // A check that takes long leaves the state where it was written.
        let running_ns = self.running.as_ref().filter(|(task, _)| task.is_due).map(|(_, since_ns)| *since_ns);
        let since_ns = self.unrecorded_ns.filter(|_| *latch != self.tried).or(running_ns);
        since_ns.is_some_and(|since_ns| is_over(since_ns, local_ns))
    }
}

/// Whether reports have waited for a record since this time for as long as they wait.
fn is_over(since_ns: u64, local_ns: u64) -> bool {
    local_ns >= since_ns.saturating_add(REPORT_WAIT_NS)
}

/// The record of one array with its store.
#[derive(Debug)]
pub struct StopRecord<S> {
    plan: RecordPlan,
    store: Option<S>,
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
            Ok(Some(text)) => match Latch::parse_of(&text) {
                // The release was of other mirrors. The stops of any device stay in force.
                Ok((latch, Some(of))) if latch.stop().is_none() && of != store.device() => {
                    stopped(format!("the last state is unknown: {name} is of {of}, not of {}", store.device()))
                }
                Ok((latch, _)) => latch,
                Err(error) => stopped(format!("the last state is unknown: {name}: {error}")),
            },
            Ok(None) if start_armed => Latch::default(),
            Ok(None) => stopped(format!("the last state is unknown: there is no {name}")),
            Err(problem) => stopped(format!("the last state is unknown: cannot read {name}: {problem}")),
        };
        latch = latch.restored(now_ns);
        let written = write(&mut store, &latch);
        let problem = written.as_ref().err().map(ToString::to_string);
        let plan = RecordPlan { tried: latch.clone(), problem, running: None, unrecorded_ns: None, has_store: true };
        if let Err(error) = written
            && latch.stop().is_none()
        {
            latch = stopped(error.to_string());
        }
        (Self { plan, store: Some(store) }, latch)
    }

    /// A record that keeps nothing; each start is stopped, for this reason.
    pub fn without_store(reason: &str, now_ns: Nanos) -> (Self, Latch) {
        let stop = LatchedStop::without_sender(&format!("the last state is unknown: {reason}"), now_ns);
        let latch = Latch::stopped(stop);
        let plan =
            RecordPlan { tried: latch.clone(), problem: None, running: None, unrecorded_ns: None, has_store: false };
        (Self { plan, store: None }, latch)
    }

    /// The plan and the store, for a caller that writes on a thread of its own.
    pub fn split(self) -> (RecordPlan, Option<S>) {
        (self.plan, self.store)
    }

    /// Writes the state if it differs from the one written last; `again` repeats a write that
    /// failed, and writes a stop again whose record was lost or changed meanwhile.
    ///
    /// # Errors
    /// [`RecordError`]: the present state is not in the store.
    pub fn keep(&mut self, latch: &Latch, again: bool) -> Result<(), RecordError> {
        let Some((task, store)) = self.plan.poll(latch, again, 0).zip(self.store.as_mut()) else { return Ok(()) };
        let result = task.run(store);
        self.plan.finish(&result);
        result
    }

    /// Why the present state is not in the store.
    pub fn problem(&self) -> Option<&str> {
        self.plan.problem.as_deref()
    }
}

fn write<S: StopStore>(store: &mut S, latch: &Latch) -> Result<(), RecordError> {
    let text = latch.to_toml_of(store.device());
    let Err(problem) = store.replace(&text) else { return Ok(()) };
    let consequence = match store.empty() {
        Ok(()) => "the next start is stopped; free the disk, or make the folder writable",
        Err(_) if latch.stop().is_some() => {
            "a restart may release the array: make the file writable, or repair the disk, before"
        }
        Err(_) => "the next start may not know of this state: repair the disk before a restart",
    };
    Err(RecordError { name: store.name(), problem, consequence })
}

/// A stop report that names the problem of the record, where the device has executed the stops.
pub fn with_record_problem(mut report: StopReport, problem: Option<&str>) -> StopReport {
    if let Some(problem) = problem.filter(|_| report.device_stopped) {
        cut(problem).clone_into(&mut report.problem);
    }
    report
}

/// The name of a device in the record: its hardware and its size.
pub fn device_of(capabilities: &Capabilities) -> String {
    let Capabilities { hardware, rows, columns, .. } = capabilities;
    format!("{hardware}, {rows} x {columns} mirrors")
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
         heliostat rearm --room {room} --connect ENDPOINT, where ENDPOINT is that of this process or of one that it \
         connects to"
    )
}
