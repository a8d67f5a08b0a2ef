//! The two-dimensional normal distribution of a place on the floor.
//!
//! Its covariance is given by the elements xx, xy and yy in m^2. The squared distance in standard
//! deviations has a chi-squared distribution with two degrees of freedom.
//!
//! ```
//! use heliostat_channel::floor_normal::{principal_axes, squared_distance, squared_radius};
//!
//! let covariance_m2 = [0.04, 0.0, 0.01];
//! assert_eq!(principal_axes(covariance_m2), ([0.2, 0.1], 0.0));
//! let squared = squared_distance([0.2, 0.1], covariance_m2).expect("a positive definite covariance");
//! assert!((squared - 2.0).abs() < 1e-12 && squared < squared_radius(0.95));
//! ```

use nalgebra::{Matrix2, Vector2};

/// d' C^-1 d for a deviation d from the mean in m; `None` where C is not positive definite.
pub fn squared_distance(away_m: [f64; 2], [xx, xy, yy]: [f64; 3]) -> Option<f64> {
    let away = Vector2::from(away_m);
    let factor = Matrix2::new(xx, xy, xy, yy).cholesky()?;
    Some(away.dot(&factor.solve(&away)))
}

/// The squared distance in standard deviations within which a place lies with this probability.
pub fn squared_radius(probability: f64) -> f64 {
    -2.0 * (1.0 - probability).ln()
}

/// Standard deviations in m along the principal axes, the larger one first, and the angle in rad
/// between the x axis and the first.
///
/// They are the square roots of the eigenvalues of the covariance.
pub fn principal_axes([xx, xy, yy]: [f64; 3]) -> ([f64; 2], f64) {
    let (mean, half_spread) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
    let deviations = [mean + half_spread, mean - half_spread].map(|variance| variance.max(0.0).sqrt());
    (deviations, 0.5 * (2.0 * xy).atan2(xx - yy))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_in_standard_deviations_along_the_axes_of_the_ellipse() {
        assert!((squared_distance([0.3, 0.0], [0.09, 0.0, 1.0]).unwrap() - 1.0).abs() < 1e-9);
        // The inverse of [[2, 1], [1, 2]] is [[2, -1], [-1, 2]] / 3.
        let oblique = squared_distance([1.0, 1.0], [2.0, 1.0, 2.0]).unwrap();
        assert!((oblique - 2.0 / 3.0).abs() < 1e-9, "{oblique}");
        assert_eq!(squared_distance([1.0, 1.0], [1.0, 1.0, 1.0]), None);
        assert_eq!(squared_distance([0.0, 0.0], [f64::NAN, 0.0, 1.0]), None);
    }

    #[test]
    fn radii_are_those_of_the_chi_squared_distribution_with_two_degrees_of_freedom() {
        assert!((squared_radius(0.5) - 1.386_294).abs() < 1e-6 && (squared_radius(0.95) - 5.991_465).abs() < 1e-6);
    }
}
