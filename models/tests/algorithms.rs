//! What every algorithm promises: the same seed gives the same actor, a resumed run is the run that was not stopped, and the exported
//! graph answers as the trainer does.

use clap::ValueEnum;
use heliostat_channel::MirrorAngles;
use heliostat_decide::observation::{OBSERVATION_VERSION, USERS_CAPACITY};
use heliostat_decide::policy::PolicyKind;
use heliostat_decide::policy::actor_file::{ActorFile, key};
use heliostat_engine::load_actor;
use heliostat_models::algorithm::{Algorithm, Preset};
use heliostat_models::checkpoint;
use heliostat_models::env::{Environment, Rooms};
use heliostat_models::learner::Learner;
use heliostat_scenario::Scenario;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const EPISODES: usize = 4;

const OBSERVATIONS: usize = 200;

/// Angles of this share of the mirrors may differ: two users or two actions whose worth is equal but for rounding.
const TIES_MAX: f64 = 1e-3;

fn begin(algorithm: Algorithm, mode: &str, seed: u64) -> Box<dyn Learner> {
    let overrides = ["mirrors.rows=3", "mirrors.columns=4", &format!("seed={seed}")].map(String::from);
    let scenario = Scenario::builtin(mode).and_then(|scenario| scenario.with_overrides(&overrides));
    let mut options = vec![format!("episodes={EPISODES}"), "steps=8".into()];
    options.extend(short(algorithm).iter().map(|option| String::from(*option)));
    algorithm.begin(scenario.expect("a valid scenario"), Preset::Tuned, &options).expect("a valid run")
}

/// Numbers that let a run of a few steps touch everything.
fn short(algorithm: Algorithm) -> &'static [&'static str] {
    match algorithm {
        Algorithm::Ddpg | Algorithm::DdpgRaw => &["warm_up=10", "batch=8", "replay=20"],
        Algorithm::DdpgBasis => &["warm_up=10", "batch=8", "replay=20", "td3=true", "gamma=0.5"],
        Algorithm::Analytic => &["batch=3"],
        Algorithm::Dql => &["warm_up=10", "batch=8", "replay=20", "steps_per_update=2"],
        Algorithm::QLearning | Algorithm::Sarsa => &[],
    }
}

fn run(learner: &mut dyn Learner, until: usize) {
    while learner.episodes_done() < until {
        learner.run_episode().expect("an episode");
    }
}

fn state(learner: &dyn Learner, folder: &tempfile::TempDir) -> Vec<u8> {
    let path = folder.path().join("checkpoint.safetensors");
    checkpoint::save(learner, &path).expect("a checkpoint");
    std::fs::read(path).expect("the file")
}

fn metadata(scenario: &Scenario) -> Vec<(String, String)> {
    let entries = [
        (key::OBSERVATION_VERSION, OBSERVATION_VERSION.to_string()),
        (key::USERS_MAX, USERS_CAPACITY.to_string()),
        (key::MIRRORS, scenario.mirror_count().to_string()),
        (key::MODE, scenario.channel.mode.name().to_string()),
        (key::GEOMETRY, scenario.geometry_hash()),
    ];
    entries.map(|(key, value)| (key.to_string(), value)).to_vec()
}

#[test]
fn the_same_seed_gives_the_same_actor_and_another_seed_another() {
    let actor = |algorithm, seed| {
        let mut learner = begin(algorithm, "specular", seed);
        run(learner.as_mut(), EPISODES);
        learner.export(&[]).expect("an actor")
    };
    for algorithm in Algorithm::value_variants() {
        let first = actor(*algorithm, 5);
        assert!(first == actor(*algorithm, 5), "{algorithm:?}");
        assert!(first != actor(*algorithm, 6), "{algorithm:?}");
    }
}

#[test]
fn a_resumed_run_is_the_run_that_was_not_stopped() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for algorithm in Algorithm::value_variants() {
        let mut whole = begin(*algorithm, "paper-calibrated", 5);
        run(whole.as_mut(), EPISODES);
        let wanted = state(whole.as_ref(), &folder);
        let mut first = begin(*algorithm, "paper-calibrated", 5);
        run(first.as_mut(), EPISODES / 2);
        assert!(state(first.as_ref(), &folder) != wanted, "{algorithm:?}: the second half must change something");
        let mut second = begin(*algorithm, "paper-calibrated", 5);
        checkpoint::load(second.as_mut(), &folder.path().join("checkpoint.safetensors")).expect("it fits");
        run(second.as_mut(), EPISODES);
        assert!(state(second.as_ref(), &folder) == wanted, "{algorithm:?}");
    }
}

#[test]
fn exported_graphs_answer_as_the_trainers_do() {
    for algorithm in Algorithm::value_variants() {
        for mode in ["specular", "paper-calibrated"] {
            let mut learner = begin(*algorithm, mode, 5);
            run(learner.as_mut(), EPISODES);
            let scenario = learner.scenario().clone();
            let bytes = learner.export(&metadata(&scenario)).expect("an actor");
            let file = ActorFile { origin: "the exported actor".into(), bytes: bytes.into() };
            let mut served = load_actor(&file, &scenario).expect("the engine takes the graph");
            let (mut rng, mut differ) = (ChaCha8Rng::seed_from_u64(11), 0);
            let mut got = MirrorAngles::flat(scenario.mirror_count());
            for _ in 0..OBSERVATIONS {
                let room = Rooms::Randomised.draw(&scenario, &mut rng);
                let environment = Environment::new(&room, rng.random()).expect("a valid room");
                let wanted = learner.act(&environment).expect("angles");
                served.answer(environment.vector(), &mut got).expect("angles");
                let pairs =
                    |one: &[f64], other: &[f64]| one.iter().zip(other).map(|(a, b)| (a - b).abs()).collect::<Vec<_>>();
                let (roll, yaw) = (pairs(&wanted.roll, &got.roll), pairs(&wanted.yaw, &got.yaw));
                differ += roll.iter().zip(&yaw).filter(|(roll, yaw)| roll.max(**yaw) > 1e-5).count();
            }
            let share = differ as f64 / (OBSERVATIONS * scenario.mirror_count()) as f64;
            assert!(share < TIES_MAX, "{algorithm:?} {mode}: {share} of the mirrors differ");
        }
    }
}

#[test]
fn every_algorithm_trains_the_policy_of_its_name_and_refuses_what_makes_no_sense() {
    for algorithm in Algorithm::value_variants() {
        let name = algorithm.to_possible_value().expect("not hidden").get_name().to_owned();
        assert_eq!(algorithm.policy().name(), name);
        assert!(algorithm.policy().is_learned() && algorithm.summary().contains("models/src/"));
        let scenario = Scenario::builtin("specular").expect("built in");
        let refusal = |options: &[&str]| {
            let options: Vec<String> = options.iter().map(|option| String::from(*option)).collect();
            algorithm.begin(scenario.clone(), Preset::Tuned, &options).err().expect("a refusal").to_string()
        };
        assert!(refusal(&["nonsense=1"]).contains("no such key"), "{name}");
        assert!(refusal(&["step_s=0"]).contains("step_s = 0"), "{name}");
        assert!(refusal(&["steps=0"]).contains("steps = 0: wanted"), "{name}");
        assert!(refusal(&["episodes=many"]).contains("episodes=many"), "{name}");
    }
    let learned = PolicyKind::value_variants().iter().filter(|kind| kind.is_learned());
    assert!(learned.count() >= Algorithm::value_variants().len());
}
