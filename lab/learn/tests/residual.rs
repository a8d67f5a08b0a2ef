//! The learner that corrects the belief: its rooms, its loss, its file, and a resumed run.

use candle_core::{Device, Tensor, Var};
use heliostat_core::correction::Correction;
use heliostat_core::evidence::FEATURES;
use heliostat_core::evidence::NORMAL;
use heliostat_core::policy::{PolicyKind, actor_file::ActorFile};
use heliostat_learn::environment::outlook::Outlook;
use heliostat_learn::environment::reported::{Example, Future, RoomChoice, Walks, decisions, examples};
use heliostat_learn::environment::{Reward, RewardForm};
use heliostat_learn::learners::residual::analytic::{self, Analytic, Batch};
use heliostat_learn::learners::residual::ddpg::{self, Ddpg};
use heliostat_learn::learners::residual::{Residual, Settings};
use heliostat_learn::training::{RunSettings, Training, checkpoint};
use heliostat_models::{ActorSource, build};
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

/// Rooms of seated users that are as the controller knows them.
fn seated_only() -> RoomChoice {
    RoomChoice { walks: vec![Walks::Seated], mismatch: Vec::new(), offices: 0.0, scenario_only: false }
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
    let one = Settings { choice: seated_only(), ..settings };
    let seated = one.choice.draw(&hall(&[]), &mut rng).unwrap();
    assert!(seated.mismatch.is_none() && format!("{:?}", seated.users.mobility).contains("Seated"));
}

#[test]
fn offices_have_seated_and_walking_users_with_tilted_receivers_that_report_no_orientation() {
    use rand::SeedableRng;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
    let offices = RoomChoice { offices: 1.0, ..seated_only() };
    let rooms: Vec<Scenario> = (0..20).map(|_| offices.draw(&hall(&[]), &mut rng).unwrap()).collect();
    assert!(rooms.iter().all(|room| room.users.mixture.len() == 2 && room.users.orientation.is_some()));
    assert!(rooms.iter().all(|room| room.streams.orientation.is_none()));
    for differs in [|room: &Scenario| room.led.positions_m.len() == 2, |room: &Scenario| room.control.tilt.is_some()] {
        let count = rooms.iter().filter(|room| differs(room)).count();
        assert!((1..20).contains(&count), "{count} of 20");
    }
}

#[test]
fn a_run_for_one_scenario_draws_no_other_room() {
    use rand::SeedableRng;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    let only = RoomChoice { scenario_only: true, ..seated_only() };
    let crowd = hall(&["users.count=20", "mirrors.rows=4"]);
    assert_eq!(only.draw(&crowd, &mut rng).unwrap().hash(), crowd.hash());
    let settings = ddpg::Settings::new(5, only);
    let refused = Training::new(crowd, settings, Ddpg::new).err().expect("too many users").to_string();
    assert!(refused.contains("20 users") && refused.contains("at most 7"), "{refused}");
}

const REWARD: Reward = Reward { form: RewardForm::Shortfall, lambda: 10.0, margin: 1.0 };

/// Decisions about seated users with tilted receivers that are believed to be upright, with the
/// changes to the true normals.
fn outlooks(seed: u64) -> (Vec<Outlook>, Vec<f32>) {
    let room = hall(&["users.mobility=seated", "users.orientation={}", "mirrors.rows=6", "mirrors.columns=6", UPRIGHT]);
    let policy = build(PolicyKind::Residual, &room, &ActorSource::Bytes(file(&training(short(1))))).unwrap();
    let (mut all, mut changes, model) = (Vec::new(), Vec::new(), room.channel_model().unwrap());
    decisions(&room, seed, (policy, 5.0), &mut |decided| {
        let future = Future::of(decided).unwrap();
        changes.extend(future.users().flat_map(|(_, tilt)| tilt));
        all.push(Outlook::of(&future, &model));
    })
    .unwrap();
    (all, changes)
}

fn reward(batch: &Batch, changes: &[f32], exponent: f64) -> f32 {
    let changes = Tensor::from_slice(changes, (changes.len() / 2, 2), &Device::Cpu).unwrap();
    batch.rewards(&changes, exponent, REWARD).unwrap().mean_all().unwrap().to_scalar().unwrap()
}

#[test]
fn the_true_normals_promise_a_higher_future_rate_than_upright_ones() {
    let (mut true_normals, mut upright) = (0.0, 0.0);
    for seed in 1..5 {
        let (all, changes) = outlooks(seed);
        assert!(all.iter().all(|one| one.rows.iter().all(|row| row[NORMAL] == 0.0)));
        let batch = Batch::new(&all).unwrap();
        true_normals += reward(&batch, &changes, 64.0);
        upright += reward(&batch, &vec![0.0; changes.len()], 64.0);
    }
    assert!(true_normals > 1.01 * upright, "{true_normals} with the true normals, {upright} with upright ones");
}

#[test]
fn the_gradient_of_the_future_rate_is_that_of_finite_differences() {
    let (all, changes) = outlooks(3);
    let (all, changes) = (&all[..4], &changes[..2 * all[..4].iter().map(Outlook::users).sum::<usize>()]);
    let half: Vec<f32> = changes.iter().map(|value| 0.5 * value).collect();
    let batch = Batch::new(all).unwrap();
    let variable = Var::from_slice(&half, (half.len() / 2, 2), &Device::Cpu).unwrap();
    let gradients = batch.rewards(&variable, 4.0, REWARD).unwrap().mean_all().unwrap().backward().unwrap();
    let gradient = gradients.get(&variable).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
    let largest = gradient.iter().fold(0.0_f32, |largest, value| largest.max(value.abs()));
    for (index, found) in gradient.iter().enumerate() {
        let moved = |by: f32| {
            let mut changes = half.clone();
            changes[index] += by;
            f64::from(reward(&batch, &changes, 4.0))
        };
        let expected = (moved(0.01) - moved(-0.01)) / 0.02;
        let error = (f64::from(*found) - expected).abs();
        assert!(error < 0.1 * f64::from(largest), "entry {index}: {found}, by differences {expected}");
    }
    assert!(largest > 1e-3, "{gradient:?}");
}

/// Short fine-tunings of a network by both methods.
fn fine_tunings(from: &std::path::Path, episodes: usize) -> [Training; 2] {
    let from = || from.to_string_lossy().into_owned();
    let room = || hall(&["mirrors.rows=4", "mirrors.columns=4", UPRIGHT]);
    let settings = analytic::Settings::new(1, seated_only());
    let run = RunSettings { episodes, ..settings.run.clone() };
    let by_gradient = analytic::Settings { from: from(), batch: 8, room_count: 3, room_s: 3.0, run, ..settings };
    let settings = ddpg::Settings::new(1, seated_only());
    let run = RunSettings { episodes, ..settings.run.clone() };
    let by_critic =
        ddpg::Settings { from: from(), batch: 8, room_count: 3, room_s: 3.0, updates: 4, warm_up: 80, run, ..settings };
    [Training::new(room(), by_gradient, Analytic::new).unwrap(), Training::new(room(), by_critic, Ddpg::new).unwrap()]
}

#[test]
fn a_fine_tuning_starts_from_a_file_changes_it_and_resumes() {
    let folder = tempfile::tempdir().unwrap();
    let start = folder.path().join("start.onnx");
    let mut supervised = training(short(1));
    supervised.run_episode().unwrap();
    let first = file(&supervised);
    std::fs::write(&start, &first.bytes).unwrap();
    for (index, mut whole) in fine_tunings(&start, 2).into_iter().enumerate() {
        assert!(file(&whole).bytes == first.bytes, "method {index}");
        whole.run_episode().unwrap();
        let path = folder.path().join("checkpoint.safetensors");
        checkpoint::save(&mut whole, &path).unwrap();
        whole.run_episode().unwrap();
        let [by_gradient, by_critic] = fine_tunings(&start, 2);
        let mut resumed = if index == 0 { by_gradient } else { by_critic };
        checkpoint::load(&mut resumed, &path).unwrap();
        resumed.run_episode().unwrap();
        assert!(file(&resumed).bytes == file(&whole).bytes, "method {index}");
        assert!(file(&whole).bytes != first.bytes, "method {index}");
    }
}

#[test]
fn caution_changes_what_a_fine_tuning_learns() {
    let folder = tempfile::tempdir().unwrap();
    let start = folder.path().join("start.onnx");
    let mut supervised = training(short(1));
    supervised.run_episode().unwrap();
    std::fs::write(&start, file(&supervised).bytes).unwrap();
    let learned = |caution: f64| {
        let settings = analytic::Settings::new(1, seated_only());
        let from = start.to_string_lossy().into_owned();
        let settings = analytic::Settings { from, caution, batch: 8, room_count: 3, room_s: 3.0, ..settings };
        let room = hall(&["mirrors.rows=4", "mirrors.columns=4", UPRIGHT]);
        let mut run = Training::new(room, settings, Analytic::new).unwrap();
        run.run_episode().unwrap();
        file(&run).bytes
    };
    assert!(learned(2.0) == learned(2.0) && learned(2.0) != learned(0.0));
}

#[test]
fn the_actor_of_ddpg_waits_until_the_critic_has_learned() {
    let folder = tempfile::tempdir().unwrap();
    let start = folder.path().join("start.onnx");
    let mut supervised = training(short(1));
    supervised.run_episode().unwrap();
    let first = file(&supervised);
    std::fs::write(&start, &first.bytes).unwrap();
    let [_, mut by_critic] = fine_tunings(&start, 3);
    // One episode has fewer decisions than the 80 of the first update, three have more.
    by_critic.run_episode().unwrap();
    assert!(file(&by_critic).bytes == first.bytes);
    by_critic.run_episode().unwrap();
    by_critic.run_episode().unwrap();
    assert!(file(&by_critic).bytes != first.bytes);
}
