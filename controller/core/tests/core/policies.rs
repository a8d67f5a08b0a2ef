//! Every policy that needs no file, on the same room.

use clap::ValueEnum;
use heliostat_channel::{ChannelModel, MirrorAngles, Vec3};
use heliostat_core::{
    observation::{Observation, RoomState},
    policy::PolicyKind,
};
use heliostat_scenario::Scenario;

use crate::support::{build, scenario};

/// Three users of whom the first two have no direct path.
fn observe(scenario: &Scenario) -> (ChannelModel, Observation) {
    let model = scenario.channel_model().unwrap();
    let mut observation = Observation::new(&model, 3);
    observation.set_state(
        &model,
        &RoomState {
            positions: &[Vec3::new(-1.5, 0.5, 0.85), Vec3::new(1.5, 1.0, 0.85), Vec3::new(0.0, -1.0, 0.85)],
            velocities: &[Vec3::zeros(); 3],
            min_rate_bps: &[1e6; 3],
            forced: &[true, true, false],
            ..RoomState::default()
        },
    );
    (model, observation)
}

/// The answer of a policy to them.
fn answer(kind: PolicyKind, scenario: &Scenario) -> (ChannelModel, Observation, MirrorAngles) {
    let (model, observation) = observe(scenario);
    let mut angles = MirrorAngles::flat(scenario.mirror_count());
    build(kind, scenario).unwrap().act(&model, &observation, &mut angles).unwrap();
    (model, observation, angles)
}

fn sum_rate(kind: PolicyKind, scenario: &Scenario) -> f64 {
    let (model, observation, angles) = answer(kind, scenario);
    let mut rates = [0.0; 3];
    observation.scene.rates_bps(&model, &angles, &mut rates);
    rates.iter().sum()
}

fn large(overrides: &[&str]) -> Scenario {
    scenario(&[&["mirrors.rows=10", "mirrors.columns=10"], overrides].concat())
}

#[test]
fn every_policy_gives_finite_angles_in_every_mode() {
    for mode in ["specular", "paper", "paper-calibrated"] {
        let scenario = scenario(&[&format!("channel.mode={mode}")]);
        let (model, observation) = observe(&scenario);
        let runs = |kind: &&PolicyKind| mode == "specular" || **kind != PolicyKind::Exhaustive;
        for kind in PolicyKind::value_variants().iter().filter(runs) {
            let mut policy = build(*kind, &scenario).unwrap();
            let mut angles = MirrorAngles { roll: vec![f64::NAN; 9], yaw: vec![f64::NAN; 9] };
            policy.act(&model, &observation, &mut angles).unwrap();
            assert!(angles.roll.iter().chain(&angles.yaw).all(|angle| angle.is_finite()), "{mode} {kind:?}");
            assert_eq!(kind.to_possible_value().unwrap().get_name(), policy.name());
        }
    }
}

#[test]
fn the_exhaustive_search_runs_in_small_rooms_and_is_refused_with_advice_elsewhere() {
    let small = scenario(&[]);
    let (best, oracle) = (sum_rate(PolicyKind::Exhaustive, &small), sum_rate(PolicyKind::Oracle, &small));
    assert!((best / oracle - 1.0).abs() < 0.02, "{best} {oracle}");
    for (elsewhere, why) in [(large(&[]), "assignments"), (scenario(&["channel.mode=paper"]), "continuous")] {
        let Err(error) = build(PolicyKind::Exhaustive, &elsewhere) else { panic!("accepted") };
        let text = error.to_string();
        assert!(text.contains(why) && text.contains("policy oracle"), "{text}");
    }
}

#[test]
fn under_the_law_of_reflection_model_based_exceeds_nearest_and_nearest_exceeds_flat() {
    let scenario = large(&[]);
    let rate = |kind| sum_rate(kind, &scenario);
    let (fixed_point, greedy) = (rate(PolicyKind::FixedPoint), rate(PolicyKind::Greedy));
    let (nearest, flat, none) = (rate(PolicyKind::Nearest), rate(PolicyKind::Flat), rate(PolicyKind::NoIrs));
    assert!(greedy >= fixed_point, "{greedy} {fixed_point}");
    assert!(fixed_point > nearest, "{fixed_point} {nearest}");
    assert!(nearest > 1.2 * flat, "{nearest} {flat}");
    assert!(flat >= none, "{flat} {none}");
}

#[test]
fn under_the_papers_equations_policies_have_the_expected_order() {
    let scenario = large(&["channel.mode=paper-calibrated", "channel.gain_scale=85", "noise.variance_a2=2.9e-13"]);
    let rate = |kind| sum_rate(kind, &scenario);
    let (fixed_point, nearest) = (rate(PolicyKind::FixedPoint), rate(PolicyKind::Nearest));
    let (flat, random, none) = (rate(PolicyKind::Flat), rate(PolicyKind::Random), rate(PolicyKind::NoIrs));
    assert!(fixed_point > nearest && fixed_point > flat, "{fixed_point} {nearest} {flat}");
    assert!(flat > random && random > none, "{flat} {random} {none}");
}

#[test]
fn no_irs_reflects_no_light_to_any_user() {
    for mode in ["specular", "paper"] {
        let (model, observation, angles) = answer(PolicyKind::NoIrs, &large(&[&format!("channel.mode={mode}")]));
        let mut gains = [f64::NAN; 3];
        observation.scene.irs_gain(&model, &angles, &mut gains);
        assert_eq!(gains, [0.0; 3], "{mode}");
    }
}

#[test]
fn nearest_serves_the_user_with_the_largest_steering_gain_of_each_mirror() {
    let (model, observation, angles) = answer(PolicyKind::Nearest, &large(&[]));
    let mut gains = vec![0.0; 300];
    observation.scene.irs_gain_each(&model, &angles, &mut gains);
    let steering = observation.scene.steering_gain();
    for mirror in 0..100 {
        let best = (0..3).map(|user| steering[user * 100 + mirror]).fold(0.0, f64::max);
        let given = (0..3).map(|user| gains[user * 100 + mirror]).fold(0.0, f64::max);
        assert!(best > 0.0 && given > 0.9 * best, "mirror {mirror}: {given} of {best}");
    }
}

#[test]
fn random_is_one_draw_by_seed_within_the_range() {
    let draw = |seed: u64| {
        let scenario = large(&["control.range_deg=30", &format!("seed={seed}")]);
        let (model, observation) = observe(&scenario);
        let mut policy = build(PolicyKind::Random, &scenario).unwrap();
        let mut angles = [MirrorAngles::flat(100), MirrorAngles::flat(100)];
        policy.act(&model, &observation, &mut angles[0]).unwrap();
        policy.act(&model, &observation, &mut angles[1]).unwrap();
        assert_eq!(angles[0], angles[1], "held for the run");
        angles[0].clone()
    };
    let angles = draw(1);
    assert!(angles.roll.iter().chain(&angles.yaw).all(|angle| angle.abs() <= 30f64.to_radians()));
    assert!(angles.roll != angles.yaw);
    assert_eq!(angles, draw(1));
    assert!(angles != draw(2));
}

/// Objective of the metaheuristics for the answer to one observation.
fn searched(kind: PolicyKind, overrides: &[&str]) -> (MirrorAngles, f64) {
    let calibrated = ["channel.mode=paper-calibrated", "channel.gain_scale=85", "noise.variance_a2=2.9e-13"];
    let scenario = large(&[&calibrated[..], &["control.search_time_us=0"], overrides].concat());
    let (model, observation, angles) = answer(kind, &scenario);
    let mut rates = [0.0; 3];
    observation.scene.rates_bps(&model, &angles, &mut rates);
    let worth = rates.iter().map(|rate| rate - 50.0 * (1e6 - rate).max(0.0)).sum();
    (angles, worth)
}

#[test]
fn metaheuristics_gain_by_every_trial_and_repeat_by_seed() {
    for kind in [PolicyKind::SineCosine, PolicyKind::Pso] {
        let with = |trials: &str| searched(kind, &[trials]);
        let (start, flat) = with("control.search_evaluations=1");
        assert_eq!(start, MirrorAngles::flat(100), "{kind:?}: the first trial is where the mirrors stand");
        let (few, many) = (with("control.search_evaluations=200"), with("control.search_evaluations=4000"));
        assert!(flat <= few.1 && few.1 < many.1, "{kind:?}: {flat} {} {}", few.1, many.1);
        assert!(many.1 > 1.02 * flat, "{kind:?}: {flat} {}", many.1);
        assert_eq!(few.0, with("control.search_evaluations=200").0, "{kind:?}");
        assert!(few.0 != searched(kind, &["control.search_evaluations=200", "seed=9"]).0 || few.1 == flat, "{kind:?}");
        let (narrow, _) = searched(kind, &["control.search_evaluations=500", "control.range_deg=5"]);
        assert!(narrow.roll.iter().chain(&narrow.yaw).all(|angle| angle.abs() <= 5f64.to_radians()), "{kind:?}");
    }
}

/// However many trials are allowed, time ends the search: an unlimited one would never return.
#[test]
fn a_time_budget_ends_the_search() {
    for kind in [PolicyKind::SineCosine, PolicyKind::Pso] {
        searched(kind, &["control.search_evaluations=100000000", "control.search_time_us=500"]);
    }
}
