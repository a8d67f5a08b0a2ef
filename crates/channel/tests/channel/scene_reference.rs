//! The pass over all users and mirrors equals the functions of one path, pair by pair, for upright
//! and for tilted receivers.

use crate::common::{PAPER, Random, Room, angle_diversity, led};
use heliostat_channel::blockage::blocks;
use heliostat_channel::decode::{aim, aim_at_point};
use heliostat_channel::diffuse::{self, Reading};
use heliostat_channel::specular::{self, Plate};
use heliostat_channel::{
    ChannelModel, Combining, Cylinder, MirrorAngles, Mode, Orientation, Receiver, Scene, Vec3, Wall, los,
};

const USERS: usize = 6;

/// A scene with blockers; every second mirror is aimed at a user, the others have random angles. The
/// users of a case with an odd seed hold their receivers in random orientations.
struct Case {
    model: ChannelModel,
    scene: Scene,
    blockers: Vec<Cylinder>,
    forced: Vec<bool>,
    orientations: Vec<Orientation>,
    angles: MirrorAngles,
}

impl Case {
    fn new(room: &Room, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let model = room.model();
        let users = random.positions(USERS);
        let blockers = random.blockers(&users);
        let forced: Vec<bool> = (0..USERS).map(|_| random.uniform(0.0, 1.0) < 0.2).collect();
        let mut scene = Scene::new(&model, USERS);
        let mut orientations = vec![Orientation::UPRIGHT; USERS];
        if seed % 2 == 1 {
            orientations.fill_with(|| random.orientation());
            scene.update_turned(&model, &users, &orientations, &blockers, &forced);
        } else {
            scene.update(&model, &users, &blockers, &forced);
        }
        let mirrors = model.mirrors.len();
        let mut angles = MirrorAngles::flat(mirrors);
        let served: Vec<usize> = (0..mirrors).map(|_| random.next() as usize % USERS).collect();
        aim(&model, &scene, &served, &mut angles);
        for mirror in (0..mirrors).step_by(2) {
            angles.roll[mirror] += 0.02 * random.normal();
            angles.yaw[mirror] += 0.02 * random.normal();
        }
        Self { model, scene, blockers, forced, orientations, angles }
    }

    fn led_of(&self, user: usize) -> &heliostat_channel::Led {
        &self.model.leds[self.scene.serving()[user]]
    }

    fn visible(&self, user: usize, mirror: usize) -> bool {
        let (led, mirror) = (&self.led_of(user).position, &self.model.mirrors.positions()[mirror]);
        let user = &self.scene.positions()[user];
        !self.blockers.iter().any(|cylinder| blocks(cylinder, led, mirror) || blocks(cylinder, user, mirror))
    }

    fn receiver(&self, user: usize) -> Receiver {
        self.model.receiver.turned(&self.orientations[user])
    }

    /// Gain of each branch by the functions of one path.
    fn reference(&self, user: usize, mirror: usize) -> Vec<f64> {
        let (led, position) = (self.led_of(user), &self.scene.positions()[user]);
        let (roll, yaw) = (self.angles.roll[mirror], self.angles.yaw[mirror]);
        let receiver = &self.receiver(user);
        let gain = |branch| match self.model.mode {
            Mode::Specular => {
                let plate = Plate::of(&self.model.mirrors, mirror, roll, yaw);
                let reflectivity = self.model.mirrors.reflectivity(mirror);
                specular::gain(led, &plate, reflectivity, (receiver, branch), position).expect("finite")
            }
            Mode::Paper { literal, gain_scale } => {
                let reading = if literal { Reading::Literal } else { Reading::Sensible };
                let path = (led, &self.model.mirrors, mirror);
                gain_scale * diffuse::gain(reading, path, (roll, yaw), (receiver, branch), position)
            }
        };
        receiver.branches.iter().map(|branch| if self.visible(user, mirror) { gain(branch) } else { 0.0 }).collect()
    }

    fn direct(&self, user: usize) -> Vec<f64> {
        let (led, position) = (self.led_of(user), &self.scene.positions()[user]);
        let blocked =
            self.forced[user] || self.blockers.iter().any(|cylinder| blocks(cylinder, &led.position, position));
        let receiver = self.receiver(user);
        let gain = |branch| los::gain(led, &receiver, branch, position).expect("apart");
        receiver.branches.iter().map(|branch| if blocked { 0.0 } else { gain(branch) }).collect()
    }

    /// Compares all results; returns the number of pairs with a gain above 0.
    fn check(&self) -> usize {
        let mirrors = self.model.mirrors.len();
        let combine = |gains: &[f64]| self.model.receiver.combining.combine(gains);
        let mut each = vec![0.0; USERS * mirrors];
        let (mut sums, mut sinr, mut rates) = (vec![0.0; USERS], vec![0.0; USERS], vec![0.0; USERS]);
        self.scene.irs_gain_each(&self.model, &self.angles, &mut each);
        self.scene.irs_gain(&self.model, &self.angles, &mut sums);
        self.scene.sinr(&self.model, &self.angles, &mut sinr);
        self.scene.rates_bps(&self.model, &self.angles, &mut rates);
        let mut lit = 0;
        for user in 0..USERS {
            let mut total = vec![0.0; self.model.receiver.branches.len()];
            for mirror in 0..mirrors {
                let expected = self.reference(user, mirror);
                close(each[user * mirrors + mirror], combine(&expected), "one mirror");
                assert_eq!(self.scene.irs_path_clear()[user * mirrors + mirror], self.visible(user, mirror));
                lit += usize::from(combine(&expected) > 0.0);
                total.iter_mut().zip(expected).for_each(|(sum, gain)| *sum += gain);
            }
            close(sums[user], combine(&total), "all mirrors");
            let direct = self.direct(user);
            close(self.scene.los_gain()[user], combine(&direct), "direct");
            total.iter_mut().zip(direct).for_each(|(sum, gain)| *sum += gain);
            let expected = self.model.budget.sinr(combine(&total));
            close(sinr[user], expected, "sinr");
            close(rates[user], self.model.budget.rate_bps(expected, USERS), "rate");
        }
        lit
    }
}

fn close(found: f64, expected: f64, what: &str) {
    assert!((found - expected).abs() <= 1e-10 * expected.abs(), "{what}: {found} instead of {expected}");
}

/// Checks random scenes of a room, of whose pairs a large fraction must have a gain above 0.
fn check_room(room: &Room) {
    let lit: usize = (0..20).map(|seed| Case::new(room, seed).check()).sum();
    assert!(lit > 100, "only {lit} pairs had light: the test would see nothing");
}

#[test]
fn point_led() {
    check_room(&Room::paper());
}

#[test]
fn panel() {
    check_room(&Room::paper().with_panel());
}

#[test]
fn panel_of_another_order() {
    let mut room = Room::paper().with_panel();
    room.leds[0].half_power_semi_angle = 35.0_f64.to_radians();
    room.leds[0].side_m = 0.6;
    check_room(&room);
}

#[test]
fn four_walls() {
    for wall in [Wall::PlusY, Wall::PlusX, Wall::MinusY, Wall::MinusX] {
        let mut room = Room::paper();
        room.array.wall = wall;
        check_room(&room);
        check_room(&room.with_mode(PAPER));
    }
}

#[test]
fn paper_readings() {
    for literal in [false, true] {
        let mut room = Room::paper().with_panel().with_mode(Mode::Paper { literal, gain_scale: 85.0 });
        check_room(&room);
        room.receiver.branches[0].fov_semi_angle = 60.0_f64.to_radians();
        check_room(&room);
    }
}

#[test]
fn branches_and_concentrator() {
    for combining in [Combining::Best, Combining::EqualGain, Combining::MaximalRatio] {
        let mut room = Room::paper();
        room.receiver.branches = angle_diversity();
        room.receiver.combining = combining;
        room.receiver.concentrator_index = Some(1.5);
        check_room(&room);
        check_room(&room.clone().with_panel());
        check_room(&room.clone().with_mode(PAPER));
        check_room(&room.with_mode(Mode::Paper { literal: true, gain_scale: 1.0 }));
    }
}

#[test]
fn several_leds() {
    let mut room = Room::paper();
    room.leds = vec![led(-1.2, -1.2, 0.0), led(1.2, 1.2, 0.1), led(-1.2, 1.2, 0.0)];
    check_room(&room);
    check_room(&room.with_mode(PAPER));
}

#[test]
fn odd_array_sizes() {
    for (rows, columns) in [(1, 1), (1, 17), (7, 7), (16, 2), (32, 32)] {
        let mut room = Room::paper();
        (room.array.rows, room.array.columns) = (rows, columns);
        (room.array.mirror_width_m, room.array.mirror_height_m, room.array.gap_m) = (0.1, 0.04, 0.005);
        for seed in 0..3 {
            Case::new(&room, seed).check();
            Case::new(&room.clone().with_mode(PAPER), seed).check();
        }
    }
}

#[test]
fn steering_gain_is_the_gain_of_an_aimed_mirror() {
    let mut adr = Room::paper().with_panel();
    adr.receiver.branches = angle_diversity();
    adr.receiver.combining = Combining::MaximalRatio;
    // Mirrors that reflect only a part of the panel to some positions.
    let (mut narrow, mut low) = (Room::paper().with_panel(), Room::paper().with_panel());
    narrow.array.mirror_width_m = 0.045;
    low.array.mirror_height_m = 0.03;
    for room in [Room::paper(), Room::paper().with_panel(), adr, narrow, low] {
        for seed in 0..10 {
            let case = Case::new(&room, seed);
            let mirrors = case.model.mirrors.len();
            let mut each = vec![0.0; USERS * mirrors];
            let mut angles = case.angles.clone();
            for user in 0..USERS {
                aim_at_point(&case.model, &case.scene.positions()[user], &mut angles);
                case.scene.irs_gain_each(&case.model, &angles, &mut each);
                let row = user * mirrors..(user + 1) * mirrors;
                for (found, expected) in case.scene.steering_gain()[row.clone()].iter().zip(&each[row]) {
                    close(*found, *expected, "steering");
                }
            }
        }
    }
}

#[test]
fn positions_without_light_have_zero_gain() {
    for room in [Room::paper(), Room::paper().with_panel(), Room::paper().with_mode(PAPER)] {
        let model = room.model();
        let users = [
            Vec3::new(0.0, 2.6, 0.85),
            Vec3::new(0.0, 0.0, 3.0),
            Vec3::new(0.3, 0.0, 3.5),
            Vec3::new(f64::NAN, 0.0, 0.85),
            Vec3::new(0.0, f64::INFINITY, 0.85),
        ];
        let mut scene = Scene::new(&model, users.len());
        scene.update(&model, &users, &[], &[false; 5]);
        let angles = MirrorAngles::flat(model.mirrors.len());
        let mut gains = [1.0; 5];
        scene.irs_gain(&model, &angles, &mut gains);
        assert_eq!(gains, [0.0; 5]);
        assert_eq!(scene.los_gain()[1..], [0.0; 4]);
        assert!(scene.steering_gain().iter().all(|gain| *gain == 0.0));
    }
}

#[test]
fn several_arrays() {
    for base in [Room::paper(), Room::paper().with_panel(), Room::paper().with_mode(PAPER)] {
        let mut room = base;
        let small = |wall, columns| heliostat_channel::ArraySpec {
            rows: 5,
            columns,
            mirror_width_m: 0.18,
            reflectivity: 0.8,
            centre_height_m: 1.7,
            wall,
            ..room.array.clone()
        };
        room.others = vec![small(Wall::MinusX, 7), small(Wall::MinusY, 3)];
        check_room(&room);
    }
}
