//! Means with confidence intervals: the only place in the workspace that computes them.
//!
//! A [`Spread`] also knows the bounds of its quantity. An interval by Student's t is symmetric, so it can
//! reach beyond them.

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// A quantity without bounds.
const UNBOUNDED: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

/// An end beyond a bound by less than this is at the bound.
const ROUNDING: f64 = 1e-9;

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
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let place = share * last as f64;
    let below = place as usize;
    let above = (below + 1).min(last);
    sorted[below] + (place - below as f64) * (sorted[above] - sorted[below])
}

/// A quantity over all states. In JSON a missing number, such as the rate of blocked users without
/// such a user, is null.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// The mean.
    pub mean: f64,
    /// Half the width of the mean's 95 % interval by Student's t; NaN for a single group.
    pub ci95: f64,
    /// The 5th percentile over states.
    pub p5: f64,
    /// Whether the interval reaches beyond a bound that the quantity has by its definition, such as
    /// 0 for a rate: there are too few groups, or they differ too much, for this interval.
    #[serde(skip_serializing_if = "is_false")]
    pub crosses_bound: bool,
    /// The smallest and the largest value that the quantity can have.
    #[serde(skip)]
    pub bounds: [f64; 2],
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "the signature that serde expects")]
fn is_false(value: &bool) -> bool {
    !value
}

impl Spread {
    /// A quantity without values.
    pub const MISSING: Self =
        Self { mean: f64::NAN, ci95: f64::NAN, p5: f64::NAN, crosses_bound: false, bounds: UNBOUNDED };

    /// The quantity from values in independent groups, of one run or of several runs on the same
    /// groups; NaN is a missing value.
    ///
    /// The variance of the mean is that over groups plus, with several runs, that over runs. The
    /// two overlap, so the interval is conservative.
    pub fn of(runs: &[Vec<Vec<f64>>]) -> Self {
        let count = runs.iter().map(Vec::len).max().unwrap_or(0);
        let pooled = |index: usize| runs.iter().flat_map(|run| present(&run[index])).collect::<Vec<_>>();
        let groups: Vec<Vec<f64>> = (0..count).map(pooled).filter(|group| !group.is_empty()).collect();
        let means: Vec<f64> = groups.iter().map(|group| mean(group)).collect();
        let of_runs: Vec<f64> = runs.iter().map(|run| mean(&present(&run.concat()))).collect();
        let mut all = groups.concat();
        all.sort_by(f64::total_cmp);
        let interval = |means: &[f64]| Estimate::of(means).ci95;
        let over_runs = if of_runs.len() > 1 { interval(&of_runs) } else { 0.0 };
        let ci95 = if means.len() > 1 { interval(&means).hypot(over_runs) } else { f64::NAN };
        Self { mean: mean(&all), ci95, p5: quantile(&all, 0.05), ..Self::MISSING }
    }

    /// The same quantity, which has a smallest and a largest value by its definition.
    pub fn within(self, low: f64, high: f64) -> Self {
        let Self { mean, ci95, .. } = self;
        let beyond = mean - ci95 < low - ROUNDING || mean + ci95 > high + ROUNDING;
        Self { crosses_bound: (low..=high).contains(&mean) && beyond, bounds: [low, high], ..self }
    }

    /// Whether the interval includes 0; false without an interval.
    pub fn includes_zero(&self) -> bool {
        self.mean.abs() <= self.ci95
    }

    /// The ends of the interval, cut at the bounds of the quantity; NaN without an interval.
    pub fn ends(&self) -> [f64; 2] {
        let [low, high] = self.bounds;
        let cut = |end: f64| if (low..=high).contains(&self.mean) { end.clamp(low, high) } else { end };
        [cut(self.mean - self.ci95), cut(self.mean + self.ci95)]
    }
}

/// The median; NaN without values.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    quantile(&values, 0.5)
}

/// The values that are not missing.
pub fn present(values: &[f64]) -> Vec<f64> {
    values.iter().copied().filter(|value| !value.is_nan()).collect()
}

/// The mean; NaN without values.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
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

    /// 97.5 % quantiles of Student's t with one and three degrees of freedom.
    const T_1: f64 = 12.706204736174694;
    const T_3: f64 = 3.18244630528371;

    #[test]
    fn intervals_come_from_groups_and_missing_values_are_ignored() {
        let alone: Vec<Vec<f64>> = [1.0, 2.0, 3.0, 4.0].map(|value| vec![value]).into();
        let pairs = vec![vec![1.0, 2.0], vec![3.0, 4.0]];
        let of = |groups: &[Vec<f64>]| Spread::of(&[groups.to_vec()]);
        let (alone, pairs) = (of(&alone), of(&pairs));
        assert_eq!((alone.mean, pairs.mean, alone.p5), (2.5, 2.5, pairs.p5));
        // Standard errors: sqrt(5/3) / 2 of four values, sqrt(2) / sqrt(2) of two means.
        assert!((alone.ci95 - T_3 * (5.0_f64 / 3.0).sqrt() / 2.0).abs() < 1e-9);
        assert!((pairs.ci95 - T_1).abs() < 1e-9);
        let gap = of(&[vec![f64::NAN], vec![2.0], vec![4.0]]);
        assert_eq!(gap.mean, 3.0);
        assert!(of(&[vec![f64::NAN]]).mean.is_nan() && of(&[vec![1.0, 2.0]]).ci95.is_nan());
    }

    #[test]
    fn an_interval_includes_zero_where_its_half_width_is_not_smaller_than_the_mean() {
        let of = |values: &[f64]| Spread::of(&[values.iter().map(|value| vec![*value]).collect()]).includes_zero();
        assert!(!of(&[-1.0, -1.1, -0.9]) && !of(&[1.0, 1.0]) && of(&[1.0, -0.9, 0.5]) && of(&[0.0, 0.0]));
        assert!(!of(&[1.0]) && !of(&[0.0]) && !of(&[]), "no interval includes nothing");
    }

    #[test]
    fn the_spread_over_runs_widens_the_interval() {
        let run = |shift: f64| [1.0, 2.0, 3.0, 4.0].map(|value| vec![value + shift]).to_vec();
        let (one, same, apart) = (&[run(0.0)][..], &[run(0.0), run(0.0)][..], &[run(-1.0), run(1.0)][..]);
        let [one, same, apart] = [one, same, apart].map(Spread::of);
        assert_eq!((one.mean, one.ci95), (same.mean, same.ci95));
        // Over runs: a standard error of sqrt(2) / sqrt(2).
        assert_eq!(apart.mean, 2.5);
        assert!((apart.ci95 - one.ci95.hypot(T_1)).abs() < 1e-9 && apart.p5 < one.p5);
    }

    #[test]
    fn an_interval_beyond_the_bounds_of_its_quantity_is_marked_and_cut() {
        let share = |values: &[f64]| Spread::of(&[values.iter().map(|value| vec![*value]).collect()]).within(0.0, 1.0);
        let rare = share(&[0.0, 0.0, 0.2]);
        assert!(rare.crosses_bound && rare.ends()[0] == 0.0 && rare.ends()[1] > 0.2, "{rare:?}");
        let usual = share(&[0.4, 0.5, 0.6]);
        assert!(!usual.crosses_bound && usual.ends()[0] == usual.mean - usual.ci95, "{usual:?}");
        let frequent = share(&[1.0, 1.0, 0.8]);
        assert!(frequent.crosses_bound && frequent.ends()[1] == 1.0, "{frequent:?}");
        let certain = share(&[1.0, 1.0, 1.0]);
        assert!(!certain.crosses_bound && certain.ends() == [1.0, 1.0], "{certain:?}");
        let single = share(&[0.0]);
        assert!(!single.crosses_bound && single.ends()[0].is_nan(), "{single:?}");
        // The oracle is no proven optimum: a ratio above 1 keeps its interval.
        let above = share(&[1.02, 1.01]);
        assert!(!above.crosses_bound && above.ends()[1] > 1.02, "{above:?}");
        let text = |spread: &Spread| serde_json::to_string(spread).expect("an object");
        assert!(text(&rare).contains("crosses_bound") && !text(&usual).contains("crosses_bound"));
    }
}
