//! Gains of a block of mirrors, each aimed at one detector, where neither the mirror nor the field
//! of view truncates the panel.
//!
//! The evaluation of [`add_reflected`](super::kernel::add_reflected) simplifies for an aimed
//! mirror. With the unit vectors p and d from the mirror to the panel's centre and to the detector,
//! and the distances P and D:
//! - the normal is n = (p + d) / |p + d|, and n . p = n . d = |p + d| / 2;
//! - the image of the detector is on the line through mirror and panel, at P + D from the panel;
//! - the central ray meets the mirror at its centre;
//! - the incidence cosine of the panel's centre on a branch of normal b is -d . b.
//!
//! [`Aimed::complete`] marks the mirrors that reflect the complete panel. The caller evaluates the
//! others exactly.

use crate::arrays::Surfaces;
use crate::geometry::Vec3;
use crate::model::{ChannelModel, Detector, Panel};
use crate::trig::{BLOCK, Lanes};

/// Margin for rounding in m: a detector that faces away by less may still see a point.
const ROUNDING_M: f64 = 1e-9;

/// The mirrors, aimed.
pub(super) struct Aimed<'a> {
    /// Lanes in which the complete panel is reflected to the detector, at a distance at which the
    /// eight points may be used.
    pub complete: [bool; BLOCK],
    /// Lanes in which no branch so far faces any point of the panel.
    pub dark: [bool; BLOCK],
    normal: [Lanes; 3],
    /// Unit vector from mirror to detector.
    to_detector: [Lanes; 3],
    /// From the image of the detector to the panel's centre, in m.
    towards_panel: [Lanes; 3],
    /// Its length.
    length: Lanes,
    /// Upper bound of its square, for any point of the panel.
    farthest_squared: Lanes,
    surfaces: &'a Surfaces,
}

impl<'a> Aimed<'a> {
    /// The mirrors from index `first` on, aimed at a detector.
    #[inline(always)]
    pub fn new(model: &'a ChannelModel, panel: &Panel, first: usize, detector: &Vec3) -> Self {
        let mirrors = &model.mirrors;
        let surfaces = mirrors.surfaces(first / BLOCK);
        let centre = mirrors.block(first / BLOCK);
        let to_panel = [0, 1, 2].map(|axis: usize| &panel.direction[axis][first / BLOCK]);
        let panel_distance = &panel.distance[first / BLOCK];
        let half = panel.half_side;
        let zero = [0.0; BLOCK];
        let mut aimed = Self {
            complete: [false; BLOCK],
            dark: [true; BLOCK],
            normal: [zero; 3],
            to_detector: [zero; 3],
            towards_panel: [zero; 3],
            length: zero,
            farthest_squared: zero,
            surfaces,
        };
        for lane in 0..BLOCK {
            let to_target = [0, 1, 2].map(|axis: usize| detector[axis] - centre[axis][lane]);
            let distance =
                (to_target[0] * to_target[0] + to_target[1] * to_target[1] + to_target[2] * to_target[2]).sqrt();
            let to_detector = to_target.map(|part| part / distance);
            let sum = [0, 1, 2].map(|axis: usize| to_panel[axis][lane] + to_detector[axis]);
            let sum_length = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]).sqrt();
            let normal = sum.map(|part| part / sum_length);
            let cosine = 0.5 * sum_length;
            let (panel_above, detector_above) = (panel_distance[lane] * cosine, distance * cosine);

            // The mirror's axes; the first is horizontal.
            let level = 1.0 / (normal[0] * normal[0] + normal[1] * normal[1]).sqrt();
            let width = [-normal[1] * level, normal[0] * level];
            let height = [-width[1] * normal[2], width[0] * normal[2], width[1] * normal[0] - width[0] * normal[1]];
            let across = to_target[0] * width[0] + to_target[1] * width[1];
            let up = to_target[0] * height[0] + to_target[1] * height[1] + to_target[2] * height[2];
            // Largest change of the weighted point of reflection over the panel; it is zero for the
            // panel's centre.
            let spread = |along: f64, axis: [f64; 2]| {
                let [x, y] = [0, 1].map(|part: usize| along * normal[part] + detector_above * axis[part]);
                half * (x.abs() + y.abs())
            };
            let least_height = panel_above - half * (normal[0].abs() + normal[1].abs());
            let room = least_height + detector_above;
            let length = panel_distance[lane] + distance;
            let towards_panel = [0, 1, 2].map(|axis: usize| length * to_panel[axis][lane]);
            let (far_x, far_y) = (towards_panel[0].abs() + half, towards_panel[1].abs() + half);

            // A NaN fails every comparison.
            aimed.complete[lane] = (least_height > 0.0)
                & (towards_panel[2] > 0.0)
                & (spread(across, width) <= surfaces.half_width[lane] * room)
                & (spread(up, [height[0], height[1]]) <= surfaces.half_height[lane] * room)
                & (length * length >= panel.few_from_squared);
            aimed.length[lane] = length;
            aimed.farthest_squared[lane] = far_x * far_x + far_y * far_y + towards_panel[2] * towards_panel[2];
            for axis in 0..3 {
                aimed.normal[axis][lane] = normal[axis];
                aimed.to_detector[axis][lane] = to_detector[axis];
                aimed.towards_panel[axis][lane] = towards_panel[axis];
            }
        }
        aimed
    }

    /// Gain of each mirror on a branch, for Lambertian order 1; clears `dark` where the branch may face
    /// the panel, and `complete` where the field
    /// of view truncates the panel.
    ///
    /// rho (n + 1) A_r T_s g / (2 pi) times the mean of cos(irradiance_angle) cos(incidence_angle)
    /// / (D1 + D2)^2 over the panel.
    #[inline(always)]
    pub fn gains(&mut self, panel: &Panel, branch: &Detector) -> Lanes {
        let least_squared = branch.fov_cosine * branch.fov_cosine;
        let (mut seen, mut slope_x, mut slope_y) = ([0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK]);
        for lane in 0..BLOCK {
            let dot = |of: &[Lanes; 3]| {
                of[0][lane] * branch.normal.x + of[1][lane] * branch.normal.y + of[2][lane] * branch.normal.z
            };
            let twice = 2.0 * dot(&self.normal);
            slope_x[lane] = branch.normal.x - twice * self.normal[0][lane];
            slope_y[lane] = branch.normal.y - twice * self.normal[1][lane];
            seen[lane] = -self.length[lane] * dot(&self.to_detector);
            let spread = panel.half_side * (slope_x[lane].abs() + slope_y[lane].abs());
            let (least, most) = (seen[lane] - spread, seen[lane] + spread);
            self.dark[lane] &= most < -ROUNDING_M;
            self.complete[lane] &= (least > 0.0) & (least * least >= least_squared * self.farthest_squared[lane]);
        }
        let [x, y, z] = &self.towards_panel;
        let mut sum = [0.0; BLOCK];
        for points in &panel.few_lanes {
            for ((dx, dy), weight) in points.x.iter().zip(&points.y).zip(&points.weight) {
                for lane in 0..BLOCK {
                    let (x, y) = (x[lane] + dx, y[lane] + dy);
                    let squared = x * x + y * y + z[lane] * z[lane];
                    let facing = seen[lane] + slope_x[lane] * dx + slope_y[lane] * dy;
                    sum[lane] += weight * facing / (squared * squared);
                }
            }
        }
        for lane in 0..BLOCK {
            let factor = self.surfaces.reflectivity[lane] * panel.front * branch.concentrator_gain;
            sum[lane] *= factor * z[lane];
        }
        sum
    }
}
