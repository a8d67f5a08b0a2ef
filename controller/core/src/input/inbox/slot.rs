//! Who publishes, and the latest report of a stream.

use heliostat_proto::{Message, Nanos, decode, encode};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de, ser};

/// The source whose reports are accepted, and the arrival of its last accepted report.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Owner {
    pub source: u64,
    pub last_report_ns: Nanos,
}

/// The latest report of a stream; the memory stays allocated when the report is discarded.
#[derive(Clone, Debug, Default)]
pub(super) struct Slot<T> {
    pub report: T,
    pub filled: bool,
}

impl<T> Slot<T> {
    pub fn get(&self) -> Option<&T> {
        self.filled.then_some(&self.report)
    }

    pub fn keep(&mut self, report: &mut T) {
        std::mem::swap(&mut self.report, report);
        self.filled = true;
    }

    pub fn forget(&mut self) {
        self.filled = false;
    }
}

/// A report as it is on the wire; nothing for none.
impl<T: Message> Serialize for Slot<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut payload = Vec::new();
        self.get().map_or(Ok(()), |report| encode(report, &mut payload)).map_err(ser::Error::custom)?;
        payload.serialize(serializer)
    }
}

impl<'de, T: Message> Deserialize<'de> for Slot<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let payload = Vec::<u8>::deserialize(deserializer)?;
        if payload.is_empty() {
            return Ok(Self { report: T::default(), filled: false });
        }
        Ok(Self { report: decode(&payload).map_err(de::Error::custom)?, filled: true })
    }
}
