//! The numbers of a controller's commands: its epoch, and sequence numbers that it gives once in each epoch.

use std::collections::BTreeMap;

use heliostat_proto::{EPOCH_SLOTS, Nanos};

/// How the epoch is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) enum Rule {
    /// One epoch; telemetry is ignored.
    #[default]
    Fixed,
    /// One epoch; stands by while another sender's commands are followed.
    Lockstep,
    /// As in the diagram of [`Tenure`](super::Tenure).
    Live { source: u64, interval_ns: Nanos },
}

impl Rule {
    /// The lowest epoch of this controller above a base; `None` where there is none.
    pub fn above(self, base: u64) -> Option<u64> {
        let next = base.checked_add(1)?;
        let Self::Live { source, .. } = self else { return Some(next) };
        next.checked_add((source % EPOCH_SLOTS + EPOCH_SLOTS - next % EPOCH_SLOTS) % EPOCH_SLOTS)
    }
}

/// The epoch, and the sequence number of its last command.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Numbers {
    epoch: u64,
    sequence: u64,
    /// The last sequence number of each former epoch with commands: at most one more for each decision.
    former: BTreeMap<u64, u64>,
}

impl Numbers {
    /// No command so far, in this epoch.
    pub fn of(epoch: u64) -> Self {
        Self { epoch, ..Self::default() }
    }

    /// The epoch of the commands; 0 before the first.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// The sequence number of the last command in this epoch.
    pub fn sequence(&self) -> u64 {
        self.sequence
    }

    /// Numbers a command of the present epoch: from 1, rising by one, also over a return to it.
    pub fn next_sequence(&mut self) -> u64 {
        self.sequence = self.sequence.saturating_add(1);
        self.sequence
    }

    /// Commands have this epoch from now on.
    pub fn begin(&mut self, epoch: u64) {
        if self.sequence > 0 {
            self.former.insert(self.epoch, self.sequence);
        }
        self.epoch = epoch;
        self.sequence = self.former.get(&epoch).copied().unwrap_or(0);
    }
}
