//! The sender of a payload whose other fields may not decode.

use crate::codec::{Reader, kind_of};
use crate::kind::Kind;

/// Source and sequence number of a payload whose other fields may not decode; no number where the payload ends
/// before it. Every message but a command begins with them.
pub fn sender_of(payload: &[u8]) -> Option<(u64, Option<u64>)> {
    kind_of(payload).ok().filter(|kind| *kind != Kind::MirrorCommand)?;
    let (mut reader, mut source, mut sequence) = (Reader::of_body(payload), 0_u64, 0_u64);
    reader.take(&mut source).ok()?;
    let read = reader.take(&mut sequence);
    Some((source, read.is_ok().then_some(sequence)))
}
