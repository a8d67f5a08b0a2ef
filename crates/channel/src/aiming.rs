//! Angles of mirrors aimed by the law of reflection, block by block.

use crate::arrays::MirrorArrays;
use crate::trig::{BLOCK, Lanes, atan_of_quotient};

/// Vectors shorter than this, in m, have no direction.
const TOO_NEAR_M: f64 = 1e-9;

/// Roll and yaw of a block of mirrors whose normals bisect the directions to an LED and to a
/// target.
///
/// With the unit vector u to the LED, the vector t to the target and its length b, the normal has
/// the direction of b u + t. In the wall frame, yaw = atan(x / y) and roll = atan(-z / sqrt(x^2 +
/// y^2)), as in [`MirrorArrays::angles_of`]. Both are 0 where the bisector does not exist.
#[inline(always)]
pub(crate) fn bisect(mirrors: &MirrorArrays, block: usize, to_led: [&Lanes; 3], target: &[Lanes; 3]) -> (Lanes, Lanes) {
    let centre = mirrors.block(block);
    let surfaces = mirrors.surfaces(block);
    let zero = [0.0; BLOCK];
    let (mut down, mut level, mut along, mut inward) = (zero, zero, zero, zero);
    for lane in 0..BLOCK {
        let to_target = [0, 1, 2].map(|axis: usize| target[axis][lane] - centre[axis][lane]);
        let squared = to_target[0] * to_target[0] + to_target[1] * to_target[1] + to_target[2] * to_target[2];
        let distance = squared.sqrt();
        let normal = [0, 1, 2].map(|axis: usize| distance * to_led[axis][lane] + to_target[axis]);
        let (cos, sin) = (surfaces.wall_cos[lane], surfaces.wall_sin[lane]);
        let (x, y) = (cos * normal[0] + sin * normal[1], cos * normal[1] - sin * normal[0]);
        let across = x * x + y * y;
        // No bisector: the target is in the mirror or opposite to the LED, or a coordinate is not a
        // number.
        let exists = (distance > TOO_NEAR_M) & (across + normal[2] * normal[2] > (TOO_NEAR_M * TOO_NEAR_M) * squared);
        down[lane] = if exists { -normal[2] } else { 0.0 };
        level[lane] = if exists { across.sqrt() } else { 1.0 };
        along[lane] = if exists { x } else { 0.0 };
        inward[lane] = if exists { y } else { 1.0 };
    }
    (atan_of_quotient(&down, &level), atan_of_quotient(&along, &inward))
}
