//! Consequences of eqs. (2) and (3) of the paper as printed.

use crate::common::{PAPER, Random, Room};
use heliostat_channel::diffuse::{self, Reading, collection, illumination, tilt_cosine};
use heliostat_channel::specular::{self, Plate};
use heliostat_channel::{MirrorAngles, Scene, Vec3, Wall};

/// Eq. (3) exactly as printed, with the mirror's own coordinates and no wall frame.
fn eq_3_as_printed(mirror: &Vec3, user: &Vec3, (roll, yaw): (f64, f64)) -> f64 {
    let d = (mirror - user).norm();
    (mirror.x - user.x) / d * yaw.sin() * roll.cos()
        + (mirror.y - user.y) / d * yaw.cos() * roll.cos()
        + (mirror.z - user.z) / d * roll.sin()
}

#[test]
fn eq_3_as_printed_is_positive_for_flat_mirrors_on_one_wall_only() {
    let mut random = Random::new(51);
    for (wall, positive) in [(Wall::PlusY, true), (Wall::PlusX, false), (Wall::MinusY, false), (Wall::MinusX, false)] {
        let mut room = Room::paper();
        room.array.wall = wall;
        let mirrors = room.mirrors();
        let users = random.positions(500);
        let all = users.iter().all(|user| eq_3_as_printed(&mirrors.positions()[45], user, (0.0, 0.0)) > 0.0);
        assert_eq!(all, positive, "{wall:?}");
        assert!(users.iter().all(|user| tilt_cosine(&mirrors, 45, (0.0, 0.0), user) > 0.0), "{wall:?} in its frame");
    }
}

/// The paper names it the incidence angle at the user, but it does not depend on the detector's
/// normal.
#[test]
fn eq_3_is_the_cosine_between_mirror_normal_and_direction_to_the_user() {
    let mirrors = Room::paper().mirrors();
    let mut random = Random::new(52);
    for user in random.positions(200) {
        let angles = (random.uniform(-1.5, 1.5), random.uniform(-1.5, 1.5));
        let direction = (user - mirrors.positions()[45]).normalize();
        let cosine = mirrors.normal(45, angles).dot(&direction);
        assert!((tilt_cosine(&mirrors, 45, angles, &user) - cosine).abs() < 1e-12);
        assert!((eq_3_as_printed(&mirrors.positions()[45], &user, angles) - cosine).abs() < 1e-12);
    }
}

/// Section II calls phi roll and theta yaw. In eq. (3) phi turns about the vertical, which is yaw.
#[test]
fn the_papers_roll_is_a_yaw() {
    let mirrors = Room::paper().mirrors();
    assert!(mirrors.normal(0, (0.0, 0.5)).z.abs() < 1e-15, "yaw keeps the normal level");
    assert!(mirrors.normal(0, (0.5, 0.0)).x.abs() < 1e-15, "roll keeps it in its upright plane");
}

/// Each mirror's best normal under eqs. (2) and (3) faces the user; by the law of reflection it is
/// the bisector.
#[test]
fn eq_2_is_largest_for_a_mirror_that_faces_the_user() {
    let room = Room::paper().with_mode(PAPER);
    let mirrors = room.mirrors();
    let user = Vec3::new(0.8, -0.6, 0.85);
    let receiver = (&room.receiver, &room.receiver.branches[0]);
    let gain = |angles| diffuse::gain(Reading::Sensible, (&room.leds[0], &mirrors, 45), angles, receiver, &user);
    let facing = mirrors.angles_of(45, &(user - mirrors.positions()[45]));
    let best = gain(facing);
    for step in 0..64 {
        let turn = f64::from(step) * 0.1;
        assert!(gain((facing.0 + 0.1 * turn.sin(), facing.1 + 0.1 * turn.cos())) < best);
    }
    let plate = Plate::of(&mirrors, 45, facing.0, facing.1);
    assert_eq!(
        specular::gain(&room.leds[0], &plate, 0.95, receiver, &user),
        Ok(0.0),
        "a real mirror sends it elsewhere"
    );
}

/// Eq. (2) falls with D1^2 D2^2, like diffuse reflection; a specular gain falls with (D1 + D2)^2.
#[test]
fn eq_2_falls_like_scattered_light() {
    let (mut near, mut far) = (Room::paper(), Room::paper());
    for (room, scale) in [(&mut near, 1.0), (&mut far, 2.0)] {
        // All distances doubled, the size of the mirror unchanged.
        (room.array.rows, room.array.columns) = (1, 1);
        room.array.wall_distance_m *= scale;
        room.array.centre_height_m *= scale;
        room.leds[0].position *= scale;
    }
    let gains = |room: &Room, mode, scale: f64| {
        let model = room.clone().with_mode(mode).model();
        let mut scene = Scene::new(&model, 1);
        scene.update(&model, &[scale * Vec3::new(0.5, -0.5, 0.85)], &[], &[false]);
        scene.steering_gain()[0]
    };
    let ratio = |mode| gains(&near, mode, 1.0) / gains(&far, mode, 2.0);
    assert!((ratio(PAPER) - 16.0).abs() < 1e-9);
    assert!((ratio(heliostat_channel::Mode::Specular) - 4.0).abs() < 1e-9);
}

#[test]
fn the_literal_reading_puts_the_field_of_view_on_the_mirrors_angle() {
    let mut room = Room::paper();
    room.receiver.branches[0].fov_semi_angle = 60.0_f64.to_radians();
    let (mirrors, inward) = (room.mirrors(), room.mirrors().array_of(45).inward());
    let receiver = (&room.receiver, &room.receiver.branches[0]);
    let mirror = mirrors.positions()[45];
    // Below the mirror and far to the side: a small incidence angle, or a grazing angle at the
    // wall.
    let user = Vec3::new(-0.2, -2.0, 0.85);
    let gain = |reading, angles| diffuse::gain(reading, (&room.leds[0], &mirrors, 45), angles, receiver, &user);
    let incidence = (mirror - user).normalize().z.acos().to_degrees();
    assert!(incidence > 60.0, "{incidence}");
    let facing = mirrors.angles_of(45, &(user - mirror));
    assert_eq!(gain(Reading::Sensible, facing), 0.0, "arrives outside the field of view");
    assert!(gain(Reading::Literal, facing) > 0.0, "the literal gate looks at the mirror's angle");
    let at_cosine = |cosine: f64| {
        // After a yaw by an angle a the cosine is sin^2 + cos^2 cos a of the roll.
        let (sin, cos) = facing.0.sin_cos();
        (facing.0, facing.1 + ((cosine - sin * sin) / (cos * cos)).acos())
    };
    assert!(gain(Reading::Literal, at_cosine(0.51)) > 0.0);
    assert_eq!(gain(Reading::Literal, at_cosine(0.49)), 0.0, "the mirror is turned by more than the field of view");
    // The product of the factors of eq. (2) is the gain.
    let halves = illumination(&room.leds[0], &mirrors, 45)
        * collection(Reading::Literal, receiver, &(mirror - user), &inward)
        * tilt_cosine(&mirrors, 45, (0.1, 0.2), &user);
    assert!((gain(Reading::Literal, (0.1, 0.2)) / halves - 1.0).abs() < 1e-12);
}

/// Flat mirrors give most of the gain under eqs. (2) and (3), since a cosine is flat near its
/// maximum.
#[test]
fn flat_mirrors_bring_most_of_what_the_papers_equations_allow() {
    let model = Room::paper().with_mode(PAPER).model();
    let mut random = Random::new(53);
    let (mut flat, mut most) = (0.0, 0.0);
    for _ in 0..200 {
        let mut scene = Scene::new(&model, 1);
        scene.update(&model, &[random.walker()], &[], &[false]);
        let mut gain = [0.0];
        scene.irs_gain(&model, &MirrorAngles::flat(100), &mut gain);
        flat += gain[0];
        most += scene.steering_gain().iter().sum::<f64>();
    }
    assert!(flat / most > 0.6, "{}", flat / most);
}
