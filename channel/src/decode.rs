//! From a few numbers to the angles of all mirrors: the one decoder.
//!
//! The best angles have a simple structure. By the law of reflection a mirror serves one user, and serves it best at the
//! bisector of the directions to that user and to the LED. Under the paper's eqs. (2) and (3) the best normal is a weighted sum of the directions to the users. Either way one weight a user
//! is enough, and this module turns weights into angles.

use crate::Vec3;
use crate::mirrors::{MirrorAngles, MirrorArray};
use crate::model::{ChannelModel, Mode};
use crate::scene::Scene;
use crate::scene::kernel::block;
use crate::trig::{BLOCK, Lanes, atan};
use crate::wide::widest;

/// Lengths below this, in m, have no direction.
const TOO_NEAR_M: f64 = 1e-9;

/// Turns one weight a user into the angles of all mirrors.
///
/// Specular: mirror m serves the user with the largest w_k a_km, the first of equals, where a_km is the steering gain; a mirror that
/// can serve nobody is aimed at user 0. Paper: the normal of mirror m is the direction of sum_k w_k c_km u_km; flat where that sum is zero.
///
/// `weights`: K, not negative, dimensionless. `out`: M angles, mechanical, in radians.
///
/// # Panics
/// When `weights` has not one entry a user of the scene or `out` not one a mirror of the model.
pub fn decode(model: &ChannelModel, scene: &Scene, weights: &[f64], out: &mut MirrorAngles) {
    let (users, mirrors) = (scene.users(), model.mirrors.len());
    assert_eq!(weights.len(), users, "one weight a user");
    check_angles(out, mirrors);
    let gain = |user: usize, mirror: usize| weights[user] * scene.steering_gain()[user * mirrors + mirror];
    if model.mode == Mode::Specular {
        aim_each(model, out, |mirror| {
            let first = (0, gain(0, mirror));
            let gains = (1..users).map(|user| (user, gain(user, mirror)));
            let (user, _) = gains.fold(first, |a, b| if b.1 > a.1 { b } else { a });
            (scene.serving()[user], scene.positions()[user])
        });
        return;
    }
    for mirror in 0..mirrors {
        let direction = |user: usize| scene.directions()[user * mirrors + mirror];
        let sum: Vec3 = (0..users).map(|user| gain(user, mirror) * direction(user)).sum();
        let flat = sum == Vec3::zeros();
        (out.roll[mirror], out.yaw[mirror]) = if flat { (0.0, 0.0) } else { model.mirrors.angles_of(&sum) };
    }
}

/// Aims each mirror at one user by the law of reflection, for the LED that serves that user.
///
/// `served`: the user of each mirror. `out`: M angles, mechanical, in radians. Shape of both: M.
///
/// # Panics
/// When `served` or `out` has not one entry a mirror, or a user does not exist.
pub fn aim(model: &ChannelModel, scene: &Scene, served: &[usize], out: &mut MirrorAngles) {
    assert_eq!(served.len(), model.mirrors.len(), "one user a mirror");
    check_angles(out, model.mirrors.len());
    aim_each(model, out, |mirror| (scene.serving()[served[mirror]], scene.positions()[served[mirror]]));
}

/// Aims all mirrors at one point (in m) by the law of reflection, with the light of the LED that is nearest to it.
///
/// `out`: M angles, mechanical, in radians.
///
/// # Panics
/// When `out` has not one entry a mirror.
pub fn aim_at_point(model: &ChannelModel, target: &Vec3, out: &mut MirrorAngles) {
    check_angles(out, model.mirrors.len());
    let distance = |led: usize| (model.leds[led].position - target).norm_squared();
    let nearest = (1..model.leds.len()).fold(0, |best, led| if distance(led) < distance(best) { led } else { best });
    aim_each(model, out, |_| (nearest, *target));
}

/// Roll and yaw that send the light of an LED's centre over each mirror's centre to a point; flat where no angle does.
///
/// `choose` gives the LED and the point of a mirror.
fn aim_each(model: &ChannelModel, out: &mut MirrorAngles, choose: impl Fn(usize) -> (usize, Vec3)) {
    widest(
        #[inline(always)]
        || {
            for first in (0..model.mirrors.len()).step_by(BLOCK) {
                let lanes = BLOCK.min(model.mirrors.len() - first);
                let (mut from, mut to) = ([[0.0; BLOCK]; 3], [[0.0; BLOCK]; 3]);
                for lane in 0..lanes {
                    let (led, target) = choose(first + lane);
                    for axis in 0..3 {
                        from[axis][lane] = model.leds[led].position[axis];
                        to[axis][lane] = target[axis];
                    }
                }
                let (roll, yaw) = bisect(&model.mirrors, first, &from, &to);
                out.roll[first..first + lanes].copy_from_slice(&roll[..lanes]);
                out.yaw[first..first + lanes].copy_from_slice(&yaw[..lanes]);
            }
        },
    );
}

/// Roll and yaw of a block of mirrors whose normals are to halve the angle between the directions to two points.
///
/// In the wall's frame the normal b s + a t, with s and t the ways to the points and a and b their lengths, has the direction of the bisector; then
/// yaw = atan(x / y) and roll = atan(-z / sqrt(x^2 + y^2)), as in [`MirrorArray::angles_of`].
#[inline(always)]
pub(crate) fn bisect(mirrors: &MirrorArray, first: usize, from: &[Lanes; 3], to: &[Lanes; 3]) -> (Lanes, Lanes) {
    let centre = [block(&mirrors.x, first), block(&mirrors.y, first), block(&mirrors.z, first)];
    let (cos, sin) = mirrors.rotation();
    let (mut rise, mut turn, mut sound) = ([0.0; BLOCK], [0.0; BLOCK], [false; BLOCK]);
    for lane in 0..BLOCK {
        let [sx, sy, sz] = [0, 1, 2].map(|axis| from[axis][lane] - centre[axis][lane]);
        let [tx, ty, tz] = [0, 1, 2].map(|axis| to[axis][lane] - centre[axis][lane]);
        let a = (sx * sx + sy * sy + sz * sz).sqrt();
        let b = (tx * tx + ty * ty + tz * tz).sqrt();
        let (nx, ny, nz) = (b * sx + a * tx, b * sy + a * ty, b * sz + a * tz);
        let (x, y) = (cos * nx + sin * ny, cos * ny - sin * nx);
        let across = x * x + y * y;
        // A point in the mirror, or two in opposite directions, leave no angle; nor does what is not a number.
        sound[lane] =
            (a > TOO_NEAR_M) & (b > TOO_NEAR_M) & (across + nz * nz > (TOO_NEAR_M * a * b) * (TOO_NEAR_M * a * b));
        rise[lane] = -nz / across.sqrt();
        turn[lane] = if x == 0.0 { 0.0 } else { x / y };
    }
    let (mut roll, mut yaw) = (atan(&rise), atan(&turn));
    for lane in 0..BLOCK {
        roll[lane] = if sound[lane] { roll[lane] } else { 0.0 };
        yaw[lane] = if sound[lane] { yaw[lane] } else { 0.0 };
    }
    (roll, yaw)
}

fn check_angles(angles: &MirrorAngles, mirrors: usize) {
    assert_eq!(angles.roll.len(), mirrors, "one roll a mirror");
    assert_eq!(angles.yaw.len(), mirrors, "one yaw a mirror");
}
