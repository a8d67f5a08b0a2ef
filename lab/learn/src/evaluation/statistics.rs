//! Means with confidence intervals: the only place in the workspace that computes them.

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Probability below the upper end of a two-sided 95 % interval.
const UPPER: f64 = 0.975;

/// A mean with half the width of its 95 % interval by Student's t.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Half the width of the interval, in the unit of the mean; NaN for a single value.
    pub ci95: f64,
}

impl Estimate {
    /// The estimate from n independent values: mean and t s / sqrt(n).
    ///
    /// s is the standard deviation with n - 1 degrees of freedom, and t the 97.5 % quantile of
    /// Student's t distribution with n - 1 degrees of freedom.
    pub fn of(values: &[f64]) -> Self {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
        Self { mean, ci95: student_t(count - 1.0) * (variance / count).sqrt() }
    }
}

/// The 97.5 % quantile of Student's t distribution; NaN without a degree of freedom.
fn student_t(degrees_of_freedom: f64) -> f64 {
    StudentsT::new(0.0, 1.0, degrees_of_freedom).map_or(f64::NAN, |distribution| distribution.inverse_cdf(UPPER))
}

/// The quantile of sorted values, linear between them; NaN without values.
pub(crate) fn quantile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let place = share * last as f64;
    let below = place as usize;
    let above = (below + 1).min(last);
    sorted[below] + (place - below as f64) * (sorted[above] - sorted[below])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_linear_between_neighbours() {
        assert_eq!(quantile(&[1.0, 2.0, 3.0], 0.5), 2.0);
        assert_eq!(quantile(&[0.0, 10.0], 0.05), 0.5);
        assert_eq!(quantile(&[4.0], 0.99), 4.0);
        assert!(quantile(&[], 0.5).is_nan());
    }

    #[test]
    fn quantiles_match_closed_forms_and_tables() {
        // One degree of freedom: tan(pi (p - 1/2)). Two: x sqrt(2 / (1 - x^2)) with x = 2 p - 1.
        let closed = [(std::f64::consts::PI * 0.475).tan(), 0.95 * (2.0_f64 / (1.0 - 0.95 * 0.95)).sqrt()];
        for (degrees, expected) in [(1.0, closed[0]), (2.0, closed[1])] {
            assert!((student_t(degrees) - expected).abs() < 1e-9, "{degrees}: {}", student_t(degrees));
        }
        for (degrees, expected) in [(3.0, 3.182446), (10.0, 2.228139), (30.0, 2.042272), (60.0, 2.000298)] {
            assert!((student_t(degrees) - expected).abs() < 1e-6, "{degrees}: {}", student_t(degrees));
        }
        // Many degrees: z + (z^3 + z) / 4n + (5 z^5 + 16 z^3 + 3 z) / 96 n^2 with the normal
        // quantile z.
        let z = 1.959963984540054_f64;
        for (degrees, tolerance) in [(1e3, 1e-8), (1e4, 1e-10), (1e5, 1e-5)] {
            let first = (z.powi(3) + z) / (4.0 * degrees);
            let second = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / (96.0 * degrees * degrees);
            assert!((student_t(degrees) - (z + first + second)).abs() < tolerance, "{degrees}: {}", student_t(degrees));
        }
    }

    #[test]
    fn quantiles_decrease_without_a_jump() {
        let values: Vec<f64> = (1..200).map(|degrees| student_t(f64::from(degrees))).collect();
        assert!(values.windows(2).all(|pair| pair[1] < pair[0]));
        assert!(values[28..].windows(2).all(|pair| pair[0] - pair[1] < 0.01));
    }

    #[test]
    fn a_single_value_has_no_interval() {
        let estimate = Estimate::of(&[3.0]);
        assert!(estimate.mean == 3.0 && estimate.ci95.is_nan());
    }
}
