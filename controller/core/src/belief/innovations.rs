//! How well the predicted positions agree with the reported ones.

use heliostat_channel::floor_normal::squared_distance;

use crate::belief::motion::MotionEstimate;

/// Normalised innovation squared of the position reports of known users since the start. A report that
/// gives an old number to another user does not count.
///
/// d' S^-1 d for the deviation d of a reported position from the predicted one, where S is the
/// covariance of the prediction plus that of the report. Its mean is 2 if both are right.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Innovations {
    /// Number of reported positions.
    pub count: u64,
    /// Sum of their normalised innovations squared.
    pub sum: f64,
}

impl Innovations {
    /// Adds a normalised innovation squared; one that is not finite does not count.
    pub(super) fn add(&mut self, squared: f64) {
        if squared.is_finite() {
            self.count += 1;
            self.sum += squared;
        }
    }
}

/// The normalised innovation squared of the reported x and y in m, whose noise has this standard
/// deviation in m; `None` where S is not positive definite.
pub(super) fn normalised_squared(predicted: &MotionEstimate, reported_m: [f64; 2], noise_m: f64) -> Option<f64> {
    let [xx, xy, yy] = predicted.position_cov_m2;
    let noise = noise_m * noise_m;
    let away_m = [0, 1].map(|axis| reported_m[axis] - predicted.position_m[axis]);
    squared_distance(away_m, [xx + noise, xy, yy + noise])
}
