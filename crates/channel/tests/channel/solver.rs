//! The solver of assignments: exhaustive search, simple methods, and limiting cases.

use crate::common::{Random, Room};
use heliostat_channel::decode::{aim_at_point, decode};
use heliostat_channel::{
    ChannelModel, Method, MinimumRates, MirrorAngles, Problem, Scene, Solution, Solver, SolverError,
};

/// Noise variances of the rooms of these tests, in A2.
const NOISE_A2: [f64; 4] = [4e-15, 6.5e-15, 2e-14, 9e-14];

/// A room with rows x columns mirrors and users from the stationary distribution; the first
/// `blocked` have no line of sight.
struct State {
    model: ChannelModel,
    scene: Scene,
    min_rate_bps: Vec<f64>,
}

impl State {
    fn new(random: &mut Random, users: usize, (rows, columns): (usize, usize), blocked: usize, noise_a2: f64) -> Self {
        let mut room = Room::paper();
        (room.array.rows, room.array.columns) = (rows, columns);
        room.budget.noise.variance_a2 = Some(noise_a2);
        let model = room.model();
        let mut scene = Scene::new(&model, users);
        let positions: Vec<_> = (0..users).map(|_| random.walker()).collect();
        let forced: Vec<bool> = (0..users).map(|k| k < blocked).collect();
        scene.update(&model, &positions, &[], &forced);
        Self { model, scene, min_rate_bps: vec![1e6; users] }
    }

    fn problem(&self, qos_penalty: f64) -> Problem<'_> {
        Problem::of_scene(&self.model, &self.scene, &MinimumRates { min_rate_bps: &self.min_rate_bps, qos_penalty })
    }
}

/// The objective of an assignment in bit/s, by its definition.
fn objective(problem: &Problem, served: &[usize]) -> f64 {
    let mut gain = problem.los_gain.to_vec();
    for (m, &k) in served.iter().enumerate() {
        gain[k] += problem.steering_gain[k * problem.mirrors + m];
    }
    (0..problem.users)
        .map(|k| {
            let amplitude = problem.amplitude_scale * gain[k];
            let rate = problem.rate_scale_bps * (1.0 + amplitude * amplitude).log2();
            rate - problem.qos_penalty * (problem.min_rate_bps[k] - rate).max(0.0)
        })
        .sum()
}

fn solver_for(problem: &Problem) -> Solver {
    Solver::new(problem.users, problem.mirrors)
}

fn assert_same(found: f64, expected: f64, relative: f64, case: &str) {
    assert!((found - expected).abs() <= relative * expected.abs(), "{case}: {found} instead of {expected}");
}

#[test]
fn oracle_equals_brute_force_with_nine_mirrors_and_three_users() {
    let mut random = Random::new(9);
    for case in 0..120 {
        let blocked = case % 4;
        let state = State::new(&mut random, 3, (3, 3), blocked, NOISE_A2[(case / 4) % 4]);
        for qos_penalty in [0.0, 50.0] {
            let problem = state.problem(qos_penalty);
            let mut solver = solver_for(&problem);
            let expected = solver.exhaustive(&problem).expect("3^9 assignments can be tried").objective_bps;
            assert_same(
                expected,
                objective(&problem, solver.served()),
                1e-9,
                "exhaustive search against the definition",
            );
            let found = solver.oracle(&problem).objective_bps;
            assert_same(found, expected, 1e-9, &format!("case {case}, {blocked} blocked, penalty {qos_penalty}"));
        }
    }
}

#[test]
fn exhaustive_search_equals_enumeration() {
    let mut random = Random::new(10);
    for blocked in 0..3 {
        let state = State::new(&mut random, 3, (2, 3), blocked, 2e-14);
        let problem = state.problem(50.0);
        let best = (0..3_usize.pow(6))
            .map(|code| {
                let served: Vec<usize> = (0..6).map(|m| code / 3_usize.pow(m) % 3).collect();
                objective(&problem, &served)
            })
            .fold(f64::NEG_INFINITY, f64::max);
        let found = solver_for(&problem).exhaustive(&problem).expect("3^6 assignments can be tried");
        assert_same(found.objective_bps, best, 1e-12, "counting");
    }
}

#[test]
fn oracle_is_at_least_as_good_as_every_other_method() {
    let mut random = Random::new(11);
    for case in 0..200 {
        let users = 1 + case % 7;
        let blocked = (random.next() % (users as u64 + 1)) as usize;
        let state = State::new(&mut random, users, (5, 6), blocked, NOISE_A2[(case / 7) % 4]);
        for qos_penalty in [0.0, 50.0] {
            let problem = state.problem(qos_penalty);
            let mut solver = solver_for(&problem);
            let mut others = vec![
                ("fixed point", solver.fixed_point(&problem).objective_bps),
                ("greedy", solver.greedy(&problem, 3).objective_bps),
                ("nearest", objective(&problem, &nearest(&problem))),
            ];
            for _ in 0..20 {
                let served: Vec<usize> = (0..30).map(|_| (random.next() % users as u64) as usize).collect();
                others.push(("random", objective(&problem, &served)));
            }
            let oracle = solver.oracle(&problem);
            assert_same(oracle.objective_bps, objective(&problem, solver.served()), 1e-9, "definition");
            for (name, value) in others {
                let allowed = 1e-9 * value.abs();
                assert!(
                    oracle.objective_bps >= value - allowed,
                    "case {case}, {users} users, {blocked} blocked, penalty {qos_penalty}: {name} has {value}, the oracle {}",
                    oracle.objective_bps
                );
            }
        }
    }
}

fn nearest(problem: &Problem) -> Vec<usize> {
    let gain = |k: usize, m: usize| problem.steering_gain[k * problem.mirrors + m];
    (0..problem.mirrors)
        .map(|m| (0..problem.users).max_by(|&a, &b| gain(a, m).total_cmp(&gain(b, m))).expect("there is a user"))
        .collect()
}

/// Sum rate of the angles in bit/s by the exact evaluation.
fn true_sum_rate(model: &ChannelModel, scene: &Scene, angles: &MirrorAngles) -> f64 {
    let mut rates = vec![0.0; scene.users()];
    scene.rates_bps(model, angles, &mut rates);
    rates.iter().sum()
}

#[test]
fn no_policy_exceeds_the_oracle() {
    let mut random = Random::new(15);
    const STATES: usize = 300;
    let (mut largest, mut sum) = (0.0_f64, 0.0);
    for case in 0..STATES {
        let users = 1 + case % 6;
        let mut room = Room::paper().with_panel();
        room.budget.noise.variance_a2 = Some(NOISE_A2[(case / 6) % 4]);
        let model = room.model();
        let mut scene = Scene::new(&model, users);
        let positions: Vec<_> = (0..users).map(|_| random.walker()).collect();
        let blockers = random.blockers(&positions);
        let forced: Vec<bool> = (0..users).map(|k| k < case / 24 % (users + 1)).collect();
        scene.update(&model, &positions, &blockers, &forced);
        let mut solver = Solver::new(users, 100);
        let mut solve = |method| {
            let mut angles = MirrorAngles::flat(100);
            solver.solve(&model, &scene, &MinimumRates::NONE, method, &mut angles);
            true_sum_rate(&model, &scene, &angles)
        };
        let oracle = solve(Method::Oracle);
        let mut others = vec![solve(Method::FixedPoint), solve(Method::Greedy { passes: 3 })];
        let mut angles = MirrorAngles::flat(100);
        others.push(true_sum_rate(&model, &scene, &angles));
        for _ in 0..10 {
            let weights: Vec<f64> = (0..users).map(|_| random.uniform(0.0, 1.0)).collect();
            decode(&model, &scene, &weights, &mut angles);
            others.push(true_sum_rate(&model, &scene, &angles));
        }
        for position in &positions {
            aim_at_point(&model, position, &mut angles);
            others.push(true_sum_rate(&model, &scene, &angles));
        }
        let best = others.iter().copied().fold(0.0, f64::max);
        let ratio = if best > 0.0 { best / oracle } else { 1.0 };
        assert!(ratio <= 1.001, "case {case}: {ratio}");
        (largest, sum) = (largest.max(ratio), sum + ratio);
    }
    println!("best policy over oracle: mean {:.5}, largest {largest:.5}", sum / STATES as f64);
}

#[test]
fn no_single_move_and_no_swap_improves_the_oracle() {
    let mut random = Random::new(12);
    for case in 0..12 {
        let state = State::new(&mut random, 4, (5, 5), case % 5, NOISE_A2[case % 4]);
        let problem = state.problem(if case % 2 == 0 { 0.0 } else { 50.0 });
        let mut solver = solver_for(&problem);
        let best = solver.oracle(&problem).objective_bps;
        let served = solver.served().to_vec();
        for m in 0..25 {
            for k in 0..4 {
                let mut other = served.clone();
                other[m] = k;
                assert!(objective(&problem, &other) <= best + 1e-9 * best.abs(), "case {case}: mirror {m} to user {k}");
            }
            for n in 0..m {
                let mut other = served.clone();
                other.swap(m, n);
                assert!(objective(&problem, &other) <= best + 1e-9 * best.abs(), "case {case}: swap of {m} and {n}");
            }
        }
    }
}

#[test]
fn more_mirrors_are_never_worse() {
    let mut random = Random::new(13);
    for case in 0..20 {
        let state = State::new(&mut random, 4, (6, 6), case % 5, NOISE_A2[case % 4]);
        let complete = state.problem(0.0);
        let mut before = 0.0;
        for mirrors in [1, 2, 5, 9, 16, 25, 36] {
            let steering: Vec<f64> =
                complete.steering_gain.chunks(36).flat_map(|line| line[..mirrors].to_vec()).collect();
            let problem = Problem { mirrors, steering_gain: &steering, ..complete };
            let found = solver_for(&problem).oracle(&problem).objective_bps;
            assert!(found >= before, "case {case}: {mirrors} mirrors give {found}, fewer {before}");
            before = found;
        }
    }
}

#[test]
fn the_oracle_depends_on_its_problem_only_and_results_are_finite() {
    let mut random = Random::new(14);
    let mut used = Solver::new(5, 20);
    for case in 0..200 {
        let mut los: Vec<f64> = (0..5).map(|_| spoiled(&mut random, 1e-6)).collect();
        let steering: Vec<f64> = (0..100).map(|_| spoiled(&mut random, 5e-8)).collect();
        if case % 10 == 0 {
            los.fill(0.0);
        }
        let problem = Problem {
            users: 5,
            mirrors: 20,
            los_gain: &los,
            steering_gain: &steering,
            directions: None,
            spill: None,
            amplitude_scale: 5e6,
            rate_scale_bps: 4e6,
            min_rate_bps: &[1e6, 0.0, 3e7],
            qos_penalty: if case % 2 == 0 { 0.0 } else { 50.0 },
        };
        for solution in [used.fixed_point(&problem), used.greedy(&problem, 3), used.oracle(&problem)] {
            assert!(solution.objective_bps.is_finite() && solution.sum_rate_bps.is_finite(), "case {case}");
        }
        assert!(used.weights().iter().all(|weight| weight.is_finite() && *weight >= 0.0), "case {case}");
        assert!(used.served().iter().all(|&k| k < 5));
        let fresh = Solver::new(5, 20).oracle(&problem);
        assert_eq!(used.oracle(&problem), fresh, "case {case}: the oracle depends on what was solved before");
    }
}

/// A gain that is often zero and sometimes not a valid gain.
fn spoiled(random: &mut Random, size: f64) -> f64 {
    match random.next() % 20 {
        0..6 => 0.0,
        6 => f64::NAN,
        7 => f64::INFINITY,
        8 => -size,
        9 => 1e300,
        _ => random.uniform(0.0, size),
    }
}

#[test]
fn one_user_gets_every_mirror_and_one_mirror_goes_to_one_user() {
    let mut random = Random::new(15);
    let state = State::new(&mut random, 1, (4, 4), 1, 6.5e-15);
    let problem = state.problem(50.0);
    let mut solver = solver_for(&problem);
    let all = objective(&problem, &[0; 16]);
    for solution in [solver.fixed_point(&problem), solver.greedy(&problem, 1), solver.oracle(&problem)] {
        assert_same(solution.objective_bps, all, 1e-12, "one user");
    }
    let state = State::new(&mut random, 6, (1, 1), 3, 6.5e-15);
    let problem = state.problem(0.0);
    let best = (0..6).map(|k| objective(&problem, &[k])).fold(0.0, f64::max);
    assert_same(solver_for(&problem).greedy(&problem, 1).objective_bps, best, 1e-12, "one mirror");
    assert_same(solver_for(&problem).oracle(&problem).objective_bps, best, 1e-12, "one mirror");
}

#[test]
fn users_that_no_mirror_reaches_get_no_mirror() {
    let mut random = Random::new(16);
    let state = State::new(&mut random, 4, (5, 5), 2, 6.5e-15);
    let complete = state.problem(0.0);
    let mut steering = complete.steering_gain.to_vec();
    steering[..25].fill(0.0);
    let problem = Problem { steering_gain: &steering, ..complete };
    let mut solver = solver_for(&problem);
    solver.oracle(&problem);
    assert!(solver.served().iter().all(|&k| k != 0), "a mirror serves a user that it does not reach");
    let nothing = vec![0.0; 100];
    let problem = Problem { steering_gain: &nothing, ..complete };
    let direct = objective(&problem, &[0; 25]);
    for solution in [solver.fixed_point(&problem), solver.greedy(&problem, 1), solver.oracle(&problem)] {
        assert_same(solution.objective_bps, direct, 1e-12, "no gain anywhere");
    }
}

#[test]
fn a_feasible_minimum_rate_is_met() {
    let mut random = Random::new(17);
    let mut plain_met = 0;
    for _ in 0..20 {
        let state = State::new(&mut random, 5, (10, 10), 5, 6.5e-15);
        // The penalty is 50 per missing bit/s; one mirror can leave 1 % of the minimum rate unmet.
        let minimum_met = |solution: Solution| solution.sum_rate_bps - solution.objective_bps < 50.0 * 1e4;
        let problem = state.problem(50.0);
        let with_minimum = solver_for(&problem).oracle(&problem);
        assert!(
            minimum_met(with_minimum),
            "five blocked users can all have 1 Mbit/s from 100 mirrors: {with_minimum:?}"
        );
        let plain = solver_for(&problem).oracle(&state.problem(0.0));
        assert!(plain.sum_rate_bps >= with_minimum.sum_rate_bps, "a minimum rate cannot raise the sum rate");
        plain_met += usize::from(plain.sum_rate_bps - with_minimum.sum_rate_bps < 1.0);
    }
    assert!(plain_met < 20, "without minimum rates some user is not served in some states");
}

#[test]
fn too_large_a_search_is_refused() {
    let mut random = Random::new(18);
    let state = State::new(&mut random, 3, (10, 10), 0, 4e-15);
    let problem = state.problem(0.0);
    let refused = solver_for(&problem).exhaustive(&problem).expect_err("3^100 assignments");
    assert!(matches!(refused, SolverError::TooMany { users: 3, mirrors: 100, .. }), "{refused}");
}

#[test]
fn many_users_and_many_mirrors() {
    let mut random = Random::new(19);
    for (users, side, blocked) in [(10, 10, 10), (30, 7, 12), (50, 10, 25), (5, 64, 5)] {
        let state = State::new(&mut random, users, (side, side), blocked, 6.5e-15);
        let problem = state.problem(0.0);
        let mut solver = solver_for(&problem);
        let fixed = solver.fixed_point(&problem).objective_bps;
        let greedy = solver.greedy(&problem, 3).objective_bps;
        assert!(greedy >= fixed, "{users} users: {greedy} below {fixed}");
        if side < 64 {
            let oracle = solver.oracle(&problem).objective_bps;
            assert!(oracle >= greedy, "{users} users: {oracle} below {greedy}");
        }
    }
}

#[test]
fn a_solver_whose_users_change_equals_a_new_one() {
    let mut random = Random::new(77);
    let mut solver = Solver::with_capacity(2, 12, 9);
    for users in [2, 5, 1, 12, 3, 7] {
        let state = State::new(&mut random, users, (3, 3), users / 2, NOISE_A2[1]);
        let problem = state.problem(50.0);
        solver.set_users(users);
        let mut fresh = solver_for(&problem);
        assert_eq!(solver.fixed_point(&problem), fresh.fixed_point(&problem), "{users} users");
        assert_eq!((solver.served(), solver.weights()), (fresh.served(), fresh.weights()), "{users} users");
        assert_eq!(solver.oracle(&problem), fresh.oracle(&problem), "{users} users");
    }
}

#[test]
fn the_weights_of_the_last_solution_stay_with_their_users() {
    let mut random = Random::new(78);
    let state = State::new(&mut random, 4, (3, 3), 2, NOISE_A2[1]);
    let mut solver = Solver::with_capacity(4, 6, 9);
    solver.greedy(&state.problem(50.0), 3);
    let (weights, served) = (solver.weights().to_vec(), solver.served().to_vec());
    solver.change_users(&[Some(3), None, Some(1), None, Some(0)]);
    assert_eq!(solver.weights(), [weights[3], 0.0, weights[1], 0.0, weights[0]]);
    let now_at = |user: &usize| [4, 2, 0, 0][*user];
    assert_eq!(solver.served(), served.iter().map(now_at).collect::<Vec<_>>());
}
