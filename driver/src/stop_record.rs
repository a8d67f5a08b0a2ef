//! The emergency stop on disk, so that a stop outlives the process that obeyed it.
//!
//! Each array has one file, written to a new file and renamed, so that it is complete at any time. A
//! missing, unreadable or damaged file means that the last state is unknown; the array then starts
//! stopped. If a state cannot be written, the file is emptied, which has the same meaning.

use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

use heliostat_array::latch::{Latch, LatchedStop};
use heliostat_proto::array_keys::array_name;
use heliostat_proto::{Nanos, Room};
use thiserror::Error;

/// Longest record in bytes: two texts at their limit, each character escaped.
const RECORD_MAX: u64 = 64 * 1024;

/// Where the stop is kept.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StopRecordSettings {
    /// The folder of the files; without one every start is stopped.
    pub directory: Option<PathBuf>,
    /// Whether an array without a file starts parked: its first start is declared safe.
    pub start_armed: bool,
}

/// A state that could not be written.
#[derive(Debug, Error)]
#[error("cannot record the emergency stop in {}: {problem}; {consequence}", file.display())]
pub struct RecordError {
    file: PathBuf,
    problem: io::Error,
    consequence: &'static str,
}

/// The file of one array.
#[derive(Debug)]
pub struct StopRecord {
    file: Option<PathBuf>,
    /// The state that was written last, or for which this was tried.
    tried: Latch,
    /// Why the present state is not in the file.
    problem: Option<String>,
}

impl StopRecordSettings {
    /// The folder of a driver: the one given, else `$STATE_DIRECTORY`, which systemd sets, else
    /// `heliostat` in `$XDG_STATE_HOME` or in `~/.local/state`.
    pub fn of_driver(given: Option<PathBuf>, start_armed: bool, variable: impl Fn(&str) -> Option<String>) -> Self {
        let set = |name: &str| variable(name).filter(|value| !value.is_empty());
        // systemd separates several folders by colons.
        let of_unit = || set("STATE_DIRECTORY").and_then(|list| list.split(':').next().map(PathBuf::from));
        let of_user = || {
            let folder = set("XDG_STATE_HOME").map(PathBuf::from);
            folder.or_else(|| Some(Path::new(&set("HOME")?).join(".local/state"))).map(|state| state.join("heliostat"))
        };
        Self { directory: given.or_else(of_unit).or_else(of_user), start_armed }
    }
}

impl StopRecord {
    /// Opens the record of a room with one array; returns the stop with which the array starts, if it starts
    /// stopped.
    ///
    /// An array whose state cannot be recorded starts stopped too: otherwise a later stop would be
    /// lost at the next start.
    pub fn open(settings: &StopRecordSettings, room: &Room, now_ns: Nanos) -> (Self, Option<LatchedStop>) {
        Self::open_array(settings, (room, 0), now_ns)
    }

    /// The same for the array of a room with this index; [`open`](Self::open) is for the first.
    pub fn open_array(
        settings: &StopRecordSettings,
        (room, array): (&Room, usize),
        now_ns: Nanos,
    ) -> (Self, Option<LatchedStop>) {
        let stopped = |reason: String| Latch::stopped(LatchedStop::without_sender(&reason, now_ns));
        let Some(directory) = &settings.directory else {
            let latch = stopped("the last state is unknown: no folder for it is given (--state DIR)".into());
            let stop = latch.stop().cloned();
            return (Self { file: None, tried: latch, problem: None }, stop);
        };
        // The name of a room contains no full stop.
        let of_array = if array == 0 { String::new() } else { format!(".{}", array_name(array)) };
        let file = directory.join(format!("{room}{of_array}.stop.toml"));
        let mut latch = match read(&file) {
            Ok(text) => match Latch::parse(&text) {
                Ok(latch) => latch,
                Err(error) => stopped(format!("the last state is unknown: {}: {error}", file.display())),
            },
            Err(error) if error.kind() == ErrorKind::NotFound && settings.start_armed => Latch::default(),
            Err(error) => stopped(format!("the last state is unknown: cannot read {}: {error}", file.display())),
        };
        if let Some(stop) = latch.stop() {
            latch = Latch::stopped(stop.clone().restored(now_ns));
        }
        let mut record = Self { file: Some(file), tried: latch.clone(), problem: None };
        if let Err(error) = record.write(&latch)
            && latch.stop().is_none()
        {
            latch = stopped(error.to_string());
        }
        (record, latch.stop().cloned())
    }

    /// Writes the state if it differs from the one written last; `again` repeats a write that
    /// failed.
    ///
    /// # Errors
    /// [`RecordError`]: the present state is not in the file.
    pub fn keep(&mut self, latch: &Latch, again: bool) -> Result<(), RecordError> {
        let is_due = *latch != self.tried || (again && self.problem.is_some());
        if is_due { self.write(latch) } else { Ok(()) }
    }

    /// Why the present state is not in the file.
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }

    fn write(&mut self, latch: &Latch) -> Result<(), RecordError> {
        self.tried = latch.clone();
        self.problem = None;
        let Some(file) = &self.file else { return Ok(()) };
        let Err(problem) = replace(file, &latch.to_toml()) else { return Ok(()) };
        let consequence = match empty(file) {
            Ok(()) => "the next start is stopped; free the disk, or make the folder writable",
            Err(_) => "the next start may not know of this state: repair the disk before a restart",
        };
        let error = RecordError { file: file.clone(), problem, consequence };
        self.problem = Some(error.to_string());
        Err(error)
    }
}

/// Reads a record. Only a regular file is one: the start must not wait for a pipe, nor fill the
/// memory.
fn read(file: &Path) -> io::Result<String> {
    let found = fs::symlink_metadata(file)?;
    if !found.is_file() || found.len() > RECORD_MAX {
        return Err(io::Error::other(format!("expected a regular file of at most {RECORD_MAX} bytes")));
    }
    fs::read_to_string(file)
}

/// Replaces a file at once, and waits until its new content is on the disk.
fn replace(file: &Path, text: &str) -> io::Result<()> {
    let folder = file.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder)?;
    let new = file.with_extension("new");
    let mut written = File::create(&new)?;
    written.write_all(text.as_bytes())?;
    written.sync_all()?;
    fs::rename(&new, file)?;
    File::open(folder)?.sync_all()
}

/// Empties a file, which needs no space.
fn empty(file: &Path) -> io::Result<()> {
    OpenOptions::new().write(true).create(true).truncate(true).open(file)?.sync_all()
}

/// Logs a new stop, or the release of the last one.
pub fn log_change(room: &str, latch: &Latch) {
    match latch.stop() {
        None => tracing::warn!(room, "the array is released"),
        Some(LatchedStop { source, sequence, operator, reason, .. }) => {
            tracing::warn!(room, "the array is stopped by {source:016x}/{sequence}, operator {operator:?}: {reason:?}")
        }
    }
}

/// Why an array starts stopped, and how it is released.
pub fn advice(room: &Room, stop: &LatchedStop) -> String {
    // Escaped: both texts can come from any process of the room.
    let [operator, reason] = [&stop.operator, &stop.reason].map(|text| text.escape_debug().to_string());
    let by = if operator.is_empty() { operator } else { format!(" by {operator}") };
    format!(
        "the array starts stopped{by}: {reason}. When its mirrors may move, re-arm it: \
         heliostat rearm --room {room}, with an endpoint of this driver"
    )
}
