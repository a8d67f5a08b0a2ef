//! The emergency stop on disk, so that a stop outlives the process that obeyed it.
//!
//! Each array has one file, written to a new file and renamed, so that it is complete at any time. One process
//! uses it.
//! `heliostat_array::stop_record` has the rules; this file has the disk.

use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use heliostat_array::latch::{Latch, LatchedStop};
use heliostat_array::stop_record::{self, RECORD_MAX, StopStore};
use heliostat_proto::{Capabilities, Nanos, Room, StopName};
use heliostat_service::log_limit::EventLimit;
use heliostat_service::whole_file::{self, Held, InUse};
use thiserror::Error;

/// The record of one array in a file.
pub type StopRecord = stop_record::StopRecord<StopFile>;

/// Another process uses the record of the array.
#[derive(Debug, Error)]
#[error(
    "another process uses the record of the emergency stop in {}: stop that process, or choose another folder with \
     --state DIR", path.display()
)]
pub struct RecordInUse {
    path: PathBuf,
}

/// Where the stop is kept.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StopRecordSettings {
    /// The folder of the files; without one every start is stopped.
    pub directory: Option<PathBuf>,
    /// Whether an array without a file starts parked: its first start is declared safe.
    pub start_armed: bool,
}

impl StopRecordSettings {
    /// The folder of a driver: the one given, else that of [`stop_record::default_folder`].
    pub fn of_driver(given: Option<PathBuf>, start_armed: bool, variable: impl Fn(&str) -> Option<String>) -> Self {
        Self { directory: given.or_else(|| stop_record::default_folder(variable)), start_armed }
    }

    /// Opens the record of the array of a room with this index and device; returns the latch with which
    /// the array starts.
    ///
    /// # Errors
    /// [`RecordInUse`]: two processes would lose each other's stops.
    pub fn open(
        &self,
        room: &Room,
        array: usize,
        capabilities: &Capabilities,
        now_ns: Nanos,
    ) -> Result<(StopRecord, Latch), RecordInUse> {
        let Some(directory) = &self.directory else {
            return Ok(StopRecord::without_store("no folder for it is given (--state DIR)", now_ns));
        };
        let device = stop_record::device_of(capabilities);
        let file = StopFile::hold(directory, &stop_record::file_name(room, array), device)?;
        Ok(StopRecord::open(file, self.start_armed, now_ns))
    }
}

/// The file of one array.
#[derive(Debug)]
pub struct StopFile {
    path: PathBuf,
    /// The device whose stops it keeps.
    device: String,
    /// Absent where the folder takes no lock.
    held: Option<Held>,
}

impl StopFile {
    /// Keeps the file from other processes. The first write waits for no reader of a pipe.
    fn hold(directory: &Path, name: &str, device: String) -> Result<Self, RecordInUse> {
        let path = directory.join(name);
        let held = fs::create_dir_all(directory).map_err(anyhow::Error::from).and_then(|()| whole_file::hold(&path));
        let held = match held {
            Err(error) if error.is::<InUse>() => return Err(RecordInUse { path }),
            // The array then starts stopped if the record cannot be written either.
            Err(error) => {
                tracing::warn!("no lock keeps other processes from the record of the emergency stop: {error:#}");
                None
            }
            Ok(held) => Some(held),
        };
        let new = new_of(&path);
        // The new file of another process, where there are no locks, stays.
        if fs::symlink_metadata(&new).is_ok_and(|found| !found.is_file()) {
            // Of a folder the first write reports the problem.
            let _ = fs::remove_file(&new);
        }
        Ok(Self { path, device, held })
    }

    /// What keeps the file from other processes, for an owner that ends before a write that hangs.
    pub(crate) fn take_held(&mut self) -> Option<Held> {
        self.held.take()
    }
}

impl StopStore for StopFile {
    fn name(&self) -> String {
        self.path.display().to_string()
    }

    fn device(&self) -> &str {
        &self.device
    }

    fn read(&mut self) -> Result<Option<String>, String> {
        match read(&self.path) {
            Ok(text) => Ok(Some(text)),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error.to_string()),
        }
    }

    fn replace(&mut self, text: &str) -> Result<(), String> {
        replace(&self.path, text).map_err(|error| error.to_string())
    }

    fn empty(&mut self) -> Result<(), String> {
        // For reading too: a pipe of this name makes the start wait for no reader.
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(true).open(&self.path);
        file.and_then(|file| file.sync_all()).map_err(|error| error.to_string())
    }
}

/// The new file beside a record, which takes its place.
fn new_of(record: &Path) -> PathBuf {
    record.with_extension("new")
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
    let new = new_of(file);
    let mut written = File::create(&new)?;
    written.write_all(text.as_bytes())?;
    written.sync_all()?;
    fs::rename(&new, file)?;
    // Windows opens no folder as a file.
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

/// The lines of the log about the stops of an array, bounded in a flood of stops. Each kind of line has a bound of its
/// own: a flood of stops hides no release.
#[derive(Debug, Default)]
pub struct StopLog {
    ordered: EventLimit,
    executed: EventLimit,
    released: EventLimit,
}

impl StopLog {
    /// Logs the order of a new stop, or the release of the last one.
    pub fn change(&mut self, room: &str, latch: &Latch) {
        match latch.stop() {
            None => {
                let line = self.released.line(Instant::now(), "the array is released", "the array is released again");
                line.into_iter().for_each(|line| tracing::info!(room, "{line}"));
            }
            Some(stop) => {
                let line = self.ordered.line(Instant::now(), in_words(stop), "further stops are ordered");
                line.into_iter().for_each(|line| tracing::warn!(room, "{line}"));
            }
        }
    }

    /// Logs that the device has executed each stop.
    pub fn stopped(&mut self, room: &str) {
        let (line, further) =
            ("the array is stopped: its device has executed the stop", "the device has executed further stops");
        let line = self.executed.line(Instant::now(), line, further);
        line.into_iter().for_each(|line| tracing::warn!(room, "{line}"));
    }
}

/// The order of a stop with its sender, its operator and its reason, as far as it has them.
fn in_words(stop: &LatchedStop) -> String {
    let LatchedStop { operator, reason, .. } = stop;
    let name = stop.name();
    match (name == StopName::default(), operator.is_empty()) {
        (true, _) => format!("stop without sender: {reason:?}"),
        (false, true) => format!("stop ordered by {name}: {reason:?}"),
        (false, false) => format!("stop ordered by {name}, operator {operator:?}: {reason:?}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_names_no_sender_and_no_operator_that_it_does_not_have() {
        let stop = |source, operator: &str| {
            let (operator, reason) = (operator.to_owned(), "ladder".to_owned());
            in_words(&LatchedStop { source, sequence: source, operator, reason, ..LatchedStop::default() })
        };
        assert_eq!(stop(0, ""), "stop without sender: \"ladder\"");
        assert_eq!(stop(7, ""), "stop ordered by 0000000000000007/7: \"ladder\"");
        assert_eq!(stop(7, "ann"), "stop ordered by 0000000000000007/7, operator \"ann\": \"ladder\"");
    }
}
