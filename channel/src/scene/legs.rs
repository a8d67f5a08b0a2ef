//! Which mirrors a point can see past the cylinders: exact, and cheap because of what need not be looked at.
//!
//! Three facts save almost all of the K * M * C segment tests. A cylinder that is lower than both ends of every leg blocks none of them. In plan, the legs from one
//! point to the array fill a triangle, and a cylinder whose disc misses the triangle blocks none. And the mirrors of a column share their leg in
//! plan, so the chord that the disc cuts from it is found once a column and only the heights differ by row. What is left is the
//! very arithmetic of [`blocks`](crate::blockage::blocks), so the outcome is the same to the last bit.

use crate::Vec3;
use crate::blockage::{Cylinder, dips, plan_chord};
use crate::mirrors::MirrorArray;
use crate::trig::BLOCK;

/// Room for rounding in m: far more than the rounding of a room's coordinates, far less than a radius.
const ROUNDING_M: f64 = 1e-9;

/// Marks the mirrors that a point can see: `legs[m]` becomes whether no cylinder stands between the point and the centre of mirror m.
///
/// `legs`: shape M.
#[inline(always)]
pub(super) fn mark_visible(legs: &mut [bool], mirrors: &MirrorArray, from: &Vec3, blockers: &[Cylinder]) {
    legs.fill(true);
    let columns = mirrors.columns();
    let positions = mirrors.positions();
    let lowest = from.z.min(positions[0].z);
    let view = Triangle::new(from, &positions[0], &positions[columns - 1]);
    for blocker in blockers {
        if blocker.height_m < lowest || view.misses(blocker) {
            continue;
        }
        for first in (0..columns).step_by(BLOCK) {
            shade(legs, mirrors, from, blocker, first);
        }
    }
}

/// Unmarks the mirrors that a cylinder hides, in a block of columns from `first` on: first the chords, then row by row.
#[inline(always)]
fn shade(legs: &mut [bool], mirrors: &MirrorArray, from: &Vec3, blocker: &Cylinder, first: usize) {
    let (columns, positions) = (mirrors.columns(), mirrors.positions());
    let lanes = BLOCK.min(columns - first);
    // What is no chord is no number, and compares with no height.
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
    for (row, legs) in legs.chunks_exact_mut(columns).enumerate() {
        let height = positions[row * columns].z;
        for (lane, leg) in legs[first..first + lanes].iter_mut().enumerate() {
            *leg &= !dips(blocker, from.z, height, (enter[lane], leave[lane]));
        }
    }
}

/// What a point sees of the array, in plan.
struct Triangle {
    axes: [Axis; 3],
}

/// A direction across an edge, and how far the triangle extends along it.
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

    /// Whether the cylinder's disc is surely outside: beyond the triangle along one of its three axes.
    fn misses(&self, cylinder: &Cylinder) -> bool {
        self.axes.iter().any(|axis| {
            let centre = axis.x * cylinder.x_m + axis.y * cylinder.y_m;
            let reach = (cylinder.radius_m + ROUNDING_M) * axis.length;
            centre - reach > axis.most || centre + reach < axis.least
        })
    }
}
