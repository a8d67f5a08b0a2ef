//! The learner that predicts places: its examples, what it learns, and its file in other rooms.

use heliostat_core::policy::{PolicyKind, actor_file::ActorFile};
use heliostat_learn::learners::lstm::{Example, Lstm, Settings, examples};
use heliostat_learn::training::{RunSettings, Training};
use heliostat_models::{ActorSource, build};
use heliostat_onnx::{ModelProto, reference::Reference};
use heliostat_scenario::Scenario;
use prost::Message;

fn hall(overrides: &[&str]) -> Scenario {
    let small = ["mirrors.rows=4", "mirrors.columns=4", "users.mobility=gauss-markov"];
    let overrides: Vec<String> = small.iter().chain(overrides).map(|text| (*text).to_owned()).collect();
    Scenario::builtin("hall").unwrap().with_overrides(&overrides).unwrap()
}

fn training(episodes: usize) -> Training {
    let settings = Settings::new(5);
    let run = RunSettings { episodes, ..settings.run };
    let settings = Settings { room_count: 8, room_s: 8.0, batch: 128, rate: 1e-2, run, ..settings };
    Training::new(hall(&[]), settings, Lstm::new).unwrap()
}

fn file(training: &Training) -> ActorFile {
    ActorFile { origin: "test.onnx".into(), bytes: training.export(&[]).unwrap().into() }
}

/// Examples of walks that training does not have.
fn held_out(file: &ActorFile, room: &Scenario, seed: u64) -> Vec<Example> {
    let policy = build(PolicyKind::Lstm, room, &ActorSource::Bytes(file.clone())).unwrap();
    examples(room, seed, policy, 6.0).unwrap()
}

fn reference(file: &ActorFile) -> Reference {
    Reference::new(&ModelProto::decode(file.bytes.as_ref()).unwrap()).unwrap()
}

/// Root mean squares in m: of the predictions of a file, of the Gauss-Markov prediction, and of the
/// last report.
fn errors_m(file: &ActorFile, all: &[Example]) -> [f64; 3] {
    let reference = reference(file);
    let mut sums = [0.0; 3];
    for example in all {
        let output = reference.run("observation", &example.row).unwrap();
        let left = [example.left[0] - output[0], example.left[1] - output[1]];
        for (sum, [x, y]) in sums.iter_mut().zip([left, example.left, example.moved]) {
            *sum += f64::from(x * x + y * y);
        }
    }
    sums.map(|sum| (sum / all.len() as f64).sqrt())
}

#[test]
fn an_untrained_network_gives_the_gauss_markov_prediction() {
    let file = file(&training(1));
    let all = held_out(&file, &hall(&[]), 1);
    assert!(all.len() > 200, "{}", all.len());
    let [found, expected, reported] = errors_m(&file, &all);
    assert_eq!(found, expected);
    assert!(expected < reported, "{expected} m, by the last report {reported} m");
}

#[test]
fn training_predicts_held_out_walks_better_than_the_gauss_markov_model_and_the_last_report() {
    let mut training = training(8);
    while training.episodes_done() < 8 {
        training.run_episode().unwrap();
    }
    let file = file(&training);
    let all: Vec<Example> = (100..106).flat_map(|seed| held_out(&file, &hall(&[]), seed)).collect();
    let [found, expected, reported] = errors_m(&file, &all);
    assert!(found < 0.95 * expected && found < 0.5 * reported, "{found} m, {expected} m, {reported} m");
}

#[test]
fn one_file_runs_in_rooms_with_other_numbers_of_users_and_mirrors() {
    let mut training = training(1);
    training.run_episode().unwrap();
    let file = file(&training);
    let rooms: [&[&str]; 3] = [&["users.count=1"], &["users.count=12"], &["users.count=2", "mirrors.rows=7"]];
    for overrides in rooms {
        let room = hall(overrides);
        let all = held_out(&file, &room, 3);
        assert!(all.len() >= 40 * room.users.count, "{overrides:?}: {}", all.len());
        let output = reference(&file).run("observation", &all[all.len() / 2].row).unwrap();
        assert!(output.len() == 2 && output.iter().all(|value| *value != 0.0), "{output:?}");
    }
}
