//! A recording of bounded size: files one after the other, of which the oldest are deleted, except those
//! around a fault.

use std::collections::{BTreeMap, VecDeque};
use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use heliostat_proto::messages::fault;
use heliostat_proto::{ArrayState, MirrorTelemetry};

/// Files of a full ring.
const FILES: u64 = 8;

/// Highest number of a file that counts as one of the ring: at one file a second a ring takes 30 years to it.
const NUMBER_MAX: u32 = 999_999_999;

/// Ending of the name of a file around a fault.
const KEPT: &str = "-fault";

/// Bounds of a ring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Largest size of the ring in bytes, and of the files around faults.
    pub bytes: u64,
    /// Time before and after a fault whose files are kept.
    pub around_fault: Duration,
}

/// The files of a recording.
#[derive(Debug)]
pub struct Ring {
    /// The path without number and extension.
    base: PathBuf,
    bounds: Bounds,
    /// Closed files, oldest first.
    closed: VecDeque<Closed>,
    number: u32,
    /// Whether the file with this number is being written, and whether it is kept.
    is_open: bool,
    is_kept: bool,
    begun: Instant,
    /// Until when files are kept.
    keep_until: Option<Instant>,
}

#[derive(Debug)]
struct Closed {
    path: PathBuf,
    bytes: u64,
    ended: Option<Instant>,
    is_kept: bool,
}

impl Ring {
    /// A ring beside files of earlier runs, which count as its oldest. Empty ones are deleted. Files with a number
    /// that no ring reaches are left alone.
    ///
    /// # Errors
    /// The folder cannot be read, or an empty file not be deleted.
    pub fn open(out: &Path, bounds: Bounds, now: Instant) -> io::Result<Self> {
        let base = out.with_extension("");
        let folder = base.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let stem = base.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let mut found = BTreeMap::new();
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            let name = entry.file_name().to_string_lossy().into_owned();
            let rest = name.strip_prefix(&stem).and_then(|rest| rest.strip_prefix('-')?.strip_suffix(".mcap"));
            let Some(rest) = rest else { continue };
            let is_kept = rest.ends_with(KEPT);
            let Ok(number) = rest.strip_suffix(KEPT).unwrap_or(rest).parse::<u32>() else { continue };
            if number > NUMBER_MAX {
                continue;
            }
            let metadata = entry.metadata()?;
            // A fault right after a restart keeps the files before the restart too.
            let age = metadata.modified().ok().and_then(|at| at.elapsed().ok());
            let ended = age.and_then(|age| now.checked_sub(age));
            found.insert(number, Closed { path: entry.path(), bytes: metadata.len(), ended, is_kept });
        }
        let number = found.last_key_value().map_or(0, |(number, _)| *number);
        // A process that was killed right after it created a file has written nothing to it.
        for (_, empty) in found.extract_if(.., |_, file| file.bytes == 0) {
            fs::remove_file(empty.path)?;
        }
        let closed = found.into_values().collect();
        Ok(Self { base, bounds, closed, number, is_open: false, is_kept: false, begun: now, keep_until: None })
    }

    /// The path of the file that is being written.
    pub fn path(&self) -> PathBuf {
        let ending = if self.is_kept { KEPT } else { "" };
        let mut name = self.base.clone().into_os_string();
        name.push(format!("-{:04}{ending}.mcap", self.number));
        name.into()
    }

    /// Creates the next file; a number that a file left alone has is passed over.
    ///
    /// # Errors
    /// It cannot be created.
    pub fn create(&mut self, now: Instant) -> io::Result<File> {
        self.begun = now;
        // Less than its time after a fault.
        self.is_kept = self.keep_until.is_some_and(|until| now <= until);
        let file = loop {
            self.number += 1;
            match OpenOptions::new().write(true).create_new(true).open(self.path()) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                created => break created?,
            }
        };
        self.is_open = true;
        Ok(file)
    }

    /// Whether the file of this size is to be closed.
    pub fn is_due(&self, bytes: u64, now: Instant) -> bool {
        let is_full = bytes >= self.bounds.bytes / FILES;
        // Short files, so that little more is kept than the time around a fault.
        is_full || (bytes > 0 && now.saturating_duration_since(self.begun) >= self.bounds.around_fault)
    }

    /// Notes a fault: the files around it are kept. The present one gets another path at once, so that a later run
    /// keeps it also where this process is killed.
    pub fn note_fault(&mut self, now: Instant) {
        self.keep_until = Some(now + self.bounds.around_fault);
        let around = self.bounds.around_fault;
        for file in &mut self.closed {
            if file.ended.is_some_and(|ended| now.saturating_duration_since(ended) <= around) {
                file.keep();
            }
        }
        if self.is_open && !self.is_kept {
            self.is_kept = rename_kept(&self.path()).is_some();
        }
    }

    /// Notes that the present file is closed, and deletes the oldest ones beyond the bounds.
    ///
    /// # Errors
    /// A file cannot be deleted.
    pub fn close(&mut self, now: Instant) -> io::Result<()> {
        self.is_open = false;
        let path = self.path();
        let bytes = fs::metadata(&path).map_or(0, |found| found.len());
        self.closed.push_back(Closed { path, bytes, ended: Some(now), is_kept: self.is_kept });
        for is_kept in [false, true] {
            let bytes = |closed: &VecDeque<Closed>| {
                closed.iter().filter(|file| file.is_kept == is_kept).map(|file| file.bytes).sum::<u64>()
            };
            // The present file has a part of the ring.
            let most = if is_kept { self.bounds.bytes } else { self.bounds.bytes - self.bounds.bytes / FILES };
            while bytes(&self.closed) > most {
                let Some(oldest) = self.closed.iter().position(|file| file.is_kept == is_kept) else { break };
                let Some(file) = self.closed.remove(oldest) else { break };
                fs::remove_file(&file.path)?;
            }
        }
        Ok(())
    }

    /// The files, oldest first.
    pub fn files(&self) -> Vec<PathBuf> {
        self.closed.iter().map(|file| file.path.clone()).collect()
    }
}

impl Closed {
    /// Marks the file as kept, by its name, so that a later run keeps it too.
    fn keep(&mut self) {
        if !self.is_kept
            && let Some(path) = rename_kept(&self.path)
        {
            (self.path, self.is_kept) = (path, true);
        }
    }
}

/// Gives a file the name of one that is kept. A file that cannot be renamed stays in the ring.
fn rename_kept(path: &Path) -> Option<PathBuf> {
    let mut name = path.with_extension("").into_os_string();
    name.push(KEPT);
    name.push(".mcap");
    let kept = PathBuf::from(name);
    fs::rename(path, &kept).ok().map(|()| kept)
}

/// Finds the faults of a room in what the arrays report.
#[derive(Debug, Default)]
pub struct FaultWatch {
    /// Fault bits, and whether the array was stopped or had lost its device, by array.
    last: BTreeMap<usize, (u32, bool)>,
}

impl FaultWatch {
    /// Whether an array is stopped or has lost its device: it gets no commands, or follows none.
    pub fn has_down(&self) -> bool {
        self.last.values().any(|(_, is_down)| *is_down)
    }

    /// The fault that begins with this telemetry, in words.
    pub fn update(&mut self, array: usize, telemetry: &MirrorTelemetry) -> Option<String> {
        let is_down = matches!(telemetry.state, ArrayState::Stopped | ArrayState::Fault);
        // The bit of a stop comes with the state.
        let faults = telemetry.faults & !fault::STOP;
        let (before, was_down) = self.last.insert(array, (faults, is_down)).unwrap_or_default();
        let new = faults & !before;
        let state = telemetry.state.name();
        match (new, is_down && !was_down) {
            (0, false) => None,
            (0, true) => Some(format!("array {array} is in the state {state}")),
            _ => Some(format!("array {array} reports the fault bits {new}, in the state {state}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Bounds = Bounds { bytes: 8_000, around_fault: Duration::from_secs(10) };

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).expect("a folder");
        let mut names: Vec<String> =
            entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    /// Writes and closes so many files of a second each.
    fn write(ring: &mut Ring, from: Instant, count: u32) {
        for second in 0..count {
            let now = from + Duration::from_secs(second.into());
            ring.create(now).expect("a file").set_len(1_000).expect("a length");
            ring.close(now + Duration::from_secs(1)).expect("closed");
        }
    }

    #[test]
    fn a_file_with_a_number_that_no_ring_reaches_is_left_alone() {
        let folder = tempfile::tempdir().expect("a folder");
        let (out, start) = (folder.path().join("room.mcap"), Instant::now());
        let foreign = folder.path().join(format!("room-{}.mcap", u32::MAX));
        File::create(&foreign).expect("a file");
        let mut ring = Ring::open(&out, BOUNDS, start).expect("a ring");
        write(&mut ring, start, 2);
        assert_eq!(names(folder.path()), ["room-0001.mcap", "room-0002.mcap", "room-4294967295.mcap"]);
        fs::write(folder.path().join(format!("room-{NUMBER_MAX}.mcap")), "recorded").expect("written");
        for last in ["room-1000000001.mcap", "room-1000000003.mcap"] {
            write(&mut Ring::open(&out, BOUNDS, start).expect("a ring"), start, 2);
            assert!(names(folder.path()).contains(&last.to_owned()), "a later run passes over the files of the former");
        }
    }

    #[test]
    fn the_oldest_files_are_deleted_and_a_later_run_continues_the_ring() {
        let folder = tempfile::tempdir().expect("a folder");
        let (out, start) = (folder.path().join("room.mcap"), Instant::now());
        let mut ring = Ring::open(&out, BOUNDS, start).expect("a ring");
        write(&mut ring, start, 20);
        let names_now = names(folder.path());
        assert_eq!((names_now.len(), names_now[0].as_str()), (7, "room-0014.mcap"), "{names_now:?}");
        let mut ring = Ring::open(&out, BOUNDS, start).expect("a ring");
        write(&mut ring, start, 2);
        let names_now = names(folder.path());
        assert_eq!((names_now.len(), names_now[6].as_str()), (7, "room-0022.mcap"), "{names_now:?}");
    }

    #[test]
    fn an_empty_file_of_a_killed_run_is_deleted_and_its_number_is_not_used_again() {
        let folder = tempfile::tempdir().expect("a folder");
        let (out, start) = (folder.path().join("room.mcap"), Instant::now());
        let mut ring = Ring::open(&out, BOUNDS, start).expect("a ring");
        write(&mut ring, start, 2);
        ring.create(start).expect("a file");
        let mut ring = Ring::open(&out, BOUNDS, start).expect("a ring");
        write(&mut ring, start, 1);
        assert_eq!(names(folder.path()), ["room-0001.mcap", "room-0002.mcap", "room-0004.mcap"]);
    }

    #[test]
    fn the_files_around_a_fault_are_kept_within_the_same_bound() {
        let folder = tempfile::tempdir().expect("a folder");
        let (out, start) = (folder.path().join("room.mcap"), Instant::now());
        let bounds = Bounds { around_fault: Duration::from_millis(1500), ..BOUNDS };
        let mut ring = Ring::open(&out, bounds, start).expect("a ring");
        write(&mut ring, start, 5);
        ring.note_fault(start + Duration::from_secs(6));
        write(&mut ring, start + Duration::from_secs(6), 20);
        let kept: Vec<String> = names(folder.path()).into_iter().filter(|name| name.contains(KEPT)).collect();
        assert_eq!(kept, ["room-0005-fault.mcap", "room-0006-fault.mcap", "room-0007-fault.mcap"]);
        for fault in 0..40 {
            let at = start + Duration::from_secs(100 + 10 * fault);
            ring.note_fault(at);
            write(&mut ring, at, 1);
        }
        let kept = names(folder.path()).into_iter().filter(|name| name.contains(KEPT)).count();
        assert_eq!(kept, 8, "faults without end are bounded too");
    }

    #[test]
    fn the_file_of_a_fault_is_kept_also_if_its_run_is_killed_within_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let (out, start) = (folder.path().join("room.mcap"), Instant::now());
        let mut ring = Ring::open(&out, BOUNDS, start).expect("a ring");
        ring.create(start).expect("a file").set_len(1_000).expect("a length");
        ring.note_fault(start);
        assert_eq!(ring.path(), folder.path().join("room-0001-fault.mcap"));
        assert_eq!(names(folder.path()), ["room-0001-fault.mcap"]);
        let mut ring = Ring::open(&out, BOUNDS, start).expect("a ring");
        write(&mut ring, start, 20);
        assert!(names(folder.path()).contains(&"room-0001-fault.mcap".to_owned()), "a later run has deleted it");
    }

    #[test]
    fn a_fault_right_after_a_restart_keeps_the_file_before_the_restart() {
        let folder = tempfile::tempdir().expect("a folder");
        let (out, start) = (folder.path().join("room.mcap"), Instant::now());
        let mut ring = Ring::open(&out, BOUNDS, start).expect("a ring");
        write(&mut ring, start, 1);
        // Longer than any delay between the two runs.
        let bounds = Bounds { around_fault: Duration::from_secs(3600), ..BOUNDS };
        let later = Instant::now();
        let mut ring = Ring::open(&out, bounds, later).expect("a ring");
        ring.create(later).expect("a file");
        ring.note_fault(later);
        assert_eq!(names(folder.path()), ["room-0001-fault.mcap", "room-0002-fault.mcap"]);
    }

    #[test]
    fn a_fault_is_a_new_bit_or_a_new_state() {
        let mut watch = FaultWatch::default();
        let telemetry = |state, faults| MirrorTelemetry { state, faults, ..MirrorTelemetry::default() };
        assert_eq!(watch.update(0, &telemetry(ArrayState::Following, 0)), None);
        assert!(watch.update(0, &telemetry(ArrayState::Fault, fault::LINK)).is_some());
        assert_eq!(watch.update(0, &telemetry(ArrayState::Fault, fault::LINK)), None);
        assert!(watch.has_down());
        assert_eq!(watch.update(0, &telemetry(ArrayState::Following, 0)), None);
        assert!(!watch.has_down());
        assert!(watch.update(0, &telemetry(ArrayState::Stopped, fault::STOP)).is_some());
        assert!(watch.update(1, &telemetry(ArrayState::Following, fault::MIRROR)).is_some());
    }
}
