//! The line-of-sight path from an LED to a detector: eq. (1).
//!
//! These functions treat one path and are the reference; [`Scene`](crate::scene::Scene) computes
//! the same gains for all users.
//!
//! ```
//! use heliostat_channel::{Branch, Combining, Led, Receiver, geometry::Vec3, los};
//!
//! let led = Led {
//!     position: Vec3::new(0.0, 0.0, 3.0),
//!     side_m: 0.0,
//!     points_per_side: 1,
//!     half_power_semi_angle: 60.0_f64.to_radians(),
//! };
//! let branch = Branch { normal: Vec3::z(), fov_semi_angle: 90.0_f64.to_radians() };
//! let receiver = Receiver {
//!     branches: vec![branch.clone()],
//!     detector_area_m2: 20e-6,
//!     filter_gain: 1.0,
//!     concentrator_index: None,
//!     combining: Combining::Best,
//! };
//! // Straight below the LED both angles are 0: H = 2 A_r / (2 pi D^2).
//! let los_gain = los::gain(&led, &receiver, &branch, &Vec3::new(0.0, 0.0, 1.0))?;
//! assert!((los_gain - 2.0 * 20e-6 / (2.0 * std::f64::consts::PI * 4.0)).abs() < 1e-18);
//! # Ok::<(), heliostat_channel::GeometryError>(())
//! ```

use crate::emitter::{Led, lambertian};
use crate::geometry::{GeometryError, Vec3, finite_point};
use crate::receiver::{Branch, Receiver};
use std::f64::consts::PI;

/// Channel gain of the unblocked line-of-sight path from one LED to one branch of a receiver.
///
/// H = (n + 1) A_r cos^n(irradiance_angle) cos(incidence_angle) T_s g / (2 pi D^2) for an incidence
/// angle within the field of view, zero outside it and behind the LED; averaged over the points of
/// the panel.
///
/// Source: paper eq. (1), with filter gain T_s and concentrator gain g (Table I).
/// Units: positions in m, area in m2; the gain is dimensionless.
///
/// # Errors
/// [`GeometryError::Coincident`] when a point of the LED and the detector share a point;
/// [`GeometryError::NotFinite`] when a coordinate of the detector is not finite.
pub fn gain(led: &Led, receiver: &Receiver, branch: &Branch, detector: &Vec3) -> Result<f64, GeometryError> {
    finite_point("the position of a detector", detector)?;
    let points = led.points();
    if points.contains(detector) {
        return Err(GeometryError::Coincident { what: "an LED and a detector" });
    }
    let order = led.lambertian_order();
    let sum: f64 =
        points.iter().map(|point| unit_gain(point, order, (&branch.normal, branch.fov_cosine()), detector)).sum();
    Ok(front_factor(order, receiver) * receiver.concentrator_gain(branch) * sum / points.len() as f64)
}

/// The gain of the unblocked line-of-sight path from one LED to an upright receiver: [`gain`] of each branch, combined.
///
/// # Errors
/// As [`gain`].
pub fn combined_gain(led: &Led, receiver: &Receiver, detector: &Vec3) -> Result<f64, GeometryError> {
    let gains = receiver.branches.iter().map(|branch| gain(led, receiver, branch, detector));
    Ok(receiver.combining.combine(&gains.collect::<Result<Vec<f64>, GeometryError>>()?))
}

/// (n + 1) A_r T_s / (2 pi) in m2: the common factor of the line-of-sight and the specular gain.
pub(crate) fn front_factor(order: f64, receiver: &Receiver) -> f64 {
    (order + 1.0) * receiver.detector_area_m2 * receiver.filter_gain / (2.0 * PI)
}

/// cos^n(irradiance_angle) cos(incidence_angle) / D^2 in 1/m2 for one point of an LED; zero outside
/// the field of view.
#[inline(always)]
pub(crate) fn unit_gain(point: &Vec3, order: f64, (normal, fov_cosine): (&Vec3, f64), detector: &Vec3) -> f64 {
    let towards_led = point - detector;
    let squared = towards_led.norm_squared();
    let distance = squared.sqrt();
    let irradiance_cosine = towards_led.z / distance;
    let incidence_cosine = towards_led.dot(normal) / distance;
    // A NaN, from a distance of zero or from a coordinate, fails every comparison.
    if irradiance_cosine > 0.0 && incidence_cosine > 0.0 && incidence_cosine >= fov_cosine {
        lambertian(irradiance_cosine, order) * incidence_cosine / squared
    } else {
        0.0
    }
}
