//! Writes a recording in complete chunks.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use heliostat_proto::{Nanos, codec::kind_of};
use mcap::records::{MessageHeader, Metadata, op};
use mcap::{MAGIC, McapError, WriteOptions, Writer};

use super::{ACCOUNT_NAME, HEADER_NAME, Header, RecordingError, Topic, WIRE_ENCODING};
use crate::account::Account;

/// A chunk is closed when it holds this many bytes, and on every flush.
const CHUNK_BYTES: u64 = 512 * 1024;

/// The medium that a recording is written to.
pub trait Storage: Write + Seek {
    /// Truncates to `length` bytes, and continues there.
    ///
    /// # Errors
    /// The error of the operating system.
    fn cut(&mut self, length: u64) -> io::Result<()>;

    /// Waits until the written bytes are on the medium: some report only then that they are full.
    ///
    /// # Errors
    /// The error of the operating system.
    fn settle(&mut self) -> io::Result<()>;
}

impl Storage for File {
    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)?;
        self.seek(SeekFrom::Start(length)).map(drop)
    }

    fn settle(&mut self) -> io::Result<()> {
        self.sync_all()
    }
}

/// A recording that is being written.
pub struct Recording<S: Storage> {
    /// `None` after writing failed.
    writer: Option<Writer<Counted<S>>>,
    length: Arc<AtomicU64>,
    channels: HashMap<String, u16>,
    sequence: u32,
    /// Length of the file up to the end of the last complete chunk.
    complete_bytes: u64,
    written: u64,
    unflushed: u64,
    unflushed_bytes: u64,
}

impl<S: Storage> Recording<S> {
    /// Starts a recording.
    ///
    /// # Errors
    /// [`RecordingError::Full`] or [`RecordingError::Write`].
    pub fn create(storage: S, header: &Header) -> Result<Self, RecordingError> {
        let options = WriteOptions::new()
            .library(concat!("heliostat ", env!("CARGO_PKG_VERSION")))
            .chunk_size(None)
            // A chunk is assembled in memory and written at once, never in part and then corrected.
            .disable_seeking(true);
        let length = Arc::new(AtomicU64::new(0));
        let counted = Counted { inner: storage, length: Arc::clone(&length) };
        let writer = options.create(counted).map_err(|error| failure(&error, 0, 0))?;
        let mut recording = Self {
            writer: Some(writer),
            length,
            channels: HashMap::new(),
            sequence: 0,
            complete_bytes: 0,
            written: 0,
            unflushed: 0,
            unflushed_bytes: 0,
        };
        let metadata = Metadata { name: HEADER_NAME.into(), metadata: header.to_map() };
        recording.with_writer(|writer| writer.write_metadata(&metadata))?;
        recording.flush()?;
        Ok(recording)
    }

    /// Appends a payload as received.
    ///
    /// # Errors
    /// As [`Recording::flush`], which this does when a chunk is full.
    pub fn payload(
        &mut self,
        key: &str,
        arrived_ns: Nanos,
        time_ns: Nanos,
        payload: &[u8],
    ) -> Result<(), RecordingError> {
        let channel = match self.channels.get(key) {
            Some(channel) => *channel,
            None => {
                let kind = kind_of(payload).map_or("unknown".to_owned(), |kind| kind.to_string().replace(' ', "-"));
                let layout = format!("{kind}: bytes as defined in CONTRACT.md of Heliostat, sections 2 and 3");
                self.open_channel(&Topic {
                    name: key,
                    encoding: WIRE_ENCODING,
                    schema: &format!("{WIRE_ENCODING}.{kind}"),
                    schema_encoding: "heliostat.contract",
                    schema_data: layout.as_bytes(),
                })?
            }
        };
        self.message(channel, arrived_ns, time_ns, payload)
    }

    /// Appends a derived message for viewers.
    ///
    /// # Errors
    /// As [`Recording::payload`].
    pub fn derived(&mut self, topic: &Topic<'_>, arrived_ns: Nanos, data: &[u8]) -> Result<(), RecordingError> {
        let channel = match self.channels.get(topic.name) {
            Some(channel) => *channel,
            None => self.open_channel(topic)?,
        };
        self.message(channel, arrived_ns, arrived_ns, data)
    }

    /// Length of the file in bytes, with what waits for the end of the chunk.
    pub fn bytes(&self) -> u64 {
        self.complete_bytes + self.unflushed_bytes
    }

    /// Closes the chunk: a later truncation of the file loses nothing written before.
    ///
    /// # Errors
    /// [`RecordingError::Full`] or [`RecordingError::Write`]; the file then ends properly after its
    /// last complete chunk, and accepts no more.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.with_writer(Writer::flush)?;
        self.complete_bytes = self.length.load(Ordering::Relaxed);
        self.written += std::mem::take(&mut self.unflushed);
        self.unflushed_bytes = 0;
        Ok(())
    }

    /// Writes the counts and the index, and closes the file.
    ///
    /// # Errors
    /// As [`Recording::flush`].
    pub fn finish(mut self, account: &Account) -> Result<(), RecordingError> {
        self.flush()?;
        let json = serde_json::to_string(account).expect("an account serialises to JSON");
        let metadata = Metadata { name: ACCOUNT_NAME.into(), metadata: [("json".to_owned(), json)].into() };
        self.with_writer(|writer| writer.write_metadata(&metadata))?;
        self.with_writer(|writer| writer.finish().map(drop))?;
        let writer = self.writer.take().expect("the writer exists until it fails");
        writer.into_inner().inner.settle().map_err(|error| failure(&McapError::Io(error), self.written, 0))
    }

    fn open_channel(&mut self, topic: &Topic<'_>) -> Result<u16, RecordingError> {
        let channel = self.with_writer(|writer| {
            let schema = writer.add_schema(topic.schema, topic.schema_encoding, topic.schema_data)?;
            writer.add_channel(schema, topic.name, topic.encoding, &BTreeMap::new())
        })?;
        self.channels.insert(topic.name.to_owned(), channel);
        Ok(channel)
    }

    fn message(
        &mut self,
        channel_id: u16,
        log_time: Nanos,
        publish_time: Nanos,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        self.sequence = self.sequence.wrapping_add(1);
        let header = MessageHeader { channel_id, sequence: self.sequence, log_time, publish_time };
        self.unflushed += 1;
        self.unflushed_bytes += data.len() as u64;
        self.with_writer(|writer| writer.write_to_known_channel(&header, data))?;
        if self.unflushed_bytes > CHUNK_BYTES { self.flush() } else { Ok(()) }
    }

    /// Applies an action to the writer; if it fails, ends the file properly.
    fn with_writer<T>(
        &mut self,
        action: impl FnOnce(&mut Writer<Counted<S>>) -> Result<T, McapError>,
    ) -> Result<T, RecordingError> {
        let Some(writer) = &mut self.writer else {
            return Err(failure(&McapError::AttemptedWriteAfterFailure, self.written, self.unflushed));
        };
        action(writer).map_err(|error| {
            if let Some(writer) = self.writer.take() {
                end_at(writer.into_inner().inner, self.complete_bytes);
            }
            failure(&error, self.written, self.unflushed)
        })
    }
}

/// Ends a file after its last complete chunk. If that fails too, the file reads like one that was
/// cut there.
fn end_at<S: Storage>(mut storage: S, complete_bytes: u64) {
    let mut ending = vec![op::DATA_END];
    ending.extend(4_u64.to_le_bytes());
    ending.extend([0; 4]);
    ending.push(op::FOOTER);
    ending.extend(20_u64.to_le_bytes());
    ending.extend([0; 20]);
    ending.extend(MAGIC);
    let ended = storage.cut(complete_bytes).and_then(|()| storage.write_all(&ending)).and_then(|()| storage.flush());
    if ended.is_err() {
        // No further attempt is possible: half an ending reads as a cut file.
        let _ = storage.cut(complete_bytes);
    }
}

fn failure(error: &McapError, written: u64, lost: u64) -> RecordingError {
    match error {
        McapError::Io(error) if is_full(error) => RecordingError::Full { written, lost },
        other => RecordingError::Write { problem: other.to_string(), written, lost },
    }
}

/// Whether the disk is full, the quota used up, or the longest allowed file reached.
fn is_full(error: &io::Error) -> bool {
    use io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
    matches!(error.kind(), StorageFull | QuotaExceeded | FileTooLarge)
}

/// Counts the bytes that reach the storage.
struct Counted<S> {
    inner: S,
    length: Arc<AtomicU64>,
}

impl<S: Write> Write for Counted<S> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.inner.write(bytes)?;
        self.length.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

impl<S: Seek> Seek for Counted<S> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.inner.seek(to)
    }
}
