//! The world: reproducibility from the seed, independence of its settings, and the share of blocked
//! paths.

use heliostat_channel::blockage::blocks;
use heliostat_room::World;
use heliostat_room::world::WorldError;
use heliostat_scenario::Scenario;

fn scenario(overrides: &[&str]) -> Scenario {
    Scenario::builtin("specular").unwrap().with_overrides(overrides).unwrap()
}

fn world(overrides: &[&str], seed: u64) -> World {
    World::new(&scenario(overrides), None, seed).unwrap()
}

/// Every bit of the users' positions and gains over 200 steps.
fn bits(world: &mut World) -> Vec<u64> {
    let mut bits = Vec::new();
    for step in 0..200 {
        world.step(0.003 * f64::from(step % 7));
        let positions = world.positions().iter().flat_map(|position| position.iter().copied());
        let gains = world.scene().los_gain().iter().chain(world.scene().steering_gain()).copied();
        bits.extend(positions.chain(gains).map(f64::to_bits));
    }
    bits
}

#[test]
fn the_same_seed_gives_the_same_world_bit_for_bit_and_another_seed_does_not() {
    assert_eq!(bits(&mut world(&[], 5)), bits(&mut world(&[], 5)));
    assert_ne!(bits(&mut world(&[], 5)), bits(&mut world(&[], 6)));
}

#[test]
fn a_restarted_world_equals_a_new_one() {
    let mut restarted = world(&[], 1);
    restarted.step(17.0);
    restarted.restart(5);
    assert_eq!(restarted.time_s(), 0.0);
    assert_eq!(bits(&mut restarted), bits(&mut world(&[], 5)));
}

#[test]
fn one_setting_does_not_change_the_random_numbers_of_the_others() {
    let plain = world(&[], 9);
    let crowded = world(&["users.count=7", "users.speed_max_m_s=1.0", "blockage.bodies=false"], 9);
    assert_eq!(plain.obstacles(), crowded.obstacles());
    let (mut few, mut many) = (world(&[], 9), world(&["blockage.obstacles_per_m2=0.2", "noise.variance_a2=1e-14"], 9));
    few.step(30.0);
    many.step(30.0);
    assert_eq!(few.users(), many.users());
}

#[test]
fn forced_users_are_the_first_ones_and_can_be_changed() {
    let mut world = world(&["blockage.forced_users=2", "blockage.bodies=false", "blockage.obstacles_per_m2=0"], 3);
    assert_eq!(world.forced(), [true, true, false, false, false]);
    assert_eq!(world.scene().los_blocked(), [true, true, false, false, false]);
    assert!(world.scene().los_gain()[..2].iter().all(|gain| *gain == 0.0));
    world.set_forced(0);
    world.step(0.0);
    assert_eq!(world.scene().los_blocked(), [false; 5]);
}

#[test]
fn bodies_are_behind_the_receivers_of_their_users() {
    let mut world = world(&["blockage.obstacles_per_m2=0"], 4);
    world.step(12.0);
    assert_eq!(world.blockers().len(), 5);
    for (user, body) in world.users().iter().zip(world.blockers()) {
        let behind = [user.position.x - body.x_m, user.position.y - body.y_m];
        assert!((behind[0].hypot(behind[1]) - 0.3).abs() < 1e-12);
        let forwards = behind[0] * user.velocity[0] + behind[1] * user.velocity[1];
        assert!(forwards > 0.0, "a body is ahead of its receiver");
    }
}

/// Mean number of users of 5 whose path to the LED is blocked, over many rooms: by obstacles, by
/// obstacles or the user's own body, by any cylinder.
fn blocked_users() -> [f64; 3] {
    let mut world = world(&[], 0);
    let rooms = 4000;
    let led = world.model().leds[0].position;
    let mut blocked = [0; 3];
    for seed in 0..rooms {
        world.restart(seed);
        let bodies = &world.blockers()[world.obstacles().len()..];
        for (user, position) in world.positions().iter().enumerate() {
            let is_blocking = |cylinder| blocks(cylinder, position, &led);
            let by_obstacle = world.obstacles().iter().any(is_blocking);
            let by_own_body = is_blocking(&bodies[user]);
            let cases = [by_obstacle, by_obstacle || by_own_body, world.scene().los_blocked()[user]];
            blocked.iter_mut().zip(cases).for_each(|(count, case)| *count += u32::from(case));
        }
    }
    blocked.map(|count| f64::from(count) / rooms as f64)
}

#[test]
fn the_number_of_blocked_users_agrees_with_an_independent_prototype() {
    // The prototype has 0.21 of 5 for two cylinders, 1.4 with each user's own body, and 1.7 with
    // the bodies of the others.
    let [obstacles, own_body, all] = blocked_users();
    assert!((obstacles - 0.21).abs() < 0.03, "{obstacles}");
    assert!((own_body - 1.4).abs() < 0.1, "{own_body}");
    assert!((all - 1.7).abs() < 0.1, "{all}");
    println!("blocked by obstacles {obstacles}, with the own body {own_body}, with all bodies {all}");
}

#[test]
fn valid_changes_in_a_running_world_take_effect_and_invalid_ones_do_not() {
    let mut world = world(&["users.speed_min_m_s=1.0", "users.speed_max_m_s=1.0"], 2);
    assert!(world.set_speed(0.5, 0.5).is_ok());
    assert!(world.set_speed(1.0, 0.5).is_err());
    world.step(0.01);
    for user in world.users() {
        assert!((user.velocity[0].hypot(user.velocity[1]) - 0.5).abs() < 1e-12);
    }
    assert!(world.set_power(3.0) && !world.set_power(-1.0) && !world.set_power(f64::NAN));
    assert_eq!(world.model().budget.power_w, 3.0);
}

#[test]
fn a_recorded_walk_moves_the_users_and_an_invalid_one_is_refused_with_its_line() {
    let with = |text| World::new(&scenario(&["users.count=1", "users.trace=walk.csv"]), text, 1);
    let mut recorded = with(Some("time,user,x,y\n0,0,-1,0\n2,0,1,0\n")).unwrap();
    recorded.step(0.5);
    assert_eq!((recorded.positions()[0].x, recorded.positions()[0].z), (-0.5, 0.85));
    let error = with(Some("time,user,x,y\n0,0,-1,0\n2,0,9,0\n")).unwrap_err();
    assert!(matches!(error, WorldError::Trace { .. }) && error.to_string().contains("line 3"), "{error}");
    let error = with(None).unwrap_err();
    assert!(error.to_string().starts_with("users.trace: walk.csv"), "{error}");
}

const ARRIVALS: [&str; 3] =
    ["users.arrivals.rate_per_min=60", "users.arrivals.mean_stay_s=4", "users.arrivals.max_users=9"];

/// The users of each step of a run, with their positions.
fn turnover(world: &mut World, step_s: f64, steps: usize) -> Vec<Vec<(u32, [f64; 3])>> {
    (0..steps)
        .map(|_| {
            world.step(step_s);
            let users = world.users().iter().map(|user| user.position.into());
            world.ids().iter().copied().zip(users).collect()
        })
        .collect()
}

#[test]
fn users_come_and_go_by_the_seed_and_no_number_is_used_twice() {
    let run = |seed| turnover(&mut world(&ARRIVALS, seed), 0.25, 400);
    let states = run(3);
    assert_eq!(states, run(3));
    assert_ne!(states, run(4));
    let counts: Vec<usize> = states.iter().map(Vec::len).collect();
    assert!(counts.iter().all(|count| *count <= 9) && counts.iter().any(|count| *count != 5), "{counts:?}");
    let (mut seen, mut gone) = (Vec::new(), Vec::new());
    for state in &states {
        let present: Vec<u32> = state.iter().map(|(id, _)| *id).collect();
        assert!(present.is_sorted() && present.iter().all(|id| !gone.contains(id)), "{present:?} after {gone:?}");
        gone.extend(seen.iter().filter(|id| !present.contains(id)).copied());
        seen = present;
    }
    assert!(gone.len() > 50, "{}", gone.len());
}

#[test]
fn a_user_walks_the_same_way_whoever_else_comes_and_goes() {
    let (mut alone, mut crowd) = (world(&["users.count=5"], 8), world(&ARRIVALS, 8));
    for _ in 0..20 {
        alone.step(0.1);
        crowd.step(0.1);
        for (id, user) in crowd.ids().iter().zip(crowd.users()).filter(|(id, _)| **id < 5) {
            assert_eq!(user, &alone.users()[*id as usize]);
        }
        assert_eq!(alone.obstacles(), crowd.obstacles());
    }
}

#[test]
fn every_list_of_a_world_has_one_entry_for_each_user() {
    let mut world =
        world(&[&ARRIVALS[..], &["users.min_rate_mbps=[1,2,3,4,5]", "blockage.forced_users=2"]].concat(), 2);
    for _ in 0..200 {
        world.step(0.2);
        let users = world.ids().len();
        assert_eq!([world.users().len(), world.positions().len(), world.scene().users()], [users; 3]);
        assert_eq!(world.blockers().len() - world.obstacles().len(), users);
        let forced = world.forced().iter().filter(|forced| **forced).count();
        assert_eq!((world.forced().len(), forced), (users, users.min(2)));
        let expected: Vec<f64> = world.ids().iter().map(|id| 1e6 * f64::from(id % 5 + 1)).collect();
        assert_eq!(world.min_rate_bps(), expected);
    }
    let turnover = world.turnover().unwrap();
    assert!(turnover.entered > 10 && turnover.left > 10, "{turnover:?}");
}

#[test]
fn arrivals_that_are_absent_or_never_come_change_no_bit_of_the_walks() {
    let never = ["users.arrivals.rate_per_min=0", "users.arrivals.mean_stay_s=1000000"];
    assert_eq!(bits(&mut world(&[], 5)), bits(&mut world(&never, 5)));
}

#[test]
fn arrivals_and_a_recorded_walk_exclude_each_other() {
    let both = ["users.trace=\"walk.csv\"", "users.arrivals.rate_per_min=1"];
    let refusal = Scenario::builtin("specular").unwrap().with_overrides(&both).unwrap_err().to_string();
    assert!(refusal.contains("users.trace") && refusal.contains("remove users.trace or users.arrivals"), "{refusal}");
}

#[test]
fn a_mismatch_changes_bodies_and_equipment_and_no_walk() {
    let (nominal, rough) = (world(&[], 9), world(&["mismatch.level=rough"], 9));
    assert_eq!(nominal.positions(), rough.positions());
    assert_eq!(nominal.obstacles(), rough.obstacles());
    let radii = |world: &World| -> Vec<f64> {
        world.blockers()[world.obstacles().len()..].iter().map(|body| body.radius_m).collect()
    };
    assert_eq!(radii(&nominal), [0.2; 5]);
    let radii = radii(&rough);
    assert!(radii.iter().all(|radius| *radius != 0.2) && radii[0] != radii[1], "{radii:?}");
    assert_ne!(nominal.model().receiver.detector_area_m2, rough.model().receiver.detector_area_m2);
}
