//! How users hold their receivers: distributions, autocorrelation, and independence of the steps.

use heliostat_channel::{MirrorAngles, Vec3};
use heliostat_room::World;
use heliostat_room::baselines::{Baselines, Snapshot};
use heliostat_room::world::orientation::{NODE_S, Orientations};
use heliostat_room::world::walker::Walker;
use heliostat_scenario::{Scenario, UserOrientation, Users};

const USERS: usize = 400;
const SITTING_COHERENCE_S: f64 = 0.373;
const WALKING_COHERENCE_S: f64 = 0.134;

/// Users who face along +x and move along it at this speed.
fn walkers(speed_m_s: f64) -> Vec<Walker> {
    vec![Walker { position: Vec3::zeros(), direction: [1.0, 0.0], velocity: [speed_m_s, 0.0] }; USERS]
}

fn begin(walkers: &[Walker], seed: u64) -> Orientations {
    let users = Users { orientation: Some(UserOrientation::default()), ..Users::default() };
    let mut orientations = Orientations::new(&users);
    orientations.begin(seed, walkers, USERS, |_| None);
    orientations
}

/// Polar angle, and azimuth from the direction towards the user's face, in degrees, of users who
/// face along +x. A receiver that faces up has no azimuth.
fn angles_deg(orientations: &Orientations) -> Vec<[f64; 2]> {
    let angles = |normal: Vec3| {
        let azimuth = if normal.z < 1.0 { (-normal.y).atan2(-normal.x) } else { 0.0 };
        [normal.z.acos(), azimuth].map(f64::to_degrees)
    };
    orientations.held().iter().map(|held| angles(held.normal())).collect()
}

/// The angles of all users at times `interval_s` apart.
fn record(walkers: &[Walker], interval_s: f64, samples: usize) -> Vec<Vec<[f64; 2]>> {
    let mut orientations = begin(walkers, 3);
    let sample = |index: usize| {
        let time_s = index as f64 * interval_s;
        while orientations.next_node_s().is_some_and(|node_s| node_s <= time_s) {
            orientations.pass_node(walkers);
        }
        orientations.hold(time_s, walkers);
        angles_deg(&orientations)
    };
    (0..samples).map(sample).collect()
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in values {
        (sum, count) = (sum + value, count + 1.0);
    }
    sum / count
}

/// Mean, standard deviation, and the share of values within `radius` of the mean.
fn moments(records: &[Vec<[f64; 2]>], angle: usize, radius: f64) -> [f64; 3] {
    let values = || records.iter().flatten().map(|angles| angles[angle]);
    let centre = mean(values());
    let variance = mean(values().map(|value| (value - centre).powi(2)));
    let within = mean(values().map(|value| f64::from(u8::from((value - centre).abs() < radius))));
    [centre, variance.sqrt(), within]
}

fn close(found: f64, expected: f64, tolerance: f64, what: &str) {
    assert!((found - expected).abs() < tolerance, "{what}: {found} instead of {expected}");
}

/// Distance from the mean within which half of a Laplace distribution lies, for deviation 1.
const LAPLACE_QUARTILE: f64 = std::f64::consts::LN_2 * std::f64::consts::FRAC_1_SQRT_2;
/// The same for a normal distribution.
const NORMAL_QUARTILE: f64 = 0.674_489_75;

/// Expects angles that each have a mean, a deviation within a tolerance, and half of their values
/// within `quartile` deviations of the mean.
fn expect_moments(speed_m_s: f64, quartile: f64, expected: [[f64; 3]; 2]) {
    // Samples at nodes, and samples in the middle between two.
    for interval_s in [NODE_S * 40.0, NODE_S * 40.5] {
        let records = record(&walkers(speed_m_s), interval_s, 500);
        for (angle, name) in ["polar angle", "azimuth"].into_iter().enumerate() {
            let [centre, deviation, tolerance] = expected[angle];
            let found = moments(&records, angle, deviation * quartile);
            close(found[0], centre, 0.1, &format!("mean of the {name}"));
            close(found[1], deviation, tolerance, &format!("deviation of the {name}"));
            close(found[2], 0.5, 0.01, &format!("share of the {name} within the quartiles"));
        }
    }
}

#[test]
fn the_angles_of_users_who_sit_have_the_measured_laplace_distribution_at_any_time() {
    expect_moments(0.0, LAPLACE_QUARTILE, [[41.39, 7.68, 0.1], [0.0, 3.67, 0.05]]);
}

#[test]
fn the_angles_of_users_who_walk_have_the_measured_normal_distribution_at_any_time() {
    expect_moments(1.0, NORMAL_QUARTILE, [[29.67, 7.78, 0.1], [0.0, 10.0, 0.1]]);
}

/// Correlation of an angle with itself `lag` samples later.
fn autocorrelation(records: &[Vec<[f64; 2]>], angle: usize, lag: usize) -> f64 {
    let [centre, deviation, _] = moments(records, angle, 1.0);
    let pairs = records.iter().zip(&records[lag..]).flat_map(|(now, later)| now.iter().zip(later));
    mean(pairs.map(|(now, later)| (now[angle] - centre) * (later[angle] - centre))) / (deviation * deviation)
}

#[test]
fn the_autocorrelation_is_a_twentieth_at_the_coherence_time_and_exponential_before() {
    for (speed_m_s, coherence_s) in [(0.0, SITTING_COHERENCE_S), (1.0, WALKING_COHERENCE_S)] {
        // An interval that is no multiple of the nodes.
        let interval_s = coherence_s / 30.0;
        let records = record(&walkers(speed_m_s), interval_s, 3000);
        for angle in [0, 1] {
            for (lag, expected) in [(30, 0.05), (20, 0.05_f64.powf(2.0 / 3.0)), (10, (-1.0_f64).exp())] {
                // The quantile function of the Laplace distribution lowers a correlation by a few
                // hundredths.
                close(autocorrelation(&records, angle, lag), expected, 0.03, "autocorrelation");
            }
        }
    }
}

#[test]
fn a_user_who_stops_changes_to_the_angles_of_sitting_over_the_coherence_time() {
    let (walking, sitting) = (walkers(1.0), walkers(0.0));
    let mut orientations = begin(&walking, 5);
    let mut polar_after = |nodes: usize, walkers: &[Walker]| {
        let mut largest_change: f64 = 0.0;
        for _ in 0..nodes {
            let before = angles_deg(&orientations);
            orientations.pass_node(walkers);
            orientations.hold(orientations.next_node_s().expect("measured") - NODE_S, walkers);
            for (before, after) in before.iter().zip(angles_deg(&orientations)) {
                largest_change = largest_change.max((after[0] - before[0]).abs());
            }
        }
        (mean(angles_deg(&orientations).iter().map(|angles| angles[0])), largest_change)
    };
    let (before, usual_change) = polar_after(400, &walking);
    close(before, 29.67, 1.5, "walking");
    // The change begins at the node of the stop, and the first interval of it ends one node later.
    let (after, change) = polar_after(75, &sitting);
    close(after, 41.39 - 0.05 * 11.72, 1.5, "one coherence time later");
    assert!(change < usual_change + 1.0, "{change} degrees at once, {usual_change} before");
}

fn scenario(overrides: &[&str]) -> Scenario {
    Scenario::builtin("specular").unwrap().with_overrides(overrides).unwrap()
}

const TILTED: [&str; 2] = ["users.orientation.model=measured", "users.pause_mean_s=1"];

fn world(overrides: &[&str], seed: u64) -> World {
    World::new(&scenario(overrides), None, seed).unwrap()
}

fn normals(world: &World) -> Vec<Vec3> {
    world.orientations().iter().map(|held| held.normal()).collect()
}

#[test]
fn the_orientations_depend_on_the_seed_and_not_on_the_steps() {
    let coming = ["users.arrivals.rate_per_min=60", "users.arrivals.mean_stay_s=4", "users.arrivals.max_users=9"];
    let crowd = ["users.mobility=social-force"];
    let turning = ["users.mobility=smooth-random"];
    for others in [&[][..], &coming, &crowd, &turning] {
        let overrides = &[&TILTED[..], others].concat();
        let (mut one, mut many, mut other) = (world(overrides, 5), world(overrides, 5), world(overrides, 6));
        for _ in 0..20 {
            one.step(0.777);
            other.step(0.777);
            for step in 0..21 {
                many.advance(0.777 * f64::from(step) / 210.0);
            }
            many.refresh();
            assert_eq!(one.ids(), many.ids());
            for (a, b) in normals(&one).iter().zip(normals(&many)) {
                assert!((a - b).norm() < 1e-8, "{a:?} {b:?}");
            }
            assert!(normals(&one) != normals(&other));
        }
    }
}

#[test]
fn a_restarted_world_equals_a_new_one_and_one_more_user_does_not_change_the_others() {
    let mut restarted = world(&TILTED, 1);
    restarted.step(7.3);
    restarted.restart(5);
    let (mut new, mut more) = (world(&TILTED, 5), world(&[&TILTED[..], &["users.count=6"]].concat(), 5));
    for _ in 0..50 {
        for world in [&mut restarted, &mut new, &mut more] {
            world.step(0.033);
        }
        assert_eq!(normals(&restarted), normals(&new));
        assert_eq!(normals(&more)[..5], normals(&new));
    }
}

#[test]
fn without_the_table_and_with_the_model_up_every_receiver_faces_up_and_the_walks_are_the_same() {
    let (mut plain, mut up) = (world(&[], 4), world(&["users.orientation.model=up"], 4));
    let mut tilted = world(&["users.orientation.model=measured"], 4);
    for _ in 0..50 {
        plain.step(0.07);
        up.step(0.07);
        tilted.step(0.07);
        assert!(normals(&plain).iter().all(|normal| *normal == Vec3::z()));
        assert_eq!(plain.users(), up.users());
        assert_eq!(plain.scene().steering_gain(), up.scene().steering_gain());
        for (a, b) in plain.positions().iter().zip(tilted.positions()) {
            assert!((a - b).norm() < 1e-9, "{a:?} {b:?}");
        }
    }
}

/// One user of the numbered entry sits, two others have a model of the shares.
const MIXED: &str = "{mobility=\"social-force\",share=1}";

#[test]
fn an_entry_of_a_mixture_states_how_its_users_hold_their_receivers() {
    let room = |own: &str| {
        let mixture = format!("users.mixture=[{{mobility=\"seated\",count=1{own}}},{MIXED}]");
        world(&["users.mobility=mixture", "users.count=3", "users.orientation={}", &mixture], 4)
    };
    let (mut alike, mut up) = (room(""), room(",orientation={model=\"up\"}"));
    let mut flat = room(",orientation={sitting_polar_mean_deg=90,sitting_polar_std_deg=0}");
    for _ in 0..50 {
        for world in [&mut alike, &mut up, &mut flat] {
            world.step(0.07);
        }
        let of = [&alike, &up, &flat].map(normals);
        assert!(of[1][0] == Vec3::z() && of[2][0].z.abs() < 1e-12 && of[0][0].z < 1.0, "{of:?}");
        assert!(of[1][1..] == of[0][1..] && of[2][1..] == of[0][1..], "the others: {of:?}");
        assert_eq!(up.users(), alike.users(), "the walks are the same");
    }
    // An entry alone can be tilted, also where users enter and leave.
    let mixture =
        "users.mixture=[{mobility=\"seated\",share=0.5,orientation={}},{mobility=\"random-waypoint\",share=0.5}]";
    let coming = ["users.arrivals.rate_per_min=60", "users.arrivals.mean_stay_s=4", "users.arrivals.max_users=9"];
    let mut mixed = world(&[&["users.mobility=mixture", mixture][..], &coming].concat(), 4);
    let (mut upright, mut tilted) = (0, 0);
    for _ in 0..200 {
        mixed.step(0.1);
        for (user, normal) in mixed.users().iter().zip(normals(&mixed)) {
            let sits = user.velocity == [0.0, 0.0];
            assert!(sits || normal == Vec3::z(), "{user:?} {normal:?}");
            *(if normal == Vec3::z() { &mut upright } else { &mut tilted }) += 1;
        }
    }
    assert!(upright > 50 && tilted > 50, "{upright} {tilted}");
}

#[test]
fn receivers_are_tilted_towards_the_faces_of_their_users() {
    let mut world = world(&TILTED, 8);
    for _ in 0..100 {
        world.step(0.05);
        for (user, normal) in world.users().iter().zip(normals(&world)) {
            let forwards = user.direction[0] * normal.x + user.direction[1] * normal.y;
            assert!(normal.z > 0.0 && forwards < 0.1, "{normal:?} of a user who faces {:?}", user.direction);
        }
    }
}

#[test]
fn the_rates_of_the_room_and_of_its_references_are_those_of_the_tilted_receivers() {
    let free = ["blockage.bodies=false", "blockage.obstacles_per_m2=0"];
    let (mut tilted, mut upright) = (world(&[&TILTED[..], &free].concat(), 2), world(&free, 2));
    tilted.step(3.0);
    upright.step(3.0);
    let led = tilted.model().leds[0].position;
    let measured = Baselines::new(&tilted).measure(&Snapshot::new(&tilted, &MirrorAngles::flat(100))).clone();
    assert_eq!(measured.los_gain, tilted.scene().los_gain());
    assert!(measured.sum_rates_bps.oracle > measured.sum_rates_bps.no_irs);
    let mut point = world(&[&TILTED[..], &free, &["led.side_m=0", "led.points_per_side=1"]].concat(), 2);
    point.step(3.0);
    for ((normal, position), gain) in normals(&point).iter().zip(point.positions()).zip(point.scene().los_gain()) {
        let ray = led - position;
        let upright_gain = 20e-6 / std::f64::consts::PI * ray.z * ray.z / ray.norm().powi(4);
        let expected = upright_gain * ray.dot(normal).max(0.0) / ray.z;
        close(*gain, expected, 1e-12 * expected, "direct gain");
    }
}
