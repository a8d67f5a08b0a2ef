//! Counts of the payloads that a room received.

use std::ops::AddAssign;

use heliostat_proto::{Counters, Kind};

/// What was delivered, and what the array did with the commands.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    /// By position in [`Kind::ALL`]: payloads, and those of them that could be decoded.
    kinds: [(u64, u64); Kind::ALL.len()],
    /// Payloads of the attacker; all others are of the genuine processes.
    pub hostile: u64,
    /// The counters of the kits.
    pub counters: Counters,
}

impl Tally {
    pub fn payloads(&self) -> u64 {
        self.kinds.iter().map(|(delivered, _)| delivered).sum()
    }

    /// Payloads of a kind, and those of them that could be decoded.
    pub fn of(&self, kind: Kind) -> (u64, u64) {
        self.kinds[Self::position(kind)]
    }

    pub fn count(&mut self, kind: Kind, is_decoded: bool) {
        let (delivered, decoded) = &mut self.kinds[Self::position(kind)];
        *delivered += 1;
        *decoded += u64::from(is_decoded);
    }

    fn position(kind: Kind) -> usize {
        Kind::ALL.into_iter().position(|other| other == kind).expect("each kind is in the list")
    }
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.hostile += other.hostile;
        for (sum, other) in self.kinds.iter_mut().zip(other.kinds) {
            sum.0 += other.0;
            sum.1 += other.1;
        }
        let Counters { accepted, clipped, late, rejected, old_epoch, old_sequence, expired, stopped } = other.counters;
        let sums = &mut self.counters;
        sums.accepted += accepted;
        sums.clipped += clipped;
        sums.late += late;
        sums.rejected += rejected;
        sums.old_epoch += old_epoch;
        sums.old_sequence += old_sequence;
        sums.expired += expired;
        sums.stopped += stopped;
    }
}
