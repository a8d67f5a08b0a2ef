//! Mirror gain by the law of reflection: the image of the LED in a tilted mirror.
//!
//! The mirror forms an image of the LED behind its plane, at the length of the reflected path. The
//! gain is that of eq. (1) for the image, times the reflectivity, if the line from the detector to
//! the image passes through the mirror's rectangle. Otherwise the gain is zero. The model has no
//! scattering and no diffraction: a mirror is about 1e5 wavelengths wide.
//!
//! These functions treat one mirror and one path and are the reference;
//! [`Scene`](crate::scene::Scene) computes the same gains for all users and mirrors in one pass.
//!
//! ```
//! use heliostat_channel::{geometry::Vec3, specular};
//!
//! // The normal that reflects a vertical ray into a horizontal one bisects the two directions.
//! let mirror = Vec3::new(0.0, 2.5, 2.0);
//! let (led, detector) = (Vec3::new(0.0, 2.5, 3.0), Vec3::new(0.0, 1.5, 2.0));
//! let normal = specular::bisector(&mirror, &led, &detector).expect("the points are not in line");
//! assert!((normal - Vec3::new(0.0, -1.0, 1.0).normalize()).norm() < 1e-12);
//! ```

use crate::arrays::MirrorArrays;
use crate::emitter::{Led, lambertian};
use crate::geometry::{GeometryError, Vec3, finite_point};
use crate::los::front_factor;
use crate::receiver::{Branch, Receiver};

/// One mirror at one orientation: a rectangle that reflects on one side.
#[derive(Clone, Debug, PartialEq)]
pub struct Plate {
    /// Centre in m.
    pub centre: Vec3,
    /// Unit normal of the reflecting side.
    pub normal: Vec3,
    /// Unit vector along the width: horizontal, since a mirror yaws first and then rolls about its
    /// own width.
    pub width_axis: Vec3,
    /// Unit vector along the height.
    pub height_axis: Vec3,
    /// Half of the width in m.
    pub half_width_m: f64,
    /// Half of the height in m.
    pub half_height_m: f64,
}

/// The reflected path from a point source by way of a mirror to a detector.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// Total length D1 + D2 in m.
    pub length_m: f64,
    /// Cosine of the irradiance angle at the source, which faces down; negative above the source.
    pub irradiance_cosine: f64,
    /// Unit vector from the detector to the image of the source, and so to the point of reflection.
    pub towards_mirror: Vec3,
}

impl Plate {
    /// Mirror `index` of the arrays at these mechanical angles in radians.
    ///
    /// # Panics
    /// When there is no such mirror.
    pub fn of(mirrors: &MirrorArrays, index: usize, roll: f64, yaw: f64) -> Self {
        let array = mirrors.array_of(index);
        let normal = array.normal(roll, yaw);
        let width_axis = array.room_from_wall(&Vec3::new(yaw.cos(), -yaw.sin(), 0.0));
        Self {
            centre: mirrors.positions()[index],
            normal,
            width_axis,
            height_axis: width_axis.cross(&-normal),
            half_width_m: 0.5 * array.spec().mirror_width_m,
            half_height_m: 0.5 * array.spec().mirror_height_m,
        }
    }

    /// Mirror `index` of the arrays with this unit normal.
    ///
    /// # Panics
    /// When there is no such mirror.
    #[inline(always)]
    pub fn facing(mirrors: &MirrorArrays, index: usize, normal: &Vec3) -> Self {
        let array = mirrors.array_of(index);
        // Horizontal and perpendicular to the normal; for a vertical normal, the direction of the
        // wall.
        let width_axis = Vec3::new(-normal.y, normal.x, 0.0)
            .try_normalize(1e-12)
            .unwrap_or_else(|| array.room_from_wall(&Vec3::x()));
        Self {
            centre: mirrors.positions()[index],
            normal: *normal,
            width_axis,
            height_axis: width_axis.cross(&-normal),
            half_width_m: 0.5 * array.spec().mirror_width_m,
            half_height_m: 0.5 * array.spec().mirror_height_m,
        }
    }

    /// Mirror image of a point: S' = S - 2 ((S - p) . n) n, with the mirror's centre p and normal
    /// n. Units: m.
    pub fn image(&self, point: &Vec3) -> Vec3 {
        point - 2.0 * (point - self.centre).dot(&self.normal) * self.normal
    }

    /// The reflected path from a point source S to a detector R.
    ///
    /// With the heights a = (S - p) . n and b = (R - p) . n above the mirror's plane, the ray meets
    /// the plane at (a R + b S) / (a + b), projected on the mirror's axes. `None` where that point
    /// is outside the rectangle, or where a or b is not positive.
    pub fn path(&self, source: &Vec3, detector: &Vec3) -> Option<Path> {
        let to_source = source - self.centre;
        let to_detector = detector - self.centre;
        let source_height = to_source.dot(&self.normal);
        let detector_height = to_detector.dot(&self.normal);
        if !(source_height > 0.0 && detector_height > 0.0) {
            return None;
        }
        let heights = source_height + detector_height;
        let hit = |axis: &Vec3| source_height * to_detector.dot(axis) + detector_height * to_source.dot(axis);
        let inside = hit(&self.width_axis).abs() <= self.half_width_m * heights
            && hit(&self.height_axis).abs() <= self.half_height_m * heights;
        if !inside {
            return None;
        }
        let towards_image = self.image(source) - detector;
        let length = towards_image.norm();
        let towards_mirror = towards_image / length;
        // The direction from the mirror to the source is the reflection of the direction of the
        // outgoing ray.
        let towards_source = towards_mirror - 2.0 * towards_mirror.dot(&self.normal) * self.normal;
        Some(Path { length_m: length, irradiance_cosine: towards_source.z, towards_mirror })
    }
}

/// Channel gain of one unblocked path from one LED by way of one mirror to one branch of a
/// receiver.
///
/// H = rho (n + 1) A_r cos^n(irradiance_angle) cos(incidence_angle) T_s g / (2 pi (D1 + D2)^2)
/// where the ray meets the mirror's rectangle and arrives within the field of view, zero elsewhere;
/// averaged over the points of the panel.
///
/// Source: paper eq. (1) for the image of the LED. The paper calls its mirrors completely specular,
/// but its equations are those of a diffuse reflector (see [`diffuse`](crate::diffuse)).
/// Units: positions in m, areas in m2; the gain is dimensionless.
///
/// # Errors
/// [`GeometryError::NotFinite`] when a coordinate of the detector is not finite.
pub fn gain(
    led: &Led,
    plate: &Plate,
    reflectivity: f64,
    (receiver, branch): (&Receiver, &Branch),
    detector: &Vec3,
) -> Result<f64, GeometryError> {
    finite_point("the position of a detector", detector)?;
    let order = led.lambertian_order();
    let points = led.points();
    let sum: f64 = points
        .iter()
        .filter_map(|point| plate.path(point, detector))
        .map(|path| received(&path, order) * detected(&path.towards_mirror, branch))
        .sum();
    let front = reflectivity * front_factor(order, receiver) * receiver.concentrator_gain(branch);
    Ok(front * sum / points.len() as f64)
}

/// cos^n(irradiance_angle) / D^2 in 1/m2; zero above the LED's plane.
#[inline]
pub(crate) fn received(path: &Path, order: f64) -> f64 {
    if path.irradiance_cosine > 0.0 {
        lambertian(path.irradiance_cosine, order) / (path.length_m * path.length_m)
    } else {
        0.0
    }
}

/// Cosine of the incidence angle on a branch, zero outside its field of view.
#[inline]
pub(crate) fn detected(towards_mirror: &Vec3, branch: &Branch) -> f64 {
    let incidence_cosine = towards_mirror.dot(&branch.normal);
    if incidence_cosine > 0.0 && incidence_cosine >= branch.fov_cosine() { incidence_cosine } else { 0.0 }
}

/// Unit normal of the mirror that reflects light from a source to a detector.
///
/// n = (u_source + u_detector) / |u_source + u_detector|, with the unit vectors from the mirror to
/// the source and to the detector. `None` where two of the points coincide, or where the mirror is
/// on the line between source and detector.
///
/// Source: law of reflection. Units: positions in m.
#[inline(always)]
pub fn bisector(mirror: &Vec3, source: &Vec3, detector: &Vec3) -> Option<Vec3> {
    let to_source = (source - mirror).try_normalize(1e-9)?;
    let to_detector = (detector - mirror).try_normalize(1e-9)?;
    (to_source + to_detector).try_normalize(1e-9)
}
