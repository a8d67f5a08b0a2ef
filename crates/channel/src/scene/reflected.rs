//! Gains of a block of mirrors at their angles for one detector, where neither the mirror nor the
//! field of view truncates the panel.
//!
//! The operations on each mirror are those of [`add_reflected`](super::kernel::add_reflected), in the
//! same order, so the gains are equal to the last bit. [`Reflected::complete`] marks the mirrors that
//! reflect the complete panel. The caller evaluates the others exactly.

use super::kernel::Turned;
use crate::geometry::Vec3;
use crate::model::{Detector, Panel};
use crate::trig::{BLOCK, Lanes};

/// The images of a detector in a block of mirrors.
pub(super) struct Reflected<'a> {
    /// Lanes in which the complete panel is reflected to the detector, at a distance at which the
    /// eight points may be used.
    pub complete: [bool; BLOCK],
    turned: &'a Turned<'a>,
    /// From the image of the detector to the panel's centre, in m.
    towards_panel: [Lanes; 3],
    /// Upper bound of the square of the distance from the image to any point of the panel.
    most_squared: Lanes,
}

impl<'a> Reflected<'a> {
    /// The images of a detector, if the panel has eight points for the mean; their gains are valid
    /// for Lambertian order 1.
    #[inline(always)]
    pub fn new(turned: &'a Turned<'a>, panel: &Panel, detector: &Vec3) -> Option<Self> {
        if panel.order != 1.0 || panel.few_lanes.is_empty() {
            return None;
        }
        let zero = [0.0; BLOCK];
        let mut reflected = Self { complete: [false; BLOCK], turned, towards_panel: [zero; 3], most_squared: zero };
        let half = panel.half_side;
        let spread = |x: f64, y: f64| half * (x.abs() + y.abs());
        for lane in 0..BLOCK {
            let part = |parts: &[Lanes; 3]| [parts[0][lane], parts[1][lane], parts[2][lane]];
            let (centre, normal) = (part(&turned.centre), part(&turned.normal));
            let width = [turned.width[0][lane], turned.width[1][lane], 0.0];
            let to_detector = [0, 1, 2].map(|axis: usize| detector[axis] - centre[axis]);
            let to_panel = [0, 1, 2].map(|axis: usize| panel.centre[axis] - centre[axis]);
            let detector_above = dot(&to_detector, &normal);
            let twice = 2.0 * detector_above;
            let towards = [0, 1, 2].map(|axis: usize| panel.centre[axis] - (detector[axis] - twice * normal[axis]));
            let above = dot(&to_panel, &normal);
            let least_height = above - spread(normal[0], normal[1]);
            let room = least_height + detector_above;
            let inside = |axis: &[f64; 3], half_length: f64| {
                let along = dot(&to_detector, axis);
                let centre = above * along + detector_above * dot(&to_panel, axis);
                let [x, y] = [0, 1].map(|part: usize| along * normal[part] + detector_above * axis[part]);
                centre.abs() + spread(x, y) <= half_length * room
            };
            let (far_x, far_y) = (towards[0].abs() + half, towards[1].abs() + half);
            let distance_squared = dot(&towards, &towards);
            // A NaN fails every comparison.
            reflected.complete[lane] = (detector_above > 0.0)
                & (towards[2] > 0.0)
                & (least_height > 0.0)
                & inside(&width, turned.surfaces.half_width[lane])
                & inside(&part(&turned.height), turned.surfaces.half_height[lane])
                & (distance_squared >= panel.few_from_squared);
            for (lanes, part) in reflected.towards_panel.iter_mut().zip(towards) {
                lanes[lane] = part;
            }
            reflected.most_squared[lane] = far_x * far_x + far_y * far_y + towards[2] * towards[2];
        }
        Some(reflected)
    }

    /// Gain of each mirror on a branch; clears `complete` where the field of view truncates the
    /// panel.
    #[inline(always)]
    pub fn gains(&mut self, panel: &Panel, branch: &Detector) -> Lanes {
        let branch_normal = [branch.normal.x, branch.normal.y, branch.normal.z];
        let least_squared = branch.fov_cosine * branch.fov_cosine;
        let (mut centre, mut slope_x, mut slope_y) = ([0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK]);
        for lane in 0..BLOCK {
            let normal = [0, 1, 2].map(|axis: usize| self.turned.normal[axis][lane]);
            let towards = [0, 1, 2].map(|axis: usize| self.towards_panel[axis][lane]);
            let twice = 2.0 * dot(&normal, &branch_normal);
            let turned = [0, 1, 2].map(|axis: usize| branch_normal[axis] - twice * normal[axis]);
            centre[lane] = dot(&towards, &turned);
            (slope_x[lane], slope_y[lane]) = (turned[0], turned[1]);
            let least = centre[lane] - panel.half_side * (turned[0].abs() + turned[1].abs());
            self.complete[lane] &= (least > 0.0) & (least * least >= least_squared * self.most_squared[lane]);
        }
        let [towards_x, towards_y, rise] = &self.towards_panel;
        let mut gains = [0.0; BLOCK];
        for points in &panel.few_lanes {
            let mut sum = [0.0; BLOCK];
            for ((x, y), weight) in points.x.iter().zip(&points.y).zip(&points.weight) {
                for lane in 0..BLOCK {
                    let (dx, dy) = (towards_x[lane] + x, towards_y[lane] + y);
                    let squared = dx * dx + dy * dy + rise[lane] * rise[lane];
                    let share = weight * (rise[lane] / (squared * squared));
                    sum[lane] += (centre[lane] + slope_x[lane] * x + slope_y[lane] * y) * share;
                }
            }
            for lane in 0..BLOCK {
                let front = self.turned.surfaces.reflectivity[lane] * panel.front * branch.concentrator_gain;
                gains[lane] += front * sum[lane];
            }
        }
        gains
    }
}

/// A scalar product; the order of the additions is that of nalgebra.
#[inline(always)]
fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
