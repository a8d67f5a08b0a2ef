//! Magnitudes of the paper's room, each with the tolerance of a reference from a finite sample.

use crate::common::{PAPER, RECEIVER_HEIGHT_M, Random, Room};
use heliostat_channel::decode::aim_at_point;
use heliostat_channel::{ChannelModel, MirrorAngles, Scene, Vec3};

fn scene_at(model: &ChannelModel, user: Vec3) -> Scene {
    let mut scene = Scene::new(model, 1);
    scene.update(model, &[user], &[], &[false]);
    scene
}

fn floor(x: f64, y: f64) -> Vec3 {
    Vec3::new(x, y, RECEIVER_HEIGHT_M)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn near(found: f64, expected: f64, relative: f64) {
    assert!((found / expected - 1.0).abs() <= relative, "{found:e} instead of {expected:e}");
}

#[test]
fn direct_gain() {
    for room in [Room::paper(), Room::paper().with_panel()] {
        let model = room.model();
        near(scene_at(&model, floor(0.0, 0.0)).los_gain()[0], 1.38e-6, 0.005);
        near(scene_at(&model, floor(2.0, -2.0)).los_gain()[0], 1.85e-7, 0.005);
    }
}

/// Mean over the array at three positions, from near the wall to the far corner.
#[test]
fn specular_gain_of_an_aimed_mirror() {
    let (specular, paper) = (Room::paper().model(), Room::paper().with_mode(PAPER).model());
    for (user, gain, ratio) in
        [(floor(0.0, 2.0), 9.05e-8, 107.0), (floor(0.0, 0.0), 2.41e-8, 280.5), (floor(2.0, -2.0), 6.97e-9, 457.0)]
    {
        let aimed = mean(scene_at(&specular, user).steering_gain());
        let diffuse = mean(scene_at(&paper, user).steering_gain());
        near(aimed, gain, 0.005);
        near(aimed / diffuse, ratio, 0.005);
    }
}

#[test]
fn paper_gain_of_the_complete_array_is_a_hundredth_of_the_line_of_sight_gain() {
    let model = Room::paper().with_mode(PAPER).model();
    let mut random = Random::new(31);
    let share = |user: Vec3| {
        let scene = scene_at(&model, user);
        scene.steering_gain().iter().sum::<f64>() / scene.los_gain()[0]
    };
    near(median((0..2000).map(|_| share(random.walker())).collect()), 0.009, 0.12);
}

/// Length of the spot along a line through the target, for one mirror in the middle of the array.
#[test]
fn spots_on_the_receiver_plane() {
    let model = Room::paper().model();
    for (target, along_x, along_y) in
        [(floor(0.0, 2.0), 0.37, 0.12), (floor(0.0, 0.0), 0.53, 0.46), (floor(2.0, -2.0), 0.8, 1.3)]
    {
        let mut angles = MirrorAngles::flat(100);
        aim_at_point(&model, &target, &mut angles);
        let lit = |direction: Vec3| {
            let step = 0.005;
            let lit = (-400..=400).filter(|index| {
                let mut each = [0.0; 100];
                scene_at(&model, target + direction * (f64::from(*index) * step))
                    .irs_gain_each(&model, &angles, &mut each);
                each[45] > 0.0
            });
            lit.count() as f64 * step
        };
        near(lit(Vec3::x()), along_x, 0.07);
        near(lit(Vec3::y()), along_y, 0.07);
    }
}

/// Gaussian jitter of each axis of each mirror; gain of all mirrors, panel of 0.1 m, users from the
/// stationary distribution.
#[test]
fn pointing_jitter() {
    let model = Room::paper().with_panel().model();
    let mut random = Random::new(32);
    let mut angles = MirrorAngles::flat(100);
    let mut gain = [0.0];
    for (jitter_deg, kept) in [(0.5_f64, 0.95), (1.0, 0.67), (2.0, 0.33)] {
        let (mut still, mut shaken) = (0.0, 0.0);
        for _ in 0..400 {
            let user = random.walker();
            let scene = scene_at(&model, user);
            aim_at_point(&model, &user, &mut angles);
            scene.irs_gain(&model, &angles, &mut gain);
            still += gain[0];
            for angle in angles.roll.iter_mut().chain(&mut angles.yaw) {
                *angle += jitter_deg.to_radians() * random.normal();
            }
            scene.irs_gain(&model, &angles, &mut gain);
            shaken += gain[0];
        }
        assert!((shaken / still - kept).abs() < 0.03, "{jitter_deg} degrees keep {}", shaken / still);
    }
}

/// Angles that aim each mirror at each point of a grid over the floor, 0.2 m apart.
#[test]
fn required_angles() {
    let model = Room::paper().model();
    let mut angles = MirrorAngles::flat(100);
    let mut pairs = Vec::new();
    for ix in -12..=12 {
        for iy in -12..=12 {
            aim_at_point(&model, &floor(f64::from(ix) * 0.2, f64::from(iy) * 0.2), &mut angles);
            pairs.extend(angles.roll.iter().zip(&angles.yaw).map(|(roll, yaw)| (roll.to_degrees(), yaw.to_degrees())));
        }
    }
    let extreme = |value: fn(&(f64, f64)) -> f64| pairs.iter().map(value).fold(0.0, f64::max);
    assert!((extreme(|pair| pair.1.abs()) - 59.0).abs() < 1.0);
    assert!((extreme(|pair| pair.0) - 40.0).abs() < 1.0);
    assert!((extreme(|pair| -pair.0) - 13.0).abs() < 1.0);
    for (range, share) in [(10.0, 0.23), (20.0, 0.53), (30.0, 0.76)] {
        let within = pairs.iter().filter(|pair| pair.0.abs() <= range && pair.1.abs() <= range).count();
        let found = within as f64 / pairs.len() as f64;
        assert!((found - share).abs() < 0.01, "{found} within {range} degrees");
    }
}

/// Angles that are best under eqs. (2) and (3) face the user; a mirror that faces the user sends
/// the LED's light elsewhere.
#[test]
fn paper_angles_bring_nothing_on_a_real_mirror() {
    let (specular, paper) = (Room::paper().with_panel().model(), Room::paper().with_mode(PAPER).model());
    let mut random = Random::new(33);
    let mut angles = MirrorAngles::flat(100);
    let (mut lit, mut aimed) = (0, 0);
    for _ in 0..200 {
        let users = random.positions(5);
        let mut scene = Scene::new(&paper, 5);
        scene.update(&paper, &users, &[], &[false; 5]);
        heliostat_channel::decode::decode(&paper, &scene, &[1.0; 5], &mut angles);
        let mut each = [0.0; 500];
        scene.irs_gain_each(&paper, &angles, &mut each);
        aimed += each.iter().filter(|gain| **gain > 0.0).count();
        let mut real = Scene::new(&specular, 5);
        real.update(&specular, &users, &[], &[false; 5]);
        real.irs_gain_each(&specular, &angles, &mut each);
        lit += each.iter().filter(|gain| **gain > 0.0).count();
    }
    assert!(aimed > 90_000 && lit < 400, "{lit} of {aimed} pairs see light");
}

/// Of 100 mirrors at random angles within 90 degrees, 0.04 reach a given user: random equals no
/// IRS.
#[test]
fn random_mirrors_hit_almost_no_user() {
    let model = Room::paper().model();
    let mut random = Random::new(34);
    let mut hits = 0;
    for _ in 0..500 {
        let users: Vec<Vec3> = (0..5).map(|_| random.walker()).collect();
        let mut scene = Scene::new(&model, 5);
        scene.update(&model, &users, &[], &[false; 5]);
        let mut angles = MirrorAngles::flat(100);
        for angle in angles.roll.iter_mut().chain(&mut angles.yaw) {
            *angle = random.uniform(-1.0, 1.0) * std::f64::consts::FRAC_PI_2;
        }
        let mut each = [0.0; 500];
        scene.irs_gain_each(&model, &angles, &mut each);
        hits += each.iter().filter(|gain| **gain > 0.0).count();
    }
    let of_a_hundred = hits as f64 / (500.0 * 5.0);
    assert!((0.02..0.06).contains(&of_a_hundred), "{of_a_hundred}");
}
