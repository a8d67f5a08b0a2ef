//! Whether a receiver is upright or tilted towards the face, by a measured direct gain.

use heliostat_channel::ChannelModel;

use super::{BODY_WRONG, Bodies, ChannelEvidence, SPREAD_OF_DEVICES};
use crate::belief::{
    densities::density,
    heading::{HEADINGS, Heading},
    readings::MeasuredGains,
    tilt::Tilt,
};

/// The user of a decision, and what is known of the headings and bodies.
#[derive(Clone, Copy)]
struct Facing<'a> {
    model: &'a ChannelModel,
    user: usize,
    bodies: &'a Bodies<'a>,
    heading: &'a Heading,
}

impl ChannelEvidence {
    /// Logarithm of the likelihood ratio of a receiver that is tilted towards the face by `polar_rad`
    /// to an upright one, by a measured direct gain; 0 where the gain shows nothing. For receivers
    /// that are evaluated upright.
    ///
    /// Each likelihood is the mean of P_l(h) f(y | g_l(h)) over the headings h at which the user's body
    /// leaves some path clear, summed over the LEDs l. P_l(h) is the probability that LED l serves if
    /// one does.
    pub(super) fn tilt_log_ratio(
        &mut self,
        model: &ChannelModel,
        (user, polar_rad): (usize, f64),
        measured: MeasuredGains,
        bodies: &Bodies<'_>,
        heading: &Heading,
    ) -> f64 {
        let reference = self.expected.strongest(user);
        if !self.readings.shows(reference) || !self.readings.shows(measured.los) {
            return 0.0;
        }
        let ratio = measured.los / reference;
        let variance = self.readings.gain_variance / reference.powi(2) + SPREAD_OF_DEVICES.powi(2);
        let (facing, polar) = (Facing { model, user, bodies, heading }, polar_rad.sin_cos());
        let possible = self.weigh_tilted(facing, |_| None, variance);
        let of_led = |led: usize| {
            let share = self.expected.direct(user, led) / reference;
            self.serving.of_led(led) / possible * density(ratio, (share, 0.0), variance)
        };
        let upright: f64 = self.expected.leds().map(of_led).sum();
        self.weigh_tilted(facing, |index| Some(Tilt::towards_face(polar, &bodies.directions[index])), variance);
        self.serving.measure(Some((ratio, 0.0)));
        let tilted: f64 = (0..HEADINGS).map(|index| self.serving.served(index)).sum();
        self.serving.clear();
        if possible > BODY_WRONG { (tilted / possible / upright).ln() } else { 0.0 }
    }

    /// Weighs each LED at the headings at which the user's body leaves some path clear, for a receiver
    /// that is tilted so at each of them, and returns the probability of these headings.
    fn weigh_tilted(
        &mut self,
        Facing { model, user, bodies, heading }: Facing<'_>,
        tilt: impl Fn(usize) -> Option<Tilt>,
        variance: f64,
    ) -> f64 {
        let reference = self.expected.strongest(user);
        let (mut possible, readings) = (0.0, self.readings);
        self.serving.clear();
        for (index, probability) in heading.possible() {
            let own = bodies.shape.behind(&self.expected.positions()[user], &bodies.directions[index]);
            let (tilt, mut is_any_clear) = (tilt(index), false);
            for led in self.expected.leds() {
                let is_clear = self.expected.is_clear(model, (user, led), &own, false);
                let slopes = self.expected.led_slopes(led);
                let [factor, spread] =
                    tilt.map_or([1.0, 0.0], |tilt| [tilt.factor(slopes), tilt.factor_variance(slopes)]);
                let direct = if is_clear { self.expected.direct(user, led) } else { 0.0 };
                let share = direct / reference;
                self.serving.expect(led, index, direct * factor);
                self.serving.expect_share(led, index, share * factor, variance + share.powi(2) * spread);
                is_any_clear |= is_clear;
            }
            if is_any_clear {
                possible += probability;
                self.serving.weigh(index, 1.0, |gain| readings.shows(gain));
                self.serving.normalise(index, probability);
            }
        }
        possible
    }
}
