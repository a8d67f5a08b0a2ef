//! Visibility of all mirrors from one point, past all cylinders.
//!
//! Three facts avoid most of the K * M * C segment tests:
//! - A cylinder that is lower than both ends of every path blocks none.
//! - In plan view, the paths from one point to an array fill a triangle. A cylinder whose disc
//!   misses the triangle blocks none.
//! - The mirrors of a column share their path in plan view, so the chord is computed once per
//!   column.
//!
//! The remaining tests use the arithmetic of [`blocks`](crate::blockage::blocks), so the results
//! are identical to the last bit.

use crate::arrays::MirrorArrays;
use crate::blockage::{Cylinder, dips, plan_chord};
use crate::geometry::Vec3;
use crate::mirrors::MirrorArray;
use crate::simd::with_widest_simd;
use crate::trig::BLOCK;

/// Margin for rounding in m: far above the rounding errors of coordinates, far below a radius.
const ROUNDING_M: f64 = 1e-9;

impl MirrorArrays {
    /// Writes to `clear[m]` whether no cylinder blocks the path from a point to the centre of
    /// mirror m, as [`Scene::update`](super::Scene::update) computes it. Shape: M.
    ///
    /// # Panics
    /// When `clear` does not have one entry per mirror.
    pub fn visible_from(&self, from: &Vec3, blockers: &[Cylinder], clear: &mut [bool]) {
        assert_eq!(clear.len(), self.len(), "one flag per mirror");
        with_widest_simd(
            #[inline(always)]
            || mark_visible(clear, self, from, blockers),
        );
    }
}

/// Writes to `clear[m]` whether no cylinder blocks the path from a point to the centre of mirror m.
/// Shape: M.
#[inline(always)]
pub(super) fn mark_visible(clear: &mut [bool], mirrors: &MirrorArrays, from: &Vec3, blockers: &[Cylinder]) {
    clear.fill(true);
    for (array, range) in mirrors.ranges() {
        shade_array(&mut clear[range], array, from, blockers);
    }
}

/// Clears the flag of each mirror of an array that a cylinder hides.
#[inline(always)]
fn shade_array(clear: &mut [bool], array: &MirrorArray, from: &Vec3, blockers: &[Cylinder]) {
    let columns = array.columns();
    let positions = array.positions();
    let lowest = from.z.min(positions[0].z);
    let view = Triangle::new(from, &positions[0], &positions[columns - 1]);
    for blocker in blockers {
        if blocker.height_m < lowest || view.misses(blocker) {
            continue;
        }
        for first in (0..columns).step_by(BLOCK) {
            shade(clear, array, from, blocker, first);
        }
    }
}

/// Clears the flag of each mirror that a cylinder hides, in the block of columns from `first` on.
#[inline(always)]
fn shade(clear: &mut [bool], array: &MirrorArray, from: &Vec3, blocker: &Cylinder, first: usize) {
    let (columns, positions) = (array.columns(), array.positions());
    let lanes = BLOCK.min(columns - first);
    // A column without a chord has NaN, which fails all comparisons with heights.
    let (mut enter, mut leave, mut any) = ([f64::NAN; BLOCK], [f64::NAN; BLOCK], false);
    for (lane, mirror) in positions[first..first + lanes].iter().enumerate() {
        if let Some(chord) = plan_chord(blocker, (from.x, from.y), (mirror.x, mirror.y)) {
            (enter[lane], leave[lane]) = chord;
            any = true;
        }
    }
    if !any {
        return;
    }
    for (row, clear) in clear.chunks_exact_mut(columns).enumerate() {
        let height = positions[row * columns].z;
        for (lane, clear) in clear[first..first + lanes].iter_mut().enumerate() {
            *clear &= !dips(blocker, from.z, height, (enter[lane], leave[lane]));
        }
    }
}

/// The paths from one point to an array, in plan view.
struct Triangle {
    axes: [Axis; 3],
}

/// A direction perpendicular to an edge, and the extent of the triangle along it.
struct Axis {
    x: f64,
    y: f64,
    least: f64,
    most: f64,
    length: f64,
}

impl Triangle {
    fn new(apex: &Vec3, left: &Vec3, right: &Vec3) -> Self {
        let across = |a: &Vec3, b: &Vec3| {
            let (x, y) = (a.y - b.y, b.x - a.x);
            let along = |point: &Vec3| x * point.x + y * point.y;
            let corners = [along(apex), along(left), along(right)];
            let least = corners.iter().copied().fold(f64::INFINITY, f64::min);
            let most = corners.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            Axis { x, y, least, most, length: (x * x + y * y).sqrt() }
        };
        Self { axes: [across(apex, left), across(apex, right), across(left, right)] }
    }

    /// Whether the cylinder's disc is outside the triangle, by the separating-axis test on its
    /// three edges.
    fn misses(&self, cylinder: &Cylinder) -> bool {
        self.axes.iter().any(|axis| {
            let centre = axis.x * cylinder.x_m + axis.y * cylinder.y_m;
            let reach = (cylinder.radius_m + ROUNDING_M) * axis.length;
            centre - reach > axis.most || centre + reach < axis.least
        })
    }
}
