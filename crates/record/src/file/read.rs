//! Reads a recording from its beginning to its end, or to its last complete chunk.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use heliostat_files::{foreign_file, open_file};
use heliostat_proto::{Nanos, VERSION};
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapError};

use super::declared::DeclaredLengths;
use super::{ACCOUNT_NAME, HEADER_NAME, Header, RecordingError};

/// Longest record, and longest chunk before and after compression, in bytes. A length in the file
/// is memory to allocate. The recorder's chunks hold some 512 KiB; other tools write 4 MiB.
const RECORD_MAX: usize = 64 << 20;

/// Opens a recording on disk.
///
/// # Errors
/// [`RecordingError::OtherKind`], [`RecordingError::Read`], [`RecordingError::Foreign`] or
/// [`RecordingError::Version`].
pub fn open(file: &Path) -> Result<Reading<BufReader<File>>, RecordingError> {
    let source = || {
        let file = open_file(file).map_err(|error| RecordingError::Open(error.to_string()))?;
        Ok::<_, RecordingError>(BufReader::new(file))
    };
    let mut first = source()?;
    let beginning = first.fill_buf().map_err(|error| RecordingError::Read(error.to_string()))?;
    if let Some(what) = foreign_file(beginning, "a recording of `heliostat record`") {
        return Err(RecordingError::OtherKind(what));
    }
    // A reader takes a file that is shorter than the mark of the format for one that was cut.
    if !beginning.iter().zip(MAGIC).all(|(found, expected)| found == expected) {
        return Err(no_mcap());
    }
    match Reading::open(first) {
        Err(RecordingError::Foreign) => {
            let header = Reading::new(source()?).later_header()?;
            Reading { header, ..Reading::new(source()?) }.of_this_version()
        }
        reading => reading,
    }
}

fn no_mcap() -> RecordingError {
    RecordingError::OtherKind("is not an MCAP file; expected a file made by `heliostat record`".into())
}

/// One message of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Its topic; for a payload, the key.
    pub topic: String,
    /// When the recorder received it, UTC in ns.
    pub arrived_ns: Nanos,
    /// The bytes.
    pub data: Vec<u8>,
}

/// A recording that is being read, up to its end or to its last complete chunk.
pub struct Reading<R> {
    source: DeclaredLengths<R>,
    reader: LinearReader,
    header: Header,
    topics: HashMap<u16, String>,
    account: Option<String>,
    /// Whether the last record of a complete file was read.
    has_footer: bool,
}

impl<R: Read> Reading<R> {
    /// Starts to read.
    ///
    /// # Errors
    /// [`RecordingError::Read`], [`RecordingError::Foreign`] or [`RecordingError::Version`].
    pub fn open(source: R) -> Result<Self, RecordingError> {
        let mut reading = Self::new(source);
        while reading.header.room.is_empty() {
            if !matches!(reading.step()?, Step::Other) {
                return Err(RecordingError::Foreign);
            }
        }
        reading.of_this_version()
    }

    fn new(source: R) -> Self {
        // A chunk is checked before any message in it is used: half a chunk counts as none.
        let options = LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(RECORD_MAX);
        let header = Header::default();
        let source = DeclaredLengths::new(source, RECORD_MAX as u64);
        let reader = LinearReader::new_with_options(options);
        Self { source, reader, header, topics: HashMap::new(), account: None, has_footer: false }
    }

    /// The header of a file that has it behind its messages, as other tools may write it.
    fn later_header(mut self) -> Result<Header, RecordingError> {
        while !matches!(self.step()?, Step::End) {
            if !self.header.room.is_empty() {
                return Ok(self.header);
            }
        }
        Err(RecordingError::Foreign)
    }

    fn of_this_version(self) -> Result<Self, RecordingError> {
        if self.header.contract == VERSION.to_string() {
            return Ok(self);
        }
        Err(RecordingError::Version { found: self.header.contract })
    }

    /// The data known when the recording started.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The counts that the recorder wrote at the end, as JSON; `None` before the end was read, and
    /// if the recording was cut.
    pub fn account(&self) -> Option<&str> {
        self.account.as_deref()
    }

    /// The next message; `None` at the end.
    ///
    /// # Errors
    /// [`RecordingError::Read`] if the file is damaged, [`RecordingError::GoesOn`] if it goes on after its end; a file
    /// that was cut ends without an error.
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
        let unreadable = |error: McapError| match error {
            McapError::BadMagic => no_mcap(),
            error => RecordingError::Read(format!("{error}; copy the file again, or repair it with `mcap recover`")),
        };
        let event = match self.reader.next_event() {
            None => return self.end(),
            Some(Err(McapError::UnexpectedEof)) => return Ok(Step::End),
            Some(event) => event.map_err(unreadable)?,
        };
        match event {
            LinearReadEvent::ReadRequest(length) => {
                let got = self.source.read(self.reader.insert(length));
                self.reader.notify_read(got.map_err(|error| RecordingError::Read(error.to_string()))?);
            }
            LinearReadEvent::Record { opcode: op::FOOTER, .. } => self.has_footer = true,
            LinearReadEvent::Record { data, opcode } if !texts_fit(opcode, data) => {
                let length = data.len();
                return Err(RecordingError::Read(format!("a text is longer than its record of {length} bytes")));
            }
            LinearReadEvent::Record { opcode, .. } if !matches!(opcode, op::CHANNEL | op::METADATA | op::MESSAGE) => {}
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

    /// The end, if no more follows it in the file: the messages of a second recording would be lost without a word.
    fn end(&mut self) -> Result<Step, RecordingError> {
        if self.has_footer {
            let rest = io::copy(&mut self.source, &mut io::sink());
            let rest = rest.map_err(|error| RecordingError::Read(error.to_string()))?;
            let bytes = rest.saturating_sub(MAGIC.len() as u64);
            if bytes > 0 {
                return Err(RecordingError::GoesOn { bytes });
            }
        }
        Ok(Step::End)
    }
}

/// Whether the texts of a record end within it: the library allocates their lengths unchecked.
///
/// Records of other kinds are not parsed here, or have no text.
fn texts_fit(opcode: u8, record: &[u8]) -> bool {
    let end = match opcode {
        // Two numbers of 16 bits, topic, encoding.
        op::CHANNEL => record.get(4..).and_then(skip_text).and_then(skip_text),
        op::METADATA => skip_text(record),
        _ => return true,
    };
    end.is_some_and(|map| {
        let Some(after) = skip_text(map) else { return false };
        let mut entries = &map[4..map.len() - after.len()];
        while let Some(rest) = skip_text(entries).and_then(skip_text) {
            entries = rest;
        }
        entries.is_empty()
    })
}

/// What follows a text or a map, which begin with their length in bytes.
fn skip_text(bytes: &[u8]) -> Option<&[u8]> {
    let (length, rest) = bytes.split_first_chunk()?;
    rest.get(u32::from_le_bytes(*length) as usize..)
}

enum Step {
    Entry(Entry),
    Other,
    End,
}
