//! Mirrors by the law of reflection: the image of the LED in a tilted mirror.
//!
//! A detector that looks into a mirror sees the LED's image behind it, at the distance that the light has travelled. It
//! receives what eq. (1) gives for that image, times the reflectivity, as long as the straight line to the image passes
//! through the mirror's rectangle; otherwise nothing. There is no scattering and no diffraction (a mirror is 1e5 wavelengths wide).
//!
//! The functions here treat one mirror and one path and are the reference; [`Scene`](crate::scene::Scene) computes the same for all
//! users and mirrors in one pass.

use crate::Vec3;
use crate::emitter::{Led, lambertian};
use crate::error::GeometryError;
use crate::los::front_factor;
use crate::mirrors::MirrorArray;
use crate::receiver::{Branch, Receiver};

/// One mirror at one orientation: a rectangle with a reflecting front.
#[derive(Clone, Debug, PartialEq)]
pub struct Plate {
    /// Centre in m.
    pub centre: Vec3,
    /// Unit normal of the reflecting side.
    pub normal: Vec3,
    /// Unit vector along the width: stays horizontal, since a mirror yaws first and rolls about its own width.
    pub width_axis: Vec3,
    /// Unit vector along the height.
    pub height_axis: Vec3,
    /// Half of the width in m.
    pub half_width_m: f64,
    /// Half of the height in m.
    pub half_height_m: f64,
}

/// The path from a point source over a mirror to a detector.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// Whole length D1 + D2 in m.
    pub length_m: f64,
    /// Cosine of the irradiance angle at the source, which faces down; negative above its plane.
    pub irradiance_cosine: f64,
    /// Unit vector from the detector towards the mirror.
    pub towards_mirror: Vec3,
}

impl Plate {
    /// Mirror `index` of the array at these angles (mechanical, rad).
    ///
    /// # Panics
    /// When the array has no such mirror.
    pub fn of(mirrors: &MirrorArray, index: usize, roll: f64, yaw: f64) -> Self {
        let normal = mirrors.normal(roll, yaw);
        let width_axis = mirrors.room_from_wall(&Vec3::new(yaw.cos(), -yaw.sin(), 0.0));
        Self {
            centre: mirrors.positions()[index],
            normal,
            width_axis,
            height_axis: width_axis.cross(&-normal),
            half_width_m: 0.5 * mirrors.spec().mirror_width_m,
            half_height_m: 0.5 * mirrors.spec().mirror_height_m,
        }
    }

    /// Mirror `index` of the array with a given unit normal.
    ///
    /// # Panics
    /// When the array has no such mirror.
    #[inline(always)]
    pub fn facing(mirrors: &MirrorArray, index: usize, normal: &Vec3) -> Self {
        // Horizontal and across the normal; a mirror that lies flat keeps the wall's own direction.
        let width_axis = Vec3::new(-normal.y, normal.x, 0.0)
            .try_normalize(1e-12)
            .unwrap_or_else(|| mirrors.room_from_wall(&Vec3::x()));
        Self {
            centre: mirrors.positions()[index],
            normal: *normal,
            width_axis,
            height_axis: width_axis.cross(&-normal),
            half_width_m: 0.5 * mirrors.spec().mirror_width_m,
            half_height_m: 0.5 * mirrors.spec().mirror_height_m,
        }
    }

    /// Image of a point in the mirror's plane, in m: S - 2 ((S - p) . n) n.
    pub fn image(&self, point: &Vec3) -> Vec3 {
        point - 2.0 * (point - self.centre).dot(&self.normal) * self.normal
    }

    /// The path from a point source to a detector, or `None` where the ray misses the mirror's rectangle or either end is behind it.
    ///
    /// With heights a = (S - p) . n and b = (R - p) . n above the mirror's plane, the ray meets the plane at the weighted mean
    /// (a R + b S) / (a + b), seen in the plane's own axes.
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
        // Where the light comes from, seen from the mirror: the mirrored direction.
        let towards_source = towards_mirror - 2.0 * towards_mirror.dot(&self.normal) * self.normal;
        Some(Path { length_m: length, irradiance_cosine: towards_source.z, towards_mirror })
    }
}

/// Channel gain of one mirror, from one LED to one branch of a receiver, with nothing in the way.
///
/// H = rho (n + 1) A_r cos^n(irradiance towards the image) cos(incidence) T_s g / (2 pi (D1 + D2)^2), where the ray hits the mirror
/// and arrives within the field of view, zero elsewhere; averaged over the points of the panel.
///
/// Source: eq. (1) for the image of the LED; the paper calls its mirrors completely specular but computes them as diffuse
/// (see [`diffuse`](crate::diffuse)).
/// Units: positions in m, areas in m2; the gain is dimensionless.
///
/// # Errors
/// [`GeometryError::NotFinite`] when a coordinate of the detector is not a number.
pub fn gain(
    led: &Led,
    plate: &Plate,
    reflectivity: f64,
    (receiver, branch): (&Receiver, &Branch),
    detector: &Vec3,
) -> Result<f64, GeometryError> {
    if !detector.iter().all(|coordinate| coordinate.is_finite()) {
        return Err(GeometryError::NotFinite { what: "the position of a detector" });
    }
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

/// cos^n(irradiance) / D^2 in 1/m2; zero above the LED's plane.
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

/// Unit normal that sends light from a source over a point to a detector: the bisector of the two directions.
///
/// `None` where the three points are in line (light cannot be turned back on itself) or two of them coincide.
#[inline(always)]
pub fn bisector(mirror: &Vec3, source: &Vec3, detector: &Vec3) -> Option<Vec3> {
    let to_source = (source - mirror).try_normalize(1e-9)?;
    let to_detector = (detector - mirror).try_normalize(1e-9)?;
    (to_source + to_detector).try_normalize(1e-9)
}
