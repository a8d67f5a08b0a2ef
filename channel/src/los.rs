//! The direct path from an LED to a detector: eq. (1).

use crate::Vec3;
use crate::emitter::{Led, lambertian};
use crate::error::GeometryError;
use crate::receiver::{Branch, Receiver};
use std::f64::consts::PI;

/// Channel gain of the direct path from one LED to one branch of a receiver, with nothing in the way.
///
/// H = (n + 1) A_r cos^n(irradiance) cos(incidence) T_s g / (2 pi D^2) for an incidence angle within the field of view,
/// zero outside it and behind the LED; averaged over the points of the panel.
///
/// Source: paper eq. (1), with filter gain T_s and concentrator gain g (Table I).
/// Units: positions in m, area in m2; the gain is dimensionless.
///
/// # Errors
/// [`GeometryError::Coincident`] when a point of the LED and the detector share a point;
/// [`GeometryError::NotFinite`] when a coordinate of the detector is not a number.
pub fn gain(led: &Led, receiver: &Receiver, branch: &Branch, detector: &Vec3) -> Result<f64, GeometryError> {
    if !detector.iter().all(|coordinate| coordinate.is_finite()) {
        return Err(GeometryError::NotFinite { what: "the position of a detector" });
    }
    let points = led.points();
    if points.contains(detector) {
        return Err(GeometryError::Coincident { what: "an LED and a detector" });
    }
    let order = led.lambertian_order();
    let sum: f64 =
        points.iter().map(|point| unit_gain(point, order, (&branch.normal, branch.fov_cosine()), detector)).sum();
    Ok(front_factor(order, receiver) * receiver.concentrator_gain(branch) * sum / points.len() as f64)
}

/// (n + 1) A_r T_s / (2 pi): what the direct and the specular gain share, in m2.
pub(crate) fn front_factor(order: f64, receiver: &Receiver) -> f64 {
    (order + 1.0) * receiver.detector_area_m2 * receiver.filter_gain / (2.0 * PI)
}

/// cos^n(irradiance) cos(incidence) / D^2 of one point of an LED within the field of view, zero elsewhere; in 1/m2.
#[inline(always)]
pub(crate) fn unit_gain(point: &Vec3, order: f64, (normal, fov_cosine): (&Vec3, f64), detector: &Vec3) -> f64 {
    let towards_led = point - detector;
    let squared = towards_led.norm_squared();
    let distance = squared.sqrt();
    let irradiance_cosine = towards_led.z / distance;
    let incidence_cosine = towards_led.dot(normal) / distance;
    // Written so that a distance of zero or a coordinate that is not a number fails the test.
    if irradiance_cosine > 0.0 && incidence_cosine > 0.0 && incidence_cosine >= fov_cosine {
        lambertian(irradiance_cosine, order) * incidence_cosine / squared
    } else {
        0.0
    }
}
