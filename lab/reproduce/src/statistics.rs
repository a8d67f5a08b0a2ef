//! From the values of several seeds to a mean with its interval; [`Estimate`] computes the interval.

use heliostat_learn::evaluation::Estimate;

use crate::figure::{Point, Series};
use crate::part::Curve;

/// The mean of independent values, and half the width of its 95 % interval; `None` for a single value.
///
/// # Panics
/// There is no value.
pub fn mean(values: &[f64]) -> (f64, Option<f64>) {
    assert!(!values.is_empty(), "a mean needs at least one value");
    let estimate = Estimate::of(values);
    (estimate.mean, (values.len() > 1).then_some(estimate.ci95))
}

/// The mean curve over seeds: at each x of the first curve, the mean of all curves that have a value there.
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
        // The 97.5 % quantile of Student's t with 2 degrees of freedom, times 1 / sqrt(3).
        assert!((half.unwrap() - 4.302652729749464 / 3.0_f64.sqrt()).abs() < 1e-9);
    }

    #[test]
    fn a_mean_curve_uses_the_values_that_exist() {
        let curve = |points: &[[f64; 2]]| Curve { group: String::new(), name: "flat".into(), points: points.to_vec() };
        let (one, other) = (curve(&[[0.0, 1.0], [1.0, 4.0]]), curve(&[[0.0, 3.0]]));
        let series = over_seeds("flat", &[&one, &other]).unwrap();
        assert_eq!((series.points[0].y, series.points[1].y, series.points[1].ci95), (2.0, 4.0, None));
    }
}
