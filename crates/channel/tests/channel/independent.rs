//! Comparison with independent implementations: vlcSim 0.8.1 from PyPI for line-of-sight gains and
//! for walls by eqs. (2) and (3), and a computation from conservation of energy for mirrors.
//! tests/reference/reference.py computes the values of tests/reference/values.json.

use crate::common::{PAPER, Room};
use heliostat_channel::specular::{self, Plate};
use heliostat_channel::{Branch, MirrorAngles, Scene, Vec3, Wall, ber_ook, los};
use serde_json::Value;

fn values(topic: &str) -> Vec<Value> {
    let all: Value = serde_json::from_str(include_str!("../reference/values.json")).expect("the file is JSON");
    all[topic].as_array().expect("a list of cases").clone()
}

fn number(case: &Value, key: &str) -> f64 {
    case[key].as_f64().expect("a number")
}

fn vector(case: &Value, key: &str) -> Vec3 {
    let list: Vec<f64> = case[key].as_array().expect("a vector").iter().filter_map(Value::as_f64).collect();
    Vec3::new(list[0], list[1], list[2])
}

fn room_of(case: &Value) -> Room {
    let mut room = Room::paper();
    room.leds[0].position = Vec3::new(0.3, -0.2, 3.0);
    room.leds[0].half_power_semi_angle = number(case, "half_power_deg").to_radians();
    room
}

#[test]
fn direct_gain_is_that_of_vlcsim() {
    let cases = values("direct");
    for case in &cases {
        let mut room = room_of(case);
        let fov_semi_angle = number(case, "fov_deg").to_radians();
        room.receiver.branches = vec![Branch { normal: Vec3::z(), fov_semi_angle }];
        room.receiver.concentrator_index = case["concentrator"].as_bool().expect("a flag").then_some(1.5);
        let user = Vec3::new(number(case, "x"), number(case, "y"), number(case, "z"));
        let gain = los::gain(&room.leds[0], &room.receiver, &room.receiver.branches[0], &user).expect("apart");
        let expected = number(case, "gain");
        assert!((gain - expected).abs() <= 1e-12 * expected, "{gain} instead of {expected}: {case}");
    }
    let dark = cases.iter().filter(|case| number(case, "gain") == 0.0).count();
    assert!(dark > 0 && dark < cases.len() / 2, "{dark} of {} are outside the field of view", cases.len());
}

/// vlcSim divides a wall of 5 m x 3 m into 10 x 6 cells of 0.25 m2 whose centres are on a grid that
/// reaches the corners; the gap between mirrors of that area makes the same grid.
#[test]
fn a_wall_of_flat_mirrors_by_the_papers_equations_is_a_wall_of_vlcsim() {
    let (pitch_x, pitch_z): (f64, f64) = (5.0 / 9.0, 3.0 / 5.0);
    let half_sum = 0.5 * (pitch_x + pitch_z);
    let gap = half_sum - (half_sum * half_sum - (pitch_x * pitch_z - 0.25)).sqrt();
    for case in values("wall") {
        let mut room = room_of(&case).with_mode(PAPER);
        (room.array.rows, room.array.columns, room.array.centre_height_m) = (6, 10, 1.5);
        (room.array.mirror_width_m, room.array.mirror_height_m) = (pitch_x - gap, pitch_z - gap);
        room.array.gap_m = gap;
        room.array.wall = match case["wall"].as_str().expect("a name") {
            "+x" => Wall::PlusX,
            "-x" => Wall::MinusX,
            "+y" => Wall::PlusY,
            _ => Wall::MinusY,
        };
        let model = room.model();
        let mut scene = Scene::new(&model, 1);
        scene.update(&model, &[Vec3::new(number(&case, "x"), number(&case, "y"), 0.0)], &[], &[false]);
        let mut gain = [0.0];
        scene.irs_gain(&model, &MirrorAngles::flat(60), &mut gain);
        let expected = number(&case, "gain");
        assert!((gain[0] - expected).abs() <= 1e-12 * expected, "{} instead of {expected}: {case}", gain[0]);
    }
}

#[test]
fn specular_gain_follows_from_the_law_of_reflection_and_energy() {
    let (mut lit, mut dark) = (0, 0);
    for case in values("specular") {
        let mut room = room_of(&case);
        room.leds[0].position = vector(&case, "led");
        room.leds[0].side_m = number(&case, "side_m");
        room.leds[0].points_per_side = 2;
        let mirror = case["mirror"].as_u64().expect("an index") as usize;
        let plate = Plate::of(&room.mirrors(), mirror, number(&case, "roll"), number(&case, "yaw"));
        let receiver = (&room.receiver, &room.receiver.branches[0]);
        let gain = specular::gain(&room.leds[0], &plate, 0.95, receiver, &vector(&case, "detector")).expect("finite");
        let expected = number(&case, "gain");
        // The reference's Jacobian is a difference quotient with an error of about 1e-8.
        assert!((gain - expected).abs() <= 1e-6 * expected, "{gain} instead of {expected}: {case}");
        if expected > 0.0 { lit += 1 } else { dark += 1 }
    }
    assert!(lit >= 20 && dark >= 5, "{lit} lit and {dark} dark cases");
}

#[test]
fn error_rate_is_that_of_the_c_library() {
    for case in values("error_rate") {
        let found = ber_ook(10.0_f64.powf(number(&case, "sinr_db") / 10.0));
        let expected = number(&case, "ber");
        assert!((found - expected).abs() <= 1e-12 * expected, "{found} instead of {expected}: {case}");
    }
}
