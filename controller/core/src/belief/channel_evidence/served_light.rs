//! The measured light of a user relative to the expected one.

use crate::belief::{heading::Heading, light::Received, readings::MeasuredGains};

use super::{ChannelEvidence, possible};

/// The mirrors serve a user whose expected gain is above this share of the gain of all mirrors.
const SERVED: f64 = 0.1;

/// Largest relative deviation of the expected gain by what is unknown of the heading.
const SPREAD: f64 = 0.2;

/// Probability above which one LED serves.
const CERTAIN: f64 = 0.9;

impl ChannelEvidence {
    /// The measured light of the user of the last examination relative to the expected one. `heading` is
    /// absent where bodies block no light.
    ///
    /// Unreported obstacles are left out: the map takes mirrors that are out of place for obstacles, and
    /// would explain their loss.
    pub(super) fn received(&self, user: usize, heading: Option<&Heading>, measured: MeasuredGains<'_>) -> Received {
        let expected: f64 = possible(heading).map(|(index, probability)| probability * self.reflected(index)).sum();
        let squared = |index: usize| (self.reflected(index) - expected).powi(2);
        let variance: f64 = possible(heading).map(|(index, probability)| probability * squared(index)).sum();
        let (likely, _) = possible(heading).fold((0, 0.0), |best, entry| if entry.1 > best.1 { entry } else { best });
        let led = self.served_by[likely];
        let is_served = expected > SERVED * self.expected.steering(led) && variance < (SPREAD * expected).powi(2);

        let (mut certain, mut direct) = (0.0, 0.0);
        for (index, probability) in possible(heading) {
            if self.served_by[index] == led && !self.serving.is_dark(led, index) {
                let tilt = self.expected.tilt(user, &Heading::direction(index));
                let factor = tilt.map_or(1.0, |tilt| tilt.factor(self.expected.led_slopes(led)));
                certain += probability;
                direct += probability * factor * self.expected.direct(user, led);
            }
        }
        let is_direct = certain > CERTAIN && self.readings.shows(measured.los) && self.readings.shows(direct);
        Received {
            mirrors: is_served.then(|| (led, measured.irs / expected)),
            direct: is_direct.then(|| (led, measured.los * certain / direct)),
        }
    }
}
