//! Which mirrors a point can see past the cylinders: exact, and cheap because of what need not be looked at.
//!
//! Three facts save almost all of the K * M * C segment tests. A cylinder that is lower than both ends of every leg blocks none of them. In plan, the legs from one
//! point to the array fill a triangle, and a cylinder whose disc misses the triangle blocks none. And the mirrors of a column share their leg in
//! plan, so the chord that the disc cuts from it is found once a column and only the heights differ by row. What is left is the
//! very arithmetic of [`blocks`](crate::blockage::blocks), so the outcome is the same to the last bit.

use crate::Vec3;
use crate::blockage::{Cylinder, dips, plan_chord};
use crate::mirrors::MirrorArray;

/// Room for rounding in m: far more than the rounding of a room's coordinates, far less than a radius.
const ROUNDING_M: f64 = 1e-9;

/// Marks the mirrors that a point can see: `legs[m]` becomes whether no cylinder stands between the point and the centre of mirror m.
///
/// `legs`: shape M.
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
        for column in 0..columns {
            let mirror = &positions[column];
            let Some(chord) = plan_chord(blocker, (from.x, from.y), (mirror.x, mirror.y)) else {
                continue;
            };
            for index in (column..positions.len()).step_by(columns) {
                legs[index] &= !dips(blocker, from.z, positions[index].z, chord);
            }
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
