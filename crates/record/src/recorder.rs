//! Records the messages of a room from the bus into a file.
//!
//! Callbacks copy each payload into a queue, and one thread writes. Payloads are dropped and
//! counted while the queue is full: the room never waits for its recorder.

mod queue;
mod room_writer;

use std::fmt;
use std::fs::{File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use heliostat_bus::{Bus, BusConfig, Presence as Liveliness};
use heliostat_files::write_advice;
use heliostat_proto::{NodeKind, keys::parse_alive};
use heliostat_scenario::Scenario;
use heliostat_service::clock::utc_ns;
use heliostat_service::exit::UnusableInput;
use heliostat_service::whole_file::expected_new;
use heliostat_service::{MetricsArgs, Page, Stop, source_id};
use serde::Serialize;

use crate::account::Account;
use crate::file::Presence;
use crate::ring::{Bounds, Ring};
use room_writer::{Begun, Item, RoomWriter};

/// Longest delay between a stop request and its effect.
const WAIT: Duration = Duration::from_millis(50);
/// Time between two pages of metrics.
const EXPORT_EVERY: Duration = Duration::from_secs(1);

/// Settings of a recorder.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The room's scenario; it is stored in the file.
    pub scenario: Scenario,
    /// The endpoints of the room.
    pub bus: BusConfig,
    /// The file to create.
    pub out: PathBuf,
    /// When to end without a stop request.
    pub run_for: Option<Duration>,
    /// Whether to end when every process that was seen in the room has left it.
    pub until_empty: bool,
    /// Where metrics are served.
    pub metrics: MetricsArgs,
    /// Bounds of a ring of files in place of one file.
    pub ring: Option<Bounds>,
}

/// The result of a recording.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// The file, or the last one of a ring.
    pub file: PathBuf,
    /// The files of a ring, oldest first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<PathBuf>,
    /// Counts of received and missing messages.
    #[serde(flatten)]
    pub account: Account,
    /// The streams that a replay needs and that were not received.
    #[serde(skip)]
    pub lacks: Vec<&'static str>,
    /// What restricts the use of the recording.
    pub problems: Vec<String>,
    /// The error that ended the writing, so that the file holds no counts and no index; or that
    /// nothing was received.
    pub failure: Option<String>,
}

impl fmt::Display for Outcome {
    /// The counts, and on the last line what a replay lacks.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}", self.account)?;
        if self.lacks.is_empty() {
            return Ok(());
        }
        write!(
            formatter,
            "\na replay cannot repeat the decisions of this recording: it lacks {}",
            self.lacks.join(" and ")
        )
    }
}

/// Records a room until it is stopped.
///
/// # Errors
/// A bus, a file or an address for metrics that cannot be opened. A later write error is reported in the [`Outcome`].
pub fn run(settings: &Settings, stop: &Stop) -> Result<Outcome> {
    let started = Instant::now();
    let ring = settings.ring.map(|bounds| Ring::open(&settings.out, bounds, started)).transpose();
    let mut ring = ring.map_err(|error| cannot_create(&settings.out, error))?;
    let (file, out) = match &mut ring {
        Some(ring) => (ring.create(started), ring.path()),
        None => (OpenOptions::new().write(true).create_new(true).open(&settings.out), settings.out.clone()),
    };
    let file = file.map_err(|error| cannot_create(&out, error))?;
    let begun = Begun { path: out.clone(), is_kept: false };
    let writer = RoomWriter::create(file, settings, out);
    let mut writer = writer.with_context(|| format!("cannot create {}", begun.path.display()))?;
    let exporter = settings.metrics.open(settings.bus.certificate_ends())?;
    let mut exported: Option<Instant> = None;
    let (payloads, queue) = queue::bounded();
    let bus = Bus::open(&settings.bus).context("cannot join the room")?;
    let room = bus.room().clone();
    let source = source_id::random();
    let own_token = room.alive(NodeKind::Viewer, source);
    let tokens = payloads.clone();
    let received = bus.subscribe_keyed(&room.everything(), move |key, payload| {
        payloads.put(key.len() + payload.len(), || Item::Payload {
            key: key.to_owned(),
            arrived_ns: utc_ns(),
            payload: payload.to_vec(),
        });
    })?;
    let seen = bus.watch(&room.all_alive(), move |key, liveliness| {
        let Some((node, source)) = parse_alive(key).filter(|_| key != own_token) else { return };
        let presence = Presence { node, source, alive: liveliness == Liveliness::Alive };
        tokens.put(0, || Item::Presence { arrived_ns: utc_ns(), presence });
    })?;
    let token = bus.announce(&room.alive(NodeKind::Viewer, source))?;
    begun.keep();
    tracing::info!("records room {room} into {}", writer.place.path().display());

    let deadline = settings.run_for.map(|run_for| started + run_for);
    while !writer.has_failed() && !stop.is_requested() && deadline.is_none_or(|deadline| Instant::now() < deadline) {
        if settings.until_empty && writer.is_empty_again() {
            break;
        }
        match queue.take(WAIT) {
            Ok(item) => writer.take(item),
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
        }
        writer.flush_if_due();
        if let Some(exporter) = exporter.as_ref().filter(|_| exported.is_none_or(|at| at.elapsed() >= EXPORT_EVERY)) {
            exported = Some(Instant::now());
            exporter.publish(metrics(room.name(), writer.account.messages(), queue.dropped()));
        }
        if let Some(missing) = writer.missing_once(started.elapsed()) {
            tracing::warn!("so far {missing}");
        }
        if let Some(ring) = &mut ring {
            turn(ring, &mut writer);
        }
    }
    drop((received, seen, token));
    while let Ok(item) = queue.take(Duration::ZERO) {
        writer.take(item);
    }
    let refused = bus.connection_problem();
    bus.close()?;
    let mut outcome = writer.finish(queue.dropped());
    if outcome.account.messages() == 0
        && let Some(reason) = refused
    {
        outcome.failure = Some(format!("nothing was received: {reason}"));
    }
    if let Some(mut ring) = ring {
        // The next file may not have been begun.
        if ring.path().exists()
            && let Err(error) = ring.close(Instant::now())
        {
            outcome.problems.push(format!("an old file of the ring cannot be deleted: {error}"));
        }
        outcome.files = ring.files();
        outcome.file = outcome.files.last().cloned().unwrap_or(outcome.file);
    }
    Ok(outcome)
}

/// The metrics of a recorder.
fn metrics(room: &str, messages: u64, dropped: u64) -> Page {
    let mut page = Page::new(&[("room", room)]);
    page.build_info("recorder", env!("CARGO_PKG_VERSION"));
    page.counter("heliostat_recorder_messages", "Messages that were recorded", &[], messages);
    let help = "Messages that were not recorded, because the disk was slower than the room";
    page.counter("heliostat_recorder_dropped", help, &[], dropped);
    page
}

/// The error of a file that cannot be created, with its name and what to do: the user named one that cannot be used.
fn cannot_create(out: &Path, error: io::Error) -> anyhow::Error {
    let advice = write_advice(&error, expected_new(&error));
    let named = UnusableInput::new(format!("cannot create {}: {advice}", out.display()));
    anyhow::Error::new(error).context(named)
}

/// Begins the next file of a ring if that is due, and keeps those around a fault.
fn turn(ring: &mut Ring, writer: &mut RoomWriter<File>) {
    let now = Instant::now();
    for fault in std::mem::take(&mut writer.faults) {
        tracing::warn!("{fault}: the files around it are kept");
        ring.note_fault(now);
        writer.place.rename(ring.path());
    }
    if writer.has_failed() || !ring.is_due(writer.bytes(), now) {
        return;
    }
    if let Err(error) = writer.next_file(|| {
        ring.close(now)?;
        Ok((ring.create(now)?, ring.path()))
    }) {
        writer.failure = Some(format!("the next file cannot be begun: {error}"));
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_file_that_gets_no_message_is_removed_and_a_full_disk_is_named_with_what_to_do() {
        let folder = tempfile::tempdir().expect("a folder");
        for is_kept in [false, true] {
            let path = folder.path().join("room.mcap");
            fs::write(&path, "a header").expect("a file");
            let begun = Begun { path: path.clone(), is_kept: false };
            if is_kept {
                begun.keep();
            } else {
                drop(begun);
            }
            assert_eq!(path.exists(), is_kept);
        }
        let message = |kind: io::ErrorKind| {
            let error = cannot_create(Path::new("room.mcap"), kind.into());
            assert!(error.is::<UnusableInput>(), "{error}");
            error.to_string()
        };
        assert!(message(io::ErrorKind::AlreadyExists).ends_with("room.mcap: expected a file that does not exist yet"));
        assert!(message(io::ErrorKind::NotFound).ends_with("room.mcap: expected a file in a folder that exists"));
        assert_eq!(
            message(io::ErrorKind::StorageFull),
            "cannot create room.mcap: free some space, or choose another disk"
        );
    }
}
