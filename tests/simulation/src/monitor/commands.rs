//! The commands that controllers send: their numbers, and their angles.

use std::collections::{BTreeMap, BTreeSet};

use heliostat_proto::{EPOCH_SLOTS, MirrorCommand, decode};

use crate::clock::{MS, TrueNs};
use crate::hosts::device::{MIRRORS, RANGE_RAD};
use crate::violation::Invariant;

/// Largest commanded angle in degrees, as in the scenario.
pub(crate) const RANGE_DEG: f32 = 68.0;

/// Angles have single precision.
const ROUNDING_RAD: f64 = 1e-5;

/// The numbers and angles that were sent so far.
#[derive(Debug)]
pub(crate) struct CommandMonitor {
    slew_rad_s: f64,
    /// The controller of each epoch of an array.
    owners: BTreeMap<(usize, u64), u64>,
    /// The last number of each controller, array and epoch.
    numbers: BTreeMap<(u64, usize, u64), u64>,
    /// The last command of a controller to an array, and when it was sent.
    last: BTreeMap<(u64, usize), (TrueNs, MirrorCommand)>,
    /// Calibrations: they turn mirrors within the range of the array, as fast as it can.
    guests: BTreeSet<u64>,
}

impl CommandMonitor {
    pub fn new(slew_rad_s: f64) -> Self {
        Self {
            slew_rad_s,
            owners: BTreeMap::new(),
            numbers: BTreeMap::new(),
            last: BTreeMap::new(),
            guests: BTreeSet::new(),
        }
    }

    /// A calibration starts.
    pub fn welcome(&mut self, source: u64) {
        self.guests.insert(source);
    }

    /// A controller chose an epoch, and knows of the one that the array follows.
    pub(super) fn chose(epoch: u64, followed: Option<u64>) -> Result<(), (Invariant, String)> {
        // No epoch is above the last ones, which forged telemetry can claim.
        match followed.filter(|followed| *followed < u64::MAX - EPOCH_SLOTS) {
            Some(followed) if epoch <= followed => {
                Err((Invariant::Numbering, format!("the epoch {epoch} was chosen, and {followed} is followed")))
            }
            _ => Ok(()),
        }
    }

    pub(super) fn sent(
        &mut self,
        now: TrueNs,
        source: u64,
        array: usize,
        payload: &[u8],
    ) -> Result<(), (Invariant, String)> {
        let command: MirrorCommand =
            decode(payload).map_err(|error| (Invariant::Payload, format!("{source:x} sent {error}")))?;
        check_number(self.numbers.insert((source, array, command.epoch), command.sequence), &command)?;
        let is_guest = self.guests.contains(&source);
        let last = self.last.get(&(source, array)).filter(|_| !is_guest);
        // A clock that was set back says nothing about the time that has passed.
        let passed = |(sent, last): &(TrueNs, MirrorCommand)| {
            command.time_ns.checked_sub(last.time_ns).unwrap_or(now.saturating_sub(*sent))
        };
        let largest = if is_guest { RANGE_RAD } else { RANGE_DEG.to_radians() };
        let limits = (f64::from(largest), self.slew_rad_s);
        check_angles(last.map(|last| (&last.1, passed(last))), &command, limits)?;
        let owner = *self.owners.entry((array, command.epoch)).or_insert(source);
        if owner != source {
            let text = format!("{owner:x} and {source:x} have the same epoch {}", command.epoch);
            return Err((Invariant::Numbering, text));
        }
        self.last.insert((source, array), (now, command));
        Ok(())
    }
}

/// Numbers of an epoch begin at 1, and go on after a return to it.
fn check_number(last: Option<u64>, sent: &MirrorCommand) -> Result<(), (Invariant, String)> {
    let (epoch, sequence) = (sent.epoch, sent.sequence);
    let expected = last.map_or(1, |last| last + 1);
    if sequence == expected {
        return Ok(());
    }
    Err((Invariant::Numbering, format!("sequence {sequence} of epoch {epoch}, expected {expected}")))
}

/// Checks a command beside the last one and the time since then.
fn check_angles(
    last: Option<(&MirrorCommand, u64)>,
    sent: &MirrorCommand,
    (largest, slew_rad_s): (f64, f64),
) -> Result<(), (Invariant, String)> {
    let fault = |text: String| Err((Invariant::Payload, text));
    if [sent.roll.len(), sent.yaw.len()] != [MIRRORS; 2] {
        return fault(format!("a command for {} mirrors", sent.roll.len()));
    }
    let angles = |command: &MirrorCommand| {
        command.roll.iter().chain(&command.yaw).map(|angle| f64::from(*angle)).collect::<Vec<_>>()
    };
    let largest = largest + ROUNDING_RAD;
    if let Some(angle) = angles(sent).into_iter().find(|angle| angle.abs() > largest) {
        return fault(format!("a command of {angle} rad"));
    }
    let Some((last, passed_ns)) = last else { return Ok(()) };
    // After the end of validity the mirrors are where telemetry has them, or park.
    if passed_ns > u64::from(last.validity_ms.min(sent.validity_ms)) * MS {
        return Ok(());
    }
    let reach = slew_rad_s * passed_ns as f64 * 1e-9 + ROUNDING_RAD;
    let moved = angles(last).into_iter().zip(angles(sent)).map(|(from, to)| (to - from).abs()).fold(0.0, f64::max);
    if moved > reach { fault(format!("a mirror turns by {moved} rad, expected at most {reach}")) } else { Ok(()) }
}
