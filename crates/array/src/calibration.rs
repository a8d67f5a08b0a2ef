//! The correction of each mirror's mounting: device angle = gain * angle + offset, for each mirror
//! and axis.

use heliostat_channel::MirrorAngles;
use heliostat_proto::{Calibration, CodecError};
use thiserror::Error;

use crate::rules::Limits;

/// Smallest and largest gain. A mirror turns by the commanded angle up to the tolerance of its
/// drive; a gain beyond these would flatten the array, or hide its angles in telemetry.
pub const GAIN_RANGE: [f64; 2] = [0.5, 2.0];

/// Largest offset in rad, 11.5 degrees: a larger error of the mounting is corrected by hand.
pub const OFFSET_MAX_RAD: f64 = 0.2;

/// Tolerance for angles that were rounded to single precision, in rad.
const ROUNDING_RAD: f64 = 1e-6;

/// Why a calibration is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Unfit {
    /// It is for an array of another size.
    #[error(transparent)]
    WrongCount(#[from] CodecError),
    /// It is not newer than the one in use.
    #[error("a calibration of sequence {found}: expected more than {used}, the one in use from this source")]
    OldSequence {
        /// Sequence of the calibration.
        found: u64,
        /// Sequence of the one in use.
        used: u64,
    },
    /// A gain that reverses, cancels or multiplies a turn.
    #[error("invalid {axis} gain {gain} of mirror {mirror}: expected {} to {}", GAIN_RANGE[0], GAIN_RANGE[1])]
    Gain {
        /// Roll or yaw.
        axis: &'static str,
        /// The first such mirror.
        mirror: usize,
        /// Its gain.
        gain: f32,
    },
    /// An offset that is no error of a mounting.
    /// Files have degrees, messages rad.
    #[error(
        "invalid {axis} offset of mirror {mirror}, {:.2} degrees ({offset_rad} rad): expected at most {:.2} degrees \
         ({OFFSET_MAX_RAD} rad) either way",
        .offset_rad.to_degrees(),
        OFFSET_MAX_RAD.to_degrees()
    )]
    Offset {
        /// Roll or yaw.
        axis: &'static str,
        /// The first such mirror.
        mirror: usize,
        /// Its offset in rad.
        offset_rad: f32,
    },
    /// A corrected angle would be beyond the range of the hardware.
    #[error(
        "the corrected {axis} of mirror {mirror} is {angle_deg:.2} degrees: \
         expected {min_deg:.2} to {max_deg:.2}, the range of its hardware; announce a smaller range for commands \
         (calibration_reserve_deg, or smaller limits and travel_rad in Python)"
    )]
    BeyondHardware {
        /// Roll or yaw.
        axis: &'static str,
        /// The first such mirror.
        mirror: usize,
        /// The angle in degrees.
        angle_deg: f64,
        /// Smallest angle of the hardware in degrees.
        min_deg: f64,
        /// Largest angle of the hardware in degrees.
        max_deg: f64,
    },
}

impl Unfit {
    /// The name under which it is counted.
    pub fn name(&self) -> &'static str {
        match self {
            Self::WrongCount(error) => error.name(),
            Self::OldSequence { .. } => "old-sequence",
            Self::Gain { .. } => "gain",
            Self::Offset { .. } => "offset",
            Self::BeyondHardware { .. } => "beyond-hardware",
        }
    }
}

/// The correction in use; at first there is none.
#[derive(Clone, Debug, Default)]
pub(crate) struct Correction {
    used: Option<Calibration>,
}

impl Correction {
    /// Sequence of the calibration in use; 0 for none.
    pub fn sequence(&self) -> u64 {
        self.used.as_ref().map_or(0, |used| used.stamp.sequence)
    }

    /// Uses another calibration from now on.
    pub fn replace(&mut self, new: &Calibration, limits: &Limits, travel_rad: [[f64; 2]; 2]) -> Result<(), Unfit> {
        new.check_mirrors(limits.mirrors)?;
        if let Some(used) = &self.used
            && used.stamp.source == new.stamp.source
            && new.stamp.sequence <= used.stamp.sequence
        {
            return Err(Unfit::OldSequence { found: new.stamp.sequence, used: used.stamp.sequence });
        }
        let axes = [
            ("roll", &new.roll_gain, &new.roll_offset_rad, limits.roll_rad),
            ("yaw", &new.yaw_gain, &new.yaw_offset_rad, limits.yaw_rad),
        ];
        for ((axis, gains, offsets, range), [min, max]) in axes.into_iter().zip(travel_rad) {
            for (mirror, (gain, offset)) in gains.iter().zip(offsets).enumerate() {
                check_correction((axis, mirror), *gain, *offset)?;
                let ends = range.map(|end| f64::from(*gain) * end + f64::from(*offset));
                let outside = |end: &f64| *end < min - ROUNDING_RAD || *end > max + ROUNDING_RAD;
                if let Some(angle) = ends.into_iter().find(outside) {
                    let [angle_deg, min_deg, max_deg] = [angle, min, max].map(f64::to_degrees);
                    return Err(Unfit::BeyondHardware { axis, mirror, angle_deg, min_deg, max_deg });
                }
            }
        }
        self.used = Some(new.clone());
        Ok(())
    }

    /// Writes the device angles that turn the mirrors to `angles`.
    pub fn apply(&self, angles: &MirrorAngles, out: &mut MirrorAngles) {
        out.clone_from(angles);
        if let Some(used) = &self.used {
            correct(&mut out.roll, &used.roll_gain, &used.roll_offset_rad, |angle, gain, offset| gain * angle + offset);
            correct(&mut out.yaw, &used.yaw_gain, &used.yaw_offset_rad, |angle, gain, offset| gain * angle + offset);
        }
    }

    /// The inverse: converts device angles to the angles of commands.
    pub fn undo(&self, angles: &mut MirrorAngles) {
        if let Some(used) = &self.used {
            let back = |angle: f64, gain: f64, offset: f64| (angle - offset) / gain;
            correct(&mut angles.roll, &used.roll_gain, &used.roll_offset_rad, back);
            correct(&mut angles.yaw, &used.yaw_gain, &used.yaw_offset_rad, back);
        }
    }
}

/// Whether a driver accepts gains and offsets, whatever its hardware.
///
/// # Errors
/// [`Unfit`] of the first mirror that it would refuse.
pub fn check_corrections(new: &Calibration) -> Result<(), Unfit> {
    let axes = [("roll", &new.roll_gain, &new.roll_offset_rad), ("yaw", &new.yaw_gain, &new.yaw_offset_rad)];
    axes.into_iter().try_for_each(|(axis, gains, offsets)| {
        let mut mirrors = gains.iter().zip(offsets).enumerate();
        mirrors.try_for_each(|(mirror, (gain, offset))| check_correction((axis, mirror), *gain, *offset))
    })
}

fn check_correction((axis, mirror): (&'static str, usize), gain: f32, offset_rad: f32) -> Result<(), Unfit> {
    let [least, most] = GAIN_RANGE;
    if !(least..=most).contains(&f64::from(gain)) {
        return Err(Unfit::Gain { axis, mirror, gain });
    }
    let bound = OFFSET_MAX_RAD + ROUNDING_RAD;
    if !(-bound..=bound).contains(&f64::from(offset_rad)) {
        return Err(Unfit::Offset { axis, mirror, offset_rad });
    }
    Ok(())
}

fn correct(angles: &mut [f64], gains: &[f32], offsets: &[f32], with: impl Fn(f64, f64, f64) -> f64) {
    for ((angle, gain), offset) in angles.iter_mut().zip(gains).zip(offsets) {
        *angle = with(*angle, f64::from(*gain), f64::from(*offset));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_has_the_units_of_the_file_and_the_message_and_says_what_to_do() {
        let offset = check_correction(("roll", 3), 1.0, 0.25).expect_err("beyond the bound").to_string();
        let expected =
            "invalid roll offset of mirror 3, 14.32 degrees (0.25 rad): expected at most 11.46 degrees (0.2 rad)";
        assert!(offset.starts_with(expected), "{offset}");
        let beyond = Unfit::BeyondHardware { axis: "yaw", mirror: 0, angle_deg: 30.5, min_deg: -30.0, max_deg: 30.0 }
            .to_string();
        assert!(beyond.contains("the range of its hardware; announce a smaller range for commands"), "{beyond}");
    }
}
