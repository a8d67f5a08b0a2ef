//! Mirror gain by the paper's eqs. (2) and (3), for comparison with the paper.
//!
//! The paper assumes complete specular reflection, but its eq. (2) is the gain of a small *diffuse*
//! reflector. The gain falls with D1^2 D2^2, not with (D1 + D2)^2, and varies with the cosine of
//! the tilt. The best angles under eq. (2) give no gain on a specular mirror.
//!
//! docs/physics.md compares the two interpretations of the symbols, see [`Reading`].
//!
//! ```
//! use heliostat_channel::{ArraySpec, MirrorArray, MirrorArrays, Wall, diffuse, geometry::Vec3};
//!
//! let mirrors: MirrorArrays = MirrorArray::new(&ArraySpec {
//!     rows: 1,
//!     columns: 1,
//!     mirror_width_m: 0.25,
//!     mirror_height_m: 0.10,
//!     gap_m: 0.02,
//!     centre_height_m: 2.0,
//!     wall: Wall::PlusY,
//!     wall_distance_m: 2.5,
//!     reflectivity: 0.95,
//! })?
//! .into();
//! // The cosine of eq. (3) is 1 for a user on the mirror's normal.
//! let user = Vec3::new(0.0, 0.5, 2.0);
//! assert_eq!(diffuse::tilt_cosine(&mirrors, 0, (0.0, 0.0), &user), 1.0);
//! # Ok::<(), heliostat_channel::ChannelError>(())
//! ```

use crate::arrays::MirrorArrays;
use crate::emitter::{Led, lambertian};
use crate::geometry::Vec3;
use crate::receiver::{Branch, Receiver};
use crate::specular::detected;
use std::f64::consts::PI;

/// How the angles of eqs. (2) and (3) are interpreted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// Eq. (3) is the irradiance cosine at the mirror, between its normal and the direction to the
    /// user. The incidence angle at the detector follows from the geometry, and the field of view
    /// limits it.
    Sensible,
    /// Eq. (3) is the incidence cosine cos(beta_km), as its left-hand side states, and the field of
    /// view limits that angle. The irradiance angle at the mirror is measured from the wall's
    /// normal. The detector's normal has no effect.
    Literal,
}

/// Cosine of the angle between the mirror's normal and the direction from the mirror to the user.
///
/// ((x_m - x_k) sin yaw cos roll + (y_m - y_k) cos yaw cos roll + (z_m - z_k) sin roll) / D2, in
/// the wall frame; negative when the mirror faces away from the user, not a number when mirror and
/// user share a point.
///
/// Source: paper eq. (3).
/// Units: roll and yaw mechanical, in radians, positions in m; the cosine is dimensionless.
pub fn tilt_cosine(mirrors: &MirrorArrays, mirror: usize, (roll, yaw): (f64, f64), user: &Vec3) -> f64 {
    let from_user = mirrors.array_of(mirror).wall_from_room(&(mirrors.positions()[mirror] - user));
    let weighted =
        from_user.x * yaw.sin() * roll.cos() + from_user.y * yaw.cos() * roll.cos() + from_user.z * roll.sin();
    weighted / from_user.norm()
}

/// The factor of eq. (2) for the path from the LED to the mirror.
///
/// (n + 1) rho dA cos^n(irradiance angle at the LED) cos(incidence angle at the mirror) / (2 pi^2
/// D1^2), with the incidence angle measured from the wall's normal; averaged over the points of the
/// panel, zero above the LED's plane.
///
/// Source: paper eq. (2). Units: positions in m, area in m2; the factor is dimensionless.
pub fn illumination(led: &Led, mirrors: &MirrorArrays, mirror: usize) -> f64 {
    let order = led.lambertian_order();
    let array = mirrors.array_of(mirror);
    let inward = array.inward();
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
    let front = (order + 1.0) * array.spec().reflectivity * array.mirror_area_m2() / (2.0 * PI * PI);
    front * sum / points.len() as f64
}

/// The factor of eq. (2) for the path from the mirror to the user, without the cosine of eq. (3).
///
/// A_r T_s g cos(angle) / D2^2. The angle is the incidence angle at the detector under
/// [`Reading::Sensible`]. Under [`Reading::Literal`] it is the irradiance angle at the mirror,
/// measured from the wall's normal.
///
/// `from_user`: vector from the detector to the mirror in m; `inward`: the wall's unit normal into
/// the room.
///
/// Source: paper eq. (2). Units: area in m2; the factor is dimensionless.
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

/// Channel gain of one unblocked path by way of one mirror: [`illumination`] times [`collection`]
/// times [`tilt_cosine`].
///
/// H = (n + 1) rho A_r dA cos^n(irradiance angle at the LED) cos(incidence angle at the mirror)
/// cos(irradiance angle at the mirror) cos(incidence angle at the detector) T_s g / (2 pi^2 D1^2
/// D2^2); zero when the mirror faces away.
///
/// Source: paper eqs. (2) and (3).
/// Units: angles mechanical, in radians, positions in m, areas in m2; the gain is dimensionless.
pub fn gain(
    reading: Reading,
    (led, mirrors, mirror): (&Led, &MirrorArrays, usize),
    angles: (f64, f64),
    (receiver, branch): (&Receiver, &Branch),
    user: &Vec3,
) -> f64 {
    let from_user = mirrors.positions()[mirror] - user;
    let cosine = tilt_cosine(mirrors, mirror, angles, user);
    if !(cosine > 0.0 && cosine >= tilt_least(reading, branch.fov_cosine())) {
        return 0.0;
    }
    let inward = mirrors.array_of(mirror).inward();
    illumination(led, mirrors, mirror) * collection(reading, (receiver, branch), &from_user, &inward) * cosine
}

/// Smallest tilt cosine with a gain: the literal interpretation applies the field of view to this
/// cosine.
#[inline]
pub(crate) fn tilt_least(reading: Reading, fov_cosine: f64) -> f64 {
    match reading {
        Reading::Sensible => 0.0,
        Reading::Literal => fov_cosine,
    }
}
