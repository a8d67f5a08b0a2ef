//! The solver of normals, the paper's eqs. (2) and (3): random starts and small rotations of
//! single mirrors.

use crate::common::{PAPER, Random, Room};
use heliostat_channel::{ChannelModel, Method, MinimumRates, MirrorAngles, Mode, Problem, Scene, Solver, Vec3};

/// A room with 20 mirrors and users, of whom the first `blocked` have no line of sight.
fn state(random: &mut Random, users: usize, blocked: usize, noise_a2: f64, mode: Mode) -> (ChannelModel, Scene) {
    let mut room = Room::paper().with_mode(mode);
    (room.array.rows, room.array.columns) = (4, 5);
    room.budget.noise.variance_a2 = Some(noise_a2);
    let model = room.model();
    let mut scene = Scene::new(&model, users);
    let positions: Vec<_> = (0..users).map(|_| random.position()).collect();
    let forced: Vec<bool> = (0..users).map(|k| k < blocked).collect();
    scene.update(&model, &positions, &[], &forced);
    (model, scene)
}

/// The objective of the normals in bit/s, by its definition.
fn objective(problem: &Problem, normals: &[Vec3]) -> f64 {
    let directions = problem.directions.expect("a problem of normals");
    (0..problem.users)
        .map(|k| {
            let pairs = (0..problem.mirrors).map(|m| (k * problem.mirrors + m, normals[m]));
            let reflected: f64 = pairs.map(|(i, n)| problem.steering_gain[i] * n.dot(&directions[i]).max(0.0)).sum();
            let amplitude = problem.amplitude_scale * (problem.los_gain[k] + reflected);
            let rate = problem.rate_scale_bps * (1.0 + amplitude * amplitude).log2();
            rate - problem.qos_penalty * (problem.min_rate_bps.get(k).copied().unwrap_or(0.0) - rate).max(0.0)
        })
        .sum()
}

/// A fixed point over the weights from given ones: an independent implementation.
fn climb(problem: &Problem, mut weights: Vec<f64>) -> f64 {
    let directions = problem.directions.expect("a problem of normals");
    let mut best = f64::NEG_INFINITY;
    for _ in 0..60 {
        let normals: Vec<Vec3> = (0..problem.mirrors)
            .map(|m| {
                let index = |k: usize| k * problem.mirrors + m;
                let pulls =
                    (0..problem.users).map(|k| weights[k] * problem.steering_gain[index(k)] * directions[index(k)]);
                pulls.sum::<Vec3>().normalize()
            })
            .collect();
        best = best.max(objective(problem, &normals));
        for (k, weight) in weights.iter_mut().enumerate() {
            let pairs = (0..problem.mirrors).map(|m| (k * problem.mirrors + m, normals[m]));
            let reflected: f64 = pairs.map(|(i, n)| problem.steering_gain[i] * n.dot(&directions[i]).max(0.0)).sum();
            let x = problem.amplitude_scale * (problem.los_gain[k] + reflected);
            *weight = 2.0 * x / (1.0 + x * x);
        }
    }
    best
}

const CASES: [(usize, f64, Mode); 4] = [
    (2, 2.9e-13, Mode::Paper { literal: false, gain_scale: 85.0 }),
    (5, 2.9e-13, Mode::Paper { literal: false, gain_scale: 85.0 }),
    (2, 8.9e-14, PAPER),
    (5, 8.9e-14, PAPER),
];

#[test]
fn oracle_equals_two_thousand_random_starts() {
    let mut random = Random::new(21);
    for (blocked, noise_a2, mode) in CASES {
        let (model, scene) = state(&mut random, 5, blocked, noise_a2, mode);
        let problem = Problem::of_scene(&model, &scene, &MinimumRates::NONE);
        let mut solver = Solver::new(5, 20);
        let oracle = solver.oracle(&problem).objective_bps;
        let defined = objective(&problem, solver.normals());
        assert!((oracle - defined).abs() <= 1e-9 * defined, "{oracle} by the solver, {defined} by the definition");
        let best = (0..2000)
            .map(|_| climb(&problem, (0..5).map(|_| random.uniform(-4.0, 4.0).exp()).collect()))
            .fold(f64::NEG_INFINITY, f64::max);
        assert!((oracle / best - 1.0).abs() <= 1e-6, "{blocked} blocked: oracle {oracle}, random starts {best}");
    }
}

#[test]
fn no_small_turn_of_a_mirror_improves_the_oracle() {
    let mut random = Random::new(22);
    for (blocked, noise_a2, mode) in CASES {
        let (model, scene) = state(&mut random, 5, blocked, noise_a2, mode);
        let problem = Problem::of_scene(&model, &scene, &MinimumRates::NONE);
        let mut solver = Solver::new(5, 20);
        let best = solver.oracle(&problem).objective_bps;
        let normals = solver.normals().to_vec();
        for size in [1e-3, 1e-2, 0.1, 0.5] {
            for _ in 0..500 {
                let mut other = normals.clone();
                let turned = (random.next() % 20) as usize;
                let turn = Vec3::new(random.normal(), random.normal(), random.normal());
                other[turned] = (other[turned] + size * turn).normalize();
                let value = objective(&problem, &other);
                assert!(value <= best * (1.0 + 1e-9), "mirror {turned} turned by {size}: {value} instead of {best}");
            }
        }
    }
}

#[test]
fn oracle_is_at_least_as_good_as_the_policies_and_flat_mirrors() {
    let mut random = Random::new(23);
    for case in 0..80 {
        let users = 1 + case % 7;
        let (_, noise_a2, mode) = CASES[case % 4];
        let (model, scene) = state(&mut random, users, case % (users + 1), noise_a2, mode);
        for qos_penalty in [0.0, 50.0] {
            let min_rates = MinimumRates { min_rate_bps: &vec![1e6; users], qos_penalty };
            let problem = Problem::of_scene(&model, &scene, &min_rates);
            let mut solver = Solver::new(users, 20);
            let cold = solver.fixed_point(&problem).objective_bps;
            let warm = solver.greedy(&problem, 3).objective_bps;
            let flat = objective(&problem, &[Vec3::new(0.0, -1.0, 0.0); 20]);
            let aimed = (0..users).map(|k| {
                let towards = &scene.directions()[k * 20..(k + 1) * 20];
                objective(&problem, towards)
            });
            let other = aimed.fold(cold.max(warm).max(flat), f64::max);
            let oracle = solver.oracle(&problem).objective_bps;
            assert!(
                oracle >= other - 1e-6 * other.abs(),
                "case {case}, {users} users, penalty {qos_penalty}: {oracle} below {other}"
            );
        }
    }
}

#[test]
fn the_angles_give_the_objective_of_the_solution() {
    let mut random = Random::new(24);
    for (blocked, noise_a2, mode) in CASES {
        let (model, scene) = state(&mut random, 5, blocked, noise_a2, mode);
        let mut angles = MirrorAngles { roll: vec![0.0; 20], yaw: vec![0.0; 20] };
        let promised = Solver::new(5, 20).solve(&model, &scene, &MinimumRates::NONE, Method::Oracle, &mut angles);
        let mut rates = vec![0.0; 5];
        scene.rates_bps(&model, &angles, &mut rates);
        let given: f64 = rates.iter().sum();
        assert!((given / promised - 1.0).abs() < 1e-9, "{given} instead of {promised}");
    }
}

#[test]
fn without_reachable_users_the_mirrors_are_flat() {
    let mut random = Random::new(25);
    let (model, scene) = state(&mut random, 3, 3, 8.9e-14, PAPER);
    let nothing = vec![0.0; 60];
    let problem = Problem { steering_gain: &nothing, ..Problem::of_scene(&model, &scene, &MinimumRates::NONE) };
    let mut solver = Solver::new(3, 20);
    for _ in 0..3 {
        assert_eq!(solver.fixed_point(&problem).objective_bps, 0.0);
        assert_eq!(solver.oracle(&problem).objective_bps, 0.0);
        assert!(solver.weights().iter().all(|weight| weight.is_finite()));
    }
    assert!(solver.normals().iter().all(|normal| *normal == Vec3::zeros()));
}
