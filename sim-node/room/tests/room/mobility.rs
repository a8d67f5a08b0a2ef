//! All mobility models in a world: reproducibility, independence of the time steps, arrivals, and
//! what the models promise.

use heliostat_room::World;
use heliostat_room::world::walker::Walker;
use heliostat_scenario::Scenario;

const MODELS: [&str; 6] =
    ["random-waypoint", "random-direction", "gauss-markov", "smooth-random", "social-force", "seated"];
const MIXTURE: &str = "users.mixture=[{ mobility = \"seated\", share = 0.4 }, { mobility = \"social-force\", share = 0.4 }, \
                       { mobility = \"random-waypoint\", share = 0.2 }]";
const ARRIVALS: [&str; 3] =
    ["users.arrivals.rate_per_min=60", "users.arrivals.mean_stay_s=4", "users.arrivals.max_users=9"];

fn world(overrides: &[&str], seed: u64) -> World {
    let scenario = Scenario::builtin("specular").unwrap().with_overrides(overrides).unwrap();
    World::new(&scenario, None, seed).unwrap()
}

/// The settings of each model alone, and of a mixture, with a heading that lags.
fn settings() -> Vec<Vec<String>> {
    let lag = "users.heading_lag_s=0.3".to_owned();
    let alone = MODELS.iter().map(|model| vec![format!("users.mobility={model}"), lag.clone()]);
    alone.chain([vec!["users.mobility=mixture".to_owned(), MIXTURE.to_owned(), lag.clone()]]).collect()
}

fn with<'a>(settings: &'a [String], more: &[&'a str]) -> Vec<&'a str> {
    settings.iter().map(String::as_str).chain(more.iter().copied()).collect()
}

/// The users after a time that is walked in steps of this length.
fn after(world: &mut World, steps: usize, step_s: f64) -> Vec<Walker> {
    (0..steps).for_each(|_| world.step(step_s));
    world.users().to_vec()
}

fn distance_m(a: &Walker, b: &Walker) -> f64 {
    (a.position - b.position).norm()
}

#[test]
fn the_same_seed_gives_the_same_walks_and_a_restarted_world_equals_a_new_one() {
    for settings in settings() {
        let new = |seed| world(&with(&settings, &[]), seed);
        let expected = after(&mut new(5), 300, 0.013);
        assert_eq!(expected, after(&mut new(5), 300, 0.013), "{settings:?}");
        assert_ne!(expected, after(&mut new(6), 300, 0.013), "{settings:?}");
        let mut restarted = new(1);
        restarted.step(7.0);
        restarted.restart(5);
        assert_eq!(expected, after(&mut restarted, 300, 0.013), "{settings:?}");
        assert_eq!(restarted.recording_s(), None);
    }
}

#[test]
fn walks_do_not_depend_on_the_time_steps_also_with_arrivals_and_tilted_receivers() {
    for settings in settings() {
        for more in [&[][..], &ARRIVALS, &["users.orientation.model=measured", "users.pause_mean_s=1"]] {
            let new = || world(&with(&settings, more), 3);
            let (mut short, mut long) = (new(), new());
            let (a, b) = (after(&mut short, 3700, 0.01), after(&mut long, 100, 0.37));
            assert_eq!(short.ids(), long.ids());
            for (a, b) in short.orientations().iter().zip(long.orientations()) {
                assert!((a.normal() - b.normal()).norm() < 1e-9, "{settings:?} {more:?}: {a:?} {b:?}");
            }
            for (a, b) in a.iter().zip(&b) {
                assert!(distance_m(a, b) < 1e-9, "{settings:?} {more:?}: {a:?} {b:?}");
                let turn = (a.direction[0] - b.direction[0]).hypot(a.direction[1] - b.direction[1]);
                assert!(turn < 1e-9, "{settings:?} {more:?}: {a:?} {b:?}");
            }
        }
    }
}

#[test]
fn users_stay_on_the_floor_face_somewhere_and_move_with_their_velocity() {
    for settings in settings() {
        let mut world = world(&with(&settings, &["room.length_x_m=6.0", "users.pause_mean_s=1"]), 7);
        let mut longest_m = 0.0_f64;
        let start = world.users().to_vec();
        for step in 0..4000 {
            let before = world.users().to_vec();
            world.step(0.01);
            for (a, b) in before.iter().zip(world.users()) {
                assert!(b.position.x.abs() <= 3.0 && b.position.y.abs() <= 2.5, "{settings:?}: {b:?}");
                assert!((b.direction[0].hypot(b.direction[1]) - 1.0).abs() < 1e-9, "{settings:?}: {b:?}");
                // Both instants are in one interval of the grid.
                if step % 2 == 0 && a.velocity == b.velocity {
                    let [x, y] = a.velocity.map(|component| component * 0.01);
                    let expected = [a.position.x + x, a.position.y + y];
                    let error_m = (b.position.x - expected[0]).hypot(b.position.y - expected[1]);
                    assert!(error_m < 1e-9, "{settings:?}: {error_m} m");
                }
            }
            longest_m = start.iter().zip(world.users()).map(|(a, b)| distance_m(a, b)).fold(longest_m, f64::max);
        }
        assert_eq!(longest_m > 2.0, settings[0] != "users.mobility=seated", "{settings:?}: {longest_m} m");
    }
}

#[test]
fn users_come_and_go_in_every_model() {
    for settings in settings() {
        let mut world = world(&with(&settings, &ARRIVALS), 2);
        for _ in 0..500 {
            world.step(0.1);
            let users = world.ids().len();
            assert_eq!([world.users().len(), world.positions().len(), world.scene().users()], [users; 3]);
        }
        let turnover = world.turnover().unwrap();
        assert!(turnover.entered > 20 && turnover.left > 20, "{settings:?}: {turnover:?}");
    }
}

#[test]
fn new_speeds_take_effect_in_every_model() {
    for model in &MODELS[..5] {
        let mobility = format!("users.mobility={model}");
        let mut world = world(&[&mobility, "users.heading_lag_s=0.3", "users.count=1", "room.length_x_m=9.0"], 4);
        world.set_speed(0.6, 0.6).unwrap();
        world.step(3.0);
        let speeds = (0..100).map(|_| {
            world.step(0.1);
            let [x, y] = world.users()[0].velocity;
            x.hypot(y)
        });
        let fastest = speeds.fold(0.0, f64::max);
        // Social forces can push a user to 1.3 times its desired speed.
        assert!((0.59..0.79).contains(&fastest), "{model}: {fastest}");
        world.set_speed(0.0, 0.0).unwrap();
        world.step(0.1);
        let before = world.users().to_vec();
        world.step(5.0);
        assert_eq!(before[0].position, world.users()[0].position, "{model}");
    }
}

#[test]
fn the_heading_follows_the_walk_with_its_time_constant() {
    // A seated user turns once: after one time constant 1/e of the angle is left.
    let turns = "users.seated.turn_mean_s=500";
    let mut world = world(&["users.mobility=seated", "users.heading_lag_s=0.5", "users.count=1", turns], 9);
    let heading = |world: &World| world.users()[0].heading();
    let start = heading(&world);
    let mut steps = 0;
    while heading(&world) == start && steps < 100_000 {
        world.step(0.02);
        steps += 1;
    }
    let first = heading(&world) - start;
    world.step(0.48);
    let later = heading(&world) - start;
    world.step(5.0);
    let all = heading(&world) - start;
    let wrapped = |angle: f64| angle.sin().atan2(angle.cos()).abs();
    assert!(wrapped(first) > 0.0 && wrapped(first) < wrapped(later), "{first} {later} {all}");
    assert!((wrapped(later) / wrapped(all) - (1.0 - (-1.0_f64).exp())).abs() < 0.02, "{first} {later} {all}");
}

#[test]
fn users_of_the_social_force_model_touch_neither_users_nor_obstacles_nor_walls() {
    for seed in 0..6 {
        let mut world = world(
            &[
                "users.mobility=social-force",
                "users.count=12",
                "users.pause_mean_s=1",
                "blockage.obstacles_per_m2=0.15",
            ],
            seed,
        );
        let (mut nearest_m, mut near_obstacles) = (f64::INFINITY, 0);
        for _ in 0..6000 {
            world.step(0.01);
            for (index, user) in world.users().iter().enumerate() {
                // The radius of a user is blockage.body_radius_m = 0.2, that of an obstacle 0.25 m.
                assert!(user.position.x.abs().max(user.position.y.abs()) <= 2.5 - 0.2 + 1e-9, "{user:?}");
                let others = &world.users()[..index];
                nearest_m = others.iter().map(|other| distance_m(user, other)).fold(nearest_m, f64::min);
                for obstacle in world.obstacles() {
                    let axis_m = (user.position.x - obstacle.x_m).hypot(user.position.y - obstacle.y_m);
                    assert!(axis_m > 0.449, "{axis_m} m from an obstacle, seed {seed}");
                    near_obstacles += usize::from(axis_m < 0.8);
                }
            }
        }
        assert!(nearest_m > 0.399 && nearest_m < 0.6, "{nearest_m} m between two users, seed {seed}");
        assert!(near_obstacles > 0 || world.obstacles().is_empty());
    }
}

#[test]
fn users_who_have_no_room_for_their_discs_stay_on_the_floor() {
    let crowded = ["users.mobility=mixture", MIXTURE, "users.count=12", "blockage.body_radius_m=1.0"];
    for seed in 0..20 {
        let mut world = world(&[&crowded[..], &["room.length_x_m=3.0"]].concat(), seed);
        for _ in 0..500 {
            world.step(0.02);
            let outside = world.users().iter().find(|user| user.position.x.abs() > 1.5 || user.position.y.abs() > 2.5);
            assert!(outside.is_none(), "{outside:?}, seed {seed}");
        }
    }
}

#[test]
fn users_of_the_social_force_model_walk_near_their_desired_speed() {
    let floor = ["room.length_x_m=30.0", "room.length_y_m=8.0", "blockage.obstacles_per_m2=0"];
    let forces = ["users.mobility=social-force", "users.count=4", "users.social_force.desired_speed_std_m_s=0"];
    let mut world = world(&[&floor[..], &forces].concat(), 1);
    let (mut sum, mut count) = (0.0, 0.0);
    for _ in 0..3000 {
        world.step(0.1);
        for user in world.users() {
            sum += user.velocity[0].hypot(user.velocity[1]);
            count += 1.0;
        }
    }
    let mean = sum / count;
    assert!((mean - 1.34).abs() < 0.1, "{mean} m/s");
}

#[test]
fn users_of_the_social_force_model_stand_still_in_their_pauses() {
    let mut world = world(&["users.mobility=social-force", "users.count=6", "users.pause_mean_s=4"], 2);
    let (mut standing, mut creeping, mut turned, steps) = (0, 0, 0, 6000);
    for _ in 0..steps {
        let before = world.users().to_vec();
        world.step(0.02);
        for (a, b) in before.iter().zip(world.users()) {
            let speed_m_s = b.velocity[0].hypot(b.velocity[1]);
            standing += usize::from(speed_m_s == 0.0);
            creeping += usize::from(speed_m_s > 0.0 && speed_m_s < 0.05);
            turned += usize::from(speed_m_s == 0.0 && a.velocity == [0.0; 2] && a.direction != b.direction);
        }
    }
    let users = steps * 6;
    assert!(standing > users / 3 && standing < 9 * users / 10, "{standing} of {users}");
    assert!(creeping < users / 25 && turned < standing / 100, "creeping {creeping}, turned {turned} of {standing}");
}

#[test]
fn two_users_in_a_corridor_pass_each_other() {
    // A corridor of 1.6 m: discs of 0.4 m can pass, and goals are on both sides.
    let corridor = ["room.length_x_m=14.0", "room.length_y_m=1.6", "blockage.obstacles_per_m2=0", "mirrors.wall=+y"];
    let forces = ["users.mobility=social-force", "users.count=2"];
    let mut world = world(&[&corridor[..], &forces].concat(), 3);
    let order = |world: &World| world.users()[0].position.x < world.users()[1].position.x;
    let (mut last, mut passes) = (order(&world), 0);
    for _ in 0..3000 {
        world.step(0.1);
        passes += usize::from(order(&world) != last);
        last = order(&world);
    }
    assert!(passes > 10, "{passes}");
}

#[test]
fn seated_users_have_the_seats_of_the_list_or_free_places() {
    let mobility = ["users.mobility=seated", "users.count=3"];
    let seats = "users.seats_m=[[1.0, 1.0], [-1.0, 0.5], [0.0, -2.0]]";
    let listed = world(&[&mobility[..], &[seats]].concat(), 1);
    let places: Vec<[f64; 2]> = listed.users().iter().map(|user| [user.position.x, user.position.y]).collect();
    assert_eq!(places, [[1.0, 1.0], [-1.0, 0.5], [0.0, -2.0]]);
    for seed in 0..50 {
        let drawn = world(&["users.mobility=seated", "users.count=6", "users.seated.spacing_m=0.8"], seed);
        for (index, user) in drawn.users().iter().enumerate() {
            assert!(user.position.x.abs().max(user.position.y.abs()) <= 2.0);
            assert!(drawn.users()[..index].iter().all(|other| distance_m(user, other) >= 0.8));
            let clear = |x: f64, y: f64| (user.position.x - x).hypot(user.position.y - y) >= 0.75;
            assert!(drawn.obstacles().iter().all(|obstacle| clear(obstacle.x_m, obstacle.y_m)));
        }
    }
}

#[test]
fn a_mixture_has_its_shares_by_the_seed() {
    let set = ["users.mobility=mixture", MIXTURE, "users.count=20", "room.length_x_m=10.0", "users.pause_mean_s=0"];
    let seated = |seed| {
        let mut world = world(&set, seed);
        let start = world.users().to_vec();
        world.step(2.0);
        start.iter().zip(world.users()).map(|(a, b)| a.position == b.position).collect::<Vec<bool>>()
    };
    for seed in 0..20 {
        let count = seated(seed).iter().filter(|seated| **seated).count();
        assert!((7..=9).contains(&count), "{count} of 20 for a share of 0.4");
    }
    assert_eq!(seated(1), seated(1));
    assert_ne!(seated(1), seated(2));
}

#[test]
fn a_mixture_with_a_number_of_users_has_that_number_for_each_seed() {
    let mixture =
        "users.mixture=[{ mobility = \"random-waypoint\", share = 1.0 }, { mobility = \"seated\", count = 2 }]";
    let set = ["users.mobility=mixture", mixture, "users.count=5", "users.pause_mean_s=0"];
    for seed in 0..20 {
        let mut world = world(&set, seed);
        let start = world.users().to_vec();
        world.step(2.0);
        let seated: Vec<bool> = start.iter().zip(world.users()).map(|(a, b)| a.position == b.position).collect();
        assert_eq!(seated, [true, true, false, false, false], "seed {seed}");
    }
}

#[test]
fn seats_of_the_list_are_free_of_obstacles_and_users_sit_there() {
    let scenario = Scenario::builtin("office").unwrap();
    let (mut seated, mut walking, mut obstacles) = (0, 0, 0);
    for seed in 0..40 {
        let mut world = World::new(&scenario, None, seed).unwrap();
        obstacles += world.obstacles().len();
        world.step(20.0);
        for user in world.users() {
            let at = [user.position.x, user.position.y];
            if scenario.users.seats_m.contains(&at) {
                seated += 1;
                // The body is 0.3 m behind the receiver and has a radius of 0.2 m.
                let clear = |x: f64, y: f64| (at[0] - x).hypot(at[1] - y) >= 0.8;
                assert!(world.obstacles().iter().all(|obstacle| clear(obstacle.x_m, obstacle.y_m)));
            } else {
                walking += 1;
            }
        }
    }
    assert!((120..=168).contains(&seated) && walking > 40 && obstacles > 10, "{seated} {walking} {obstacles}");
}
