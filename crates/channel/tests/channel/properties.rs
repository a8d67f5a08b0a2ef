//! For every valid room the gains are finite and not negative; every invalid one is refused.

use crate::common::{RECEIVER_HEIGHT_M, Room, angle_diversity, led};
use heliostat_channel::decode::decode;
use heliostat_channel::{
    ArraySpec, Branch, ChannelError, ChannelModel, Combining, Cylinder, MirrorAngles, MirrorArray, Mode, PowerLaw,
    Scene, Vec3, Wall,
};
use proptest::prelude::*;

fn walls() -> impl Strategy<Value = Wall> {
    prop_oneof![Just(Wall::PlusY), Just(Wall::PlusX), Just(Wall::MinusY), Just(Wall::MinusX)]
}

fn modes() -> impl Strategy<Value = Mode> {
    let paper = (any::<bool>(), 0.1..100.0).prop_map(|(literal, gain_scale)| Mode::Paper { literal, gain_scale });
    prop_oneof![Just(Mode::Specular), paper]
}

fn combinings() -> impl Strategy<Value = Combining> {
    prop_oneof![Just(Combining::Best), Just(Combining::EqualGain), Just(Combining::MaximalRatio)]
}

prop_compose! {
    fn rooms()(
        mode in modes(),
        wall in walls(),
        combining in combinings(),
        (rows, columns) in (1_usize..9, 1_usize..9),
        (side_m, points_per_side, half_power_deg) in (0.0..0.5, 1_usize..4, 10.0..80.0_f64),
        (fov_deg, many_branches, concentrator) in (10.0..90.0_f64, any::<bool>(), proptest::option::of(1.0..2.0)),
        (reflectivity, second_led) in (0.0..=1.0, proptest::option::of((-2.0..2.0, -2.0..2.0))),
    ) -> Room {
        let mut room = Room::paper();
        room.mode = mode;
        (room.array.wall, room.array.rows, room.array.columns) = (wall, rows, columns);
        room.array.reflectivity = reflectivity;
        room.leds[0].half_power_semi_angle = half_power_deg.to_radians();
        (room.leds[0].side_m, room.leds[0].points_per_side) = (side_m, points_per_side);
        room.leds.extend(second_led.map(|(x, y)| led(x, y, 0.0)));
        room.receiver.branches = match many_branches {
            true => angle_diversity(),
            false => vec![Branch { normal: Vec3::z(), fov_semi_angle: fov_deg.to_radians() }],
        };
        room.receiver.combining = combining;
        room.receiver.concentrator_index = concentrator;
        room
    }
}

prop_compose! {
    fn users()(list in proptest::collection::vec((-2.5..2.5, -2.5..2.5, 0.0..2.0), 1..6)) -> Vec<Vec3> {
        list.into_iter().map(|(x, y, z)| Vec3::new(x, y, z)).collect()
    }
}

prop_compose! {
    fn blockers()(list in proptest::collection::vec((-2.5..2.5, -2.5..2.5, 0.05..0.6, 0.3..2.9), 0..6)) -> Vec<Cylinder> {
        let cylinder = |(x_m, y_m, radius_m, height_m)| Cylinder { x_m, y_m, radius_m, height_m };
        list.into_iter().map(cylinder).collect()
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn gains_are_finite_and_not_negative(
        room in rooms(),
        users in users(),
        blockers in blockers(),
        angle_seed in proptest::collection::vec(-1.6..1.6, 128),
        weights in proptest::collection::vec(0.0..10.0, 6),
    ) {
        let model = room.model();
        let (count, mirrors) = (users.len(), model.mirrors.len());
        let mut scene = Scene::new(&model, count);
        scene.update(&model, &users, &blockers, &vec![false; count]);
        let mut angles = MirrorAngles {
            roll: angle_seed[..mirrors].to_vec(),
            yaw: angle_seed[64..64 + mirrors].to_vec(),
        };
        let (mut gains, mut each) = (vec![0.0; count], vec![0.0; count * mirrors]);
        for decoded in [false, true] {
            if decoded {
                decode(&model, &scene, &weights[..count], &mut angles);
            }
            scene.irs_gain(&model, &angles, &mut gains);
            scene.irs_gain_each(&model, &angles, &mut each);
            let all = gains.iter().chain(&each).chain(scene.los_gain()).chain(scene.steering_gain());
            for gain in all {
                prop_assert!(gain.is_finite() && *gain >= 0.0, "{}", gain);
            }
            prop_assert!(angles.roll.iter().chain(&angles.yaw).all(|angle| angle.abs() <= 1.6));
            scene.rates_bps(&model, &angles, &mut gains);
            prop_assert!(gains.iter().all(|rate| rate.is_finite() && *rate >= 0.0));
        }
    }

    /// A mirror gives at most the gain of an unobstructed path of the same length with all cosines
    /// 1, times its reflectivity.
    #[test]
    fn a_mirror_adds_no_energy(users in users(), wall in walls()) {
        let mut room = Room::paper();
        room.array.wall = wall;
        let model = room.model();
        let mut scene = Scene::new(&model, users.len());
        scene.update(&model, &users, &[], &vec![false; users.len()]);
        for (user, position) in users.iter().enumerate() {
            for (mirror, centre) in model.mirrors.positions().iter().enumerate() {
                let length = (centre - room.leds[0].position).norm() + (centre - position).norm();
                let bound = 0.95 * 20e-6 / (std::f64::consts::PI * length * length);
                prop_assert!(scene.steering_gain()[user * 100 + mirror] <= bound * (1.0 + 1e-12));
            }
        }
    }

    /// Additional cylinders increase no gain.
    #[test]
    fn blockers_never_increase_a_gain(users in users(), blockers in blockers()) {
        let model = Room::paper().model();
        let (mut with, mut without) = (Scene::new(&model, users.len()), Scene::new(&model, users.len()));
        with.update(&model, &users, &blockers, &vec![false; users.len()]);
        without.update(&model, &users, blockers.get(1..).unwrap_or_default(), &vec![false; users.len()]);
        let pairs = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| a <= b);
        prop_assert!(pairs(with.los_gain(), without.los_gain()));
        prop_assert!(pairs(with.steering_gain(), without.steering_gain()));
    }

    /// A measured direct gain replaces the computed one in the SINR, whatever the receiver.
    #[test]
    fn a_measured_line_of_sight_gain_replaces_the_computed_gain(room in rooms(), gain in 1e-9..1e-5_f64, blocked in any::<bool>()) {
        let model = room.model();
        let mut scene = Scene::new(&model, 1);
        scene.update(&model, &[Vec3::new(0.3, 0.2, RECEIVER_HEIGHT_M)], &[], &[blocked]);
        scene.set_los_gain(&[gain]);
        prop_assert_eq!(scene.los_gain(), &[gain][..]);
        // All mirrors turned away: only the direct path is left.
        let away = MirrorAngles { roll: vec![-1.5; model.mirrors.len()], yaw: vec![0.0; model.mirrors.len()] };
        let mut reflected = [0.0];
        scene.irs_gain(&model, &away, &mut reflected);
        prop_assume!(reflected[0] == 0.0);
        let mut sinr = [0.0];
        scene.sinr(&model, &away, &mut sinr);
        prop_assert!((sinr[0] / model.budget.sinr(gain) - 1.0).abs() < 1e-9);
    }
}

fn build(room: &Room) -> Result<ChannelModel, ChannelError> {
    let parts = room.clone();
    let mirrors = MirrorArray::new(&parts.array)?;
    ChannelModel::new(parts.mode, parts.leds, mirrors, parts.receiver, parts.budget)
}

/// Changes one thing of a valid room and asks that it is refused.
fn refused(what: &str, change: impl Fn(&mut Room)) {
    let mut room = Room::paper();
    change(&mut room);
    assert!(build(&room).is_err(), "{what} was accepted");
}

#[test]
fn numbers_outside_their_domain_are_refused() {
    let never = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1.0];
    for bad in never {
        refused("side", |room| room.leds[0].side_m = bad);
        refused("gap", |room| room.array.gap_m = bad);
        refused("noise item", |room| room.budget.noise.thermal_a2_per_hz = bad);
        refused("reflectivity", |room| room.array.reflectivity = bad);
        refused("concentrator index", |room| room.receiver.concentrator_index = Some(bad));
    }
    for bad in never.into_iter().chain([0.0]) {
        refused("half-power semi-angle", |room| room.leds[0].half_power_semi_angle = bad);
        refused("mirror width", |room| room.array.mirror_width_m = bad);
        refused("mirror height", |room| room.array.mirror_height_m = bad);
        refused("wall distance", |room| room.array.wall_distance_m = bad);
        refused("detector area", |room| room.receiver.detector_area_m2 = bad);
        refused("filter gain", |room| room.receiver.filter_gain = bad);
        refused("field of view", |room| room.receiver.branches[0].fov_semi_angle = bad);
        refused("power", |room| room.budget.power_w = bad);
        refused("responsivity", |room| room.budget.responsivity_a_per_w = bad);
        refused("bandwidth", |room| room.budget.bandwidth_hz = bad);
        refused("noise", |room| room.budget.noise.variance_a2 = Some(bad));
        refused("gain scale", |room| room.mode = Mode::Paper { literal: false, gain_scale: bad });
    }
    refused("LED position", |room| room.leds[0].position.x = f64::NAN);
    refused("array height", |room| room.array.centre_height_m = f64::INFINITY);
    refused("reflectivity above 1", |room| room.array.reflectivity = 1.01);
    refused("field of view above 90 degrees", |room| room.receiver.branches[0].fov_semi_angle = 1.6);
    refused("half-power semi-angle of 90 degrees", |room| room.leds[0].half_power_semi_angle = 1.58);
    refused("branch that is no direction", |room| room.receiver.branches[0].normal = Vec3::new(0.0, 0.0, 2.0));
    refused("no noise at all", |room| {
        room.budget.noise.background_shot_a2_per_hz = 0.0;
        room.budget.noise.thermal_a2_per_hz = 0.0;
        room.budget.noise.preamplifier_a2_per_hz = 0.0;
    });
}

#[test]
fn too_few_and_too_many_are_refused() {
    refused("no LED", |room| room.leds.clear());
    refused("65 LEDs", |room| room.leds = vec![led(0.0, 0.0, 0.0); 65]);
    refused("no branch", |room| room.receiver.branches.clear());
    refused("17 branches", |room| room.receiver.branches = vec![room.receiver.branches[0].clone(); 17]);
    refused("no row", |room| room.array.rows = 0);
    refused("too many mirrors", |room| (room.array.rows, room.array.columns) = (129, 128));
    refused("more mirrors than there are numbers", |room| room.array.rows = usize::MAX);
    refused("no point", |room| room.leds[0].points_per_side = 0);
    refused("65 points a side", |room| room.leds[0].points_per_side = 65);
}

#[test]
fn an_led_behind_the_mirrors_is_refused() {
    let mut room = Room::paper();
    room.leds[0].position.y = 2.6;
    let error = build(&room).expect_err("behind the wall");
    assert!(matches!(error, ChannelError::LedBehindWall { led: 0, .. }), "{error}");
    room.array = ArraySpec { wall: Wall::MinusY, ..room.array };
    assert!(build(&room).is_ok(), "in front of the opposite wall");
}

#[test]
fn squared_power_counts_squared() {
    let mut room = Room::paper();
    let linear = room.model().budget.sinr(1e-7);
    room.budget.power_law = PowerLaw::Squared;
    assert!((room.model().budget.sinr(1e-7) / linear - 2.0).abs() < 1e-12);
}
