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

use heliostat_channel::ChannelModel;

use super::BODY_WRONG;
use crate::belief::{densities::Densities, heading::HEADINGS};

/// The direct path from one LED at each heading.
#[derive(Clone, Debug)]
struct Path {
    /// Probability that no unreported obstacle blocks it.
    unobstructed: f64,
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
}

impl Serving {
    /// Buffers for all LEDs.
    pub fn new(model: &ChannelModel) -> Self {
        let path =
            Path { unobstructed: 1.0, gain: [0.0; HEADINGS], densities: Densities::default(), weight: [0.0; HEADINGS] };
        let paths = vec![path; model.leds.len()];
        Self { order: Vec::with_capacity(paths.len()), paths, none: [0.0; HEADINGS] }
    }

    /// Begins a user; `unobstructed` is the probability that no unreported obstacle blocks the path
    /// from an LED.
    pub fn begin(&mut self, unobstructed: impl Fn(usize) -> f64) {
        self.paths.iter_mut().enumerate().for_each(|(led, path)| path.unobstructed = unobstructed(led));
        self.clear();
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
    pub fn weigh(&mut self, heading: usize, mut open: f64, shows: impl Fn(f64) -> bool) {
        let Self { paths, order, none } = self;
        order.clear();
        order.extend(0..paths.len());
        order.sort_by(|one, other| paths[*other].gain[heading].total_cmp(&paths[*one].gain[heading]));
        let mut unserved = 1.0;
        for led in order {
            let path = &mut paths[*led];
            let clear = if shows(path.gain[heading]) {
                (path.unobstructed * open).clamp(BODY_WRONG, 1.0 - BODY_WRONG)
            } else {
                BODY_WRONG
            };
            path.weight[heading] = unserved * clear;
            unserved *= 1.0 - clear;
            if shows(path.gain[heading]) {
                let unobstructed = path.unobstructed.clamp(BODY_WRONG, 1.0 - BODY_WRONG);
                open *= (1.0 - unobstructed) / (1.0 - unobstructed * open);
            }
        }
        none[heading] = unserved;
    }

    /// Multiplies the weights at a heading by a factor, and divides them by their sum.
    pub fn normalise(&mut self, heading: usize, factor: f64) {
        let total = self.served(heading);
        for path in &mut self.paths {
            path.weight[heading] = factor * (path.weight[heading] / total);
        }
    }

    /// The sum of an LED's weights over all headings.
    pub fn of_led(&self, led: usize) -> f64 {
        self.paths[led].weight.iter().sum()
    }

    /// Takes a measured gain as a share of the one that the expected shares refer to, with its
    /// standard deviation relative to each of them; `None`: no path is shown as clear.
    pub fn measure(&mut self, share: Option<(f64, f64)>) {
        match share {
            Some((share, relative)) => {
                self.none.fill(0.0);
                for path in &mut self.paths {
                    path.densities.apply(share, relative, &mut path.weight);
                }
            }
            None => self.paths.iter_mut().for_each(|path| path.weight.fill(0.0)),
        }
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
    fn serving(unobstructed: f64, open: f64) -> Serving {
        let overrides = ["led.positions_m=[[-1,0,3],[1,0,3]]".to_owned()];
        let scenario = Scenario::builtin("hall").unwrap().with_overrides(&overrides).unwrap();
        let mut serving = Serving::new(&scenario.channel_model().unwrap());
        serving.begin(|led| if led == 0 { unobstructed } else { 1.0 });
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
        let serving = serving(1.0, 1.0);
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
        let [open, covered] = [1.0, 0.5].map(|open| serving(1.0, open));
        // The first path is clear past body and obstacles; if it is blocked, the detector is covered.
        assert!(covered.paths[1].weight[0] < 0.1 * covered.paths[0].weight[0], "{:?}", covered.paths[1].weight);
        assert!(covered.none[0] > 0.4 && open.none[0] < 0.01, "{} {}", covered.none[0], open.none[0]);
        // An obstacle is another reason.
        let obstacle = serving(0.1, 0.5);
        assert!(obstacle.paths[1].weight[0] > 0.4, "{:?}", obstacle.paths[1].weight);
    }

    #[test]
    fn the_gain_of_the_weaker_led_shows_that_the_path_from_the_stronger_one_is_blocked() {
        let mut serving = serving(0.5, 1.0);
        serving.measure(Some((0.5, 0.08)));
        assert_eq!(serving.led(0), Some(1));
        let [clear, blocked] = serving.shown(0, [(0, 1.0)].into_iter());
        assert!(blocked > 0.9 && (clear + blocked - 1.0).abs() < 1e-12, "{clear} {blocked}");
        let [clear, blocked] = serving.shown(1, [(0, 1.0)].into_iter());
        assert!(clear > 0.9 && blocked < 1e-12, "{clear} {blocked}");
    }

    #[test]
    fn a_gain_of_zero_shows_all_paths_as_blocked() {
        let mut serving = serving(1.0, 0.5);
        serving.measure(None);
        assert_eq!(serving.led(0), None);
        for led in 0..2 {
            assert_eq!(serving.shown(led, [(0, 0.7), (1, 0.3)].into_iter()), [0.0, 1.0]);
        }
    }
}
