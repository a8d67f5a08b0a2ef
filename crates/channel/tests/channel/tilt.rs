//! Tilted receivers: closed forms, symmetries, and values of an independent computation with
//! matrices. tests/reference/tilted.py computes tests/reference/tilted.json.

use crate::common::{PAPER, Random, Room, angle_diversity, led};
use heliostat_channel::decode::{aim_at_point, decode};
use heliostat_channel::specular::{self, Plate};
use heliostat_channel::{
    Branch, ChannelModel, Combining, GeometryError, Method, MinimumRates, MirrorAngles, Mode, Orientation, Scene,
    Solver, Vec3, Wall, los,
};
use serde_json::Value;
use std::f64::consts::{FRAC_PI_2, PI};

fn close(found: f64, expected: f64, relative: f64, case: &str) {
    assert!((found - expected).abs() <= relative * expected.abs(), "{case}: {found} instead of {expected}");
}

fn number(case: &Value, key: &str) -> f64 {
    case[key].as_f64().expect("a number")
}

fn list(value: &Value) -> Vec<f64> {
    value.as_array().expect("a list").iter().map(|entry| entry.as_f64().expect("a number")).collect()
}

fn vector(value: &Value) -> Vec3 {
    Vec3::from_column_slice(&list(value))
}

/// The room of an independent value, and the user's orientation.
fn room_of(case: &Value) -> (Room, Orientation) {
    let mut room = Room::paper();
    room.leds = vec![led(0.0, 0.0, number(case, "side_m"))];
    room.leds[0].position = vector(&case["led"]);
    room.leds[0].points_per_side = number(case, "points_per_side") as usize;
    room.leds[0].half_power_semi_angle = number(case, "half_power_deg").to_radians();
    (room.array.rows, room.array.columns) = (2, 3);
    room.array.wall = match case["wall"].as_str().expect("a name") {
        "+x" => Wall::PlusX,
        "-x" => Wall::MinusX,
        "+y" => Wall::PlusY,
        _ => Wall::MinusY,
    };
    let branches = case["branches"].as_array().expect("a list");
    let branch = |entry: &Value| Branch {
        normal: vector(&entry["normal"]),
        fov_semi_angle: number(entry, "fov_deg").to_radians(),
    };
    room.receiver.branches = branches.iter().map(branch).collect();
    room.receiver.combining = Combining::MaximalRatio;
    room.receiver.concentrator_index = branches[0]["concentrator"].as_bool().expect("a flag").then_some(1.5);
    let orientation = match &case["quaternion"] {
        Value::Null => Orientation::from_polar_azimuth(number(case, "polar"), number(case, "azimuth")),
        quaternion => {
            let quaternion = list(quaternion).try_into().expect("four numbers");
            Orientation::from_quaternion(quaternion).expect("of length 1")
        }
    };
    (room, orientation)
}

#[test]
fn gains_of_tilted_receivers_are_those_of_an_independent_computation() {
    let all: Value = serde_json::from_str(include_str!("../reference/tilted.json")).expect("the file is JSON");
    let (mut lit, mut dark) = (0, 0);
    for case in all.as_array().expect("a list of cases") {
        let (room, orientation) = room_of(case);
        let (model, position) = (room.model(), vector(&case["position"]));
        let receiver = room.receiver.turned(&orientation);
        let direct = list(&case["direct"]);
        for (branch, expected) in receiver.branches.iter().zip(&direct) {
            let gain = los::gain(&room.leds[0], &receiver, branch, &position).expect("apart");
            close(gain, *expected, 1e-9, "one direct path");
        }
        let mut angles = MirrorAngles::flat(6);
        let mut reflected = Vec::new();
        for mirror in 0..6 {
            let turned = list(&case["angles"][mirror]);
            (angles.roll[mirror], angles.yaw[mirror]) = (turned[0], turned[1]);
            let plate = Plate::of(&model.mirrors, mirror, turned[0], turned[1]);
            let expected = list(&case["reflected"][mirror]);
            for (branch, expected) in receiver.branches.iter().zip(&expected) {
                let gain = specular::gain(&room.leds[0], &plate, 0.95, (&receiver, branch), &position).expect("finite");
                close(gain, *expected, 1e-9, "one reflected path");
                if *expected > 0.0 { lit += 1 } else { dark += 1 }
            }
            reflected.push(Combining::MaximalRatio.combine(&expected));
        }
        let (mut scene, mut each) = (Scene::new(&model, 1), vec![0.0; 6]);
        scene.update_turned(&model, &[position], &[orientation], &[], &[false]);
        close(scene.los_gain()[0], Combining::MaximalRatio.combine(&direct), 1e-9, "all direct paths");
        scene.irs_gain_each(&model, &angles, &mut each);
        each.iter().zip(&reflected).for_each(|(gain, expected)| close(*gain, *expected, 1e-9, "all mirrors"));
    }
    assert!(lit >= 200 && dark >= 200, "{lit} lit and {dark} dark paths");
}

#[test]
fn a_polar_angle_and_an_azimuth_give_the_direction_of_the_normal() {
    let mut random = Random::new(1);
    for _ in 0..100 {
        let (polar, azimuth) = (random.uniform(0.0, PI), random.uniform(-PI, PI));
        let orientation = Orientation::from_polar_azimuth(polar, azimuth);
        let expected = Vec3::new(polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos());
        assert!((orientation.normal() - expected).norm() < 1e-14);
        let axis = Vec3::new(-azimuth.sin(), azimuth.cos(), 0.0);
        assert!((orientation.turn(&axis) - axis).norm() < 1e-14, "the axis of the smallest rotation is level");
        let rotated = Orientation::from_rotation_vector((polar * axis).into());
        assert!((rotated.normal() - expected).norm() < 1e-14, "about the same axis");
        let again = Orientation::from_quaternion(orientation.quaternion()).expect("of length 1");
        let v = random.position();
        assert!((again.turn(&v) - orientation.turn(&v)).norm() < 1e-14 * v.norm());
        let other = random.orientation();
        let both = orientation.then(&other).turn(&v);
        assert!((both - other.turn(&orientation.turn(&v))).norm() < 1e-13, "one rotation after the other");
    }
}

#[test]
fn a_quaternion_of_another_length_or_without_a_number_is_refused() {
    for bad in [[0.0; 4], [1.0, 0.0, 0.0, 0.1], [f64::NAN, 0.0, 0.0, 1.0], [f64::INFINITY, 0.0, 0.0, 0.0]] {
        assert!(matches!(Orientation::from_quaternion(bad), Err(GeometryError::NotUnit { .. })), "{bad:?}");
    }
    assert_eq!(Orientation::from_rotation_vector([0.0; 3]), Orientation::UPRIGHT);
    let rounded = Orientation::from_quaternion([0.8001, 0.6, 0.0, 0.0]).expect("rounded");
    assert!((rounded.turn(&Vec3::x()).norm() - 1.0).abs() < 1e-15);
}

/// Gain over the direct path of one user with a single detector.
fn direct(room: &Room, user: Vec3, orientation: Orientation) -> f64 {
    let model = room.model();
    let mut scene = Scene::new(&model, 1);
    scene.update_turned(&model, &[user], &[orientation], &[], &[false]);
    scene.los_gain()[0]
}

#[test]
fn a_tilt_towards_the_led_raises_the_direct_gain_by_the_ratio_of_the_cosines() {
    let room = Room::paper();
    let user = Vec3::new(1.2, -0.7, 0.85);
    let to_led = room.leds[0].position - user;
    let polar = (to_led.z / to_led.norm()).acos();
    let azimuth = to_led.y.atan2(to_led.x);
    let upright = direct(&room, user, Orientation::UPRIGHT);
    for tilt in [0.1, 0.5 * polar, polar, polar + 0.4] {
        let tilted = direct(&room, user, Orientation::from_polar_azimuth(tilt, azimuth));
        close(tilted / upright, (polar - tilt).cos() / polar.cos(), 1e-12, "towards the LED");
    }
}

#[test]
fn a_tilted_receiver_is_dark_outside_its_field_of_view_and_when_it_faces_away() {
    let mut room = Room::paper();
    let below = Vec3::new(0.0, 0.0, 0.85);
    let tilted =
        |room: &Room, degrees: f64| direct(room, below, Orientation::from_polar_azimuth(degrees.to_radians(), 0.7));
    assert!(tilted(&room, 89.99) > 0.0);
    assert_eq!([tilted(&room, 90.01), tilted(&room, 180.0)], [0.0; 2]);
    room.receiver.branches[0].fov_semi_angle = 35.0_f64.to_radians();
    assert!(tilted(&room, 34.99) > 0.0);
    assert_eq!(tilted(&room, 35.01), 0.0);
    // The mirrors are at +y: a receiver that faces -y sees none of them.
    for room in [room.clone(), room.clone().with_panel(), room.with_mode(PAPER)] {
        let model = room.model();
        let away = Orientation::from_polar_azimuth(80.0_f64.to_radians(), -FRAC_PI_2);
        let (mut scene, mut angles, mut gain) = (Scene::new(&model, 1), MirrorAngles::flat(100), [1.0]);
        scene.update_turned(&model, &[below], &[away], &[], &[false]);
        aim_at_point(&model, &below, &mut angles);
        scene.irs_gain(&model, &angles, &mut gain);
        assert!(gain == [0.0] && scene.steering_gain().iter().all(|gain| *gain == 0.0));
    }
}

#[test]
fn the_gain_of_a_tilted_receiver_falls_with_the_square_of_the_distance() {
    let room = Room::paper();
    let direction = Vec3::new(0.6, -0.3, -0.74).normalize();
    let tilted = Orientation::from_polar_azimuth(0.5, 2.0);
    let at = |distance: f64| direct(&room, room.leds[0].position + distance * direction, tilted);
    for factor in [1.5, 2.0, 3.0] {
        close(at(0.9) / at(0.9 * factor), factor * factor, 1e-12, "distance");
    }
}

#[test]
fn below_the_led_the_azimuth_of_the_tilt_does_not_matter() {
    for room in [Room::paper(), Room::paper().with_mode(PAPER)] {
        let below = Vec3::new(0.0, 0.0, 0.85);
        let first = direct(&room, below, Orientation::from_polar_azimuth(0.6, 0.0));
        close(first, direct(&room, below, Orientation::UPRIGHT) * 0.6_f64.cos(), 1e-12, "cosine of the tilt");
        for step in 1..12 {
            let azimuth = f64::from(step) * PI / 6.0;
            close(direct(&room, below, Orientation::from_polar_azimuth(0.6, azimuth)), first, 1e-12, "azimuth");
        }
    }
}

#[test]
fn a_room_turned_by_a_quarter_with_its_tilted_receivers_is_the_same_room() {
    let mut random = Random::new(11);
    let users = random.positions(5);
    let tilts: Vec<(f64, f64)> = (0..5).map(|_| (random.uniform(0.0, 1.0), random.uniform(-PI, PI))).collect();
    let turn = |quarters: usize, v: &Vec3| (0..quarters).fold(*v, |v, _| Vec3::new(v.y, -v.x, v.z));
    let mut expected: Option<[f64; 5]> = None;
    for (quarters, wall) in [Wall::PlusY, Wall::PlusX, Wall::MinusY, Wall::MinusX].into_iter().enumerate() {
        let mut room = Room::paper().with_panel();
        room.array.wall = wall;
        let model = room.model();
        let turned: Vec<Vec3> = users.iter().map(|user| turn(quarters, user)).collect();
        let azimuth_of = |azimuth: f64| azimuth - quarters as f64 * FRAC_PI_2;
        let held = tilts.iter().map(|(polar, azimuth)| Orientation::from_polar_azimuth(*polar, azimuth_of(*azimuth)));
        let (mut scene, mut angles, mut rates) = (Scene::new(&model, 5), MirrorAngles::flat(100), [0.0; 5]);
        scene.update_turned(&model, &turned, &held.collect::<Vec<_>>(), &[], &[false; 5]);
        decode(&model, &scene, &[1.0; 5], &mut angles);
        scene.rates_bps(&model, &angles, &mut rates);
        let first = *expected.get_or_insert(rates);
        rates.iter().zip(first).for_each(|(found, first)| close(*found, first, 1e-9, "rate"));
    }
    assert!(expected.is_some_and(|rates| rates.iter().all(|rate| *rate > 0.0)));
}

/// Every bit of the gains of a scene, with the mirrors at the angles of the decoder.
fn bits(model: &ChannelModel, scene: &Scene) -> Vec<u64> {
    let (users, mut angles) = (scene.users(), MirrorAngles::flat(scene.mirrors()));
    decode(model, scene, &vec![1.0; users], &mut angles);
    let mut rates = vec![0.0; users];
    scene.rates_bps(model, &angles, &mut rates);
    let gains = scene.los_gain().iter().chain(scene.steering_gain()).chain(&rates);
    gains.map(|gain| gain.to_bits()).collect()
}

#[test]
fn upright_orientations_change_no_bit_of_any_gain() {
    let mut branches = Room::paper().with_panel();
    branches.receiver.branches = angle_diversity();
    branches.receiver.combining = Combining::MaximalRatio;
    branches.leds.push(led(1.0, 1.0, 0.1));
    let literal = Room::paper().with_mode(Mode::Paper { literal: true, gain_scale: 1.0 });
    for room in [Room::paper(), Room::paper().with_panel(), literal, branches.clone().with_mode(PAPER), branches] {
        let model = room.model();
        let mut random = Random::new(7);
        let (users, blockers) = (random.positions(8), random.blockers(&[]));
        let (mut plain, mut turned) = (Scene::new(&model, 8), Scene::new(&model, 8));
        plain.update(&model, &users, &blockers, &[false; 8]);
        let tilted: Vec<_> = (0..8).map(|_| random.orientation()).collect();
        turned.update_turned(&model, &users, &tilted, &blockers, &[false; 8]);
        assert_ne!(bits(&model, &turned), bits(&model, &plain));
        turned.update_turned(&model, &users, &[Orientation::UPRIGHT; 8], &blockers, &[false; 8]);
        assert_eq!(bits(&model, &turned), bits(&model, &plain));
        // An update without orientations is upright, whatever was before.
        turned.update_turned(&model, &users, &tilted, &blockers, &[false; 8]);
        turned.update(&model, &users, &blockers, &[false; 8]);
        assert_eq!(bits(&model, &turned), bits(&model, &plain));
    }
}

#[test]
fn the_solvers_objective_for_tilted_receivers_is_that_of_its_angles() {
    let mut random = Random::new(3);
    for case in 0..20 {
        let model = Room::paper().with_panel().model();
        let (users, held) = (random.positions(5), [(); 5].map(|()| random.orientation()));
        let forced = [true, case % 2 == 0, false, false, case % 3 == 0];
        let (mut scene, mut angles, mut rates) = (Scene::new(&model, 5), MirrorAngles::flat(100), [0.0; 5]);
        scene.update_turned(&model, &users, &held, &[], &forced);
        for method in [Method::Greedy { passes: 3 }, Method::Oracle] {
            let objective = Solver::new(5, 100).solve(&model, &scene, &MinimumRates::NONE, method, &mut angles);
            scene.rates_bps(&model, &angles, &mut rates);
            close(rates.iter().sum(), objective, 1e-9, "objective");
        }
    }
}

#[test]
fn a_user_served_by_a_given_led_has_the_gains_of_a_room_with_that_led_alone() {
    let mut random = Random::new(11);
    let mut room = Room::paper().with_panel();
    room.leds = vec![led(-1.2, 0.3, 0.1), led(1.1, -0.4, 0.1)];
    let both = room.model();
    let (users, blockers) = (random.positions(6), random.blockers(&[]));
    let held: Vec<_> = (0..6).map(|_| random.orientation()).collect();
    let mut scene = Scene::new(&both, 6);
    scene.place_turned(&both, &users, &held, &blockers);
    let (angles, mut gains, mut gains_alone) = (MirrorAngles::flat(100), vec![0.0; 100], vec![0.0; 600]);
    for index in 0..2 {
        let alone = Room { leds: vec![room.leds[index].clone()], ..room.clone() }.model();
        let mut expected = Scene::new(&alone, 6);
        expected.update_turned(&alone, &users, &held, &blockers, &[false; 6]);
        (0..6).for_each(|user| scene.serve_by(&both, &blockers, user, index));
        assert_eq!(scene.los_gain(), expected.los_gain(), "LED {index}");
        assert_eq!(scene.steering_gain(), expected.steering_gain(), "LED {index}");
        assert_eq!(scene.irs_path_clear(), expected.irs_path_clear(), "LED {index}");
        assert_eq!(scene.serving(), [index; 6]);
        expected.irs_gain_each(&alone, &angles, &mut gains_alone);
        for user in 0..6 {
            scene.irs_gain_each_of(&both, &angles, user, &mut gains);
            assert_eq!(gains, gains_alone[user * 100..][..100], "LED {index}, user {user}");
            let other = scene.los_gain_by(&both, &blockers, user, 1 - index);
            scene.serve_by(&both, &blockers, user, 1 - index);
            assert_eq!(other, scene.los_gain()[user], "the direct gain of the LED that does not serve");
            scene.serve_by(&both, &blockers, user, index);
        }
    }
}
