//! How good a belief itself is, over the episodes of a comparison.

use serde::Serialize;

use super::belief_log::Errors;
use heliostat_environment::statistics::{Spread, median};

/// The quality of a belief over the episodes of a comparison. An interval is over episodes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BeliefQuality {
    /// Median distance on the floor from the predicted to the true place, in cm.
    pub place_error_median_cm: f64,
    /// Mean of that distance in cm.
    pub place_error_cm: Spread,
    /// Mean angle between believed and true heading of users who walk, in degrees.
    pub heading_error_walking_deg: Spread,
    /// The same of users who stand: below 0.05 m/s.
    pub heading_error_standing_deg: Spread,
    /// Share of true places within the ellipse that should contain 50 % of them; missing for a
    /// belief without a covariance.
    pub coverage_50: Spread,
    /// The same for 95 %.
    pub coverage_95: Spread,
}

/// The quality over episodes.
pub(super) fn quality(episodes: &[Errors]) -> BeliefQuality {
    let spread = |values: fn(&Errors) -> &Vec<f64>| Spread::of(&[episodes.iter().map(values).cloned().collect()]);
    let places = episodes.iter().flat_map(|errors| errors.place_cm.iter().copied());
    BeliefQuality {
        place_error_median_cm: median(places.collect()),
        place_error_cm: spread(|errors| &errors.place_cm).within(0.0, f64::INFINITY),
        heading_error_walking_deg: spread(|errors| &errors.walking_deg).within(0.0, 180.0),
        heading_error_standing_deg: spread(|errors| &errors.standing_deg).within(0.0, 180.0),
        coverage_50: spread(|errors| &errors.within_50).within(0.0, 1.0),
        coverage_95: spread(|errors| &errors.within_95).within(0.0, 1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_have_an_interval_over_episodes_and_missing_errors_have_no_figure() {
        let episode = |place_cm: &[f64]| Errors { place_cm: place_cm.to_vec(), ..Errors::default() };
        let quality = quality(&[episode(&[1.0, 3.0]), episode(&[2.0, 4.0, 6.0])]);
        assert_eq!((quality.place_error_median_cm, quality.place_error_cm.mean), (3.0, 3.2));
        // The means of the episodes are 2 and 4; the quantile of Student's t is 12.706.
        assert!((quality.place_error_cm.ci95 - 12.706_204_736).abs() < 1e-6, "{quality:?}");
        assert!(quality.coverage_50.mean.is_nan() && quality.heading_error_standing_deg.mean.is_nan());
    }
}
