//! Whether the light of a single mirror is strong enough to be measured at a place.

use heliostat_channel::Vec3;

use crate::optics::{Optics, PLACE, QUANTITIES, Quantities};
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
    /// Its ratio to the noise of a dark reading.
    pub ratio: f64,
}

impl Signal {
    /// Whether it is too weak for readings of single mirrors.
    pub fn is_weak(&self) -> bool {
        self.ratio < RATIO_MIN
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
    let mut exact: Quantities = [0.0; QUANTITIES];
    exact[PLACE..PLACE + 3].copy_from_slice(&[at.x, at.y, height_m]);
    let direct = |led: usize| optics.direct_gain(led, &exact);
    let led = (0..optics.leds.len()).max_by(|a, b| direct(*a).total_cmp(&direct(*b)))?;
    let gain = |mirror: usize| {
        let aim = optics.aim((mirror, led), &exact)?;
        Some(optics.mirror_gain((mirror, led), aim, &exact))
    };
    Some((0..optics.centres.len()).map(|mirror| gain(mirror).unwrap_or(0.0)).collect())
}
