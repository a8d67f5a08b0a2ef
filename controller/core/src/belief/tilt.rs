//! The gains of a receiver that its user tilts towards the face, from those of an upright one.
//!
//! A detector without a limited field of view receives light in proportion to the cosine of its
//! incidence. For light from the unit direction d and a detector of normal n, the gain is
//!
//! H(n) = H(z) max(0, n . d) / d_z,
//!
//! with the gain H(z) of the upright detector. The direction enters by its slopes d_x / d_z and
//! d_y / d_z.

use heliostat_channel::{ChannelModel, Vec3};

use crate::belief::device::{AZIMUTH_SPREAD_RAD, Lean};

/// Standard deviation of the polar angle of a held device in rad: 7.7 degrees for users who sit and
/// 7.8 degrees for users who walk (Soltani et al., IEEE Trans. Commun. 67(3), 2019).
pub(super) const POLAR_SPREAD_RAD: f64 = 0.135;

/// The normal of a tilted detector, and its derivatives.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tilt {
    normal: Vec3,
    by_polar: Vec3,
    by_azimuth: Vec3,
    /// Share of the variance of both angles that is not known.
    unknown: f64,
}

impl Tilt {
    /// A detector whose polar angle has this sine and cosine, tilted towards the face of a user
    /// with this heading, a unit vector.
    pub fn towards_face((sine, cosine): (f64, f64), heading: &Vec3) -> Self {
        Self {
            normal: Vec3::new(-sine * heading.x, -sine * heading.y, cosine),
            by_polar: Vec3::new(-cosine * heading.x, -cosine * heading.y, -sine),
            by_azimuth: Vec3::new(sine * heading.y, -sine * heading.x, 0.0),
            unknown: 1.0,
        }
    }

    /// The detector of a device that leans so, of a user with this heading.
    pub fn of(lean: &Lean, heading: &Vec3) -> Self {
        let towards_face = Self::towards_face(lean.polar_rad.sin_cos(), heading);
        Self { normal: lean.normal(heading), unknown: 1.0 - lean.correlation.powi(2), ..towards_face }
    }

    /// Gain over that of the upright detector, for light from a direction of these slopes.
    #[inline]
    pub fn factor(&self, slopes: [f64; 2]) -> f64 {
        along(&self.normal, slopes).max(0.0)
    }

    /// Variance of that factor by the spread of the angles of held devices.
    pub fn factor_variance(&self, slopes: [f64; 2]) -> f64 {
        let by_polar = (POLAR_SPREAD_RAD * along(&self.by_polar, slopes)).powi(2);
        let by_azimuth = (AZIMUTH_SPREAD_RAD * along(&self.by_azimuth, slopes)).powi(2);
        self.unknown * (by_polar + by_azimuth)
    }
}

/// Whether the gains of a model's receiver follow from those of the upright one: a single detector
/// that faces up, with a field of view of a half-space.
pub(super) fn is_single_open_detector(model: &ChannelModel) -> bool {
    match &model.receiver.branches[..] {
        [only] => only.normal == Vec3::z() && only.fov_semi_angle >= std::f64::consts::FRAC_PI_2,
        _ => false,
    }
}

/// The slopes of the direction from a receiver to a point; 0 for a point at its height or below,
/// from which an upright detector receives nothing.
pub(super) fn slopes(from: &Vec3, to: &Vec3) -> [f64; 2] {
    let towards = to - from;
    if towards.z > 0.0 { [towards.x / towards.z, towards.y / towards.z] } else { [0.0; 2] }
}

#[inline]
fn along(vector: &Vec3, [x, y]: [f64; 2]) -> f64 {
    vector.z + vector.x * x + vector.y * y
}

#[cfg(test)]
mod tests {
    use heliostat_channel::{Orientation, Scene};
    use heliostat_scenario::Scenario;

    use super::*;

    fn model(overrides: &[&str]) -> ChannelModel {
        Scenario::builtin("hall").unwrap().with_overrides(overrides).unwrap().channel_model().unwrap()
    }

    #[test]
    fn the_factor_is_that_of_the_channel_model() {
        let model = model(&["led.side_m=0.0"]);
        let (place, polar_rad) = (Vec3::new(1.0, -0.7, 0.85), 0.6_f64);
        let direct = |held: Orientation| {
            let mut scene = Scene::new(&model, 1);
            scene.update_turned(&model, &[place], &[held], &[], &[false]);
            scene.los_gain()[0]
        };
        for azimuth in [0.0_f64, 1.0, 2.2, 3.9, 5.5] {
            let heading = -Vec3::new(azimuth.cos(), azimuth.sin(), 0.0);
            let factor =
                Tilt::towards_face(polar_rad.sin_cos(), &heading).factor(slopes(&place, &model.leds[0].position));
            let expected = direct(Orientation::from_polar_azimuth(polar_rad, azimuth)) / direct(Orientation::UPRIGHT);
            assert!((factor - expected).abs() < 1e-9, "{azimuth}: {factor} instead of {expected}");
        }
    }

    #[test]
    fn the_variance_is_that_of_a_small_change_of_each_angle() {
        let (polar_rad, azimuth, slopes) = (0.7_f64, 0.4_f64, [0.6, -0.3]);
        let factor = |polar_rad: f64, azimuth: f64| {
            Tilt::towards_face(polar_rad.sin_cos(), &Vec3::new(azimuth.cos(), azimuth.sin(), 0.0)).factor(slopes)
        };
        let step = 1e-5;
        let by_polar = (factor(polar_rad + step, azimuth) - factor(polar_rad - step, azimuth)) / (2.0 * step);
        let by_azimuth = (factor(polar_rad, azimuth + step) - factor(polar_rad, azimuth - step)) / (2.0 * step);
        let expected = (POLAR_SPREAD_RAD * by_polar).powi(2) + (AZIMUTH_SPREAD_RAD * by_azimuth).powi(2);
        let heading = Vec3::new(azimuth.cos(), azimuth.sin(), 0.0);
        let variance = Tilt::towards_face(polar_rad.sin_cos(), &heading).factor_variance(slopes);
        assert!((variance - expected).abs() < 1e-8, "{variance} instead of {expected}");
    }

    #[test]
    fn a_detector_that_faces_away_is_dark_and_one_with_a_narrow_field_of_view_does_not_follow() {
        let tilt = Tilt::towards_face(1.2_f64.sin_cos(), &Vec3::x());
        assert_eq!(tilt.factor([2.0, 0.0]), 0.0);
        assert!(is_single_open_detector(&model(&[])));
        assert!(!is_single_open_detector(&model(&["receiver.fov_deg=60"])));
        assert!(!is_single_open_detector(&model(&["receiver.preset=angle-diversity"])));
    }
}
