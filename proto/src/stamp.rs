//! The stamp of a payload whose other fields may not decode.

use crate::codec::{Reader, kind_of};
use crate::kind::Kind;
use crate::structures::Stamp;

/// The stamp of a payload whose other fields may not decode. Every message but a command begins with it.
pub fn stamp_of(payload: &[u8]) -> Option<Stamp> {
    kind_of(payload).ok().filter(|kind| *kind != Kind::MirrorCommand)?;
    let (mut reader, mut stamp) = (Reader::of_body(payload), Stamp::default());
    reader.take(&mut stamp.source).ok()?;
    reader.take(&mut stamp.sequence).ok()?;
    reader.take(&mut stamp.time_ns).ok()?;
    Some(stamp)
}
