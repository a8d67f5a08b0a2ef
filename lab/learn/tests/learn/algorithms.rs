//! Properties of every algorithm: the same seed gives the same actor, a resumed run equals an
//! uninterrupted one, and the exported graph gives the learner's angles.

use clap::ValueEnum;
use heliostat_channel::MirrorAngles;
use heliostat_core::observation::USERS_CAPACITY;
use heliostat_core::policy::actor_file::{ActorFile, room_entries};
use heliostat_core::policy::{Policy, PolicyKind};
use heliostat_learn::environment::{Environment, Rooms};
use heliostat_learn::training::{Algorithm, Preset, Training, checkpoint};
use heliostat_scenario::Scenario;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const EPISODES: usize = 4;

const OBSERVATIONS: usize = 200;

/// Share of the mirrors whose angles may differ: two users or two actions with values equal except
/// for rounding.
const TIES_MAX: f64 = 1e-3;

fn begin(algorithm: Algorithm, mode: &str, seed: u64) -> Training {
    let overrides = ["mirrors.rows=3", "mirrors.columns=4", &format!("seed={seed}")];
    let scenario = Scenario::builtin(mode).and_then(|scenario| scenario.with_overrides(&overrides));
    let mut options = vec![format!("episodes={EPISODES}"), "steps=8".into()];
    options.extend(short(algorithm).iter().map(|option| String::from(*option)));
    algorithm.begin(scenario.expect("a valid scenario"), Preset::Tuned, &options).expect("a valid run")
}

/// Numbers with which a run of a few steps reaches every part of an algorithm.
fn short(algorithm: Algorithm) -> &'static [&'static str] {
    match algorithm.name {
        "ddpg" | "ddpg-raw" => &["warm_up=10", "batch=8", "replay=20"],
        "analytic" => &["batch=3"],
        "dql" => &["warm_up=10", "batch=8", "replay=20", "steps_per_update=2"],
        _ => &[],
    }
}

fn run(training: &mut Training, until: usize) {
    while training.episodes_done() < until {
        training.run_episode().expect("an episode");
    }
}

fn state(training: &mut Training, folder: &tempfile::TempDir) -> Vec<u8> {
    let path = folder.path().join("checkpoint.safetensors");
    checkpoint::save(training, &path).expect("a checkpoint");
    std::fs::read(path).expect("the file")
}

#[test]
fn the_same_seed_gives_the_same_actor_and_another_seed_another() {
    let actor = |algorithm, seed| {
        let mut training = begin(algorithm, "specular", seed);
        run(&mut training, EPISODES);
        training.export(&[]).expect("an actor")
    };
    for algorithm in Algorithm::value_variants() {
        let first = actor(*algorithm, 5);
        assert!(first == actor(*algorithm, 5), "{}", algorithm.name);
        assert!(first != actor(*algorithm, 6), "{}", algorithm.name);
    }
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_run() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for algorithm in Algorithm::value_variants() {
        let name = algorithm.name;
        let mut uninterrupted = begin(*algorithm, "paper-calibrated", 5);
        run(&mut uninterrupted, EPISODES);
        let expected = state(&mut uninterrupted, &folder);
        let mut first = begin(*algorithm, "paper-calibrated", 5);
        run(&mut first, EPISODES / 2);
        assert!(state(&mut first, &folder) != expected, "{name}: the second half must change something");
        let mut second = begin(*algorithm, "paper-calibrated", 5);
        checkpoint::load(&mut second, &folder.path().join("checkpoint.safetensors")).expect("it fits");
        run(&mut second, EPISODES);
        assert!(state(&mut second, &folder) == expected, "{name}");
    }
}

#[test]
fn exported_graphs_give_the_learners_angles() {
    for algorithm in Algorithm::value_variants() {
        for mode in ["specular", "paper-calibrated"] {
            let mut training = begin(*algorithm, mode, 5);
            run(&mut training, EPISODES);
            let scenario = training.scenario().clone();
            let bytes = training.export(&room_entries(&scenario, USERS_CAPACITY)).expect("an actor");
            let file = ActorFile { origin: "the exported actor".into(), bytes: bytes.into() };
            let mut served = heliostat_models::load_actor(&file, &scenario).expect("the engine takes the graph");
            let (mut rng, mut differ) = (ChaCha8Rng::seed_from_u64(11), 0);
            let mut got = MirrorAngles::flat(scenario.mirror_count());
            for _ in 0..OBSERVATIONS {
                let room = Rooms::Randomised.draw(&scenario, &mut rng);
                let environment = Environment::new(&room, None, rng.random()).expect("a valid room");
                let expected = training.act(&environment).expect("angles");
                served.act(environment.model(), environment.observation(), &mut got).expect("angles");
                let pairs =
                    |one: &[f64], other: &[f64]| one.iter().zip(other).map(|(a, b)| (a - b).abs()).collect::<Vec<_>>();
                let (roll, yaw) = (pairs(&expected.roll, &got.roll), pairs(&expected.yaw, &got.yaw));
                differ += roll.iter().zip(&yaw).filter(|(roll, yaw)| roll.max(**yaw) > 1e-5).count();
            }
            let share = differ as f64 / (OBSERVATIONS * scenario.mirror_count()) as f64;
            assert!(share < TIES_MAX, "{} {mode}: {share} of the mirrors differ", algorithm.name);
        }
    }
}

#[test]
fn every_algorithm_trains_the_policy_of_its_name_and_refuses_invalid_options() {
    for algorithm in Algorithm::value_variants() {
        let name = algorithm.to_possible_value().expect("not hidden").get_name().to_owned();
        assert_eq!(algorithm.policy.name(), name);
        assert!(algorithm.policy.is_learned() && algorithm.summary.contains("lab/learn/src/learners/"));
        let scenario = Scenario::builtin("specular").expect("built in");
        let refusal = |options: &[&str]| {
            let options: Vec<String> = options.iter().map(|option| String::from(*option)).collect();
            algorithm.begin(scenario.clone(), Preset::Tuned, &options).err().expect("a refusal").to_string()
        };
        assert!(refusal(&["nonsense=1"]).contains("no such key"), "{name}");
        assert!(refusal(&["step_s=0"]).contains("step_s = 0"), "{name}");
        assert!(refusal(&["steps=0"]).contains("steps = 0: expected"), "{name}");
        assert!(refusal(&["episodes=many"]).contains("episodes=many"), "{name}");
    }
    let learned = PolicyKind::value_variants().iter().filter(|kind| kind.is_learned());
    assert!(learned.count() >= Algorithm::value_variants().len());
}

#[test]
fn a_room_with_several_leds_is_refused_with_how_its_actor_is_trained() {
    let two = "led.positions_m=[[-1.25,0,3],[1.25,0,3]]";
    let scenario = Scenario::builtin("hall").and_then(|hall| hall.with_overrides(&[two])).expect("a valid scenario");
    for algorithm in Algorithm::value_variants() {
        let refused = algorithm.begin(scenario.clone(), Preset::Tuned, &[]).err().expect("a refusal").to_string();
        assert!(refused.contains("led.positions_m lists 2 LEDs: expected 1"), "{refused}");
        let advice = if algorithm.policy.fits_any_array() {
            "--set 'led.positions_m=[[-1.25, 0.0, 3.0]]'"
        } else {
            "in the room of its training only: choose ddpg or analytic"
        };
        assert!(refused.contains(advice), "{}: {refused}", algorithm.name);
    }
    let one =
        scenario.with_overrides(&["led.positions_m=[[-1.25, 0.0, 3.0]]"]).expect("the advice is a valid override");
    assert_eq!(one.led.positions_m, [[-1.25, 0.0, 3.0]]);
}
