//! Several mirror arrays: one index space, and the gains of the single arrays.

use crate::common::{PAPER, Random, Room, angle_diversity, led};
use heliostat_channel::decode::{aim, decode};
use heliostat_channel::scene::Spill;
use heliostat_channel::{
    ArraySpec, ChannelError, ChannelModel, Combining, Cylinder, Led, Method, MinimumRates, MirrorAngles, MirrorArray,
    MirrorArrays, Mode, Orientation, Scene, Solver, Vec3, Wall,
};

const USERS: usize = 5;

/// A second array of another size, reflectivity and wall; 35 mirrors, so that a block of mirrors
/// spans both arrays.
fn second() -> ArraySpec {
    ArraySpec {
        rows: 7,
        columns: 5,
        mirror_width_m: 0.15,
        mirror_height_m: 0.12,
        gap_m: 0.01,
        centre_height_m: 1.8,
        wall: Wall::PlusX,
        wall_distance_m: 2.5,
        reflectivity: 0.7,
    }
}

fn with_second(room: &Room) -> Room {
    Room { others: vec![second()], ..room.clone() }
}

/// The paper's rooms with one array.
fn rooms() -> Vec<Room> {
    let mut diverse = Room::paper().with_panel();
    diverse.receiver.branches = angle_diversity();
    diverse.receiver.combining = Combining::EqualGain;
    let several = Room { leds: vec![led(-1.2, -1.2, 0.0), led(1.2, 1.2, 0.1)], ..Room::paper() };
    let paper = Room::paper().with_mode(PAPER);
    let literal = Room::paper().with_mode(Mode::Paper { literal: true, gain_scale: 85.0 });
    vec![Room::paper(), Room::paper().with_panel(), diverse, several, paper, literal]
}

/// Users with blockers and orientations.
struct Crowd {
    users: Vec<Vec3>,
    blockers: Vec<Cylinder>,
    orientations: Vec<Orientation>,
}

impl Crowd {
    fn new(random: &mut Random) -> Self {
        let mut users = random.positions(USERS);
        // Close to the first, so that it is within the spot of a mirror.
        users[1] = users[0] + Vec3::new(0.04, 0.05, 0.0);
        let blockers = random.blockers(&users[2..]);
        let orientations = (0..USERS).map(|_| Orientation::from_polar_azimuth(random.uniform(0.0, 0.5), 1.0)).collect();
        Self { users, blockers, orientations }
    }

    fn scene(&self, model: &ChannelModel) -> Scene {
        let mut scene = Scene::new(model, USERS);
        scene.update_turned(model, &self.users, &self.orientations, &self.blockers, &[false; USERS]);
        scene
    }
}

fn close(found: f64, expected: f64, what: &str) {
    assert!((found - expected).abs() <= 1e-12 * expected.abs(), "{what}: {found} instead of {expected}");
}

fn part(angles: &MirrorAngles, range: std::ops::Range<usize>) -> MirrorAngles {
    MirrorAngles { roll: angles.roll[range.clone()].to_vec(), yaw: angles.yaw[range].to_vec() }
}

#[test]
fn two_arrays_give_each_user_the_gains_of_both() {
    let mut lit = [0; 2];
    for (case, room) in rooms().into_iter().enumerate() {
        let alone = [room.model(), Room { array: second(), ..room.clone() }.model()];
        let both = with_second(&room).model();
        let mut random = Random::new(71 + case as u64);
        for _ in 0..10 {
            let crowd = Crowd::new(&mut random);
            let scene = crowd.scene(&both);
            let mut angles = MirrorAngles::flat(135);
            let served: Vec<usize> = (0..135).map(|_| random.next() as usize % USERS).collect();
            aim(&both, &scene, &served, &mut angles);
            let mut each = vec![0.0; USERS * 135];
            scene.irs_gain_each(&both, &angles, &mut each);
            for (index, model) in alone.iter().enumerate() {
                let (single, range) = (crowd.scene(model), both.mirrors.range(index));
                // The sum over all arrays chooses the LED of a user without a direct path.
                if single.serving() != scene.serving() {
                    continue;
                }
                let count = range.len();
                let mut expected = vec![0.0; USERS * count];
                single.irs_gain_each(model, &part(&angles, range.clone()), &mut expected);
                for user in 0..USERS {
                    let row = user * 135 + range.start..user * 135 + range.end;
                    let (gains, rows) = (&each[row.clone()], user * count..(user + 1) * count);
                    gains
                        .iter()
                        .zip(&expected[rows.clone()])
                        .for_each(|(found, expected)| close(*found, *expected, "gain"));
                    let steering = scene.steering_gain()[row.clone()].iter().zip(&single.steering_gain()[rows.clone()]);
                    steering.for_each(|(found, expected)| close(*found, *expected, "steering gain"));
                    assert_eq!(scene.irs_path_clear()[row], single.irs_path_clear()[rows]);
                }
                lit[index] += expected.iter().filter(|gain| **gain > 0.0).count();
            }
        }
    }
    assert!(lit.iter().all(|lit| *lit > 500), "too few pairs had light: {lit:?}");
}

#[test]
fn rates_at_given_angles_are_those_of_the_summed_gains() {
    let room = Room::paper().with_panel();
    let (both, mut random) = (with_second(&room).model(), Random::new(72));
    for _ in 0..20 {
        let crowd = Crowd::new(&mut random);
        let scene = crowd.scene(&both);
        let mut angles = MirrorAngles::flat(135);
        decode(&both, &scene, &[1.0; USERS], &mut angles);
        let mut gains = scene.los_gain().to_vec();
        for (index, array) in [room.array.clone(), second()].into_iter().enumerate() {
            let model = Room { array, ..room.clone() }.model();
            let mut reflected = [0.0; USERS];
            crowd.scene(&model).irs_gain(&model, &part(&angles, both.mirrors.range(index)), &mut reflected);
            gains.iter_mut().zip(reflected).for_each(|(sum, gain)| *sum += gain);
        }
        let mut rates = [0.0; USERS];
        scene.rates_bps(&both, &angles, &mut rates);
        for (rate, gain) in rates.into_iter().zip(gains) {
            close(rate, both.budget.rate_bps(both.budget.sinr(gain), USERS), "rate");
        }
    }
}

/// Rotation about z by -90 degrees: the +y wall becomes the +x wall.
fn turned(point: &Vec3) -> Vec3 {
    Vec3::new(point.y, -point.x, point.z)
}

fn turned_wall(wall: Wall) -> Wall {
    match wall {
        Wall::PlusY => Wall::PlusX,
        Wall::PlusX => Wall::MinusY,
        Wall::MinusY => Wall::MinusX,
        Wall::MinusX => Wall::PlusY,
    }
}

#[test]
fn a_room_with_an_array_on_each_wall_can_be_rotated() {
    for mode in [Mode::Specular, PAPER, Mode::Paper { literal: true, gain_scale: 1.0 }] {
        let mut room = Room::paper().with_mode(mode);
        room.leds = vec![led(0.4, -0.3, 0.1)];
        let array = |wall, rows, reflectivity| ArraySpec { wall, rows, reflectivity, ..second() };
        room.array = array(Wall::PlusY, 4, 0.95);
        room.others = vec![array(Wall::PlusX, 3, 0.8), array(Wall::MinusY, 5, 0.9), array(Wall::MinusX, 2, 0.6)];
        let mut rotated = room.clone();
        rotated.leds.iter_mut().for_each(|led: &mut Led| led.position = turned(&led.position));
        for spec in std::iter::once(&mut rotated.array).chain(&mut rotated.others) {
            spec.wall = turned_wall(spec.wall);
        }
        let (model, rotated) = (room.model(), rotated.model());
        let mut random = Random::new(73);
        for _ in 0..10 {
            let users = random.positions(USERS);
            let around: Vec<Vec3> = users.iter().map(turned).collect();
            let (mut scene, mut other) = (Scene::new(&model, USERS), Scene::new(&rotated, USERS));
            scene.update(&model, &users, &[], &[false; USERS]);
            other.update(&rotated, &around, &[], &[false; USERS]);
            let (mut angles, mut same) = (MirrorAngles::flat(70), MirrorAngles::flat(70));
            let weights = [1.0, 3.0, 0.5, 2.0, 1.0];
            decode(&model, &scene, &weights, &mut angles);
            decode(&rotated, &other, &weights, &mut same);
            for (angle, same) in angles.roll.iter().chain(&angles.yaw).zip(same.roll.iter().chain(&same.yaw)) {
                assert!((angle - same).abs() < 1e-9, "{angle} and {same}");
            }
            let (mut gains, mut expected) = ([0.0; USERS], [0.0; USERS]);
            scene.irs_gain(&model, &angles, &mut gains);
            other.irs_gain(&rotated, &angles, &mut expected);
            assert!(gains.iter().any(|gain| *gain > 0.0));
            for (gain, expected) in gains.into_iter().zip(expected) {
                assert!((gain - expected).abs() <= 1e-9 * expected, "{gain} instead of {expected}");
            }
        }
    }
}

#[test]
fn the_solver_gains_from_a_second_array() {
    let room = Room::paper().with_panel();
    let (mut better, mut random) = (0, Random::new(74));
    for _ in 0..20 {
        let crowd = Crowd::new(&mut random);
        let solve = |room: &Room| {
            let model = room.model();
            let mut solver = Solver::new(USERS, model.mirrors.len());
            let (rates, mut angles) = ([1e6; USERS], MirrorAngles::flat(model.mirrors.len()));
            let min_rates = MinimumRates { min_rate_bps: &rates, qos_penalty: 0.0 };
            let scene = crowd.scene(&model);
            solver.solve(&model, &scene, &min_rates, Method::Oracle, &mut angles);
            let mut rates = [0.0; USERS];
            scene.rates_bps(&model, &angles, &mut rates);
            rates.iter().sum::<f64>()
        };
        let alone = solve(&room).max(solve(&Room { array: second(), ..room.clone() }));
        let both = solve(&with_second(&room));
        assert!(both >= alone * (1.0 - 1e-9), "{both} with both arrays, {alone} with one");
        better += usize::from(both > 1.01 * alone);
    }
    assert!(better > 10, "{better} of 20 states");
}

#[test]
fn spilled_gains_of_two_arrays_are_those_at_the_angles_of_the_aims() {
    let model = with_second(&Room::paper().with_panel()).model();
    let (mut entries, mut random) = ([0; 2], Random::new(75));
    for _ in 0..20 {
        let crowd = Crowd::new(&mut random);
        let scene = crowd.scene(&model);
        let mut spill = Spill::new(USERS, 135);
        spill.update(&model, &scene);
        let (mut angles, mut each) = (MirrorAngles::flat(135), vec![0.0; USERS * 135]);
        for user in 0..USERS {
            aim(&model, &scene, &[user; 135], &mut angles);
            scene.irs_gain_each(&model, &angles, &mut each);
            for mirror in 0..135 {
                for spilled in spill.of(user, mirror) {
                    assert_eq!(spilled.gain, each[spilled.user * 135 + mirror]);
                    entries[usize::from(mirror >= 100)] += 1;
                }
                let lit = (0..USERS).filter(|other| *other != user && each[other * 135 + mirror] > 0.0).count();
                if scene.steering_gain()[user * 135 + mirror] > 0.0 {
                    assert_eq!(spill.of(user, mirror).len(), lit, "no lit user is missing");
                }
            }
        }
    }
    assert!(entries.iter().all(|entries| *entries > 100), "{entries:?}");
}

#[test]
fn the_columns_of_each_array_have_their_own_weights() {
    let model = with_second(&Room::paper()).model();
    let crowd = Crowd::new(&mut Random::new(76));
    let (before, mut scene) = (crowd.scene(&model), crowd.scene(&model));
    let factors: Vec<f64> = (1..=15).map(f64::from).collect();
    scene.weigh_columns(&model, 2, &factors);
    for mirror in 0..135 {
        let factor = if mirror < 100 { factors[mirror % 10] } else { factors[10 + (mirror - 100) % 5] };
        assert_eq!(scene.steering_gain()[270 + mirror], factor * before.steering_gain()[270 + mirror]);
    }
    assert!(before.steering_gain()[270..405].iter().any(|gain| *gain > 0.0));
}

#[test]
fn an_led_behind_any_wall_with_mirrors_is_refused() {
    let mut room = with_second(&Room::paper());
    room.leds[0].position.x = 2.6;
    let error = ChannelModel::new(room.mode, room.leds.clone(), room.mirrors(), room.receiver.clone(), room.budget)
        .expect_err("behind the second array");
    assert!(matches!(error, ChannelError::LedBehindWall { led: 0, .. }), "{error}");
}

#[test]
fn too_few_and_too_many_arrays_are_refused() {
    let array = |rows| MirrorArray::new(&ArraySpec { rows, columns: 128, ..second() }).expect("a valid array");
    for arrays in [vec![], vec![array(1); 17], vec![array(64), array(65)]] {
        let error = MirrorArrays::new(arrays).expect_err("refused");
        assert!(matches!(error, ChannelError::Count { .. }), "{error}");
    }
    assert_eq!(MirrorArrays::new(vec![array(64); 2]).expect("at the limit").len(), 16_384);
}
