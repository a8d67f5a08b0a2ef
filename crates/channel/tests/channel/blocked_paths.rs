//! Blockage by cylinders: the segment test, the skipped tests, and the paper's shadow length.

use crate::common::{PAPER, Random, Room};
use heliostat_channel::blockage::{Cylinder, blocks};
use heliostat_channel::specular::bisector;
use heliostat_channel::{Scene, Vec3, Wall};

const PERSON: Cylinder = Cylinder { x_m: 1.0, y_m: 0.0, radius_m: 0.25, height_m: 1.75 };

fn at(x: f64, y: f64, z: f64) -> Vec3 {
    Vec3::new(x, y, z)
}

#[test]
fn through_over_and_beside() {
    assert!(blocks(&PERSON, &at(0.0, 0.0, 1.0), &at(2.0, 0.0, 1.0)), "through the middle");
    assert!(!blocks(&PERSON, &at(0.0, 0.0, 1.8), &at(2.0, 0.0, 1.8)), "over the top");
    assert!(!blocks(&PERSON, &at(0.0, 0.26, 1.0), &at(2.0, 0.26, 1.0)), "beside");
    assert!(blocks(&PERSON, &at(0.0, 0.24, 1.0), &at(2.0, 0.24, 1.0)), "through the edge");
    assert!(!blocks(&PERSON, &at(0.0, 0.0, 1.0), &at(0.7, 0.0, 1.0)), "ends before");
    assert!(!blocks(&PERSON, &at(1.3, 0.0, 1.0), &at(2.0, 0.0, 1.0)), "starts behind");
    assert!(blocks(&PERSON, &at(1.0, 0.0, 1.0), &at(1.1, 0.0, 1.0)), "inside");
    assert!(!blocks(&PERSON, &at(0.0, 0.0, -0.2), &at(2.0, 0.0, -0.1)), "below the floor");
}

#[test]
fn slanted_and_upright_segments() {
    // Descends from 3 m above the axis; passes the near side at 1.75 m or slightly above.
    let over = |x: f64| blocks(&PERSON, &at(0.0, 0.0, 3.0), &at(x, 0.0, 0.85));
    assert!(over(2.0), "2.19 m at the near side, 1.66 m at the far side");
    assert!(!over(2.2), "1.78 m at the far side");
    assert!(over(2.1), "1.72 m at the far side");
    assert!(blocks(&PERSON, &at(1.0, 0.2, 3.0), &at(1.0, 0.2, 0.85)), "straight down into the top");
    assert!(!blocks(&PERSON, &at(1.0, 0.2, 3.0), &at(1.0, 0.2, 1.8)), "straight down, not far enough");
    assert!(!blocks(&PERSON, &at(1.0, 0.3, 3.0), &at(1.0, 0.3, 0.85)), "straight down beside it");
}

/// A segment is blocked when one of many points along it is inside the cylinder.
#[test]
fn agrees_with_points_along_the_segment() {
    let mut random = Random::new(21);
    let mut blocked = 0;
    for _ in 0..3000 {
        let cylinder = Cylinder {
            x_m: random.uniform(-2.0, 2.0),
            y_m: random.uniform(-2.0, 2.0),
            radius_m: random.uniform(0.1, 0.6),
            height_m: random.uniform(0.5, 2.5),
        };
        let a = at(random.uniform(-2.5, 2.5), random.uniform(-2.5, 2.5), random.uniform(0.0, 3.0));
        let b = at(random.uniform(-2.5, 2.5), random.uniform(-2.5, 2.5), random.uniform(0.0, 3.0));
        let inside = |grow: f64| {
            (0..=2000).any(|step| {
                let point = a + (b - a) * (f64::from(step) / 2000.0);
                let (x, y) = (point.x - cylinder.x_m, point.y - cylinder.y_m);
                x.hypot(y) < cylinder.radius_m + grow && point.z < cylinder.height_m + grow
            })
        };
        let found = blocks(&cylinder, &a, &b);
        assert_eq!(found, blocks(&cylinder, &b, &a), "the same both ways");
        // Points up to 4 mm apart can miss a short chord, so smaller and larger cylinders bracket
        // the result.
        assert!(!inside(-0.005) || found);
        assert!(inside(0.005) || !found);
        blocked += usize::from(found);
    }
    assert!((100..2900).contains(&blocked), "{blocked}");
}

/// The skipped tests change no result: the reference tests each path against each cylinder.
#[test]
fn skipping_is_exact() {
    let mut random = Random::new(22);
    let mut blocked = 0;
    for round in 0..400 {
        let mut room = Room::paper();
        room.array.wall = [Wall::PlusY, Wall::PlusX, Wall::MinusY, Wall::MinusX][round % 4];
        // Low arrays and tall cylinders, so that both paths are sometimes blocked; sometimes one
        // column.
        room.array.centre_height_m = random.uniform(0.9, 2.2);
        room.array.columns = if round % 5 == 0 { 1 } else { 10 };
        let model = room.model();
        let users = random.positions(4);
        let mut blockers = random.blockers(&users);
        for blocker in &mut blockers {
            blocker.height_m = random.uniform(0.8, 2.8);
        }
        let mut scene = Scene::new(&model, 4);
        scene.update(&model, &users, &blockers, &[false; 4]);
        let led = &model.leds[0].position;
        for (user, position) in users.iter().enumerate() {
            for (mirror, centre) in model.mirrors.positions().iter().enumerate() {
                let clear = !blockers.iter().any(|c| blocks(c, led, centre) || blocks(c, position, centre));
                let found = scene.irs_path_clear()[user * model.mirrors.len() + mirror];
                assert_eq!(found, clear, "user {user} mirror {mirror} in round {round}");
                blocked += usize::from(!clear);
            }
            let direct = !blockers.iter().any(|c| blocks(c, led, position));
            assert_eq!(scene.los_blocked()[user], !direct);
            assert_eq!(scene.los_gain()[user] > 0.0, direct);
        }
    }
    assert!(blocked > 10_000, "{blocked} blocked paths");
}

#[test]
fn forced_users_lose_the_direct_path_only() {
    let model = Room::paper().model();
    let users = Random::new(23).positions(3);
    let mut scene = Scene::new(&model, 3);
    scene.update(&model, &users, &[], &[false, true, false]);
    assert_eq!(scene.los_blocked(), [false, true, false]);
    assert_eq!(scene.los_gain()[1], 0.0);
    assert!(scene.los_gain()[0] > 0.0 && scene.irs_path_clear().iter().all(|visible| *visible));
    scene.update(&model, &users, &[], &[false; 3]);
    assert!(scene.los_gain()[1] > 0.0, "the flag is not kept");
}

/// Also segments through the axis, where the discriminant is 0 or a rounding error.
#[test]
fn a_cylinder_of_radius_0_blocks_nothing() {
    let mut random = Random::new(31);
    for _ in 0..10_000 {
        let (x_m, y_m) = (random.uniform(-3.0, 3.0), random.uniform(-3.0, 3.0));
        let line = Cylinder { x_m, y_m, radius_m: 0.0, height_m: 3.0 };
        let from = at(random.uniform(-3.0, 3.0), random.uniform(-3.0, 3.0), 2.0);
        let fraction = random.uniform(0.1, 0.9);
        let through = |axis: f64, start: f64| start + (axis - start) / fraction;
        let to = at(through(x_m, from.x), through(y_m, from.y), 1.0);
        assert!(!blocks(&line, &from, &to), "{line:?}: {from} to {to}");
        assert!(!blocks(&line, &at(x_m, y_m, 2.0), &at(x_m, y_m, 1.0)), "along the axis");
    }
}

/// Eq. (5) in explicit form: the length of the shadow in m behind a blocker at a horizontal distance from the LED, with
/// the heights of both above the receivers in m.
fn shadow_length(distance_m: f64, blocker_height_m: f64, led_height_m: f64) -> f64 {
    distance_m * blocker_height_m / (led_height_m - blocker_height_m)
}

/// A thin blocker's shadow on the receiver plane begins and ends where
/// the segment test says.
#[test]
fn shadow_length_of_a_thin_blocker() {
    let (plane, led_height) = (0.85, 3.0);
    for (distance, height) in [(0.5, 1.75), (1.0, 1.2), (1.5, 1.5)] {
        let blocker = Cylinder { x_m: distance, y_m: 0.0, radius_m: 1e-4, height_m: height };
        let led = at(0.0, 0.0, led_height);
        let shadow = shadow_length(distance, height - plane, led_height - plane);
        let dark = |beyond: f64| blocks(&blocker, &led, &at(distance + beyond, 0.0, plane));
        assert!(dark(0.01) && dark(shadow - 0.002), "{shadow}");
        assert!(!dark(shadow + 0.002) && !dark(-0.01), "{shadow}");
        // As printed, (d_L - d_B) = h_B d_L / h_l, with d_L = d_B + shadow.
        let printed = (height - plane) * (distance + shadow) / (led_height - plane);
        assert!((printed - shadow).abs() < 1e-12);
    }
}

/// The rectangle of eq. (5) is as wide as the blocker; the shadow of a point of light widens with
/// the distance.
#[test]
fn the_rectangle_of_eq_5_understates_the_shadow() {
    let led = at(0.0, 0.0, 3.0);
    let shadow = shadow_length(PERSON.x_m, 1.75 - 0.85, 3.0 - 0.85);
    let in_rectangle = |x: f64, y: f64| (1.0..=1.0 + shadow).contains(&x) && y.abs() <= PERSON.radius_m;
    let (mut dark, mut covered, mut bright_inside) = (0, 0, 0);
    for ix in 0..300 {
        for iy in -100..=100 {
            let (x, y) = (f64::from(ix) * 0.01, f64::from(iy) * 0.01);
            let blocked = blocks(&PERSON, &led, &at(x, y, 0.85));
            dark += usize::from(blocked);
            covered += usize::from(blocked && in_rectangle(x, y));
            bright_inside += usize::from(!blocked && in_rectangle(x, y));
        }
    }
    assert!((covered as f64) < 0.75 * dark as f64, "{covered} of {dark}");
    assert_eq!(bright_inside, 0, "the rectangle lies within the shadow");
}

#[test]
fn invalid_cylinders_are_refused() {
    assert!(Cylinder::new(0.0, 0.0, 0.2, 1.75).is_ok());
    assert!(Cylinder::new(f64::NAN, 0.0, 0.2, 1.75).is_err());
    assert!(Cylinder::new(0.0, 0.0, 0.0, 1.75).is_err());
    assert!(Cylinder::new(0.0, 0.0, 0.2, -1.0).is_err());
}

#[test]
fn excluded_mirrors_have_no_steering_gain() {
    let model = Room::paper().model();
    let users = Random::new(23).positions(3);
    let mut scene = Scene::new(&model, 3);
    scene.update(&model, &users, &[], &[false; 3]);
    let mirrors = model.mirrors.len();
    let complete = scene.steering_gain().to_vec();
    scene.exclude_mirrors(&[0, 7, u32::MAX]);
    for (pair, (gain, before)) in scene.steering_gain().iter().zip(&complete).enumerate() {
        let excluded = [0, 7].contains(&(pair % mirrors));
        assert_eq!(*gain, if excluded { 0.0 } else { *before });
        assert_eq!(scene.irs_path_clear()[pair], !excluded);
    }
    scene.update(&model, &users, &[], &[false; 3]);
    assert_eq!(scene.steering_gain(), complete, "until the next update");
}

#[test]
fn a_mirror_has_no_steering_gain_outside_its_range() {
    let model = Room::paper().model();
    let users = Random::new(23).positions(3);
    let mut scene = Scene::new(&model, 3);
    scene.update(&model, &users, &[], &[false; 3]);
    let (mirrors, complete) = (model.mirrors.len(), scene.steering_gain().to_vec());
    let (roll, yaw) = (-0.1..=0.15, -0.3..=0.05);
    scene.restrict_to_range(&model, &roll, &yaw);
    let (mut within_range, mut at_the_edge) = (0, 0);
    for (pair, (gain, before)) in scene.steering_gain().iter().zip(&complete).enumerate() {
        let (mirror, user, led) = (pair % mirrors, &users[pair / mirrors], &model.leds[0].position);
        let towards = bisector(&model.mirrors.positions()[mirror], led, user).expect("an angle");
        let aim = model.mirrors.angles_of(mirror, &towards);
        let within = roll.contains(&aim.0) && yaw.contains(&aim.1);
        let off = (aim.0 - aim.0.clamp(-0.1, 0.15)).hypot(aim.1 - aim.1.clamp(-0.3, 0.05));
        // The ray still meets the mirror within twice a quarter of its side over the distance:
        // 0.006 to 0.05 rad here.
        let lit = *gain > 0.0;
        assert!(lit || *gain == 0.0 && (!within || *before == 0.0), "{aim:?}");
        assert!(!lit || (*gain == *before && off < 0.06), "{aim:?}");
        (within_range, at_the_edge) = (within_range + usize::from(within), at_the_edge + usize::from(lit && !within));
    }
    assert!(within_range > 20 && within_range < 280 && at_the_edge > 0, "{within_range} and {at_the_edge} of 300");
    assert!(scene.irs_path_clear().iter().all(|visible| *visible), "paths stay clear");
    let paper = Room::paper().with_mode(PAPER).model();
    let mut scene = Scene::new(&paper, 3);
    scene.update(&paper, &users, &[], &[false; 3]);
    let complete = scene.steering_gain().to_vec();
    scene.restrict_to_range(&paper, &roll, &yaw);
    assert_eq!(scene.steering_gain(), complete, "the paper's equations have no angle for a pair");
}
