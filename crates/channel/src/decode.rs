//! The decoder: from one weight per user to the angles of all mirrors.
//!
//! By the law of reflection a mirror serves one user, and its best normal bisects the directions to
//! that user and to the LED. Under the paper's eqs. (2) and (3) the best normal is a weighted sum
//! of the directions to the users. In both cases one weight per user determines all angles.
//!
//! [`decode`] is the decoder of the learned policies, inside and outside an exported graph. A mirror
//! serves one user there.
//!
//! ```
//! use heliostat_channel::decode::decode;
//! use heliostat_channel::{
//!     ArraySpec, Branch, ChannelModel, Combining, Led, LinkBudget, MirrorAngles, MirrorArray, Mode, NoiseBudget,
//!     PowerLaw, Receiver, Scene, Vec3, Wall,
//! };
//!
//! let array = ArraySpec {
//!     rows: 2,
//!     columns: 2,
//!     mirror_width_m: 0.25,
//!     mirror_height_m: 0.10,
//!     gap_m: 0.02,
//!     centre_height_m: 2.0,
//!     wall: Wall::PlusY,
//!     wall_distance_m: 2.5,
//!     reflectivity: 0.95,
//! };
//! let led = Led {
//!     position: Vec3::new(0.0, 0.0, 3.0),
//!     side_m: 0.0,
//!     points_per_side: 1,
//!     half_power_semi_angle: 60.0_f64.to_radians(),
//! };
//! let receiver = Receiver {
//!     branches: vec![Branch { normal: Vec3::z(), fov_semi_angle: 90.0_f64.to_radians() }],
//!     detector_area_m2: 20e-6,
//!     filter_gain: 1.0,
//!     concentrator_index: None,
//!     combining: Combining::Best,
//! };
//! let budget = LinkBudget {
//!     power_w: 2.0,
//!     power_law: PowerLaw::Linear,
//!     responsivity_a_per_w: 0.4,
//!     noise: NoiseBudget::default(),
//!     bandwidth_hz: 20e6,
//! };
//! let model = ChannelModel::new(Mode::Specular, vec![led], MirrorArray::new(&array)?, receiver, budget)?;
//!
//! let mut scene = Scene::new(&model, 2);
//! scene.update(&model, &[Vec3::new(1.0, 1.0, 0.85), Vec3::new(-1.0, 0.0, 0.85)], &[], &[false, false]);
//! let mut angles = MirrorAngles::flat(4);
//! decode(&model, &scene, &[0.0, 1.0], &mut angles);
//!
//! // Only user 1 has a weight, so all four mirrors reflect light to it.
//! let mut irs_gain = [0.0; 2];
//! scene.irs_gain(&model, &angles, &mut irs_gain);
//! assert!(irs_gain[0] == 0.0 && irs_gain[1] > 1e-8);
//! # Ok::<(), heliostat_channel::ChannelError>(())
//! ```

use std::ops::Range;

use crate::aiming::bisect;
use crate::geometry::Vec3;
use crate::mirrors::MirrorAngles;
use crate::model::{ChannelModel, Mode};
use crate::scene::{Scene, Spill};
use crate::simd::with_widest_simd;
use crate::trig::BLOCK;

/// Computes the angles of all mirrors from one weight per user.
///
/// Specular: mirror m serves user argmax_k w_k a_km with the steering gain a_km; the lowest index
/// wins a tie. A mirror with no steering gain is aimed at user 0. Paper: the normal of mirror m has
/// the direction of sum_k w_k c_km u_km; the mirror is flat if that sum is zero.
///
/// `weights`: w_k, not negative, dimensionless. Shape: K. `out`: mechanical angles in radians.
/// Shape: M.
///
/// # Panics
/// When `weights` does not have one entry per user of the scene, or `out` one per mirror of the
/// model.
pub fn decode(model: &ChannelModel, scene: &Scene, weights: &[f64], out: &mut MirrorAngles) {
    let (users, mirrors) = (scene.users(), model.mirrors.len());
    assert_eq!(weights.len(), users, "one weight per user");
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
        (out.roll[mirror], out.yaw[mirror]) = if flat { (0.0, 0.0) } else { model.mirrors.angles_of(mirror, &sum) };
    }
}

/// Aims each mirror at one user by the law of reflection, with the light of the LED that serves
/// that user.
///
/// `served`: the user of each mirror. `out`: mechanical angles in radians. Shape of both: M.
///
/// # Panics
/// When `served` or `out` does not have one entry per mirror, or a user does not exist.
pub fn aim(model: &ChannelModel, scene: &Scene, served: &[usize], out: &mut MirrorAngles) {
    aim_chosen(model, &Targets::of(scene), served, out);
}

/// Aims each mirror at one aim of a list by the law of reflection.
pub(crate) fn aim_at(model: &ChannelModel, spill: &Spill, aims: &[usize], out: &mut MirrorAngles) {
    aim_chosen(model, &Targets { points: spill.points(), leds: spill.leds() }, aims, out);
}

fn aim_chosen(model: &ChannelModel, targets: &Targets<'_>, chosen: &[usize], out: &mut MirrorAngles) {
    assert_eq!(chosen.len(), model.mirrors.len(), "one user per mirror");
    check_angles(out, model.mirrors.len());
    aim_each(
        model,
        targets,
        out,
        #[inline(always)]
        |first, lanes| {
            let mut block = [0; BLOCK];
            block[..lanes].copy_from_slice(&chosen[first..first + lanes]);
            block
        },
    );
}

/// Aims all mirrors at one point by the law of reflection, with the light of the LED nearest to
/// that point.
///
/// `target`: in m. `out`: mechanical angles in radians. Shape: M.
///
/// # Panics
/// When `out` does not have one entry per mirror.
pub fn aim_at_point(model: &ChannelModel, target: &Vec3, out: &mut MirrorAngles) {
    check_angles(out, model.mirrors.len());
    let distance = |led: usize| (model.leds[led].position - target).norm_squared();
    let nearest = (1..model.leds.len()).fold(0, |best, led| if distance(led) < distance(best) { led } else { best });
    aim_each(model, &Targets { points: &[*target], leds: &[nearest] }, out, |_, _| [0; BLOCK]);
}

/// The user with the largest weighted gain for each of at most a block of mirrors; the lowest index
/// wins a tie.
#[inline(always)]
fn best_in_block(scene: &Scene, weights: &[f64], mirrors: Range<usize>) -> [usize; BLOCK] {
    let (mut best, mut largest) = ([0; BLOCK], [f64::NEG_INFINITY; BLOCK]);
    let rows = scene.steering_gain().chunks_exact(scene.mirrors());
    for (user, (row, weight)) in rows.zip(weights).enumerate() {
        let mut gains = [0.0; BLOCK];
        gains[..mirrors.len()].copy_from_slice(&row[mirrors.clone()]);
        for lane in 0..BLOCK {
            let score = weight * gains[lane];
            // Selections instead of branches, so that the loop vectorises.
            let larger = score > largest[lane];
            largest[lane] = if larger { score } else { largest[lane] };
            best[lane] = if larger { user } else { best[lane] };
        }
    }
    best
}

/// The points in m at which mirrors can be aimed, and the LED whose light each point receives.
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

/// Roll and yaw that reflect light from an LED's centre at each mirror's centre to a target; 0
/// where no such angles exist.
///
/// `choose` returns the targets of a block from the index of its first mirror and the number of its
/// mirrors. Lanes beyond that number may hold any valid target.
fn aim_each(
    model: &ChannelModel,
    targets: &Targets<'_>,
    out: &mut MirrorAngles,
    choose: impl Fn(usize, usize) -> [usize; BLOCK],
) {
    with_widest_simd(
        #[inline(always)]
        || {
            for (index, first) in (0..model.mirrors.len()).step_by(BLOCK).enumerate() {
                let lanes = BLOCK.min(model.mirrors.len() - first);
                let chosen = choose(first, lanes);
                let mut towards_led = model.directions_to_led(0, index).map(|lanes| *lanes);
                let mut target = [[0.0; BLOCK]; 3];
                for lane in 0..BLOCK {
                    let point = &targets.points[chosen[lane]];
                    for (lanes, coordinate) in target.iter_mut().zip(point) {
                        lanes[lane] = *coordinate;
                    }
                    if model.leds.len() > 1 {
                        let directions = model.directions_to_led(targets.leds[chosen[lane]], index);
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

fn check_angles(angles: &MirrorAngles, mirrors: usize) {
    assert_eq!(angles.roll.len(), mirrors, "one roll per mirror");
    assert_eq!(angles.yaw.len(), mirrors, "one yaw per mirror");
}
