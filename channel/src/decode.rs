//! From a few numbers to the angles of all mirrors: the one decoder.
//!
//! The best angles have a simple structure. By the law of reflection a mirror serves one user, and serves it best at the
//! bisector of the directions to that user and to the LED. Under the paper's eqs. (2) and (3) the best normal is a weighted sum of the directions to the users. Either way one weight a user
//! is enough, and this module turns weights into angles.

use std::ops::Range;

use crate::Vec3;
use crate::mirrors::{MirrorAngles, MirrorArray};
use crate::model::{ChannelModel, Mode};
use crate::scene::Scene;
use crate::trig::{BLOCK, Lanes, atan_of_quotient};
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
    if model.mode == Mode::Specular {
        aim_each(
            model,
            &Targets::of(scene),
            out,
            #[inline(always)]
            |first, lanes| best_in_block(scene, weights, first..first + lanes),
        );
        return;
    }
    let gain = |user: usize, mirror: usize| weights[user] * scene.steering_gain()[user * mirrors + mirror];
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
    aim_each(
        model,
        &Targets::of(scene),
        out,
        #[inline(always)]
        |first, lanes| {
            let mut block = [0; BLOCK];
            block[..lanes].copy_from_slice(&served[first..first + lanes]);
            block
        },
    );
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
    aim_each(model, &Targets { points: &[*target], leds: &[nearest] }, out, |_, _| [0; BLOCK]);
}

/// For each of these mirrors, at most a block, the user with the largest weighted gain, the first of equals.
#[inline(always)]
fn best_in_block(scene: &Scene, weights: &[f64], mirrors: Range<usize>) -> [usize; BLOCK] {
    let (mut best, mut largest) = ([0; BLOCK], [f64::NEG_INFINITY; BLOCK]);
    let rows = scene.steering_gain().chunks_exact(scene.mirrors());
    for (user, (row, weight)) in rows.zip(weights).enumerate() {
        let mut gains = [0.0; BLOCK];
        gains[..mirrors.len()].copy_from_slice(&row[mirrors.clone()]);
        for lane in 0..BLOCK {
            let score = weight * gains[lane];
            // Written so that no lane takes a branch.
            let larger = score > largest[lane];
            largest[lane] = if larger { score } else { largest[lane] };
            best[lane] = if larger { user } else { best[lane] };
        }
    }
    best
}

/// Where mirrors can be aimed, in m, and with the light of which LED.
struct Targets<'a> {
    points: &'a [Vec3],
    leds: &'a [usize],
}

impl<'a> Targets<'a> {
    /// The users of a scene.
    fn of(scene: &'a Scene) -> Self {
        Self { points: scene.positions(), leds: scene.serving() }
    }
}

/// Roll and yaw that send the light of an LED's centre over each mirror's centre to a target; flat where no angle does.
///
/// `choose` gives the targets of a block, from the index of its first mirror and the number of its mirrors; what it says of lanes beyond these does
/// not matter, but must be a target.
fn aim_each(
    model: &ChannelModel,
    targets: &Targets<'_>,
    out: &mut MirrorAngles,
    choose: impl Fn(usize, usize) -> [usize; BLOCK],
) {
    widest(
        #[inline(always)]
        || {
            for (index, first) in (0..model.mirrors.len()).step_by(BLOCK).enumerate() {
                let lanes = BLOCK.min(model.mirrors.len() - first);
                let chosen = choose(first, lanes);
                let mut towards_led = towards(model, 0, index).map(|lanes| *lanes);
                let mut target = [[0.0; BLOCK]; 3];
                for lane in 0..BLOCK {
                    let point = &targets.points[chosen[lane]];
                    for (lanes, coordinate) in target.iter_mut().zip(point) {
                        lanes[lane] = *coordinate;
                    }
                    if model.leds.len() > 1 {
                        let directions = towards(model, targets.leds[chosen[lane]], index);
                        for (lanes, direction) in towards_led.iter_mut().zip(directions) {
                            lanes[lane] = direction[lane];
                        }
                    }
                }
                let (roll, yaw) = bisect(&model.mirrors, index, towards_led.each_ref(), &target);
                out.roll[first..first + lanes].copy_from_slice(&roll[..lanes]);
                out.yaw[first..first + lanes].copy_from_slice(&yaw[..lanes]);
            }
        },
    );
}

/// Unit vectors from a block of mirrors to an LED.
#[inline(always)]
pub(crate) fn towards(model: &ChannelModel, led: usize, block: usize) -> [&Lanes; 3] {
    model.panels[led].direction.each_ref().map(|axis| &axis[block])
}

/// Roll and yaw of a block of mirrors whose normals are to halve the angle between a direction and the way to a point.
///
/// With u the unit vector, t the way and b its length, the normal b u + t has the direction of the bisector; then, in the wall's frame,
/// yaw = atan(x / y) and roll = atan(-z / sqrt(x^2 + y^2)), as in [`MirrorArray::angles_of`].
#[inline(always)]
pub(crate) fn bisect(mirrors: &MirrorArray, block: usize, towards: [&Lanes; 3], target: &[Lanes; 3]) -> (Lanes, Lanes) {
    let centre = mirrors.block(block);
    let (cos, sin) = mirrors.rotation();
    let zero = [0.0; BLOCK];
    let (mut down, mut level, mut along, mut inward) = (zero, zero, zero, zero);
    for lane in 0..BLOCK {
        let way = [0, 1, 2].map(|axis: usize| target[axis][lane] - centre[axis][lane]);
        let squared = way[0] * way[0] + way[1] * way[1] + way[2] * way[2];
        let distance = squared.sqrt();
        let normal = [0, 1, 2].map(|axis: usize| distance * towards[axis][lane] + way[axis]);
        let (x, y) = (cos * normal[0] + sin * normal[1], cos * normal[1] - sin * normal[0]);
        let across = x * x + y * y;
        // A point in the mirror, or one opposite to the direction, leaves no angle; nor does what is not a number.
        let sound = (distance > TOO_NEAR_M) & (across + normal[2] * normal[2] > (TOO_NEAR_M * TOO_NEAR_M) * squared);
        down[lane] = if sound { -normal[2] } else { 0.0 };
        level[lane] = if sound { across.sqrt() } else { 1.0 };
        along[lane] = if sound { x } else { 0.0 };
        inward[lane] = if sound { y } else { 1.0 };
    }
    (atan_of_quotient(&down, &level), atan_of_quotient(&along, &inward))
}

fn check_angles(angles: &MirrorAngles, mirrors: usize) {
    assert_eq!(angles.roll.len(), mirrors, "one roll a mirror");
    assert_eq!(angles.yaw.len(), mirrors, "one yaw a mirror");
}
