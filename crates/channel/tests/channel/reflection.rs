//! The law of reflection: angles, symmetry of the room, and the flux from a mirror.

use crate::common::{PAPER, Random, Room};
use heliostat_channel::decode::{aim_at_point, decode};
use heliostat_channel::specular::{self, Plate, bisector};
use heliostat_channel::{MirrorAngles, Scene, Vec3, Wall};

const WALLS: [Wall; 4] = [Wall::PlusY, Wall::PlusX, Wall::MinusY, Wall::MinusX];

fn rooms() -> impl Iterator<Item = Room> {
    WALLS.into_iter().map(|wall| {
        let mut room = Room::paper();
        room.array.wall = wall;
        room
    })
}

#[test]
fn the_aimed_normal_sends_the_central_ray_to_the_detector() {
    let mut random = Random::new(7);
    for room in rooms() {
        let (model, led) = (room.model(), room.leds[0].position);
        let mut angles = MirrorAngles::flat(100);
        for _ in 0..50 {
            let user = random.position();
            aim_at_point(&model, &user, &mut angles);
            for mirror in 0..100 {
                let plate = Plate::of(&model.mirrors, mirror, angles.roll[mirror], angles.yaw[mirror]);
                // Distance of the reflected ray from the detector.
                let ray = (plate.centre - led).normalize();
                let reflected = ray - 2.0 * ray.dot(&plate.normal) * plate.normal;
                let miss = (user - plate.centre).cross(&reflected).norm();
                assert!(miss < 1e-12, "misses by {miss} m");
                let path = plate.path(&led, &user).expect("the central ray hits the mirror");
                let length = (plate.centre - led).norm() + (user - plate.centre).norm();
                assert!((path.length_m - length).abs() < 1e-12);
            }
        }
    }
}

#[test]
fn the_reflected_path_is_reversible() {
    let model = Room::paper().model();
    let mut random = Random::new(8);
    let mut seen = 0;
    for _ in 0..400 {
        let (a, b) = (random.position(), Vec3::new(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), 2.9));
        let mirror = random.next() as usize % 100;
        let normal = bisector(&model.mirrors.positions()[mirror], &a, &b).expect("not in line");
        let (roll, yaw) = model.mirrors.angles_of(mirror, &normal);
        let plate = Plate::of(&model.mirrors, mirror, roll + 0.02 * random.normal(), yaw + 0.02 * random.normal());
        let (there, back) = (plate.path(&a, &b), plate.path(&b, &a));
        assert_eq!(there.is_some(), back.is_some());
        if let (Some(there), Some(back)) = (there, back) {
            seen += 1;
            assert!((there.length_m - back.length_m).abs() < 1e-12);
        }
    }
    assert!(seen > 100, "{seen} paths");
}

#[test]
fn the_image_is_as_far_behind_the_mirror() {
    let plate = Plate::of(&Room::paper().mirrors(), 37, 0.2, -0.4);
    let point = Vec3::new(0.1, 0.2, 3.0);
    let image = plate.image(&point);
    let height = |p: &Vec3| (p - plate.centre).dot(&plate.normal);
    assert!((height(&point) + height(&image)).abs() < 1e-12);
    assert!((plate.image(&image) - point).norm() < 1e-12);
}

#[test]
fn angles_and_normals_are_inverse() {
    let mut random = Random::new(9);
    for room in rooms() {
        let mirrors = room.mirrors();
        assert!((mirrors.normal(0, (0.0, 0.0)) - mirrors.array_of(0).inward()).norm() < 1e-15);
        assert!(mirrors.normal(0, (0.3, 0.0)).z < 0.0, "a positive roll looks down");
        for _ in 0..200 {
            let (roll, yaw) = (random.uniform(-1.5, 1.5), random.uniform(-1.5, 1.5));
            let normal = mirrors.normal(0, (roll, yaw));
            assert!((normal.norm() - 1.0).abs() < 1e-15);
            let (found_roll, found_yaw) = mirrors.angles_of(0, &(3.0 * normal));
            assert!((found_roll - roll).abs() < 1e-12 && (found_yaw - yaw).abs() < 1e-12);
            let turned = Plate::of(&mirrors, 0, roll, yaw);
            let faced = Plate::facing(&mirrors, 0, &normal);
            assert!((turned.width_axis - faced.width_axis).norm() < 1e-12);
            assert!((turned.height_axis - faced.height_axis).norm() < 1e-12);
            assert!(turned.height_axis.z > 0.0, "the height points up");
        }
    }
}

#[test]
fn the_array_hangs_where_it_should() {
    let mirrors = Room::paper().mirrors();
    let positions = mirrors.positions();
    assert_eq!((mirrors.len(), mirrors.arrays()[0].rows(), mirrors.columns()), (100, 10, 10));
    assert!((positions[0] - Vec3::new(-1.215, 2.5, 1.46)).norm() < 1e-12, "row 0 lowest, column 0 at the smallest x");
    assert!((positions[9] - Vec3::new(1.215, 2.5, 1.46)).norm() < 1e-12, "index = row * columns + column");
    assert!((positions[90] - Vec3::new(-1.215, 2.5, 2.54)).norm() < 1e-12);
    let corner = |wall| {
        let mut room = Room::paper();
        room.array.wall = wall;
        room.mirrors().positions()[0]
    };
    assert!((corner(Wall::PlusX) - Vec3::new(2.5, 1.215, 1.46)).norm() < 1e-12);
    assert!((corner(Wall::MinusY) - Vec3::new(1.215, -2.5, 1.46)).norm() < 1e-12);
    assert!((corner(Wall::MinusX) - Vec3::new(-2.5, -1.215, 1.46)).norm() < 1e-12);
}

/// The room reflected in the plane x = 0: x, columns and yaw change sign or order.
#[test]
fn the_room_is_symmetric_about_its_middle() {
    let mut random = Random::new(10);
    for room in [Room::paper(), Room::paper().with_panel(), Room::paper().with_mode(PAPER)] {
        let model = room.model();
        let users = random.positions(5);
        let mirrored: Vec<Vec3> = users.iter().map(|user| Vec3::new(-user.x, user.y, user.z)).collect();
        let blockers = random.blockers(&users);
        let mirrored_blockers: Vec<_> =
            blockers.iter().map(|blocker| heliostat_channel::Cylinder { x_m: -blocker.x_m, ..*blocker }).collect();
        let (mut here, mut there) = (Scene::new(&model, 5), Scene::new(&model, 5));
        here.update(&model, &users, &blockers, &[false; 5]);
        there.update(&model, &mirrored, &mirrored_blockers, &[false; 5]);
        let mut angles = MirrorAngles::flat(100);
        decode(&model, &here, &[1.0, 0.7, 1.4, 0.9, 1.1], &mut angles);
        let mut reversed = angles.clone();
        for mirror in 0..100 {
            let twin = mirror / 10 * 10 + 9 - mirror % 10;
            (reversed.roll[twin], reversed.yaw[twin]) = (angles.roll[mirror], -angles.yaw[mirror]);
        }
        let (mut gains, mut twins) = ([0.0; 5], [0.0; 5]);
        here.irs_gain(&model, &angles, &mut gains);
        there.irs_gain(&model, &reversed, &mut twins);
        assert!(gains.iter().any(|gain| *gain > 1e-9));
        for (gain, twin) in gains.iter().zip(&twins) {
            assert!((gain - twin).abs() <= 1e-9 * gain, "{gain} and {twin}");
        }
        assert_eq!(here.los_blocked(), there.los_blocked());
    }
}

#[test]
fn a_room_turned_by_a_quarter_is_the_same_room() {
    let mut random = Random::new(11);
    let users = random.positions(5);
    let turn = |quarters: usize, v: &Vec3| (0..quarters).fold(*v, |v, _| Vec3::new(v.y, -v.x, v.z));
    let mut expected: Option<[f64; 5]> = None;
    for (quarters, room) in rooms().enumerate() {
        let model = room.model();
        let turned: Vec<Vec3> = users.iter().map(|user| turn(quarters, user)).collect();
        let mut scene = Scene::new(&model, 5);
        scene.update(&model, &turned, &[], &[false; 5]);
        let mut angles = MirrorAngles::flat(100);
        decode(&model, &scene, &[1.0; 5], &mut angles);
        let mut gains = [0.0; 5];
        scene.irs_gain(&model, &angles, &mut gains);
        match expected {
            None => expected = Some(gains),
            Some(first) => {
                assert!(gains.iter().zip(first).all(|(a, b)| (a - b).abs() <= 1e-9 * b), "{gains:?} {first:?}");
            }
        }
    }
}

#[test]
fn no_light_behind_a_mirror() {
    let room = Room::paper();
    let (mirrors, receiver) = (room.mirrors(), (&room.receiver, &room.receiver.branches[0]));
    // The LED is behind the mirror's plane, so the gain is zero for any detector.
    let plate = Plate::of(&mirrors, 45, -80.0_f64.to_radians(), 85.0_f64.to_radians());
    for user in Random::new(12).positions(100) {
        if (room.leds[0].position - plate.centre).dot(&plate.normal) <= 0.0
            || (user - plate.centre).dot(&plate.normal) <= 0.0
        {
            let gain = specular::gain(&room.leds[0], &plate, 0.95, receiver, &user).expect("finite");
            assert_eq!(gain, 0.0);
        }
    }
    let flat = Plate::of(&mirrors, 45, 0.0, 0.0);
    assert!(flat.path(&room.leds[0].position, &Vec3::new(0.0, 3.0, 0.85)).is_none());
    assert!(flat.path(&Vec3::new(0.0, 3.0, 3.0), &Vec3::new(0.0, 0.0, 0.85)).is_none());
}

/// The flux from one mirror to a large floor is the flux on the mirror times its reflectivity.
#[test]
fn flux_of_one_mirror_over_the_floor() {
    for (room, mirror) in [(Room::paper(), 45), (Room::paper().with_panel(), 45), (Room::paper(), 3)] {
        let mirrors = room.mirrors();
        let target = Vec3::new(0.4, -0.3, 0.85);
        let normal = bisector(&mirrors.positions()[mirror], &room.leds[0].position, &target).expect("not in line");
        let plate = Plate::facing(&mirrors, mirror, &normal);
        let receiver = (&room.receiver, &room.receiver.branches[0]);
        let step = 0.01;
        let mut on_floor = 0.0;
        for ix in -150..150 {
            for iy in -150..150 {
                let cell = target + Vec3::new((f64::from(ix) + 0.5) * step, (f64::from(iy) + 0.5) * step, 0.0);
                on_floor += specular::gain(&room.leds[0], &plate, 0.95, receiver, &cell).expect("finite");
            }
        }
        on_floor *= step * step / room.receiver.detector_area_m2;
        let ratio = on_floor / (0.95 * flux_on_mirror(&room, &plate));
        assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    }
}

/// Fraction of the LED's power on a mirror: (n + 1) cos^n(irradiance) cos(incidence) / (2
/// pi D^2), summed over its surface.
fn flux_on_mirror(room: &Room, plate: &Plate) -> f64 {
    let points = room.leds[0].points();
    let cells = 20;
    let mut sum = 0.0;
    for iu in 0..cells {
        for iv in 0..cells {
            let along = |index: i32, half: f64| ((f64::from(index) + 0.5) / f64::from(cells) * 2.0 - 1.0) * half;
            let spot = plate.centre
                + along(iu, plate.half_width_m) * plate.width_axis
                + along(iv, plate.half_height_m) * plate.height_axis;
            for point in &points {
                let to_led = point - spot;
                let distance = to_led.norm();
                sum += to_led.z / distance * to_led.dot(&plate.normal) / distance / (distance * distance);
            }
        }
    }
    let cell_area = 4.0 * plate.half_width_m * plate.half_height_m / f64::from(cells * cells);
    sum * cell_area * 2.0 / (2.0 * std::f64::consts::PI) / points.len() as f64
}
