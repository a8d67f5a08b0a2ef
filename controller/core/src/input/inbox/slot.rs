//! Who publishes, and the latest report of a stream.

use heliostat_proto::Nanos;
use serde::{Deserialize, Serialize};

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
