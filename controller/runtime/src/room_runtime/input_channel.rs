//! Where a payload came from.

use heliostat_core::refusal::Stream;

/// A stream, and for telemetry the array that it describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputChannel {
    /// The stream.
    pub stream: Stream,
    /// Index of the array; 0 for reports about the room.
    pub array: usize,
}

impl From<Stream> for InputChannel {
    fn from(stream: Stream) -> Self {
        Self { stream, array: 0 }
    }
}
