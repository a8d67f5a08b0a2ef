//! A recording as a file: written in whole chunks, readable up to the last whole chunk wherever it was cut.
//!
//! | in the file | holds |
//! | --- | --- |
//! | metadata `heliostat` | room, scenario, versions: see [`Header`] |
//! | channels `heliostat/v1/...` | payloads as they came, encoding [`WIRE_ENCODING`] |
//! | channel [`PRESENCE_TOPIC`] | who came into the room and who left it, as JSON |
//! | other channels | what is derived for viewers, see [`crate::scene`] and [`crate::series`] |
//! | metadata `heliostat.account` | what came and what is missing, as JSON; absent where the recording was cut |

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use heliostat_proto::{Nanos, NodeKind, VERSION, codec::kind_of};
use mcap::records::{MessageHeader, Metadata, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapError, WriteOptions, Writer};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::account::Account;

/// Message encoding of the channels that hold payloads as they came.
pub const WIRE_ENCODING: &str = "heliostat.v1";
/// Topic of [`Presence`].
pub const PRESENCE_TOPIC: &str = "/presence";

const HEADER_NAME: &str = "heliostat";
const ACCOUNT_NAME: &str = "heliostat.account";
/// A chunk is closed when it holds this many bytes, or when somebody flushes.
const CHUNK_BYTES: u64 = 512 * 1024;

/// Why a recording cannot be written or read.
#[derive(Debug, Error)]
pub enum RecordingError {
    /// No space is left; what was written before is whole.
    #[error(
        "no space is left for the recording: it ends after {written} messages, is whole up to there, and {lost} more are lost; make room, or record elsewhere"
    )]
    Full {
        /// Messages in whole chunks.
        written: u64,
        /// Messages that were taken and not written.
        lost: u64,
    },
    /// Writing failed otherwise.
    #[error("the recording cannot be written ({problem}): it ends after {written} messages, and {lost} more are lost")]
    Write {
        /// The account of the operating system or of the library.
        problem: String,
        /// Messages in whole chunks.
        written: u64,
        /// Messages that were taken and not written.
        lost: u64,
    },
    /// The file cannot be read, or is no MCAP file.
    #[error("the recording cannot be read: {0}")]
    Read(String),
    /// An MCAP file, but none of ours.
    #[error(
        "the file holds no recording of a room: its metadata \"heliostat\" is missing; wanted one made by `heliostat record`"
    )]
    Foreign,
    /// A recording of another version of the contract.
    #[error("the recording speaks version {found} of the contract, this program version {VERSION}")]
    Version {
        /// The version in the file.
        found: String,
    },
}

/// What is known before the first message.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Name of the room.
    pub room: String,
    /// Name of the scenario.
    pub scenario_name: String,
    /// Hash of the effective scenario.
    pub scenario_hash: String,
    /// The effective scenario as TOML.
    pub scenario: String,
    /// Version of the recording program.
    pub software: String,
    /// Version of the contract.
    pub contract: String,
    /// When the recording began, UTC in ns.
    pub started_ns: String,
}

/// Somebody came into the room, or left it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Presence {
    /// What sort of process.
    pub node: NodeKind,
    /// The id in its stamps.
    pub source: u64,
    /// Whether it is there.
    pub alive: bool,
}

/// Where a recording is put.
pub trait Storage: Write + Seek {
    /// Cuts off what stands after `length` bytes, and goes on from there.
    ///
    /// # Errors
    /// The operating system's.
    fn cut(&mut self, length: u64) -> io::Result<()>;

    /// Waits until what was written is kept: some disks tell only then that they are full.
    ///
    /// # Errors
    /// The operating system's.
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

/// A channel for what is derived.
#[derive(Clone, Copy, Debug)]
pub struct Topic<'a> {
    /// The topic.
    pub name: &'a str,
    /// How its messages are encoded: `json` or `protobuf`.
    pub encoding: &'a str,
    /// Name of the schema.
    pub schema: &'a str,
    /// Encoding of the schema: `jsonschema` or `protobuf`.
    pub schema_encoding: &'a str,
    /// The schema.
    pub schema_data: &'a [u8],
}

/// A recording that is being written.
pub struct Recording<S: Storage> {
    /// Nothing once writing failed.
    writer: Option<Writer<Counted<S>>>,
    length: Arc<AtomicU64>,
    channels: HashMap<String, u16>,
    sequence: u32,
    /// Length of the file up to which it is whole.
    whole_bytes: u64,
    written: u64,
    unflushed: u64,
    unflushed_bytes: u64,
}

impl<S: Storage> Recording<S> {
    /// Begins a recording.
    ///
    /// # Errors
    /// [`RecordingError::Full`] or [`RecordingError::Write`].
    pub fn create(storage: S, header: &Header) -> Result<Self, RecordingError> {
        let options = WriteOptions::new()
            .library(concat!("heliostat ", env!("CARGO_PKG_VERSION")))
            .chunk_size(None)
            // A chunk is put together in memory and written in one go, never half a one and then a correction.
            .disable_seeking(true);
        let length = Arc::new(AtomicU64::new(0));
        let counted = Counted { inner: storage, length: Arc::clone(&length) };
        let writer = options.create(counted).map_err(|error| failure(&error, 0, 0))?;
        let mut recording = Self {
            writer: Some(writer),
            length,
            channels: HashMap::new(),
            sequence: 0,
            whole_bytes: 0,
            written: 0,
            unflushed: 0,
            unflushed_bytes: 0,
        };
        let metadata = Metadata { name: HEADER_NAME.into(), metadata: header.to_map() };
        recording.with_writer(|writer| writer.write_metadata(&metadata))?;
        recording.flush()?;
        Ok(recording)
    }

    /// Takes a payload as it came.
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
                let layout = format!("{kind}: bytes as CONTRACT.md of Heliostat says, sections 2 and 3");
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

    /// Takes a message for viewers.
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

    /// Closes the chunk: from here on a cut of the file loses nothing that came before.
    ///
    /// # Errors
    /// [`RecordingError::Full`] or [`RecordingError::Write`]; the file then ends in good order after its last whole chunk, and takes nothing
    /// more.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.with_writer(Writer::flush)?;
        self.whole_bytes = self.length.load(Ordering::Relaxed);
        self.written += std::mem::take(&mut self.unflushed);
        self.unflushed_bytes = 0;
        Ok(())
    }

    /// Writes the account and the index, and closes the file.
    ///
    /// # Errors
    /// As [`Recording::flush`].
    pub fn finish(mut self, account: &Account) -> Result<(), RecordingError> {
        self.flush()?;
        let json = serde_json::to_string(account).expect("an account has a JSON form");
        let metadata = Metadata { name: ACCOUNT_NAME.into(), metadata: [("json".to_owned(), json)].into() };
        self.with_writer(|writer| writer.write_metadata(&metadata))?;
        self.with_writer(|writer| writer.finish().map(drop))?;
        let writer = self.writer.take().expect("a writer that did not fail is there");
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

    /// Does something with the writer; where that fails, ends the file in good order.
    fn with_writer<T>(
        &mut self,
        action: impl FnOnce(&mut Writer<Counted<S>>) -> Result<T, McapError>,
    ) -> Result<T, RecordingError> {
        let Some(writer) = &mut self.writer else {
            return Err(failure(&McapError::AttemptedWriteAfterFailure, self.written, self.unflushed));
        };
        action(writer).map_err(|error| {
            if let Some(writer) = self.writer.take() {
                end_at(writer.into_inner().inner, self.whole_bytes);
            }
            failure(&error, self.written, self.unflushed)
        })
    }
}

/// Ends a file after its last whole chunk. Where not even that can be written, the file is as readable as one that was cut there.
fn end_at<S: Storage>(mut storage: S, whole_bytes: u64) {
    let mut ending = vec![op::DATA_END];
    ending.extend(4_u64.to_le_bytes());
    ending.extend([0; 4]);
    ending.push(op::FOOTER);
    ending.extend(20_u64.to_le_bytes());
    ending.extend([0; 20]);
    ending.extend(MAGIC);
    let ended = storage.cut(whole_bytes).and_then(|()| storage.write_all(&ending)).and_then(|()| storage.flush());
    if ended.is_err() {
        // Nothing is left to try: half an ending reads as a cut file.
        let _ = storage.cut(whole_bytes);
    }
}

fn failure(error: &McapError, written: u64, lost: u64) -> RecordingError {
    match error {
        McapError::Io(error) if is_full(error) => RecordingError::Full { written, lost },
        other => RecordingError::Write { problem: other.to_string(), written, lost },
    }
}

/// Whether no more fits: on the disk, into the quota, into the longest file that is allowed.
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

impl Header {
    fn to_map(&self) -> BTreeMap<String, String> {
        let value = serde_json::to_value(self).expect("a header has a JSON form");
        serde_json::from_value(value).expect("a header holds nothing but text")
    }

    fn from_map(map: &BTreeMap<String, String>) -> Result<Self, RecordingError> {
        let value = serde_json::to_value(map).expect("a map of text has a JSON form");
        serde_json::from_value(value).map_err(|error| RecordingError::Read(format!("its metadata: {error}")))
    }
}

/// One message of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Its topic; of a payload, the key.
    pub topic: String,
    /// When the recorder got it, UTC in ns.
    pub arrived_ns: Nanos,
    /// The bytes.
    pub data: Vec<u8>,
}

/// A recording that is being read, from its beginning to its end or to its last whole chunk.
pub struct Reading<R> {
    source: R,
    reader: LinearReader,
    header: Header,
    topics: HashMap<u16, String>,
    account: Option<String>,
}

impl<R: Read> Reading<R> {
    /// Begins to read.
    ///
    /// # Errors
    /// [`RecordingError::Read`], [`RecordingError::Foreign`] or [`RecordingError::Version`].
    pub fn open(source: R) -> Result<Self, RecordingError> {
        // A chunk is checked before anything in it is used, so that half of one is as good as none.
        let options = LinearReaderOptions::default().with_skip_end_magic(true).with_prevalidate_chunk_crcs(true);
        let header = Header::default();
        let reader = LinearReader::new_with_options(options);
        let mut reading = Self { source, reader, header, topics: HashMap::new(), account: None };
        while reading.header.room.is_empty() {
            if !matches!(reading.step()?, Step::Other) {
                return Err(RecordingError::Foreign);
            }
        }
        if reading.header.contract != VERSION.to_string() {
            return Err(RecordingError::Version { found: reading.header.contract });
        }
        Ok(reading)
    }

    /// What was known when the recording began.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The account that the recorder wrote at the end, as JSON; nothing before the end was read, or where the recording was cut.
    pub fn account(&self) -> Option<&str> {
        self.account.as_deref()
    }

    /// The next message; nothing at the end.
    ///
    /// # Errors
    /// [`RecordingError::Read`] where the file is damaged; a file that was cut just ends.
    pub fn entry(&mut self) -> Result<Option<Entry>, RecordingError> {
        loop {
            match self.step()? {
                Step::Entry(entry) => return Ok(Some(entry)),
                Step::Other => {}
                Step::End => return Ok(None),
            }
        }
    }

    fn step(&mut self) -> Result<Step, RecordingError> {
        let unreadable = |error: McapError| RecordingError::Read(error.to_string());
        let event = match self.reader.next_event() {
            None => return Ok(Step::End),
            Some(Err(McapError::UnexpectedEof)) => return Ok(Step::End),
            Some(event) => event.map_err(unreadable)?,
        };
        match event {
            LinearReadEvent::ReadRequest(wanted) => {
                let got = self.source.read(self.reader.insert(wanted));
                self.reader.notify_read(got.map_err(|error| RecordingError::Read(error.to_string()))?);
            }
            LinearReadEvent::Record { data, opcode } => match mcap::parse_record(opcode, data).map_err(unreadable)? {
                Record::Channel(channel) => drop(self.topics.insert(channel.id, channel.topic)),
                Record::Metadata(found) if found.name == HEADER_NAME => {
                    self.header = Header::from_map(&found.metadata)?
                }
                Record::Metadata(mut found) if found.name == ACCOUNT_NAME => {
                    self.account = found.metadata.remove("json")
                }
                Record::Message { header, data } => {
                    let topic = self.topics.get(&header.channel_id).cloned().unwrap_or_default();
                    return Ok(Step::Entry(Entry { topic, arrived_ns: header.log_time, data: data.into_owned() }));
                }
                _ => {}
            },
        }
        Ok(Step::Other)
    }
}

enum Step {
    Entry(Entry),
    Other,
    End,
}
