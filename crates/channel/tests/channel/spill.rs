//! Users within one spot: the light of a mirror for users at whom it is not aimed.

use crate::common::{Random, Room, angle_diversity, led};
use heliostat_channel::decode::{aim, aim_at_point, decode};
use heliostat_channel::scene::Spill;
use heliostat_channel::{
    ChannelModel, Combining, Method, MinimumRates, MirrorAngles, Problem, Scene, Solution, Solver, Vec3,
};

const MINIMUM: MinimumRates = MinimumRates { min_rate_bps: &[1e6; 10], qos_penalty: 50.0 };

/// Users of a room in clusters: each but the first of a cluster is 0.05 to 0.5 m from the first.
fn clusters(random: &mut Random, sizes: &[usize]) -> Vec<Vec3> {
    let mut positions = Vec::new();
    for size in sizes {
        let first = random.walker();
        positions.push(first);
        for _ in 1..*size {
            let (distance, towards) = (random.uniform(0.05, 0.5), random.uniform(0.0, std::f64::consts::TAU));
            let within = |coordinate: f64| coordinate.clamp(-2.45, 2.45);
            let (x, y) = (first.x + distance * towards.cos(), first.y + distance * towards.sin());
            positions.push(Vec3::new(within(x), within(y), first.z));
        }
    }
    positions
}

/// Users at least 2 m apart, near the corners of the floor.
fn apart(random: &mut Random) -> Vec<Vec3> {
    [(-1.6, -1.6), (1.6, -1.6), (-1.6, 1.6), (1.6, 1.6)]
        .map(|(x, y)| Vec3::new(x + random.uniform(-0.4, 0.4), y + random.uniform(-0.4, 0.4), 0.85))
        .to_vec()
}

/// The paper's room with a panel and this many mirrors.
fn panel_room(random: &mut Random, (rows, columns): (usize, usize)) -> ChannelModel {
    let mut room = Room::paper().with_panel();
    (room.array.rows, room.array.columns) = (rows, columns);
    room.budget.noise.variance_a2 = Some([4e-15, 6.5e-15, 2e-14, 9e-14][random.next() as usize % 4]);
    room.model()
}

/// The users of a room, the first `blocked` of whom have no line of sight, with or without obstacles.
fn scene_of(random: &mut Random, model: &ChannelModel, positions: &[Vec3], blocked: usize) -> Scene {
    let blockers = if random.next().is_multiple_of(2) { random.blockers(positions) } else { Vec::new() };
    let forced: Vec<bool> = (0..positions.len()).map(|k| k < blocked).collect();
    let mut scene = Scene::new(model, positions.len());
    scene.update(model, positions, &blockers, &forced);
    scene
}

fn spill_of(model: &ChannelModel, scene: &Scene) -> Spill {
    let mut spill = Spill::new(scene.users(), scene.mirrors());
    spill.update(model, scene);
    spill
}

/// Objective of the angles in bit/s by the exact evaluation.
fn value(model: &ChannelModel, scene: &Scene, angles: &MirrorAngles, min_rates: &MinimumRates) -> f64 {
    let mut rates = vec![0.0; scene.users()];
    scene.rates_bps(model, angles, &mut rates);
    let shortfall = |(k, rate): (usize, &f64)| (min_rates.min_rate_bps.get(k).unwrap_or(&0.0) - rate).max(0.0);
    rates.iter().sum::<f64>() - min_rates.qos_penalty * rates.iter().enumerate().map(shortfall).sum::<f64>()
}

/// Values of the angles of policies: solver, decoder with random weights, and all mirrors at one
/// user or between two.
fn policies(random: &mut Random, model: &ChannelModel, scene: &Scene, min_rates: &MinimumRates) -> Vec<f64> {
    let (users, mirrors) = (scene.users(), scene.mirrors());
    let spill = spill_of(model, scene);
    let mut angles = MirrorAngles::flat(mirrors);
    let mut values = vec![value(model, scene, &angles, min_rates)];
    let mut solver = Solver::new(users, mirrors);
    for method in [Method::FixedPoint, Method::Greedy { passes: 3 }] {
        solver.solve(model, scene, min_rates, method, &mut angles);
        values.push(value(model, scene, &angles, min_rates));
    }
    for _ in 0..10 {
        let weights: Vec<f64> = (0..users).map(|_| random.uniform(0.0, 1.0)).collect();
        decode(model, scene, &weights, &mut angles);
        values.push(value(model, scene, &angles, min_rates));
    }
    for point in spill.points() {
        aim_at_point(model, point, &mut angles);
        values.push(value(model, scene, &angles, min_rates));
    }
    values
}

#[test]
fn spilled_gains_are_those_of_the_angles() {
    let mut random = Random::new(1);
    let mut branches = Room::paper().with_panel();
    branches.receiver.branches = angle_diversity();
    branches.receiver.combining = Combining::MaximalRatio;
    let mut several = Room::paper().with_panel();
    several.leds.push(led(1.0, 1.0, 0.1));
    let (mut entries, mut midpoints) = (0, 0);
    for room in [Room::paper(), Room::paper().with_panel(), branches, several] {
        let model = room.model();
        for case in 0..20 {
            let mut positions = clusters(&mut random, &[4, 1, 2]);
            positions[1].z += 0.3;
            positions.push(random.position());
            let mut scene = scene_of(&mut random, &model, &positions, 2);
            if case % 2 == 1 {
                let orientations: Vec<_> = positions.iter().map(|_| random.orientation()).collect();
                scene.update_turned(&model, &positions, &orientations, &[], &vec![false; positions.len()]);
            }
            let spill = spill_of(&model, &scene);
            let mut angles = MirrorAngles::flat(100);
            let mut each = vec![0.0; positions.len() * 100];
            for (index, point) in spill.points().iter().enumerate() {
                let user = (index < positions.len()).then_some(index);
                match user {
                    Some(user) => aim(&model, &scene, &[user; 100], &mut angles),
                    None if model.leds.len() > 1 => continue,
                    None => aim_at_point(&model, point, &mut angles),
                }
                scene.irs_gain_each(&model, &angles, &mut each);
                for mirror in 0..100 {
                    let reached = (0..positions.len()).filter(|k| Some(*k) != user && each[k * 100 + mirror] > 0.0);
                    let mut expected: Vec<_> = reached.map(|k| (k, each[k * 100 + mirror])).collect();
                    let steering = |k: usize| scene.steering_gain()[k * 100 + mirror];
                    if let [(only, gain)] = expected[..]
                        && user.is_none_or(|user| steering(user) == 0.0)
                        && gain <= steering(only)
                    {
                        expected.clear();
                    }
                    let found: Vec<_> = spill.of(index, mirror).iter().map(|entry| (entry.user, entry.gain)).collect();
                    assert_eq!(found, expected, "aim {index}, mirror {mirror}");
                    entries += found.len();
                    midpoints += usize::from(user.is_none() && !found.is_empty());
                }
            }
        }
    }
    assert!(entries > 1000 && midpoints > 1000, "{entries} gains, {midpoints} midpoints");
}

#[test]
fn spilled_gains_are_weighed_by_the_probability_of_a_clear_path() {
    let mut random = Random::new(8);
    let model = panel_room(&mut random, (10, 10));
    let positions = [Vec3::new(0.0, 0.0, 0.85), Vec3::new(0.05, 0.0, 0.85)];
    let mut scene = Scene::new(&model, 2);
    scene.update(&model, &positions, &[], &[false; 2]);
    let certain = spill_of(&model, &scene);
    let factors: Vec<f64> = (0..10).map(|column| 0.1 * f64::from(column)).collect();
    scene.weigh_columns(&model, 1, &factors);
    let weighed = spill_of(&model, &scene);
    for mirror in 0..100 {
        let factor = factors[mirror % 10];
        let expected: Vec<_> =
            certain.of(0, mirror).iter().map(|entry| factor * entry.gain).filter(|gain| *gain > 0.0).collect();
        let found: Vec<_> = weighed.of(0, mirror).iter().map(|entry| entry.gain).collect();
        assert_eq!(found, expected, "mirror {mirror}, received by user 1");
        assert!(
            mirror % 10 == 0 || weighed.of(1, mirror) == certain.of(1, mirror),
            "mirror {mirror}, received by user 0"
        );
    }
    assert!((0..100).any(|mirror| !certain.of(0, mirror).is_empty()));
}

#[test]
fn a_mirror_has_no_shared_aim_outside_its_range() {
    let mut random = Random::new(9);
    let model = panel_room(&mut random, (10, 10));
    let positions = [Vec3::new(0.0, 0.0, 0.85), Vec3::new(0.05, 0.0, 0.85)];
    let mut scene = Scene::new(&model, 2);
    scene.update(&model, &positions, &[], &[false; 2]);
    scene.exclude_mirrors(&[3]);
    let range = -10.0_f64.to_radians()..=10.0_f64.to_radians();
    scene.restrict_to_range(&model, &range, &range);
    let spill = spill_of(&model, &scene);
    let mut left_out = 0;
    for mirror in 0..100 {
        let aimed = (0..2).all(|user| scene.steering_gain()[user * 100 + mirror] > 0.0);
        assert!(aimed || (0..spill.points().len()).all(|aim| spill.of(aim, mirror).is_empty()), "mirror {mirror}");
        left_out += usize::from(!aimed);
    }
    assert!(!spill.is_empty() && left_out > 10, "{left_out} of 100");
}

#[test]
fn no_policy_exceeds_the_oracle_in_rooms_with_close_users() {
    let mut random = Random::new(2);
    let mut largest = 0.0_f64;
    for case in 0..120 {
        let model = panel_room(&mut random, (10, 10));
        let sizes: &[usize] = [&[2][..], &[3, 2], &[5], &[2, 1, 1], &[4, 3], &[1, 2, 2, 1]][case % 6];
        let positions = clusters(&mut random, sizes);
        let scene = scene_of(&mut random, &model, &positions, case / 6 % (positions.len() + 1));
        for min_rates in [MinimumRates::NONE, MINIMUM] {
            let mut angles = MirrorAngles::flat(100);
            let oracle =
                Solver::new(positions.len(), 100).solve(&model, &scene, &min_rates, Method::Oracle, &mut angles);
            let achieved = value(&model, &scene, &angles, &min_rates);
            assert!((achieved - oracle).abs() <= 1e-9 * oracle.abs().max(1e6), "case {case}: {achieved}, {oracle}");
            for policy in policies(&mut random, &model, &scene, &min_rates) {
                assert!(policy <= oracle + 0.001 * oracle.abs(), "case {case}: {policy} above the oracle's {oracle}");
                largest = largest.max(if oracle > 0.0 { policy / oracle } else { 0.0 });
            }
        }
    }
    println!("largest ratio to the oracle: {largest}");
}

#[test]
fn oracle_and_policies_in_rooms_with_close_users_are_bounded_by_exhaustive_search() {
    let mut random = Random::new(3);
    let (mut equal, mut least) = (0, 1.0_f64);
    const CASES: usize = 60;
    for case in 0..CASES {
        let model = panel_room(&mut random, (3, 3));
        let positions = clusters(&mut random, [&[3][..], &[2, 1]][case % 2]);
        let scene = scene_of(&mut random, &model, &positions, case / 2 % 4);
        for min_rates in [MinimumRates::NONE, MINIMUM] {
            let (mut solver, mut angles) = (Solver::new(3, 9), MirrorAngles::flat(9));
            let best = solver.solve_exhaustively(&model, &scene, &min_rates, &mut angles).expect("few assignments");
            let achieved = value(&model, &scene, &angles, &min_rates);
            assert!((achieved - best).abs() <= 1e-9 * best.abs().max(1e6), "case {case}: {achieved}, {best}");
            let oracle = solver.solve(&model, &scene, &min_rates, Method::Oracle, &mut angles);
            for policy in policies(&mut random, &model, &scene, &min_rates).into_iter().chain([oracle]) {
                assert!(policy <= best + 1e-9 * best.abs(), "case {case}: {policy} above {best}");
            }
            equal += usize::from(oracle >= best - 1e-9 * best.abs());
            least = least.min(if best > 0.0 { oracle / best } else { 1.0 });
        }
    }
    println!("the oracle equals exhaustive search in {equal} of {} problems, least ratio {least}", 2 * CASES);
    assert!(equal >= 2 * CASES - 6 && least >= 0.99, "{equal} of {}, {least}", 2 * CASES);
}

#[test]
fn rooms_without_close_users_have_the_same_assignments_with_and_without_spill() {
    let mut random = Random::new(4);
    for case in 0..60 {
        let model = panel_room(&mut random, (10, 10));
        let positions = apart(&mut random);
        let scene = scene_of(&mut random, &model, &positions, case % 5);
        assert!(spill_of(&model, &scene).is_empty(), "case {case}");
        for min_rates in [MinimumRates::NONE, MINIMUM] {
            let problem = Problem::of_scene(&model, &scene, &min_rates);
            let [mut with, mut without] = [Solver::new(4, 100), Solver::new(4, 100)];
            let mut angles = MirrorAngles::flat(100);
            let mut same = |method: Method, of_table: &dyn Fn(&mut Solver) -> Solution| {
                let objective = with.solve(&model, &scene, &min_rates, method, &mut angles);
                assert_eq!(objective, of_table(&mut without).objective_bps, "case {case}, {method:?}");
                assert_eq!(with.served(), without.served(), "case {case}, {method:?}");
            };
            same(Method::FixedPoint, &|solver| solver.fixed_point(&problem));
            same(Method::Greedy { passes: 3 }, &|solver| solver.greedy(&problem, 3));
            same(Method::Oracle, &|solver| solver.oracle(&problem));
        }
    }
}

#[test]
fn the_fixed_point_has_the_aims_of_the_decoder_for_its_weights() {
    let mut random = Random::new(5);
    for case in 0..40 {
        let model = panel_room(&mut random, (10, 10));
        let positions = clusters(&mut random, &[3, 1, 2]);
        let scene = scene_of(&mut random, &model, &positions, case % 7);
        let (mut solver, mut angles) = (Solver::new(6, 100), MirrorAngles::flat(100));
        solver.solve(&model, &scene, &MinimumRates::NONE, Method::FixedPoint, &mut angles);
        let mut decoded = MirrorAngles::flat(100);
        decode(&model, &scene, solver.weights(), &mut decoded);
        assert_eq!(angles, decoded, "case {case}");
    }
}

#[test]
fn one_aim_serves_two_users_side_by_side() {
    let mut random = Random::new(6);
    let model = panel_room(&mut random, (10, 10));
    let positions = [Vec3::new(0.0, 0.0, 0.85), Vec3::new(0.1, 0.0, 0.85)];
    let mut scene = Scene::new(&model, 2);
    scene.update(&model, &positions, &[], &[true, true]);
    let (mut solver, mut angles) = (Solver::new(2, 100), MirrorAngles::flat(100));
    let sharing = solver.solve(&model, &scene, &MinimumRates::NONE, Method::Oracle, &mut angles);
    let dividing = solver.oracle(&Problem::of_scene(&model, &scene, &MinimumRates::NONE)).objective_bps;
    assert!(sharing > 1.2 * dividing, "{sharing} and {dividing} bit/s");
}

#[test]
fn policies_follow_users_who_meet_part_come_and_leave() {
    let mut random = Random::new(7);
    let model = panel_room(&mut random, (6, 6));
    let (mut scene, mut angles) = (Scene::new(&model, 8), MirrorAngles::flat(36));
    let mut solver = Solver::with_capacity(5, 8, 36);
    let mut users = 5;
    for step in 0..200 {
        if step % 3 == 0 {
            let before = users;
            users = 1 + random.next() as usize % 8;
            let former: Vec<_> = (0..users).map(|k| Some((k + 1) % 8).filter(|index| *index < before)).collect();
            solver.change_users(&former);
        }
        let positions: Vec<_> = clusters(&mut random, &[3, 2, 3])[..users].to_vec();
        scene.resize(users);
        scene.update(&model, &positions, &[], &[step % 2 == 0; 8][..users]);
        let greedy = solver.solve(&model, &scene, &MinimumRates::NONE, Method::Greedy { passes: 1 }, &mut angles);
        let achieved = value(&model, &scene, &angles, &MinimumRates::NONE);
        assert!((achieved - greedy).abs() <= 1e-9 * greedy.abs(), "step {step}: {achieved}, {greedy}");
        let oracle = solver.solve(&model, &scene, &MinimumRates::NONE, Method::Oracle, &mut angles);
        let fresh = Solver::new(users, 36).solve(&model, &scene, &MinimumRates::NONE, Method::Oracle, &mut angles);
        assert_eq!(oracle, fresh, "step {step}: the oracle depends on what was solved before");
    }
}
