//! Densities of measured gains at expected ones.

use heliostat_channel::simd::with_widest_simd;

use crate::belief::{elementary::exp, heading::HEADINGS};

/// The same relative to the gain without any body: mirrors at the edge of a body.
const SPREAD_OF_CLEAR: f64 = 0.05;

/// Probability that something else explains a measured gain.
const UNEXPLAINED: f64 = 0.1;

/// What is expected of one measurement at each heading, in arrays that vectorise.
#[derive(Clone, Debug)]
pub(super) struct Densities {
    expected: [f64; HEADINGS],
    variance: [f64; HEADINGS],
    /// Whether anything is expected at the heading.
    is_expected: [bool; HEADINGS],
}

impl Default for Densities {
    fn default() -> Self {
        Self { expected: [1.0; HEADINGS], variance: [1.0; HEADINGS], is_expected: [false; HEADINGS] }
    }
}

impl Densities {
    /// Notes what is expected at a heading, with its variance.
    pub fn expect(&mut self, heading: usize, expected: f64, variance: f64) {
        self.expected[heading] = expected;
        self.variance[heading] = variance;
        self.is_expected[heading] = true;
    }

    /// Multiplies by the density of the measured value at each heading where one is expected.
    pub fn apply(&self, measured: f64, relative: f64, likelihood: &mut [f64; HEADINGS]) {
        if !self.is_expected.contains(&true) {
            return;
        }
        with_widest_simd(
            #[inline(always)]
            || {
                for (index, likelihood) in likelihood.iter_mut().enumerate() {
                    let density = density(measured, (self.expected[index], relative), self.variance[index]);
                    *likelihood *= if self.is_expected[index] { density } else { 1.0 };
                }
            },
        );
    }
}

/// Density of a measured gain at an expected one, which has this relative standard deviation; all
/// are shares of the same gain.
#[inline(always)]
pub(super) fn density(measured: f64, (expected, relative): (f64, f64), variance: f64) -> f64 {
    let scaled = relative * expected;
    let variance = scaled * scaled + SPREAD_OF_CLEAR * SPREAD_OF_CLEAR + variance;
    let deviation = measured - expected;
    let normal = exp(-0.5 * deviation * deviation / variance) / (variance * std::f64::consts::TAU).sqrt();
    (1.0 - UNEXPLAINED) * normal + UNEXPLAINED
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_heading_has_the_density_of_its_own_expectation_and_the_others_keep_their_likelihood() {
        let (mut densities, mut likelihood) = (Densities::default(), [0.5; HEADINGS]);
        densities.apply(0.8, 0.2, &mut likelihood);
        assert_eq!(likelihood, [0.5; HEADINGS], "nothing is expected");
        densities.expect(3, 0.8, 0.01);
        densities.expect(7, 0.2, 0.01);
        densities.apply(0.8, 0.2, &mut likelihood);
        let normal = |deviation: f64, variance: f64| {
            (-0.5 * deviation * deviation / variance).exp() / (std::f64::consts::TAU * variance).sqrt()
        };
        let expected = |deviation: f64, gain: f64| {
            let variance = (0.2 * gain).powi(2) + SPREAD_OF_CLEAR.powi(2) + 0.01;
            0.5 * (UNEXPLAINED + (1.0 - UNEXPLAINED) * normal(deviation, variance))
        };
        assert!((likelihood[3] - expected(0.0, 0.8)).abs() < 1e-12, "{likelihood:?}");
        assert!((likelihood[7] - expected(0.6, 0.2)).abs() < 1e-12, "{likelihood:?}");
        assert_eq!(likelihood.iter().filter(|one| **one == 0.5).count(), HEADINGS - 2);
    }
}
