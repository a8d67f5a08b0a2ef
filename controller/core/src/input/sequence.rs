//! The sequence numbers of one stream: which number may come next, and how many did not arrive.
//!
//! The first accepted message of a source sets the base, whatever its number: a tracker that has
//! run for a day meets a controller that has just started. Later numbers must rise, by at most
//! [`SEQUENCE_STEP_MAX`]. Where no message of the stream was accepted for the source timeout, the
//! next one sets a new base. One message with a wild number thus delays its stream by that timeout
//! at most.

use heliostat_proto::{Nanos, Stamp};
use serde::{Deserialize, Serialize};

use crate::input::refusal::Refusal;

/// Largest difference between the sequence numbers of two consecutive accepted messages of a
/// source, as in section 5 of CONTRACT.md.
pub const SEQUENCE_STEP_MAX: u64 = 1_000_000;

/// The sequence numbers of one stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct SequenceTrack {
    last: Option<Accepted>,
    /// Messages after the last accepted one that arrived and were refused, or did not decode.
    #[serde(skip)]
    refused: u64,
    #[serde(skip)]
    missed: u64,
}

/// The last accepted message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Accepted {
    source: u64,
    sequence: u64,
    at_ns: Nanos,
}

impl Accepted {
    /// How far a number lies ahead, if it is of this source and within the bound.
    fn step_to(&self, stamp: &Stamp) -> Option<u64> {
        let step = stamp.sequence.checked_sub(self.sequence).filter(|_| self.source == stamp.source)?;
        (1..=SEQUENCE_STEP_MAX).contains(&step).then_some(step)
    }
}

impl SequenceTrack {
    /// Whether a message with this stamp may be accepted at `now`.
    pub fn check(&self, now: Nanos, stamp: &Stamp, timeout_ns: Nanos) -> Result<(), Refusal> {
        let is_base = |last: &Accepted| last.source == stamp.source && now.abs_diff(last.at_ns) <= timeout_ns;
        let Some(last) = self.last.filter(is_base) else { return Ok(()) };
        match stamp.sequence {
            sequence if sequence == last.sequence => Err(Refusal::Repeated),
            sequence if sequence < last.sequence => Err(Refusal::OutOfOrder),
            _ if last.step_to(stamp).is_none() => Err(Refusal::SequenceJump),
            _ => Ok(()),
        }
    }

    /// Records an accepted message, and counts the numbers that it skipped.
    pub fn on_accepted(&mut self, now: Nanos, stamp: &Stamp) {
        if let Some(step) = self.last.and_then(|last| last.step_to(stamp)) {
            self.missed += (step - 1).saturating_sub(self.refused);
        }
        self.refused = 0;
        self.last = Some(Accepted { source: stamp.source, sequence: stamp.sequence, at_ns: now });
    }

    /// Records a refused message: it arrived, so it is not missing.
    pub fn on_refused(&mut self, stamp: &Stamp) {
        self.refused += u64::from(self.last.is_some_and(|last| last.step_to(stamp).is_some()));
    }

    /// Records a payload of a source that does not decode: it arrived too, also where its number is cut off.
    pub fn on_unreadable(&mut self, source: u64, sequence: Option<u64>) {
        match sequence {
            Some(sequence) => self.on_refused(&Stamp { source, sequence, time_ns: 0 }),
            None => self.refused += u64::from(self.last.is_some_and(|last| last.source == source)),
        }
    }

    /// Discards the base if it is of this source.
    pub fn forget(&mut self, source: u64) {
        self.last = self.last.filter(|last| last.source != source);
    }

    /// Numbers that did not arrive, since the start.
    pub fn missed(&self) -> u64 {
        self.missed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIMEOUT: Nanos = 1000;

    fn stamp(source: u64, sequence: u64) -> Stamp {
        Stamp { source, sequence, time_ns: 0 }
    }

    fn after(source: u64, sequence: u64) -> SequenceTrack {
        let mut track = SequenceTrack::default();
        track.on_accepted(10, &stamp(source, sequence));
        track
    }

    #[test]
    fn numbers_rise_by_a_bounded_step() {
        let track = after(1, 5);
        let check = |sequence| track.check(20, &stamp(1, sequence), TIMEOUT);
        assert_eq!([check(4), check(5)], [Err(Refusal::OutOfOrder), Err(Refusal::Repeated)]);
        assert_eq!([check(6), check(5 + SEQUENCE_STEP_MAX)], [Ok(()), Ok(())]);
        assert_eq!([check(6 + SEQUENCE_STEP_MAX), check(u64::MAX)], [Err(Refusal::SequenceJump); 2]);
    }

    #[test]
    fn only_numbers_that_never_arrived_are_missed() {
        let mut track = after(1, 5);
        track.on_accepted(11, &stamp(1, 6));
        assert_eq!(track.missed(), 0);
        track.on_refused(&stamp(1, 8));
        track.on_refused(&stamp(2, 9));
        track.on_accepted(12, &stamp(1, 10));
        assert_eq!(track.missed(), 2, "7 and 9 did not arrive");
        track.on_accepted(13, &stamp(2, 100));
        track.on_accepted(9 * TIMEOUT, &stamp(2, 3));
        assert_eq!(track.missed(), 2, "a new base is no gap");
    }
}
