//! Whether the light of a single mirror is strong enough to be measured at a place.

use heliostat_channel::Vec3;

use crate::code::{self, SIZES};
use crate::optics::{Optics, nominal_at};
use crate::stand::median;

/// Ratio of the light of a mirror to the noise of a reading below which the readings of a spot do not locate
/// it: a reading at the edge of the light then says less than how the mirror was mounted.
pub const RATIO_MIN: f64 = 3.0;

/// The light of single mirrors at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signal {
    /// Index of the place.
    pub place: usize,
    /// The largest gain of the median mirror.
    pub gain: f64,
    /// Its ratio to the noise of a reading without light.
    pub ratio: f64,
}

impl Signal {
    /// Whether it is too weak for readings of single mirrors.
    pub fn is_weak(&self) -> bool {
        self.ratio < RATIO_MIN
    }

    /// Mirrors of a coded group: 1 unless the light of single ones is too weak. Of the possible sizes that with the
    /// least noise, if two groups are among `mirrors`. `relative`: noise of a gain, relative to it.
    pub fn group(&self, relative: f64, mirrors: usize) -> usize {
        if !self.is_weak() {
            return 1;
        }
        let sizes = SIZES.into_iter().filter(|size| *size == 1 || 2 * size <= mirrors);
        let noise = |size: &usize| code::deviation(*size, (relative, self.gain / self.ratio), self.gain);
        sizes.min_by(|a, b| noise(a).total_cmp(&noise(b))).unwrap_or(1)
    }

    /// The same light with the noise of groups of this size.
    pub fn in_groups(self, size: usize, relative: f64) -> Self {
        let noise = code::deviation(size, (relative, self.gain / self.ratio), self.gain);
        Self { ratio: self.gain / noise, ..self }
    }

    /// The weakest light of single mirrors at these places, by the nominal room. Places: x, y and the height of the
    /// detector in m, in the room's frame, each with its index. `noise_gain`: standard deviation of a dark reading.
    pub fn weakest(optics: &Optics, places: impl Iterator<Item = (usize, [f64; 3])>, noise_gain: f64) -> Option<Self> {
        let at = |(place, at): (usize, [f64; 3])| {
            let gain = median(&gains(optics, at)?);
            Some(Self { place, gain, ratio: gain / noise_gain })
        };
        places.filter_map(at).min_by(|a, b| a.gain.total_cmp(&b.gain))
    }
}

/// The gain of each mirror that is aimed at a place, from the LED that serves it.
fn gains(optics: &Optics, [x, y, height_m]: [f64; 3]) -> Option<Vec<f64>> {
    let at = optics.array().wall_from_room(&Vec3::new(x, y, 0.0));
    let exact = nominal_at([at.x, at.y], height_m);
    let direct = |led: usize| optics.direct_gain(led, &exact);
    let led = (0..optics.leds.len()).max_by(|a, b| direct(*a).total_cmp(&direct(*b)))?;
    let gain = |mirror: usize| {
        let aim = optics.aim((mirror, led), &exact)?;
        Some(optics.mirror_gain((mirror, led), aim, &exact))
    };
    Some((0..optics.centres.len()).map(|mirror| gain(mirror).unwrap_or(0.0)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_are_chosen_only_where_the_light_of_single_mirrors_is_weak() {
        let signal = |ratio: f64| Signal { place: 0, gain: 2e-8, ratio };
        for ratio in [RATIO_MIN, 20.0, f64::INFINITY] {
            assert_eq!(signal(ratio).group(0.05, 400), 1, "at {ratio}");
            assert_eq!(signal(ratio).in_groups(1, 0.05).ratio, ratio);
        }
        assert_eq!([1.0, 2.9].map(|ratio| signal(ratio).group(0.05, 400)), [31, 31]);
        assert_eq!([0.1, 0.3].map(|relative| signal(2.9).group(relative, 400)), [15, 1], "the light's own noise");
        assert_eq!([400, 36, 16, 4].map(|mirrors| signal(1.0).group(0.05, mirrors)), [31, 15, 7, 1]);
        assert!(signal(1.0).in_groups(31, 0.05).ratio > 2.5);
    }
}
