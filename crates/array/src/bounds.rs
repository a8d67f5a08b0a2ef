//! Bounds on the numbers of a command: epoch, sequence and validity.
//!
//! An array follows the highest epoch, and within it the highest sequence. A number near the end of
//! its range would therefore exclude all later controllers, and a long validity would hold the
//! array after its controller is lost. The bounds keep both recoverable, with any one message:
//!
//! - Epoch: at most `epoch_lead_max` above the larger of UTC in ms and the highest accepted epoch.
//!   A controller that starts with UTC in ms, or with the highest accepted epoch plus one, is
//!   always within it.
//! - Sequence: at most `sequence_step_max` above the last accepted one of its epoch, or above 0.
//! - Validity: at most `validity_max_ms`.

use heliostat_proto::MirrorCommand;

use crate::refusal::Refusal;

/// Highest first epoch where the array has no UTC: UTC in ms in the year 2109.
pub const EPOCH_MAX_WITHOUT_UTC: u64 = 1 << 42;

/// Room time before 2020 in ms is not UTC: it is simulated, or the clock of the host is not set.
const UTC_MIN_MS: u64 = 1_577_836_800_000;

/// Bounds on the numbers of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    /// Longest validity in ms.
    pub validity_max_ms: u32,
    /// Largest lead of an epoch over UTC in ms, or over the highest accepted epoch.
    pub epoch_lead_max: u64,
    /// Largest difference of the sequence numbers of two accepted commands of an epoch.
    pub sequence_step_max: u64,
}

impl Default for Bounds {
    /// The bounds of every array of this project.
    ///
    /// A minute exceeds the difference of two clocks that work. A sequence may pass 49 days of
    /// 1000 commands a second, so a controller that was cut off for days continues its epoch.
    fn default() -> Self {
        Self { validity_max_ms: 10_000, epoch_lead_max: 60_000, sequence_step_max: 1 << 32 }
    }
}

impl Bounds {
    /// Checks a command after `last`, epoch and sequence of the last accepted one. `utc_ms` is UTC,
    /// absent where the array does not know it.
    pub(crate) fn check(
        &self,
        command: &MirrorCommand,
        last: Option<(u64, u64)>,
        utc_ms: Option<u64>,
    ) -> Result<(), Refusal> {
        let &MirrorCommand { epoch, sequence, validity_ms, .. } = command;
        let (highest, last_sequence) = last.unwrap_or((0, 0));
        let bound = match utc_ms {
            Some(utc_ms) => highest.max(utc_ms).saturating_add(self.epoch_lead_max),
            None => highest.saturating_add(self.epoch_lead_max).max(EPOCH_MAX_WITHOUT_UTC),
        };
        if epoch > bound {
            return Err(Refusal::EpochBound { found: epoch, bound });
        }
        let first = if epoch == highest { last_sequence } else { 0 };
        let bound = first.saturating_add(self.sequence_step_max);
        if sequence > bound {
            return Err(Refusal::SequenceBound { found: sequence, bound });
        }
        if validity_ms > self.validity_max_ms {
            return Err(Refusal::ValidityBound { found_ms: validity_ms, bound_ms: self.validity_max_ms });
        }
        Ok(())
    }
}

/// Room time in ms where it is UTC.
pub(crate) fn utc_ms(room_ns: u64) -> Option<u64> {
    Some(room_ns / 1_000_000).filter(|ms| *ms >= UTC_MIN_MS)
}
