//! From the values of several seeds to a mean with its interval.

use crate::figure::{Point, Series};
use crate::part::Curve;

/// Two-sided 95 % quantiles of Student's t distribution for 1 to 30 degrees of freedom.
const T_95: [f64; 30] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131, 2.120,
    2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
];

/// The mean of independent values, and half the width of its 95 % interval by Student's t; none for a single value.
///
/// # Panics
/// Without a value.
pub fn mean(values: &[f64]) -> (f64, Option<f64>) {
    assert!(!values.is_empty(), "a mean of nothing");
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    if values.len() == 1 {
        return (mean, None);
    }
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let quantile = T_95.get(values.len() - 2).copied().unwrap_or(1.96);
    (mean, Some(quantile * (variance / count).sqrt()))
}

/// The mean curve over seeds: at each place of the first curve, of all curves that have a value there.
pub fn over_seeds(name: &str, curves: &[&Curve]) -> Option<Series> {
    let first = curves.first()?;
    let value = |curve: &Curve, x: f64| curve.points.iter().find(|point| point[0] == x).map(|point| point[1]);
    let points = first.points.iter().map(|[x, _]| {
        let values: Vec<f64> = curves.iter().filter_map(|curve| value(curve, *x)).collect();
        let (y, ci95) = mean(&values);
        Point { x: *x, y, ci95, x_ci95: None }
    });
    Some(Series { name: name.into(), points: points.collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_seeds_have_wide_intervals_and_one_has_none() {
        assert_eq!(mean(&[3.0]), (3.0, None));
        let (centre, half) = mean(&[1.0, 2.0, 3.0]);
        assert_eq!(centre, 2.0);
        // t of 2 degrees of freedom times 1 / sqrt(3).
        assert!((half.unwrap() - 4.303 / 3.0_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_mean_curve_takes_the_values_that_there_are() {
        let curve = |points: &[[f64; 2]]| Curve { group: String::new(), name: "flat".into(), points: points.to_vec() };
        let (one, other) = (curve(&[[0.0, 1.0], [1.0, 4.0]]), curve(&[[0.0, 3.0]]));
        let series = over_seeds("flat", &[&one, &other]).unwrap();
        assert_eq!((series.points[0].y, series.points[1].y, series.points[1].ci95), (2.0, 4.0, None));
    }
}
