//! Mirrors as the paper computes them: eqs. (2) and (3).
//!
//! The paper speaks of complete specular reflection, but its eq. (2) is the gain of a small *diffusing* plate: it falls with the product
//! D1^2 D2^2, not with (D1 + D2)^2, and it changes with the cosine of the tilt, not with whether the ray arrives. It is here
//! to compare with the paper. Angles that are best under it bring nothing on a real mirror.
//!
//! How the symbols are read (the [`Reading`]s) is said in docs/physics.md.

use crate::Vec3;
use crate::emitter::{Led, lambertian};
use crate::mirrors::MirrorArray;
use crate::receiver::{Branch, Receiver};
use crate::specular::detected;
use std::f64::consts::PI;

/// What the angles of eqs. (2) and (3) are taken to mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// Eq. (3) is the cosine between mirror normal and direction to the user, so it stands for the irradiance cosine at the
    /// mirror; the incidence at the receiver is that of the ray on the detector, with the field-of-view gate on it.
    Sensible,
    /// Eq. (3) is cos(beta_km) as its left-hand side says, with the field-of-view gate on that angle; the irradiance angle at the mirror is
    /// measured from the wall's normal, and the receiver's own orientation does not matter.
    Literal,
}

/// Cosine of eq. (3): between the mirror's normal and the direction from the mirror to the user.
///
/// ((x_m - x_k) sin yaw cos roll + (y_m - y_k) cos yaw cos roll + (z_m - z_k) sin roll) / D, in the wall frame. Dimensionless;
/// negative when the mirror faces away.
///
/// Source: paper eq. (3).
pub fn tilt_cosine(mirrors: &MirrorArray, mirror: usize, (roll, yaw): (f64, f64), user: &Vec3) -> f64 {
    let from_user = mirrors.wall_from_room(&(mirrors.positions()[mirror] - user));
    let weighted =
        from_user.x * yaw.sin() * roll.cos() + from_user.y * yaw.cos() * roll.cos() + from_user.z * roll.sin();
    weighted / from_user.norm()
}

/// Half of eq. (2) that is the same for every user: (n + 1) rho dA cos^n(irradiance at the LED) cos(incidence at the mirror) / (2 pi^2 D1^2).
///
/// The incidence at the mirror is measured from the wall's normal. Averaged over the points of the panel; zero above the LED's plane.
/// Dimensionless.
pub fn illumination(led: &Led, mirrors: &MirrorArray, mirror: usize) -> f64 {
    let order = led.lambertian_order();
    let inward = mirrors.inward();
    let points = led.points();
    let sum: f64 = points
        .iter()
        .map(|point| {
            let towards_led = point - mirrors.positions()[mirror];
            let squared = towards_led.norm_squared();
            let distance = squared.sqrt();
            let irradiance_cosine = (towards_led.z / distance).max(0.0);
            let incidence_cosine = (towards_led.dot(&inward) / distance).max(0.0);
            lambertian(irradiance_cosine, order) * incidence_cosine / squared
        })
        .sum();
    let front = (order + 1.0) * mirrors.spec().reflectivity * mirrors.mirror_area_m2() / (2.0 * PI * PI);
    front * sum / points.len() as f64
}

/// The other half of eq. (2) without the cosine of eq. (3): A_r T_s g cos(the angle that does not turn) / D2^2.
///
/// That angle is the incidence at the receiver under [`Reading::Sensible`] and the irradiance from the wall's normal
/// under [`Reading::Literal`]. `from_user`: vector from the detector to the mirror in m; `inward`: the wall's normal. Dimensionless.
pub fn collection(reading: Reading, (receiver, branch): (&Receiver, &Branch), from_user: &Vec3, inward: &Vec3) -> f64 {
    let squared = from_user.norm_squared();
    let towards_mirror = from_user / squared.sqrt();
    let cosine = match reading {
        Reading::Sensible => detected(&towards_mirror, branch),
        Reading::Literal => (-towards_mirror.dot(inward)).max(0.0),
    };
    if cosine > 0.0 {
        receiver.detector_area_m2 * receiver.filter_gain * receiver.concentrator_gain(branch) * cosine / squared
    } else {
        0.0
    }
}

/// Channel gain of one mirror by eqs. (2) and (3), with nothing in the way: illumination times collection times the tilt cosine.
///
/// H = (n + 1) rho A_r dA cos^n cos(beta_ml) cos(irradiance at the mirror) cos(incidence) T_s g / (2 pi^2 D1^2 D2^2); zero when the mirror faces away.
///
/// Source: paper eqs. (2) and (3). Units: positions in m; the gain is dimensionless.
pub fn gain(
    reading: Reading,
    (led, mirrors, mirror): (&Led, &MirrorArray, usize),
    angles: (f64, f64),
    (receiver, branch): (&Receiver, &Branch),
    user: &Vec3,
) -> f64 {
    let from_user = mirrors.positions()[mirror] - user;
    let cosine = tilt_cosine(mirrors, mirror, angles, user);
    if !(cosine > 0.0 && cosine >= tilt_least(reading, branch.fov_cosine())) {
        return 0.0;
    }
    illumination(led, mirrors, mirror) * collection(reading, (receiver, branch), &from_user, &mirrors.inward()) * cosine
}

/// Smallest tilt cosine that brings light, besides being positive: the field-of-view gate, where the literal reading puts it there.
#[inline]
pub(crate) fn tilt_least(reading: Reading, fov_cosine: f64) -> f64 {
    match reading {
        Reading::Sensible => 0.0,
        Reading::Literal => fov_cosine,
    }
}
