//! The height of a user's detector: constant, with rare changes when a user sits down or rises.

use serde::{Deserialize, Serialize};

/// Variance in m2 that the height gains per second, so that a slow change is followed.
const DRIFT_M2_PER_S: f64 = 1e-4;

/// A report that deviates by more standard deviations than this starts the estimate again.
const CHANGE_DEVIATIONS: f64 = 5.0;

/// A Kalman filter for one constant.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Height {
    mean_m: f64,
    /// Variance in m2; 0 before the first report.
    variance: f64,
}

impl Height {
    /// Takes a reported height with this standard deviation, `elapsed_s` after the last one.
    pub fn correct(&mut self, elapsed_s: f64, reported_m: f64, noise_m: f64) {
        let noise = noise_m * noise_m;
        let predicted = self.variance + DRIFT_M2_PER_S * elapsed_s;
        let innovation = reported_m - self.mean_m;
        let deviates = innovation * innovation > CHANGE_DEVIATIONS * CHANGE_DEVIATIONS * (predicted + noise);
        if self.variance == 0.0 || deviates {
            *self = Self { mean_m: reported_m, variance: noise };
            return;
        }
        let gain = predicted / (predicted + noise);
        self.mean_m += gain * innovation;
        self.variance = predicted * (1.0 - gain);
    }

    /// Whether the numbers are those of a height: a recorded state may hold any.
    pub(super) fn is_sound(&self) -> bool {
        self.mean_m.is_finite() && self.variance >= 0.0 && self.variance.is_finite()
    }

    /// The estimate in m.
    pub fn mean_m(&self) -> f64 {
        self.mean_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_averages_out_and_a_user_who_sits_down_is_followed_at_once() {
        let mut height = Height::default();
        for index in 0..100 {
            height.correct(0.1, if index % 2 == 0 { 1.25 } else { 1.15 }, 0.05);
        }
        assert!((height.mean_m() - 1.2).abs() < 0.02, "{}", height.mean_m());
        height.correct(0.1, 0.7, 0.05);
        assert_eq!(height.mean_m(), 0.7);
    }
}
