//! From a few numbers to the angles of all mirrors: the one decoder.
//!
//! The best angles have a simple structure. By the law of reflection a mirror serves one user, and serves it best at the
//! bisector of the directions to that user and to the LED. Under the paper's eqs. (2) and (3) the best normal is a weighted sum of the directions to the users. Either way one weight a user
//! is enough, and this module turns weights into angles.

use crate::Vec3;
use crate::mirrors::MirrorAngles;
use crate::model::{ChannelModel, Mode};
use crate::scene::Scene;
use crate::specular::bisector;

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
    for mirror in 0..mirrors {
        let gain = |user: usize| weights[user] * scene.steering_gain()[user * mirrors + mirror];
        let (roll, yaw) = match model.mode {
            Mode::Specular => {
                let first = (0, gain(0));
                let best = (1..users).map(|user| (user, gain(user))).fold(first, |a, b| if b.1 > a.1 { b } else { a });
                aimed_angles(model, scene.serving()[best.0], mirror, &scene.positions()[best.0])
            }
            Mode::Paper { .. } => {
                let direction = |user: usize| scene.directions()[user * mirrors + mirror];
                let sum: Vec3 = (0..users).map(|user| gain(user) * direction(user)).sum();
                if sum == Vec3::zeros() { (0.0, 0.0) } else { model.mirrors.angles_of(&sum) }
            }
        };
        (out.roll[mirror], out.yaw[mirror]) = (roll, yaw);
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
    for (mirror, &user) in served.iter().enumerate() {
        let (roll, yaw) = aimed_angles(model, scene.serving()[user], mirror, &scene.positions()[user]);
        (out.roll[mirror], out.yaw[mirror]) = (roll, yaw);
    }
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
    for mirror in 0..model.mirrors.len() {
        let (roll, yaw) = aimed_angles(model, nearest, mirror, target);
        (out.roll[mirror], out.yaw[mirror]) = (roll, yaw);
    }
}

/// Roll and yaw that send the light of an LED's centre over a mirror's centre to a point; flat where no angle does.
fn aimed_angles(model: &ChannelModel, led: usize, mirror: usize, target: &Vec3) -> (f64, f64) {
    let normal = bisector(&model.mirrors.positions()[mirror], &model.leds[led].position, target);
    normal.map_or((0.0, 0.0), |normal| model.mirrors.angles_of(&normal))
}

fn check_angles(angles: &MirrorAngles, mirrors: usize) {
    assert_eq!(angles.roll.len(), mirrors, "one roll a mirror");
    assert_eq!(angles.yaw.len(), mirrors, "one yaw a mirror");
}
