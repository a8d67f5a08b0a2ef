//! The emergency stop on disk: an unknown state starts the array stopped.

use std::fs;
use std::path::{Path, PathBuf};

use heliostat_array::latch::{Latch, LatchedStop};
use heliostat_driver::stop_record::{StopRecord, StopRecordSettings};
use heliostat_proto::{Capabilities, Room};

const NOW_NS: u64 = 1_800_000_000_000_000_000;

fn settings(folder: &Path, start_armed: bool) -> StopRecordSettings {
    StopRecordSettings { directory: Some(folder.to_owned()), start_armed }
}

fn capabilities(rows: u32, columns: u32) -> Capabilities {
    Capabilities { hardware: "servo board".into(), rows, columns, ..Capabilities::default() }
}

fn open(settings: &StopRecordSettings) -> (StopRecord, Option<LatchedStop>) {
    let (record, latch) =
        settings.open(&Room::new("lab").unwrap(), 0, &capabilities(2, 2), NOW_NS).expect("no other process");
    (record, latch.stop().cloned())
}

fn stop() -> Latch {
    let operator = "ann".to_owned();
    Latch::stopped(LatchedStop {
        source: 7,
        sequence: 3,
        time_ns: 5,
        arrived_ns: 6,
        operator,
        ..LatchedStop::default()
    })
}

/// The stop at the next start, with the flag that declares a first start safe.
fn next_start(folder: &Path) -> Option<LatchedStop> {
    open(&settings(folder, true)).1
}

/// The stop at the start of another host with the same disk, where no process uses the record.
fn start_elsewhere(folder: &Path) -> Option<LatchedStop> {
    let copy = tempfile::tempdir().unwrap();
    fs::copy(folder.join("lab.stop.toml"), copy.path().join("lab.stop.toml")).unwrap();
    next_start(copy.path())
}

#[test]
fn a_record_is_of_one_process_until_it_ends() {
    let folder = tempfile::tempdir().unwrap();
    let settings = settings(folder.path(), true);
    let (mut record, _) = open(&settings);
    let refusal =
        settings.open(&Room::new("lab").unwrap(), 0, &capabilities(2, 2), NOW_NS).expect_err("in use").to_string();
    for part in ["another process uses the record", "lab.stop.toml", "stop that process", "--state DIR"] {
        assert!(refusal.contains(part), "{refusal}");
    }
    settings
        .open(&Room::new("lab").unwrap(), 1, &capabilities(2, 2), NOW_NS)
        .expect("another array has its own record");
    record.keep(&stop(), false).unwrap();
    drop(record);
    assert_eq!(next_start(folder.path()).as_ref(), stop().stop());
    // A killed process leaves its file, and no lock.
    fs::write(folder.path().join("lab.stop.toml.lock"), "").unwrap();
    assert_eq!(next_start(folder.path()).as_ref(), stop().stop());
}

#[test]
fn a_first_start_is_stopped_unless_it_is_declared_safe() {
    let (stopped, armed) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (_, start) = open(&settings(stopped.path(), false));
    let start = start.unwrap();
    assert_eq!((start.source, start.sequence), (0, 0));
    assert!(start.reason.contains("the last state is unknown") && start.reason.contains("lab.stop.toml"), "{start:?}");
    assert_eq!(next_start(stopped.path()), Some(start), "the flag does not override a recorded stop");
    assert_eq!(next_start(&armed.path().join("new/folder")), None);
    assert_eq!(open(&settings(&armed.path().join("new/folder"), false)).1, None, "the state is recorded");
    let start = open(&StopRecordSettings { directory: None, start_armed: true }).1.unwrap();
    assert!(start.reason.contains("--state DIR"), "{start:?}");
}

#[test]
fn a_stop_and_its_rearm_are_in_force_at_the_next_start() {
    let folder = tempfile::tempdir().unwrap();
    let (mut record, _) = open(&settings(folder.path(), true));
    record.keep(&stop(), false).unwrap();
    assert_eq!(start_elsewhere(folder.path()).as_ref(), stop().stop());
    record.keep(&Latch::default(), false).unwrap();
    assert_eq!(start_elsewhere(folder.path()), None);
    let (_, other) =
        settings(folder.path(), false).open(&Room::new("hall").unwrap(), 0, &capabilities(2, 2), NOW_NS).unwrap();
    assert!(other.stop().is_some(), "another room has its own record");
}

#[test]
fn another_device_starts_stopped_and_a_record_without_device_counts() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(next_start(folder.path()), None, "the release of a device with 2 x 2 mirrors is recorded");
    let start = |of: &Capabilities| {
        let opened = settings(folder.path(), true).open(&Room::new("lab").unwrap(), 0, of, NOW_NS);
        opened.expect("no other process").1.stop().cloned()
    };
    let larger = start(&capabilities(4, 6)).expect("stopped");
    let devices = "is of servo board, 2 x 2 mirrors, not of servo board, 4 x 6 mirrors";
    assert!(larger.reason.ends_with(devices), "{}", larger.reason);
    assert_eq!(start(&capabilities(4, 6)), Some(larger.clone()), "the stop is recorded");
    assert_eq!(start(&capabilities(2, 2)), Some(larger), "the stops of any device stay in force");
    fs::write(folder.path().join("lab.stop.toml"), Latch::default().to_toml()).unwrap();
    assert_eq!(start(&capabilities(4, 6)), None, "a record without a device");
    let other = Capabilities { hardware: "another board".into(), ..capabilities(4, 6) };
    assert!(start(&other).is_some(), "the record has the device now");
}

#[test]
fn a_damaged_record_starts_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let (mut record, _) = open(&settings(folder.path(), true));
    let file = folder.path().join("lab.stop.toml");
    for damage in [&b""[..], b"version = 1", b"\xff\xfe", b"version = 1\nstopped = false\n\0\0"] {
        fs::write(&file, damage).unwrap();
        let start = start_elsewhere(folder.path()).expect("stopped");
        assert!(start.reason.contains("lab.stop.toml"), "{start:?}");
    }
    record.keep(&Latch::default(), false).unwrap();
}

/// Makes it impossible to write a new file, for any user: a folder has its name.
fn block(folder: &Path) -> PathBuf {
    let new = folder.join("lab.stop.new");
    fs::create_dir(&new).unwrap();
    new
}

#[test]
fn a_stop_that_cannot_be_written_stops_the_next_start() {
    let folder = tempfile::tempdir().unwrap();
    let (mut record, start) = open(&settings(folder.path(), true));
    assert_eq!(start, None);
    let blocked = block(folder.path());
    let problem = record.keep(&stop(), false).unwrap_err().to_string();
    assert!(problem.contains("lab.stop.toml") && problem.contains("the next start is stopped"), "{problem}");
    assert_eq!(record.problem(), Some(problem.as_str()));
    record.keep(&stop(), false).expect("no second attempt until it is due");
    assert!(start_elsewhere(folder.path()).is_some());
    record.keep(&stop(), true).unwrap_err();
    fs::remove_dir(blocked).unwrap();
    record.keep(&stop(), true).unwrap();
    assert_eq!((record.problem(), start_elsewhere(folder.path()).as_ref()), (None, stop().stop()));
}

#[test]
fn an_array_whose_state_cannot_be_recorded_starts_stopped() {
    let folder = tempfile::tempdir().unwrap();
    block(folder.path());
    let start = next_start(folder.path()).expect("stopped");
    assert!(start.reason.contains("cannot record the emergency stop"), "{start:?}");
    let file = tempfile::NamedTempFile::new().unwrap();
    assert!(next_start(file.path()).is_some(), "a file is no folder");
}

/// A pipe in place of the record or of its new file has no reader: a start that waits for one fails.
#[cfg(unix)]
#[test]
fn a_pipe_at_the_place_of_the_record_or_of_its_new_file_makes_no_start_wait() {
    let start_with = |pipes: &[&str], folders: &[&str]| {
        let folder = tempfile::tempdir().unwrap();
        for name in pipes {
            let made = std::process::Command::new("mkfifo").arg(folder.path().join(name)).status().unwrap();
            assert!(made.success(), "mkfifo {name}");
        }
        folders.iter().for_each(|name| fs::create_dir(folder.path().join(name)).unwrap());
        let (sender, result) = std::sync::mpsc::channel();
        let at = folder.path().to_owned();
        std::thread::spawn(move || drop(sender.send(next_start(&at))));
        let start = result.recv_timeout(std::time::Duration::from_secs(60)).expect("no wait for a reader");
        (start, next_start(folder.path()))
    };
    assert_eq!(start_with(&["lab.stop.new"], &[]), (None, None), "the state is recorded");
    let (start, next) = start_with(&["lab.stop.toml"], &[]);
    let reason = start.as_ref().map(|stop| stop.reason.as_str()).unwrap_or_default();
    assert!(reason.contains("expected a regular file"), "{reason}");
    assert_eq!(next, start, "the stop is recorded");
    assert!(start_with(&["lab.stop.toml"], &["lab.stop.new"]).0.is_some(), "the record cannot be written");
}

#[test]
fn a_recorded_stop_of_a_clock_that_was_set_back_can_be_released_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let (mut record, _) = open(&settings(folder.path(), true));
    record.keep(&Latch::stopped(LatchedStop { time_ns: NOW_NS + 9, ..LatchedStop::default() }), false).unwrap();
    assert_eq!(start_elsewhere(folder.path()).unwrap().time_ns, NOW_NS);
}

#[test]
fn the_folder_is_that_of_the_flag_the_unit_or_the_user() {
    let of = |given: Option<&str>, variables: &[(&str, &str)]| {
        let variable =
            |name: &str| variables.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned());
        StopRecordSettings::of_driver(given.map(PathBuf::from), false, variable).directory
    };
    let all = [("STATE_DIRECTORY", "/s/a:/s/b"), ("XDG_STATE_HOME", "/x"), ("HOME", "/h")];
    assert_eq!(of(Some("here"), &all), Some("here".into()));
    assert_eq!(of(None, &all), Some("/s/a".into()));
    assert_eq!(of(None, &all[1..]), Some("/x/heliostat".into()));
    assert_eq!(of(None, &all[2..]), Some("/h/.local/state/heliostat".into()));
    assert_eq!(of(None, &[("HOME", "")]), None);
}

#[cfg(unix)]
#[test]
fn what_is_no_regular_file_of_the_size_of_a_record_is_an_unknown_state() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lab.stop.toml");
    std::os::unix::fs::symlink(folder.path().join("absent"), &file).unwrap();
    let reason = |stop: Option<LatchedStop>| stop.expect("the array starts stopped").reason;
    assert!(reason(next_start(folder.path())).contains("expected a regular file"));
    fs::remove_file(&file).unwrap();
    fs::File::create(&file).unwrap().set_len(1 << 30).unwrap();
    let reason = reason(next_start(folder.path()));
    assert!(reason.contains("at most 1048576 bytes") && reason.len() < 1024, "{reason}");
}

#[test]
fn a_stop_whose_record_is_lost_while_it_is_in_force_is_recorded_again() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state");
    let (mut record, _) = open(&settings(&state, true));
    record.keep(&stop(), false).unwrap();
    for damage in [
        |state: &Path| fs::remove_dir_all(state).unwrap(),
        |state: &Path| fs::write(state.join("lab.stop.toml"), Latch::default().to_toml()).unwrap(),
    ] {
        damage(&state);
        record.keep(&stop(), true).unwrap();
        assert_eq!(start_elsewhere(&state).as_ref(), stop().stop());
    }
}
