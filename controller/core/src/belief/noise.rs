//! Noise of the reports, estimated from the reports.
//!
//! The distance of a position from the line through the ones before and after it has a variance
//! between 1.5 s2 (equal intervals) and 2 s2 on a straight walk, and the first difference of two
//! velocities has 2 s2. Turns add a few large values, so the estimate uses the median: half of the
//! squared differences lie below 2 ln 2 times the variance.
//! The median of the stream is tracked by steps up and down, which no single value can upset.

use serde::{Deserialize, Serialize};

/// Relative step of the logarithm of the median per value: the estimate doubles or halves within
/// about 35 values of one sign, so it follows a wrong setting within some seconds.
const STEP: f64 = 0.02;

/// The standard deviation of one kind of noise.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct NoiseLevel {
    /// Variance of one axis.
    variance: f64,
    /// Bounds of the variance.
    bounds: [f64; 2],
}

impl NoiseLevel {
    /// Starts from a standard deviation, and stays within these bounds of it.
    pub fn new(first: f64, [least, largest]: [f64; 2]) -> Self {
        let first = first.clamp(least, largest);
        Self { variance: first * first, bounds: [least * least, largest * largest] }
    }

    /// Whether another level has the same bounds, and lies within them.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        self.bounds == other.bounds && (self.bounds[0]..=self.bounds[1]).contains(&other.variance)
    }

    /// Takes the square of a difference in the plane, which has `factor` times the variance of one
    /// report.
    pub fn handle(&mut self, squared: f64, factor: f64) {
        let median = 2.0 * std::f64::consts::LN_2 * factor * self.variance;
        let ratio = if squared > median { 1.0 + STEP } else { 1.0 / (1.0 + STEP) };
        self.variance = (self.variance * ratio).clamp(self.bounds[0], self.bounds[1]);
    }

    /// The estimate of the standard deviation of one axis.
    pub fn deviation(&self) -> f64 {
        self.variance.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_setting_is_replaced_by_the_spread_of_the_differences() {
        for (first, truth) in [(0.05, 0.2), (0.2, 0.05), (0.001, 0.05)] {
            let mut level = NoiseLevel::new(first, [1e-3, 1.0]);
            for index in 0..1000 {
                // Quantiles of the squared length of a circular normal vector: -2 ln(1 - q).
                let quantile = (index as f64 * 0.618_034).fract();
                level.handle(-2.0 * (1.0 - quantile).ln() * 6.0 * truth * truth, 6.0);
            }
            assert!((level.deviation() / truth - 1.0).abs() < 0.1, "{first}: {} for {truth}", level.deviation());
        }
    }

    #[test]
    fn one_jump_in_ten_hardly_changes_the_estimate() {
        let mut level = NoiseLevel::new(0.05, [1e-3, 1.0]);
        for index in 0..1000 {
            let quantile = (index as f64 * 0.618_034).fract();
            let jump = if index % 10 == 0 { 4.0 } else { 0.0 };
            level.handle(jump - 2.0 * (1.0 - quantile).ln() * 2.0 * 0.0025, 2.0);
        }
        assert!((level.deviation() / 0.05 - 1.0).abs() < 0.2, "{}", level.deviation());
    }
}
