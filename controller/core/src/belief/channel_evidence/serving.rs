//! Which LED serves a user at each heading, by what is expected of the direct paths and by the
//! measured direct gain.
//!
//! The LED with the largest direct gain serves of those whose path is clear. Let the LEDs be in the
//! order of their expected gains g_l(h) at a heading h, and c_l(h) the probability that the path
//! from LED l is clear if those of the stronger LEDs are blocked. Then LED l serves with the
//! probability
//!
//! P_l(h) = c_l(h) * product over the stronger LEDs j of (1 - c_j(h)),
//!
//! and none with the product over all LEDs. A covered detector blocks the paths from all LEDs
//! together, so that each blocked path makes it more probable. A measured gain y multiplies P_l by
//! the density f(y | g_l), and a measured gain of zero excludes that an LED serves.
//!
//! A receiver may also report which LED serves it, or the gain y_l of each LED. The weight of a heading
//! is then the product over all LEDs of c_l f(y_l | g_l) for those that it detects, and of 1 - c_l for
//! the others.

use heliostat_channel::ChannelModel;

use super::BODY_WRONG;
use crate::belief::{
    densities::Densities,
    heading::HEADINGS,
    readings::{MeasuredLeds, Readings},
};

/// Probability that another LED serves than a report names.
const REPORT_WRONG: f64 = 0.02;

/// The direct path from one LED at each heading.
#[derive(Clone, Debug)]
struct Path {
    /// Probability that no unreported obstacle blocks it.
    unobstructed: f64,
    /// The measured gain, where the receiver reports each LED; 0 for one that it does not detect.
    measured: f64,
    /// Expected gain past the user's body.
    gain: [f64; HEADINGS],
    /// Density of the measured gain.
    densities: Densities,
    /// Probability that the LED serves, then its product with that density.
    weight: [f64; HEADINGS],
}

/// What the direct paths to one user say about each heading; its buffers are allocated once.
#[derive(Clone, Debug)]
pub(super) struct Serving {
    /// By LED.
    paths: Vec<Path>,
    /// Probability that no LED serves, where the measured gain allows it.
    none: [f64; HEADINGS],
    /// The LEDs in the order of their gains at one heading.
    order: Vec<usize>,
    /// The LED that a report names, or from which the receiver detects the most light.
    named: Option<usize>,
    /// Whether the receiver reports each LED.
    measures_each: bool,
}

impl Serving {
    /// Buffers for all LEDs.
    pub fn new(model: &ChannelModel) -> Self {
        let path = Path {
            unobstructed: 1.0,
            measured: 0.0,
            gain: [0.0; HEADINGS],
            densities: Densities::default(),
            weight: [0.0; HEADINGS],
        };
        let paths = vec![path; model.leds.len()];
        let order = Vec::with_capacity(paths.len());
        Self { paths, none: [0.0; HEADINGS], order, named: None, measures_each: false }
    }

    /// Begins a user whose receiver tells this about LEDs; `unobstructed` is the probability that no
    /// unreported obstacle blocks the path from an LED.
    pub fn begin(&mut self, leds: MeasuredLeds<'_>, readings: &Readings, unobstructed: impl Fn(usize) -> f64) {
        (self.named, self.measures_each) = (None, false);
        for (led, path) in self.paths.iter_mut().enumerate() {
            (path.unobstructed, path.measured) = (unobstructed(led), 0.0);
        }
        match leds {
            MeasuredLeds::Unknown => {}
            MeasuredLeds::Serving(led) => self.named = Some(led),
            MeasuredLeds::Each(gains) => {
                self.measures_each = true;
                let mut most = 0.0;
                for (led, gain) in gains.iter().enumerate().filter(|(_, gain)| readings.shows(**gain)) {
                    self.paths[led].measured = *gain;
                    if *gain > most {
                        (self.named, most) = (Some(led), *gain);
                    }
                }
            }
        }
        self.clear();
    }

    /// Whether the receiver reports each LED.
    pub fn measures_each(&self) -> bool {
        self.measures_each
    }

    /// Forgets what is expected at each heading.
    pub fn clear(&mut self) {
        self.none.fill(0.0);
        for path in &mut self.paths {
            // A heading that is not examined is not dark.
            path.gain.fill(f64::INFINITY);
            path.weight.fill(0.0);
            path.densities = Densities::default();
        }
    }

    /// Probability that no unreported obstacle blocks the path from an LED.
    pub fn unobstructed(&self, led: usize) -> f64 {
        self.paths[led].unobstructed
    }

    /// Notes the expected gain by an LED at a heading, past the user's body.
    pub fn expect(&mut self, led: usize, heading: usize, gain: f64) {
        self.paths[led].gain[heading] = gain;
    }

    /// Notes the density of the measured gain if the LED serves at a heading: expected value and
    /// variance, as shares of the same gain as the measured one.
    pub fn expect_share(&mut self, led: usize, heading: usize, expected: f64, variance: f64) {
        self.paths[led].densities.expect(heading, expected, variance);
    }

    /// Whether the path from an LED is dark at a heading: blocked, or outside the field of view.
    pub fn is_dark(&self, led: usize, heading: usize) -> bool {
        self.paths[led].gain[heading] <= 0.0
    }

    /// Computes the probability that each LED serves at a heading. `open` is the probability that
    /// the detector is not covered; `shows` tells gains of clear paths from those of blocked ones.
    ///
    /// Where the receiver reports each LED, the probability of all that it detects is the weight of the
    /// LED from which it detects the most light.
    pub fn weigh(&mut self, heading: usize, mut open: f64, shows: impl Fn(f64) -> bool) {
        let Self { paths, order, none, named, measures_each } = self;
        order.clear();
        order.extend(0..paths.len());
        order.sort_unstable_by(|one, other| {
            let by_gain = paths[*other].gain[heading].total_cmp(&paths[*one].gain[heading]);
            by_gain.then(one.cmp(other))
        });
        let mut unserved = 1.0;
        for led in order {
            let path = &mut paths[*led];
            let is_lit = shows(path.gain[heading]);
            let clear =
                if is_lit { (path.unobstructed * open).clamp(BODY_WRONG, 1.0 - BODY_WRONG) } else { BODY_WRONG };
            if *measures_each && path.measured > 0.0 {
                (unserved, open) = (unserved * clear, 1.0);
                continue;
            }
            path.weight[heading] = if *measures_each { 0.0 } else { unserved * clear };
            unserved *= 1.0 - clear;
            if is_lit {
                let unobstructed = path.unobstructed.clamp(BODY_WRONG, 1.0 - BODY_WRONG);
                open *= (1.0 - unobstructed) / (1.0 - unobstructed * open);
            }
        }
        match named {
            Some(led) if *measures_each => (paths[*led].weight[heading], none[heading]) = (unserved, 0.0),
            _ => none[heading] = unserved,
        }
    }

    /// Multiplies the weights at a heading by a factor. Divides them by their sum, unless the receiver
    /// reports each LED: the probability of what it detects then counts.
    pub fn scale(&mut self, heading: usize, factor: f64) {
        let total = if self.measures_each { 1.0 } else { self.served(heading) };
        for path in &mut self.paths {
            path.weight[heading] = factor * (path.weight[heading] / total);
        }
    }

    /// The sum of an LED's weights over all headings.
    pub fn of_led(&self, led: usize) -> f64 {
        self.paths[led].weight.iter().sum()
    }

    /// Takes the measured gain, where it shows a clear path, and those of each LED. `reference` is the
    /// gain that the expected shares refer to, and `relative` the standard deviation relative to each.
    pub fn measure(&mut self, los: Option<f64>, reference: f64, relative: f64) {
        if self.measures_each {
            return self.measure_each(reference, relative);
        }
        let Some(los) = los else { return self.paths.iter_mut().for_each(|path| path.weight.fill(0.0)) };
        self.none.fill(0.0);
        for (led, path) in self.paths.iter_mut().enumerate() {
            path.densities.apply(los / reference, relative, &mut path.weight);
            if self.named.is_some_and(|named| named != led) {
                path.weight.iter_mut().for_each(|weight| *weight *= REPORT_WRONG);
            }
        }
    }

    fn measure_each(&mut self, reference: f64, relative: f64) {
        let Some(named) = self.named else { return };
        let mut weight = self.paths[named].weight;
        for path in self.paths.iter().filter(|path| path.measured > 0.0) {
            path.densities.apply(path.measured / reference, relative, &mut weight);
        }
        self.paths[named].weight = weight;
    }

    /// The likelihood of a heading.
    pub fn likelihood(&self, heading: usize) -> f64 {
        self.served(heading) + self.none[heading]
    }

    /// The LED that most probably serves at a heading; `None` where probably none does.
    pub fn led(&self, heading: usize) -> Option<usize> {
        let mut most = (None, 0.0);
        for (led, path) in self.paths.iter().enumerate() {
            if path.weight[heading] > most.1 {
                most = (Some(led), path.weight[heading]);
            }
        }
        most.0
    }

    /// How far the measurement shows the path from an LED as clear, and how far as blocked, over
    /// these headings with their probabilities; each from 0 to 1. A path is clear if its LED
    /// serves, and blocked if a weaker LED serves, or none.
    pub fn shown(&self, led: usize, headings: impl Iterator<Item = (usize, f64)>) -> [f64; 2] {
        if self.measures_each {
            return if self.paths[led].measured > 0.0 { [1.0, 0.0] } else { [0.0, 1.0] };
        }
        let (mut all, mut clear, mut blocked) = (0.0, 0.0, 0.0);
        for (heading, probability) in headings {
            let total = self.likelihood(heading);
            if total <= 0.0 {
                continue;
            }
            let gain = self.paths[led].gain[heading];
            let is_weaker =
                |(other, path): &(usize, &Path)| *other != led && (path.gain[heading], led) < (gain, *other);
            let weaker: f64 =
                self.paths.iter().enumerate().filter(is_weaker).map(|(_, path)| path.weight[heading]).sum();
            all += probability;
            clear += probability * (self.paths[led].weight[heading] / total);
            blocked += probability * ((weaker + self.none[heading]) / total);
        }
        if all > 0.0 { [clear / all, blocked / all] } else { [0.0; 2] }
    }

    /// The sum of the LEDs' weights at a heading.
    pub fn served(&self, heading: usize) -> f64 {
        self.paths.iter().map(|path| path.weight[heading]).sum()
    }
}

#[cfg(test)]
mod tests {
    use heliostat_scenario::Scenario;

    use super::*;

    /// Two LEDs, of which the second one has half the gain of the first, at the headings 0, where both
    /// paths are clear, and 1, where the user's body blocks that of the first.
    fn serving(leds: MeasuredLeds<'_>, unobstructed: f64, open: f64) -> Serving {
        let overrides = ["led.positions_m=[[-1,0,3],[1,0,3]]"];
        let scenario = Scenario::builtin("hall").unwrap().with_overrides(&overrides).unwrap();
        let mut serving = Serving::new(&scenario.channel_model().unwrap());
        serving.begin(leds, &Readings::new(&scenario.streams.channel), |led| if led == 0 { unobstructed } else { 1.0 });
        for (heading, gains) in [[1.0, 0.5], [0.0, 0.5]].iter().enumerate() {
            for (led, gain) in gains.iter().enumerate() {
                serving.expect(led, heading, *gain);
                serving.expect_share(led, heading, *gain, 1e-4);
            }
            serving.weigh(heading, open, |gain| gain > 0.1);
        }
        serving
    }

    #[test]
    fn the_strongest_led_serves_and_the_next_one_past_a_body() {
        let serving = serving(MeasuredLeds::Unknown, 1.0, 1.0);
        let clear = 1.0 - BODY_WRONG;
        assert_eq!(serving.led(0), Some(0));
        assert_eq!(serving.led(1), Some(1));
        assert!((serving.paths[0].weight[0] - clear).abs() < 1e-12);
        assert!((serving.paths[1].weight[1] - clear).abs() < 1e-12);
        assert!((serving.none[1] - BODY_WRONG * clear).abs() < 1e-12, "{}", serving.none[1]);
        for heading in 0..2 {
            assert!((serving.likelihood(heading) - 1.0).abs() < 1e-12, "the LEDs or none");
        }
    }

    #[test]
    fn a_path_that_is_blocked_for_no_known_reason_shows_a_covered_detector() {
        let [open, covered] = [1.0, 0.5].map(|open| serving(MeasuredLeds::Unknown, 1.0, open));
        // The first path is clear past body and obstacles; if it is blocked, the detector is covered.
        assert!(covered.paths[1].weight[0] < 0.1 * covered.paths[0].weight[0], "{:?}", covered.paths[1].weight);
        assert!(covered.none[0] > 0.4 && open.none[0] < 0.01, "{} {}", covered.none[0], open.none[0]);
        // An obstacle is another reason.
        let obstacle = serving(MeasuredLeds::Unknown, 0.1, 0.5);
        assert!(obstacle.paths[1].weight[0] > 0.4, "{:?}", obstacle.paths[1].weight);
    }

    #[test]
    fn the_gain_of_the_weaker_led_shows_that_the_path_from_the_stronger_one_is_blocked() {
        let mut serving = serving(MeasuredLeds::Unknown, 0.5, 1.0);
        serving.measure(Some(0.5), 1.0, 0.08);
        assert_eq!(serving.led(0), Some(1));
        let [clear, blocked] = serving.shown(0, [(0, 1.0)].into_iter());
        assert!(blocked > 0.9 && (clear + blocked - 1.0).abs() < 1e-12, "{clear} {blocked}");
        let [clear, blocked] = serving.shown(1, [(0, 1.0)].into_iter());
        assert!(clear > 0.9 && blocked < 1e-12, "{clear} {blocked}");
    }

    #[test]
    fn a_gain_of_zero_shows_all_paths_as_blocked() {
        let mut serving = serving(MeasuredLeds::Unknown, 1.0, 0.5);
        serving.measure(None, 1.0, 0.08);
        assert_eq!(serving.led(0), None);
        for led in 0..2 {
            assert_eq!(serving.shown(led, [(0, 0.7), (1, 0.3)].into_iter()), [0.0, 1.0]);
        }
    }

    #[test]
    fn a_named_led_serves_unless_the_gain_is_that_of_another_one() {
        let mut serving = serving(MeasuredLeds::Serving(1), 1.0, 1.0);
        serving.measure(Some(0.5), 1.0, 0.08);
        assert_eq!([serving.led(0), serving.led(1)], [Some(1); 2]);
        assert!(serving.likelihood(1) > 20.0 * serving.likelihood(0), "the body blocks the first LED");
    }

    #[test]
    fn the_gains_of_each_led_show_the_heading_at_which_all_of_them_fit() {
        for (gains, heading) in [([1.0, 0.5], 0), ([0.0, 0.5], 1)] {
            let mut serving = serving(MeasuredLeds::Each(&gains), 1.0, 1.0);
            serving.measure(None, 1.0, 0.08);
            let [fits, other] = [heading, 1 - heading].map(|heading| serving.likelihood(heading));
            assert!(fits > 20.0 * other, "{gains:?}: {fits} {other}");
            assert_eq!(serving.led(heading), Some(heading), "the LED with the most detected light");
            assert_eq!(serving.shown(0, std::iter::empty()), if heading == 0 { [1.0, 0.0] } else { [0.0, 1.0] });
        }
        let mut serving = serving(MeasuredLeds::Each(&[0.0; 2]), 1.0, 0.5);
        serving.measure(None, 1.0, 0.08);
        assert_eq!(serving.led(0), None);
        assert!((serving.likelihood(0) - 0.5).abs() < 0.05, "the detector is covered: {}", serving.likelihood(0));
    }
}
