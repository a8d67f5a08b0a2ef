//! A user of an episode as it is and as the controller believes it to be, for a picture.

use heliostat_channel::Vec3;
use heliostat_channel::floor_normal::{principal_axes, squared_radius};
use heliostat_core::belief::Estimate;
use heliostat_room::world::walker::Walker;
use nalgebra::{Rotation2, Vector2};

/// A user at an instant, and what the controller predicted for this instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedUser {
    /// Number of the user.
    pub user: u32,
    /// Time in s since the controller's start.
    pub after_s: f64,
    /// True x and y in m.
    pub true_m: [f64; 2],
    /// The direction in which the user faces: a unit vector.
    pub true_heading: [f64; 2],
    /// Predicted x and y in m.
    pub believed_m: [f64; 2],
    /// Covariance of the prediction in m2: xx, xy, yy.
    pub covariance_m2: [f64; 3],
    /// The believed heading: a unit vector, or zero while unknown.
    pub believed_heading: [f64; 2],
}

impl TrackedUser {
    /// The number of a user and a time, truth and prediction, and the believed heading.
    pub(super) fn new((user, after_s): (u32, f64), (truth, estimate): (&Walker, &Estimate), heading: &Vec3) -> Self {
        Self {
            user,
            after_s,
            true_m: [truth.position.x, truth.position.y],
            true_heading: truth.direction,
            believed_m: [estimate.position.x, estimate.position.y],
            covariance_m2: estimate.position_cov_m2,
            believed_heading: [heading.x, heading.y],
        }
    }

    /// The edge of the ellipse that contains the true place with this probability, as points in m.
    pub fn ellipse(&self, probability: f64, points: usize) -> Vec<[f64; 2]> {
        let (deviations_m, angle) = principal_axes(self.covariance_m2);
        let [along, across] = deviations_m.map(|deviation| squared_radius(probability).sqrt() * deviation);
        let turn = Rotation2::new(angle);
        let point = |index: usize| {
            let (sine, cosine) = (index as f64 / points as f64 * std::f64::consts::TAU).sin_cos();
            (Vector2::from(self.believed_m) + turn * Vector2::new(along * cosine, across * sine)).into()
        };
        (0..=points).map(point).collect()
    }
}

#[cfg(test)]
mod tests {
    use heliostat_channel::floor_normal::squared_distance;

    use super::*;

    #[test]
    fn each_point_of_an_ellipse_has_the_same_distance_in_standard_deviations() {
        let [xx, xy, yy] = [0.04, 0.01, 0.02];
        let user = TrackedUser {
            user: 0,
            after_s: 0.0,
            true_m: [0.0; 2],
            true_heading: [1.0, 0.0],
            believed_m: [1.0, -2.0],
            covariance_m2: [xx, xy, yy],
            believed_heading: [0.0; 2],
        };
        let edge = user.ellipse(0.95, 16);
        assert_eq!(edge.len(), 17);
        for [x, y] in edge {
            let [x, y] = [x - 1.0, y + 2.0];
            let squared = squared_distance([x, y], [xx, xy, yy]).expect("a positive definite covariance");
            // The table of the chi-squared distribution with two degrees of freedom.
            assert!((squared - 5.991_465).abs() < 1e-5, "{squared}");
        }
    }
}
