//! The lengths that chunks declare, before the library unpacks them.
//!
//! The library compares the length of a chunk with its limit only where the chunk has a checksum. A chunk without one
//! would be unpacked record by record, however long it is.

use std::io::{self, Read};

use mcap::MAGIC;
use mcap::records::op;

/// Kind and length of a record.
const RECORD_HEAD: usize = 1 + 8;
/// Two times, then the length of the chunk's records before compression.
const CHUNK_HEAD: usize = 8 + 8 + 8;

/// The bytes of a file, up to a chunk that declares too much.
pub struct DeclaredLengths<R> {
    source: R,
    /// Most bytes of a chunk before compression.
    limit: u64,
    /// The first bytes of the present record.
    head: Vec<u8>,
    /// Bytes before the next record.
    skipped: u64,
    /// Whether the last record has begun.
    is_over: bool,
}

impl<R: Read> DeclaredLengths<R> {
    /// Reads a file from its beginning.
    pub fn new(source: R, limit: u64) -> Self {
        Self { source, limit, head: Vec::new(), skipped: MAGIC.len() as u64, is_over: false }
    }

    fn note(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        while !self.is_over {
            let skipped = bytes.len().min(usize::try_from(self.skipped).unwrap_or(usize::MAX));
            self.skipped -= skipped as u64;
            let Some((first, rest)) = bytes[skipped..].split_first() else { break };
            bytes = rest;
            self.head.push(*first);
            self.note_head()?;
        }
        Ok(())
    }

    /// Looks at a record as soon as enough of it is known.
    fn note_head(&mut self) -> io::Result<()> {
        let Some(length) = number(&self.head, 1) else { return Ok(()) };
        let mut known = 0;
        if self.head[0] == op::CHUNK && length >= CHUNK_HEAD as u64 {
            let Some(declared) = number(&self.head, RECORD_HEAD + 16) else { return Ok(()) };
            if declared > self.limit {
                let limit = self.limit;
                return Err(io::Error::other(format!(
                    "a chunk declares {declared} bytes before compression; expected at most {limit}: write the file again with smaller chunks"
                )));
            }
            known = CHUNK_HEAD;
        }
        self.is_over = self.head[0] == op::FOOTER;
        self.skipped = length - known as u64;
        self.head.clear();
        Ok(())
    }
}

impl<R: Read> Read for DeclaredLengths<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.source.read(buffer)?;
        self.note(&buffer[..count])?;
        Ok(count)
    }
}

/// The number at an offset, if all of it is known.
fn number(bytes: &[u8], offset: usize) -> Option<u64> {
    bytes.get(offset..)?.first_chunk::<8>().map(|bytes| u64::from_le_bytes(*bytes))
}
