//! Sum rates of the paper's room, and ratios of the methods to the oracle: the quoted figures.
//!
//! Each is a mean over random states with an uncertainty of 1 to 3 %; that of the quoted figures is
//! 3 to 8 %. The quoted figures of the specular mode omit the light of a mirror for users at whom it is
//! not aimed.

use crate::common::{PAPER, Random, Room};
use heliostat_channel::{ChannelModel, Method, MinimumRates, MirrorAngles, Mode, Problem, Scene, Solver, Vec3};

const USERS: usize = 5;
const CALIBRATED: Mode = Mode::Paper { literal: false, gain_scale: 85.0 };

/// The parameters of one row of the table.
struct Row {
    mode: Mode,
    noise_a2: f64,
    blocked: usize,
    side: usize,
    power_w: f64,
}

impl Row {
    fn specular(noise_a2: f64, blocked: usize) -> Self {
        Self { mode: Mode::Specular, noise_a2, blocked, side: 10, power_w: 2.0 }
    }

    fn calibrated() -> Self {
        Self { mode: CALIBRATED, noise_a2: 2.9e-13, blocked: 2, side: 10, power_w: 2.0 }
    }

    fn model(&self) -> ChannelModel {
        let mut room = if self.mode == Mode::Specular { Room::paper().with_panel() } else { Room::paper() };
        room.mode = self.mode;
        (room.array.rows, room.array.columns) = (self.side, self.side);
        room.budget.noise.variance_a2 = Some(self.noise_a2);
        room.budget.power_w = self.power_w;
        room.model()
    }

    /// Calls `see` with the model and each of `states` scenes.
    fn each(&self, states: usize, mut see: impl FnMut(&ChannelModel, &Scene, &mut Random)) {
        let model = self.model();
        let mut random = Random::new(2024);
        let mut scene = Scene::new(&model, USERS);
        let forced: Vec<bool> = (0..USERS).map(|k| k < self.blocked).collect();
        for _ in 0..states {
            let positions: Vec<_> = (0..USERS).map(|_| walking(&mut random)).collect();
            scene.update(&model, &positions, &[], &forced);
            see(&model, &scene, &mut random);
        }
    }

    /// Mean sum rates in Mbit/s.
    fn means(&self, states: usize, min_rates: &MinimumRates) -> Means {
        let mut means = Means::default();
        self.each(states, |model, scene, random| {
            let mut solver = Solver::new(USERS, model.mirrors.len());
            let mut angles = flat(model);
            means.flat += sum_rate_mbps(model, scene, &angles) / states as f64;
            let direct = scene.los_gain().iter().map(|&gain| model.budget.rate_bps(model.budget.sinr(gain), USERS));
            means.no_irs += direct.sum::<f64>() / 1e6 / states as f64;
            for angle in angles.roll.iter_mut().chain(&mut angles.yaw) {
                *angle = random.uniform(-std::f64::consts::FRAC_PI_2, std::f64::consts::FRAC_PI_2);
            }
            means.random += sum_rate_mbps(model, scene, &angles) / states as f64;
            let without_spill = Problem::of_scene(model, scene, min_rates);
            means.without_spill += solver.oracle(&without_spill).sum_rate_bps / 1e6 / states as f64;
            solver.solve(model, scene, min_rates, Method::Oracle, &mut angles);
            means.oracle += sum_rate_mbps(model, scene, &angles) / states as f64;
        });
        means
    }
}

/// The position at a random time of a random waypoint walk: a point between two uniform waypoints,
/// with a probability proportional to their distance.
fn walking(random: &mut Random) -> Vec3 {
    loop {
        let (from, to) = (random.position(), random.position());
        if (to - from).norm() >= random.uniform(0.0, 50.0_f64.sqrt()) {
            return from + random.uniform(0.0, 1.0) * (to - from);
        }
    }
}

#[derive(Debug, Default)]
struct Means {
    no_irs: f64,
    random: f64,
    flat: f64,
    /// By the table of gains, in which each mirror reaches the user at whom it is aimed only.
    without_spill: f64,
    oracle: f64,
}

fn flat(model: &ChannelModel) -> MirrorAngles {
    MirrorAngles { roll: vec![0.0; model.mirrors.len()], yaw: vec![0.0; model.mirrors.len()] }
}

fn sum_rate_mbps(model: &ChannelModel, scene: &Scene, angles: &MirrorAngles) -> f64 {
    let mut rates = vec![0.0; USERS];
    scene.rates_bps(model, angles, &mut rates);
    rates.iter().sum::<f64>() / 1e6
}

fn assert_near(found: f64, quoted: f64, relative: f64, what: &str) {
    println!("{what}: {found:.2} (quoted {quoted})");
    assert!((found - quoted).abs() <= relative * quoted, "{what}: {found:.2} instead of {quoted}");
}

#[test]
fn specular_sum_rates() {
    let quoted = [
        (4e-15, 0, 80.4, 118.5),
        (4e-15, 2, 47.4, 105.6),
        (6.5e-15, 2, 40.0, 92.6),
        (6.5e-15, 5, 0.0, 63.1),
        (2e-14, 2, 24.8, 65.2),
        (9e-14, 2, 10.4, 36.7),
    ];
    for (noise_a2, blocked, no_irs, oracle) in quoted {
        let means = Row::specular(noise_a2, blocked).means(300, &MinimumRates::NONE);
        let what = format!("specular, noise {noise_a2:e} A2, {blocked} blocked");
        assert_near(means.no_irs, no_irs, 0.10, &format!("{what}, no IRS"));
        assert_near(means.without_spill, oracle, 0.05, &format!("{what}, oracle without spill"));
        println!("{what}, oracle: {:.2}", means.oracle);
        assert!(means.oracle > means.without_spill, "{what}: close users can share mirrors: {means:?}");
        assert!((means.random - means.no_irs).abs() <= 0.3, "{what}: random mirrors reach almost no user: {means:?}");
    }
}

#[test]
fn specular_sum_rate_with_minimum_rates() {
    let min_rates = MinimumRates { min_rate_bps: &[1e6; USERS], qos_penalty: 50.0 };
    let means = Row::specular(9e-14, 2).means(200, &min_rates);
    assert_near(means.without_spill, 33.6, 0.05, "specular, noise 9e-14 A2, 2 blocked, 1 Mbit/s for each");
}

#[test]
fn paper_calibrated_sum_rates() {
    let means = Row::calibrated().means(400, &MinimumRates::NONE);
    assert_near(means.no_irs, 3.9, 0.08, "paper-calibrated, no IRS");
    assert_near(means.random, 10.0, 0.08, "paper-calibrated, random");
    assert_near(means.flat, 14.8, 0.05, "paper-calibrated, flat");
    assert_near(means.oracle, 19.7, 0.05, "paper-calibrated, optimum");

    let means = Row { side: 7, ..Row::calibrated() }.means(400, &MinimumRates::NONE);
    assert_near(means.random, 7.0, 0.08, "paper-calibrated, 49 mirrors, random");
    assert_near(means.oracle, 12.6, 0.08, "paper-calibrated, 49 mirrors, optimum");

    // These two rows are quoted from few states as 5.6 and 11.9, 7.6 and 16.3; the means over 4000
    // states stand here.
    let means = Row { power_w: 1.0, ..Row::calibrated() }.means(400, &MinimumRates::NONE);
    assert_near(means.random, 6.1, 0.05, "paper-calibrated, 1 W, random");
    assert_near(means.oracle, 13.4, 0.05, "paper-calibrated, 1 W, optimum");

    let means = Row { blocked: 3, ..Row::calibrated() }.means(400, &MinimumRates::NONE);
    assert_near(means.random, 8.4, 0.05, "paper-calibrated, 3 blocked, random");
    assert_near(means.oracle, 18.1, 0.05, "paper-calibrated, 3 blocked, optimum");
}

#[test]
fn paper_sum_rates() {
    let row = Row { mode: PAPER, noise_a2: 8.9e-14, ..Row::calibrated() };
    let means = row.means(400, &MinimumRates::NONE);
    assert_near(means.random, 10.0, 0.08, "paper, 2 blocked, random");
    assert_near(means.oracle / means.random, 1.014, 0.005, "paper, 2 blocked, optimum over random");
    let means = Row { blocked: 5, ..row }.means(400, &MinimumRates::NONE);
    // Quoted as +160 %: of the gain. At so small an SNR a rate goes with the square of the gain.
    let gain_ratio = (means.oracle / means.random).sqrt();
    assert_near(gain_ratio, 2.6, 0.05, "paper, 5 blocked, gain of the optimum over that of random");
}

/// Mean ratio of each method's true sum rate to the oracle's.
fn ratios(row: &Row, states: usize, methods: &[Method]) -> Vec<f64> {
    let mut ratios = vec![0.0; methods.len()];
    row.each(states, |model, scene, _| {
        let mut angles = flat(model);
        let mirrors = model.mirrors.len();
        Solver::new(USERS, mirrors).solve(model, scene, &MinimumRates::NONE, Method::Oracle, &mut angles);
        let oracle = sum_rate_mbps(model, scene, &angles);
        for (ratio, &method) in ratios.iter_mut().zip(methods) {
            Solver::new(USERS, mirrors).solve(model, scene, &MinimumRates::NONE, method, &mut angles);
            *ratio += sum_rate_mbps(model, scene, &angles) / oracle / states as f64;
        }
    });
    ratios
}

#[test]
fn policies_reach_the_stated_ratio_to_the_oracle() {
    let methods = [Method::FixedPoint, Method::Greedy { passes: 1 }, Method::Greedy { passes: 3 }];
    for (blocked, promised) in [(2, [0.94, 0.994, 0.998]), (5, [0.89, 0.971, 0.98])] {
        let found = ratios(&Row::specular(6.5e-15, blocked), 250, &methods);
        println!("specular, 6.5e-15 A2, {blocked} blocked: {found:.4?}");
        for ((method, found), promised) in methods.iter().zip(found).zip(promised) {
            assert!(found >= promised, "{blocked} blocked, {method:?}: {found:.4} of the oracle, not {promised}");
            assert!(found <= 1.005, "{blocked} blocked, {method:?}: the oracle loses by {found:.4}");
        }
    }
    let found = ratios(&Row::calibrated(), 250, &[Method::FixedPoint]);
    println!("paper-calibrated: {found:.5?}");
    assert!(found[0] >= 0.998 && found[0] <= 1.000_001, "paper-calibrated, fixed point: {found:?}");
}
