//! The learner that corrects the belief: its rooms, its loss, its file, and a resumed run.

use heliostat_decide::correction::Correction;
use heliostat_decide::evidence::FEATURES;
use heliostat_decide::policy::{PolicyKind, actor_file::ActorFile};
use heliostat_engine::{ActorSource, build};
use heliostat_models::environment::reported::{Example, Walks, examples};
use heliostat_models::learners::residual::{Residual, Settings};
use heliostat_models::training::{RunSettings, Training, checkpoint};
use heliostat_onnx::{ModelProto, reference::Reference};
use heliostat_scenario::Scenario;
use prost::Message;

fn hall(overrides: &[&str]) -> Scenario {
    let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
    Scenario::builtin("hall").unwrap().with_overrides(&overrides).unwrap()
}

fn short(episodes: usize) -> Settings {
    let settings = Settings::new(5);
    let run = RunSettings { episodes, ..settings.run };
    Settings { room_count: 4, room_s: 3.0, batch: 64, run, ..settings }
}

/// The belief takes all receivers for upright, so that the network alone can find their tilt.
const UPRIGHT: &str = "control.tilt={walking_deg=0.0,sitting_deg=0.0}";

fn training(settings: Settings) -> Training {
    Training::new(hall(&["mirrors.rows=4", "mirrors.columns=4", UPRIGHT]), settings, Residual::new).unwrap()
}

fn file(training: &Training) -> ActorFile {
    ActorFile { origin: "test.onnx".into(), bytes: training.export(&[]).unwrap().into() }
}

/// Examples of seated users with tilted receivers, in which this actor decides.
fn seated(file: &ActorFile, seed: u64) -> Vec<Example> {
    let room = hall(&["users.mobility=seated", "users.orientation={}", "mirrors.rows=6", "mirrors.columns=6", UPRIGHT]);
    let policy = build(PolicyKind::Residual, &room, &ActorSource::Bytes(file.clone())).unwrap();
    examples(&room, seed, policy, 6.0).unwrap()
}

fn outputs(reference: &Reference, row: &[f32; FEATURES]) -> Vec<f32> {
    reference.run("observation", row).unwrap()
}

#[test]
fn an_untrained_network_changes_nothing() {
    let file = file(&training(short(2)));
    let reference = Reference::new(&ModelProto::decode(file.bytes.as_ref()).unwrap()).unwrap();
    let all = seated(&file, 1);
    assert!(all.len() > 100);
    for example in &all {
        assert_eq!(outputs(&reference, &example.row), [0.0; Correction::VALUES]);
        assert!(example.tilt[0].hypot(example.tilt[1]) < 1.0 + 1e-5);
    }
}

#[test]
fn training_finds_the_tilt_of_receivers_in_rooms_that_it_has_not_seen() {
    let settings = Settings { room_count: 8, room_s: 6.0, ..short(6) };
    let mut training = training(Settings { batch: 128, ..settings });
    while training.episodes_done() < 6 {
        training.run_episode().unwrap();
    }
    let file = file(&training);
    let reference = Reference::new(&ModelProto::decode(file.bytes.as_ref()).unwrap()).unwrap();
    let (mut with, mut without) = (0.0, 0.0);
    for example in (100..104).flat_map(|seed| seated(&file, seed)) {
        let found = outputs(&reference, &example.row);
        let [x, y] = example.tilt;
        with += f64::from((found[0] - x).powi(2) + (found[1] - y).powi(2));
        without += f64::from(x * x + y * y);
    }
    assert!(with < 0.85 * without, "squared errors of the normal: {with:.1} with corrections, {without:.1} without");
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("checkpoint.safetensors");
    let mut whole = training(short(2));
    whole.run_episode().unwrap();
    checkpoint::save(&mut whole, &path).unwrap();
    whole.run_episode().unwrap();
    let mut resumed = training(short(2));
    checkpoint::load(&mut resumed, &path).unwrap();
    resumed.run_episode().unwrap();
    assert_eq!(file(&resumed).bytes, file(&whole).bytes);
    assert_ne!(file(&training(short(2))).bytes, file(&whole).bytes);
}

#[test]
fn rooms_differ_in_everything_that_a_run_may_draw() {
    use rand::SeedableRng;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let settings = Settings::new(1);
    let rooms: Vec<Scenario> = (0..40).map(|_| settings.choice.draw(&hall(&[]), &mut rng).unwrap()).collect();
    let differ = |value: &dyn Fn(&Scenario) -> String| {
        let mut all: Vec<String> = rooms.iter().map(value).collect();
        all.sort();
        all.dedup();
        all.len()
    };
    assert!(differ(&|room| format!("{:?} {}", room.users.mobility, room.users.pause_mean_s)) >= Walks::ALL.len() - 1);
    assert_eq!(differ(&|room| format!("{:?}", room.mismatch.level)), 3);
    assert_eq!(differ(&|room| room.users.orientation.is_some().to_string()), 2);
    assert!(differ(&|room| format!("{}", room.streams.positions.latency_ms)) > 20);
    let one = Settings {
        choice: heliostat_models::environment::reported::RoomChoice {
            walks: vec![Walks::Seated],
            mismatch: Vec::new(),
        },
        ..settings
    };
    let seated = one.choice.draw(&hall(&[]), &mut rng).unwrap();
    assert!(seated.mismatch.is_none() && format!("{:?}", seated.users.mobility).contains("Seated"));
}
