//! Whether served users receive the light that the belief expects.
//!
//! The ratio of a measured gain to the expected one, at the angles in force, differs from 1 by errors of
//! position and heading, by bodies, by unreported obstacles and by noise. A mirror that is dirty, stuck or
//! out of place, and an LED that was moved or dimmed, change it for all users and for long. The watch
//! follows the median of these ratios, which neither one user nor a short time upsets. It corrects
//! nothing: no decision depends on it.

use heliostat_proto::Nanos;

/// Change of the logarithm of the median with each ratio: at 50 ratios a second a loss of a quarter of
/// the light shows after some 10 s.
const STEP: f64 = 5e-4;

/// A median whose logarithm is further from 0 is not the expected light: below 0.78, or above 1.28.
const OFF: f64 = 0.25;

/// The expected light has returned when the logarithm is within this.
const ON: f64 = 0.17;

/// The logarithm of the median stays within this. The ratio of dead mirrors is far below any other one: without a
/// bound, the median would need as long to return as they were dead.
const FARTHEST: f64 = 1.0;

/// Ratios before which the median cannot show light that is not the expected one.
const ENOUGH: u64 = (OFF / STEP) as u64;

/// Time between two ratios of users whose gains over the mirrors show the belief nothing, in ns.
const SELDOM_NS: Nanos = 1_000_000_000;

/// The median of measured gains relative to expected ones.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightLevel {
    log_ratio: f64,
    count: u64,
    off_since_ns: Option<Nanos>,
}

impl LightLevel {
    /// The median ratio; 1 before the first measurement.
    pub fn ratio(&self) -> f64 {
        self.log_ratio.exp()
    }

    /// Whether there were enough ratios to show light that is not the expected one.
    pub fn is_known(&self) -> bool {
        self.count >= ENOUGH
    }

    /// Since when the light is not the expected one, in ns.
    pub fn off_since_ns(&self) -> Option<Nanos> {
        self.off_since_ns
    }

    fn handle(&mut self, ratio: f64, time_ns: Nanos) {
        let step = if ratio > self.ratio() { STEP } else { -STEP };
        self.log_ratio = (self.log_ratio + step).clamp(-FARTHEST, FARTHEST);
        self.count += 1;
        let off = self.log_ratio.abs();
        if off > OFF {
            self.off_since_ns.get_or_insert(time_ns);
        } else if off < ON {
            self.off_since_ns = None;
        }
    }
}

/// The measured light of one user relative to the expected one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Received {
    /// By which LED, and over the mirrors; absent where the mirrors do not serve the user.
    pub mirrors: Option<(usize, f64)>,
    /// By which LED, and over its direct path; absent where it may be blocked.
    pub direct: Option<(usize, f64)>,
}

/// The light over the mirrors and from each LED.
#[derive(Clone, Debug)]
pub struct LightWatch {
    mirrors: LightLevel,
    leds: Vec<LightLevel>,
    next_ns: Nanos,
}

impl LightWatch {
    pub(super) fn new(leds: usize) -> Self {
        Self { mirrors: LightLevel::default(), leds: vec![LightLevel::default(); leds], next_ns: 0 }
    }

    /// The light over the mirrors, relative to that of the LED over its direct path.
    pub fn mirrors(&self) -> &LightLevel {
        &self.mirrors
    }

    /// The light over the direct path from each LED.
    pub fn leds(&self) -> &[LightLevel] {
        &self.leds
    }

    /// Whether a measurement at this time counts that the belief itself does not need.
    pub(super) fn is_due(&mut self, time_ns: Nanos) -> bool {
        let is_due = time_ns >= self.next_ns;
        if is_due {
            self.next_ns = time_ns + SELDOM_NS;
        }
        is_due
    }

    pub(super) fn handle(&mut self, received: Received, time_ns: Nanos) {
        if let Some((led, ratio)) = received.mirrors {
            // The mirrors reflect what the LED emits.
            self.mirrors.handle(ratio / self.leds[led].ratio(), time_ns);
        }
        if let Some((led, ratio)) = received.direct {
            self.leds[led].handle(ratio, time_ns);
        }
    }

    /// Starts again, since another source reports from now on.
    pub(super) fn clear(&mut self) {
        self.mirrors = LightLevel::default();
        self.leds.fill(LightLevel::default());
        self.next_ns = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A watch of one LED after so many reports that show this ratio of the light over the mirrors.
    fn after(mut watch: LightWatch, reports: u64, ratio: f64) -> LightWatch {
        for report in 0..reports {
            watch.handle(Received { mirrors: Some((0, ratio)), direct: None }, report);
        }
        watch
    }

    #[test]
    fn the_light_of_mirrors_that_were_dead_for_an_hour_returns_within_a_minute() {
        const RATE: u64 = 50;
        let dead = after(LightWatch::new(1), 3600 * RATE, 0.0);
        assert!(dead.mirrors().off_since_ns().is_some() && dead.mirrors().ratio() > 0.3);
        let repaired = after(dead, 60 * RATE, 1.01);
        assert!(repaired.mirrors().off_since_ns().is_none(), "{:?}", repaired.mirrors());
    }

    #[test]
    fn a_level_is_known_when_it_could_have_shown_a_loss() {
        let watch = after(LightWatch::new(1), ENOUGH - 1, 0.5);
        assert!(!watch.mirrors().is_known() && watch.mirrors().off_since_ns().is_none());
        let watch = after(watch, 2, 0.5);
        assert!(watch.mirrors().is_known() && watch.mirrors().off_since_ns().is_some());
        assert!(!watch.leds()[0].is_known());
    }
}
