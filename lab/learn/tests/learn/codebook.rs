//! Learners that choose among the codewords of a codebook: file and learner, the upper bound, and
//! learning.

use heliostat_channel::MirrorAngles;
use heliostat_core::observation::USERS_CAPACITY;
use heliostat_core::policy::actor_file::{ActorFile, room_entries};
use heliostat_core::policy::{Actor as Served, Policy};
use heliostat_core::safety::Limits;
use heliostat_learn::environment::codebook::{Codebook, objective_bps};
use heliostat_learn::environment::target_user::TargetUser;
use heliostat_learn::environment::{Environment, Rooms};
use heliostat_learn::evaluation::HeldOut;
use heliostat_learn::learners::{dql, q_learning, sarsa};
use heliostat_learn::networks::on_one_thread;
use heliostat_learn::training::{Algorithm, Preset, Training};
use heliostat_scenario::Scenario;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const ALGORITHMS: [Algorithm; 3] = [dql::ALGORITHM, q_learning::ALGORITHM, sarsa::ALGORITHM];
const OBSERVATIONS: usize = 500;

/// Few mirrors, for short run times.
fn small(name: &str, overrides: &[&str]) -> Scenario {
    let all = [&["mirrors.rows=4", "mirrors.columns=4"], overrides].concat();
    Scenario::builtin(name).and_then(|scenario| scenario.with_overrides(&all)).expect("a valid scenario")
}

fn trained(algorithm: Algorithm, scenario: &Scenario, options: &[&str]) -> Training {
    let options: Vec<String> = options.iter().map(|&text| text.into()).collect();
    let mut training = algorithm.begin(scenario.clone(), Preset::Tuned, &options).expect("a valid run");
    while training.episodes_done() < training.run().episodes {
        training.run_episode().expect("an episode");
    }
    training
}

fn served(training: &Training) -> Served {
    let scenario = training.scenario();
    let bytes = training.export(&room_entries(scenario, USERS_CAPACITY)).expect("a file");
    let file = ActorFile { origin: "the exported actor".into(), bytes: bytes.into() };
    heliostat_models::load_actor(&file, scenario).expect("the engine takes the graph")
}

/// Whether the benefits of two users are so close that rounding may order them either way.
fn near_tie(target_user: &TargetUser, vector: &[f32]) -> bool {
    let mut benefits: Vec<f32> = target_user.benefits(vector).collect();
    benefits.sort_by(|a, b| b.total_cmp(a));
    benefits[0] > 0.0 && benefits[0] - benefits[1] < 1e-5 * benefits[0]
}

/// Number of rooms in which the served policy gives other angles than the learner, near ties
/// excepted.
fn differences(training: &Training) -> usize {
    let (scenario, mut served) = (training.scenario(), served(training));
    let (target_user, mut rng) = (TargetUser::of(scenario), ChaCha8Rng::seed_from_u64(11));
    let mut got = MirrorAngles::flat(scenario.mirror_count());
    let differs = (0..OBSERVATIONS).filter(|_| {
        let room = Rooms::Randomised.draw(scenario, &mut rng);
        let environment = Environment::new(&room, None, rng.random()).expect("a valid room");
        let expected = training.act(&environment).expect("angles");
        served.act(environment.model(), environment.observation(), &mut got).expect("angles");
        let pairs = expected.roll.iter().chain(&expected.yaw).zip(got.roll.iter().chain(&got.yaw));
        let difference = pairs.map(|(expected, got)| (expected - got).abs()).fold(0.0, f64::max);
        difference > 1e-6 && !near_tie(&target_user, environment.vector())
    });
    differs.count()
}

#[test]
fn the_file_gives_the_learners_angles() {
    on_one_thread(files_give_the_learners_angles).expect("a thread");
}

fn files_give_the_learners_angles() {
    for name in ["specular", "paper-calibrated"] {
        for algorithm in ALGORITHMS {
            let training = trained(algorithm, &small(name, &[]), &["episodes=12", "steps=40", "exploration.end=0.5"]);
            let differences = differences(&training);
            // A network may also give two codewords the same value.
            let allowed = if algorithm.name == "dql" { OBSERVATIONS / 200 } else { 0 };
            assert!(differences <= allowed, "{} in {name}: {differences} of {OBSERVATIONS} differ", algorithm.name);
        }
    }
}

#[test]
fn every_angle_is_within_range() {
    for (name, count) in [("specular", 144), ("paper", 25), ("paper-calibrated", 25)] {
        for range in ["90", "20"] {
            let scenario = small(name, &[&format!("control.range_deg={range}")]);
            let (codebook, limit) = (Codebook::of(&scenario).expect("a codebook"), Limits::new(&scenario.control));
            assert_eq!((codebook.codewords().len(), codebook.coordinates().len()), (count, count), "{name}");
            for codeword in codebook.codewords() {
                let mut angles = codeword.roll.iter().chain(&codeword.yaw);
                assert!(angles.all(|angle| angle.abs() <= limit.range_rad()), "{name}");
            }
        }
    }
}

#[test]
fn no_policy_of_a_codebook_is_above_its_ceiling() {
    on_one_thread(no_policy_is_above_the_ceiling).expect("a thread");
}

fn no_policy_is_above_the_ceiling() {
    for name in ["specular", "paper-calibrated"] {
        let scenario = small(name, &["blockage.forced_users=2"]);
        let trainings = ALGORITHMS.map(|algorithm| trained(algorithm, &scenario, &["episodes=8"]));
        for seed in 0..25 {
            let environment = Environment::new(&scenario, None, seed).expect("a valid room");
            let (model, seen) = (environment.model(), environment.observation());
            let mut rates = vec![0.0; seen.users()];
            let mut objective = |angles: &MirrorAngles| {
                seen.scene.rates_bps(model, angles, &mut rates);
                objective_bps(&rates, &seen.min_rate_bps)
            };
            for training in &trainings {
                let best = objective(&training.learner().best_action(&environment).expect("a codebook"));
                let own = objective(&training.act(&environment).expect("angles"));
                assert!(own <= best, "{name}, room {seed}: {own} above {best}");
            }
        }
    }
}

/// One user in shadow: the best codeword aims at this user, and every learner finds it far more
/// often than by chance.
#[test]
fn a_learner_aims_at_the_user_in_shadow() {
    on_one_thread(aims_at_the_user_in_shadow).expect("a thread");
}

fn aims_at_the_user_in_shadow() {
    let scenario = small("specular", &["users.count=1", "blockage.forced_users=1", "blockage.bodies=false"]);
    let mut held_out = HeldOut::default();
    held_out.add(&scenario, 40).expect("held-out states");
    for algorithm in ALGORITHMS {
        let fresh = algorithm.begin(scenario.clone(), Preset::Tuned, &[]).expect("a valid run");
        let before = held_out.score(|room| fresh.act(room)).expect("a score").sum_rate_mbps.mean;
        // A table has to visit each of its cells; a network generalises to other states.
        let episodes = if algorithm.name == "dql" { "episodes=200" } else { "episodes=1000" };
        let training = trained(algorithm, &scenario, &["rooms=fixed", episodes, "exploration.end=0.05"]);
        let after = held_out.score(|room| training.act(room)).expect("a score").sum_rate_mbps.mean;
        let best = held_out.upper_bound(|room| training.learner().best_action(room)).expect("a score");
        let best = best.expect("a codebook").sum_rate_mbps.mean;
        assert!(
            after > before + 0.4 * (best - before),
            "{}: {before} before, {after} after, at best {best}",
            algorithm.name
        );
    }
}

/// The target of one uses the codeword that is taken next, that of the other the best codeword.
#[test]
fn sarsa_and_q_learning_learn_different_tables() {
    let scenario = small("paper-calibrated", &[]);
    let file = |algorithm| trained(algorithm, &scenario, &["episodes=15", "steps=60"]).export(&[]).expect("a file");
    assert!(file(q_learning::ALGORITHM) != file(sarsa::ALGORITHM));
}
