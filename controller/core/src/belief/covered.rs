//! Whether a user's direct path is off for a reason that neither bodies nor obstacles explain: a
//! hand over the detector, a user without a device.

use serde::{Deserialize, Serialize};

/// Probability of a measurement that contradicts the state.
const WRONG: f64 = 0.02;

/// The probability that a user's direct path is off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Covered {
    probability: f64,
    prior: f64,
    /// Share of the difference from the prior that is lost with each report.
    change: f64,
}

impl Covered {
    /// Where the obstacles are known, any other blockage has such a reason, and lasts as long as it
    /// is measured.
    pub const KNOWN_OBSTACLES: Self = Self { probability: 0.5, prior: 0.5, change: 1.0 };

    /// Where they are not, a lasting one is rare.
    pub const UNKNOWN_OBSTACLES: Self = Self { probability: 0.005, prior: 0.005, change: 0.01 };

    /// Whether the values are probabilities: a recorded state may hold any numbers.
    pub(super) fn is_sound(&self) -> bool {
        [self.probability, self.prior, self.change].iter().all(|value| (0.0..=1.0).contains(value))
    }

    /// The probability.
    pub fn probability(&self) -> f64 {
        self.probability
    }

    /// The state may have changed since the last report.
    pub fn predict(&mut self) {
        self.probability += self.change * (self.prior - self.probability);
    }

    /// Takes whether the direct path was measured as clear; `clear` is the probability of that for
    /// a path that is not off.
    pub fn handle_direct(&mut self, is_clear: bool, clear: f64) {
        let clear = clear.clamp(WRONG, 1.0 - WRONG);
        let (off, on) = if is_clear { (WRONG, clear) } else { (1.0 - WRONG, 1.0 - clear) };
        let joint = self.probability * off;
        self.probability = joint / (joint + (1.0 - self.probability) * on);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn with_known_obstacles_each_measurement_counts_at_once() {
        let mut covered = Covered::KNOWN_OBSTACLES;
        for is_clear in [true, false, false, true] {
            covered.predict();
            covered.handle_direct(is_clear, 1.0);
            assert_eq!(covered.probability() < 0.5, is_clear);
        }
    }

    #[test]
    fn a_shadow_is_not_taken_for_a_covered_detector_until_it_lasts() {
        let mut covered = Covered::UNKNOWN_OBSTACLES;
        covered.handle_direct(false, 0.9);
        assert!(covered.probability() < 0.1);
        for _ in 0..3 {
            covered.predict();
            covered.handle_direct(false, 0.3);
        }
        assert!(covered.probability() < 0.25, "an obstacle explains it: {}", covered.probability());
        for _ in 0..3 {
            covered.predict();
            covered.handle_direct(false, 0.95);
        }
        assert!(covered.probability() > 0.9, "{}", covered.probability());
    }
}
