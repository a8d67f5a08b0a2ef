//! The last check before the mirrors: commanded angles are finite, within range and within the slew
//! limit.
//!
//! It does not judge whether angles are useful, and it does not replace the limits that a driver
//! enforces.

use std::ops::{AddAssign, Range, RangeInclusive};

use heliostat_channel::mirrors::MirrorAngles;
use heliostat_proto::AxisLimits;
use heliostat_scenario::Control;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Limits of a command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest angle of each axis, plus and minus, in rad.
    range_rad: f64,
    /// Smallest and largest roll, then yaw, in rad: within the range and the capabilities of the
    /// array.
    axes_rad: [[f64; 2]; 2],
    /// Largest angular rate of each axis in rad/s.
    slew_rad_per_s: Option<f64>,
}

/// How many axis values the limits changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clipped {
    /// Values outside the range.
    pub range: u64,
    /// Values further from the last command than the slew limit lets a mirror turn.
    pub slew: u64,
}

impl AddAssign for Clipped {
    fn add_assign(&mut self, other: Self) {
        self.range += other.range;
        self.slew += other.slew;
    }
}

/// A proposed angle is not a finite number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the angles proposed for mirror {mirror} are not finite numbers")]
pub struct NotFinite {
    /// Index of the first such mirror.
    pub mirror: usize,
}

impl Limits {
    /// The limits of a scenario's `control` table.
    pub fn new(control: &Control) -> Self {
        let range_rad = f64::from(largest_f32_within(control.range_deg.to_radians()));
        Self {
            range_rad,
            axes_rad: [[-range_rad, range_rad]; 2],
            slew_rad_per_s: (control.slew_deg_per_s > 0.0).then(|| control.slew_deg_per_s.to_radians()),
        }
    }

    /// Narrows the limits to the capabilities of the array.
    pub fn narrow(&mut self, roll: &AxisLimits, yaw: &AxisLimits) {
        let ends = |axis: &AxisLimits| {
            [axis.min_rad, axis.max_rad].map(|end| f64::from(end).clamp(-self.range_rad, self.range_rad))
        };
        self.axes_rad = [ends(roll), ends(yaw)];
    }

    /// Smallest and largest roll, then yaw, in rad.
    pub fn axes_rad(&self) -> [[f64; 2]; 2] {
        self.axes_rad
    }

    /// Replaces smallest and largest roll, then yaw, in rad; false, without a change, where they
    /// are not within the range.
    pub fn restore_axes(&mut self, axes_rad: [[f64; 2]; 2]) -> bool {
        let within = |[min, max]: &[f64; 2]| -self.range_rad <= *min && min <= max && *max <= self.range_rad;
        let fits = axes_rad.iter().all(within);
        if fits {
            self.axes_rad = axes_rad;
        }
        fits
    }

    /// Largest angle of each axis, plus and minus, in rad.
    pub fn range_rad(&self) -> f64 {
        self.range_rad
    }

    /// Smallest and largest roll, then yaw, in rad.
    ///
    /// `None` where both axes turn by 90 degrees or more in either direction, which is all that a
    /// mirror on a wall can use.
    pub fn narrow_axes_rad(&self) -> Option<[RangeInclusive<f64>; 2]> {
        let quarter = f64::from(largest_f32_within(std::f64::consts::FRAC_PI_2));
        let narrow = self.axes_rad.iter().any(|[min, max]| *min > -quarter || *max < quarter);
        narrow.then(|| self.axes_rad.map(|[min, max]| min..=max))
    }

    /// Limits proposed angles to the range, and to what the slew rate allows from `from` in
    /// `elapsed_s` seconds.
    pub fn bound(&self, from: &MirrorAngles, elapsed_s: f64, angles: &mut MirrorAngles) -> Clipped {
        let all = 0..angles.roll.len();
        self.bound_array(from, elapsed_s, angles, all)
    }

    /// The same for some of the mirrors, for example those of an array.
    ///
    /// # Panics
    /// When there are no such mirrors.
    pub fn bound_array(
        &self,
        from: &MirrorAngles,
        elapsed_s: f64,
        angles: &mut MirrorAngles,
        mirrors: Range<usize>,
    ) -> Clipped {
        let reach_rad = self.slew_rad_per_s.map_or(f64::INFINITY, |slew| slew * elapsed_s.max(0.0));
        let mut clipped = Clipped::default();
        let axes = [
            (&from.roll[mirrors.clone()], &mut angles.roll[mirrors.clone()]),
            (&from.yaw[mirrors.clone()], &mut angles.yaw[mirrors]),
        ];
        for ((from, angles), [min, max]) in axes.into_iter().zip(self.axes_rad) {
            for (&from, angle) in from.iter().zip(angles) {
                // clamp() checks its bounds for each angle, which prevents vectorisation.
                let in_range = angle.max(min).min(max);
                let in_reach = in_range.max(from - reach_rad).min(from + reach_rad);
                clipped.range += u64::from(in_range != *angle);
                clipped.slew += u64::from(in_reach != in_range);
                *angle = in_reach;
            }
        }
        clipped
    }
}

/// Checks that every proposed angle is a finite number.
///
/// # Errors
/// [`NotFinite`] with the first mirror for which it is not.
pub fn check_finite(angles: &MirrorAngles) -> Result<(), NotFinite> {
    let bad = |(roll, yaw): (&f64, &f64)| !(roll.is_finite() && yaw.is_finite());
    match angles.roll.iter().zip(&angles.yaw).position(bad) {
        Some(mirror) => Err(NotFinite { mirror }),
        None => Ok(()),
    }
}

/// Returns the largest f32 that does not exceed `value`.
///
/// Commands carry f32, in which 90 degrees rounds up. An array that checks its range would refuse
/// the rounded value.
fn largest_f32_within(value: f64) -> f32 {
    let nearest = value as f32;
    if f64::from(nearest) > value { nearest.next_down() } else { nearest }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits(range_deg: f64) -> Limits {
        Limits::new(&Control { range_deg, slew_deg_per_s: 0.0, ..Control::default() })
    }

    #[test]
    fn capabilities_narrow_the_range_and_never_widen_it() {
        let mut limits = limits(30.0);
        let axis = |min_rad, max_rad| AxisLimits { min_rad, max_rad, ..AxisLimits::default() };
        limits.narrow(&axis(-0.125, 0.25), &axis(-3.0, 3.0));
        let mut proposed = MirrorAngles { roll: vec![1.0, -1.0], yaw: vec![1.0, 0.0] };
        let clipped = limits.bound(&MirrorAngles::flat(2), 0.01, &mut proposed);
        assert_eq!(clipped.range, 3);
        assert_eq!(proposed.roll, [0.25, -0.125]);
        assert!((proposed.yaw[0] - 30f64.to_radians()).abs() < 1e-7);
    }

    #[test]
    fn ninety_degrees_does_not_round_up_in_a_command() {
        let range = limits(90.0).range_rad();
        assert!(f64::from(range as f32) <= 90f64.to_radians());
        assert!(90f64.to_radians() - range < 1e-6);
    }
}
