//! Actors that are refused, and the text of the refusals.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use heliostat_channel::MirrorAngles;
use heliostat_core::{
    observation::Observation,
    policy::{
        Actor, Engine, Network, Policy, PolicyError,
        actor_file::{ANGLES, ActorError, ActorFile, key},
    },
};
use heliostat_scenario::Scenario;

use crate::support::{ActorRecipe, FixedEngine, load_actor, model, scenario};

fn refusal(recipe: &ActorRecipe, scenario: &Scenario) -> ActorError {
    match load_actor(&recipe.file(), scenario) {
        Ok(_) => panic!("the actor was accepted"),
        Err(error) => error,
    }
}

#[track_caller]
fn assert_contains(error: &dyn std::error::Error, words: &[&str]) {
    let text = error.to_string();
    for word in words {
        assert!(text.contains(word), "\"{text}\" does not contain \"{word}\"");
    }
}

#[test]
fn an_actor_that_fits_acts() {
    let scenario = scenario(&[]);
    let model = model(&scenario);
    let mut actor = load_actor(&ActorRecipe::fitting(&scenario).file(), &scenario).unwrap();
    let mut angles = MirrorAngles::flat(9);
    actor.act(&model, &Observation::new(&model, 3), &mut angles).unwrap();
    assert!(angles.roll.iter().chain(&angles.yaw).all(|angle| *angle == 0.25));
    assert_eq!(actor.info().users_max, 4);
}

#[test]
fn bytes_that_are_not_onnx_are_refused() {
    let scenario = scenario(&[]);
    for bytes in [&b"not a network"[..], b"", &[0xff; 64]] {
        let file = ActorFile { origin: "junk.onnx".into(), bytes: bytes.to_vec().into() };
        let Err(error) = load_actor(&file, &scenario) else { panic!("accepted") };
        assert!(matches!(error, ActorError::NotOnnx { .. }), "{error}");
        assert_contains(&error, &["junk.onnx"]);
    }
}

#[test]
fn a_truncated_file_is_refused() {
    let scenario = scenario(&[]);
    let bytes = ActorRecipe::fitting(&scenario).bytes();
    for length in [1, bytes.len() / 2, bytes.len() - 1] {
        let file = ActorFile { origin: "cut.onnx".into(), bytes: bytes[..length].to_vec().into() };
        assert!(load_actor(&file, &scenario).is_err(), "{length} bytes were accepted");
    }
}

#[test]
fn other_ports_are_refused() {
    let scenario = scenario(&[]);
    let error = refusal(&ActorRecipe { input_name: "state", ..ActorRecipe::fitting(&scenario) }, &scenario);
    assert_contains(&error, &["inputs", "state", "\"observation\""]);
    let error = refusal(&ActorRecipe { output_name: "action", ..ActorRecipe::fitting(&scenario) }, &scenario);
    assert_contains(&error, &["outputs", "action", "\"angles\""]);
}

#[test]
fn an_unknown_action_is_named_with_the_known_ones() {
    let scenario = scenario(&[]);
    let with = |action: &str| ActorRecipe::fitting(&scenario).with_metadata(key::ACTION, action);
    assert!(load_actor(&with("angles").file(), &scenario).is_ok());
    for action in ["COMPACT", "weights", ""] {
        let error = refusal(&with(action), &scenario);
        assert_contains(&error, &[&format!("unknown action \"{action}\""), "\"angles\"", "heliostat.action"]);
    }
    for action in ["compact", "displacements"] {
        assert_contains(&refusal(&with(action), &scenario), &[&format!("the action {action} was removed"), "weights"]);
    }
    let error = refusal(&with(&"\u{1b}x".repeat(5000)), &scenario);
    assert!(error.to_string().len() < 600 && !error.to_string().contains('\u{1b}'), "{error}");
}

#[test]
fn an_opset_that_is_not_known_is_refused_with_the_known_ones() {
    let scenario = scenario(&[]);
    for opset in [6, 29, -5] {
        let error = refusal(&ActorRecipe { opset, ..ActorRecipe::fitting(&scenario) }, &scenario);
        assert_contains(&error, &["test.onnx", &format!("the opset {opset}"), "from 7 to 28", "export it again"]);
    }
}

#[test]
fn other_shapes_are_refused() {
    let scenario = scenario(&[]);
    // 4 users and 9 mirrors: 4 * (17 + 9) + 18 = 122.
    let error = refusal(&ActorRecipe { input_length: 117, ..ActorRecipe::fitting(&scenario) }, &scenario);
    assert_contains(&error, &["observation", "f32 [1, 117]", "f32 [1, 122]", "users.count = 4", "size 9"]);
    let error = refusal(&ActorRecipe { output_length: 9, ..ActorRecipe::fitting(&scenario) }, &scenario);
    assert_contains(&error, &["angles", "f32 [1, 9]", "f32 [1, 18]"]);
}

#[test]
fn missing_and_unreadable_metadata_is_named() {
    let scenario = scenario(&[]);
    for key in [key::OBSERVATION_VERSION, key::USERS_MAX, key::MIRRORS, key::MODE, key::GEOMETRY] {
        assert_contains(&refusal(&ActorRecipe::fitting(&scenario).without_metadata(key), &scenario), &[key]);
    }
    let error = refusal(&ActorRecipe::fitting(&scenario).with_metadata(key::MIRRORS, "nine"), &scenario);
    assert_contains(&error, &[key::MIRRORS, "nine"]);
}

#[test]
fn an_actor_of_another_observation_version_is_refused() {
    let scenario = scenario(&[]);
    let error = refusal(&ActorRecipe::fitting(&scenario).with_metadata(key::OBSERVATION_VERSION, "1"), &scenario);
    assert_contains(&error, &["observation version 1", "expected 3", "train it again"]);
    // As long as these versions were, 4 * (6 + 9) + 18 and 4 * (16 + 9) + 18: it is the version
    // that is wrong, not the shape.
    for (version, input_length) in [("1", 78), ("2", 118)] {
        let former = ActorRecipe { input_length, ..ActorRecipe::fitting(&scenario) };
        let error = refusal(&former.with_metadata(key::OBSERVATION_VERSION, version), &scenario);
        assert_contains(&error, &[&format!("observation version {version}"), "expected 3", "train it again"]);
    }
}

#[test]
fn an_actor_for_another_array_is_refused() {
    let recipe = ActorRecipe::fitting(&scenario(&[]));
    let error = refusal(&recipe, &scenario(&["mirrors.rows=4"]));
    assert_contains(&error, &["mirrors of 9", "12 (4 x 3)", "heliostat train", "policy fixed-point"]);
}

#[test]
fn an_actor_for_fewer_users_is_refused() {
    let recipe = ActorRecipe::fitting(&scenario(&[]));
    assert_contains(&refusal(&recipe, &scenario(&["users.count=5"])), &["at most 4", "expected 5"]);
}

#[test]
fn an_actor_of_another_mode_is_refused() {
    let recipe = ActorRecipe::fitting(&scenario(&[]));
    let error = refusal(&recipe, &scenario(&["channel.mode=paper"]));
    assert_contains(&error, &["specular", "expected paper"]);
}

#[test]
fn an_actor_of_another_geometry_is_refused_and_one_of_another_noise_is_not() {
    let recipe = ActorRecipe::fitting(&scenario(&[]));
    let error = refusal(&recipe, &scenario(&["mirrors.centre_height_m=1.8"]));
    assert_contains(&error, &["optical geometry", "heliostat train"]);
    let noisier = scenario(&["noise.variance_a2=1e-13", "led.power_w=1.0", "users.speed_max_m_s=1.0"]);
    assert!(load_actor(&recipe.file(), &noisier).is_ok());
}

#[test]
fn an_output_that_is_not_finite_is_an_error() {
    let scenario = scenario(&[]);
    let recipe = ActorRecipe::fitting(&scenario);
    let mut actor = Actor::load(&recipe.file(), &scenario, &FixedEngine(f32::INFINITY)).unwrap();
    let vector = vec![0.0; recipe.input_length];
    let error = actor.answer(&vector, &mut MirrorAngles::flat(9)).unwrap_err();
    assert!(error.to_string().contains("mirror 0"), "{error}");
}

#[test]
fn a_file_with_weights_that_are_not_finite_is_refused_with_the_name_of_the_tensor() {
    let scenario = scenario(&[]);
    for bias in [f32::NAN, f32::INFINITY] {
        let error = refusal(&ActorRecipe { bias: vec![bias; 18], ..ActorRecipe::fitting(&scenario) }, &scenario);
        assert_contains(&error, &["test.onnx", "tensor bias", "not finite"]);
    }
}

#[test]
fn a_file_without_any_metadata_says_which_command_prints_what_is_needed() {
    let scenario = scenario(&[]);
    let recipe = ActorRecipe { metadata: vec![("author", "a stranger".into())], ..ActorRecipe::fitting(&scenario) };
    let error = refusal(&recipe, &scenario);
    assert_contains(
        &error,
        &["without the metadata of an actor", "heliostat config --as-json actor", "heliostat train"],
    );
    let error = refusal(&ActorRecipe::fitting(&scenario).without_metadata(key::USERS_MAX), &scenario).to_string();
    assert!(error.contains("found none") && !error.contains("None"), "{error}");
}

/// Runs of the networks of [`CountingEngine`].
static RUNS: AtomicU64 = AtomicU64::new(0);

struct CountingEngine;

struct Counting(Vec<f32>, [f32; 18]);

impl Engine for CountingEngine {
    fn load(&self, _: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
        Ok(Box::new(Counting(vec![0.0; input_length], [0.25; 18])))
    }
}

impl Network for Counting {
    fn engine(&self) -> &'static str {
        "counting"
    }

    fn set_rows(&mut self, rows: usize) -> Result<(), PolicyError> {
        assert_eq!(rows, 1, "an actor has one row");
        Ok(())
    }

    fn input_mut(&mut self) -> &mut [f32] {
        &mut self.0
    }

    fn run(&mut self) -> Result<&[f32], PolicyError> {
        RUNS.fetch_add(1, Relaxed);
        Ok(&self.1)
    }
}

#[test]
fn a_slow_network_is_tried_only_once() {
    /// Each reading is 0.3 s later, as if a run took that long.
    fn slow_clock() -> u64 {
        static NOW: AtomicU64 = AtomicU64::new(0);
        NOW.fetch_add(300_000_000, Relaxed)
    }
    let scenario = scenario(&[]);
    let file = ActorRecipe::fitting(&scenario).file();
    let mut actor = Actor::load(&file, &scenario, &CountingEngine).unwrap();
    actor.try_out(&file, &scenario, slow_clock).unwrap();
    assert_eq!(RUNS.load(Relaxed), 1);
    actor.try_out(&file, &scenario, || 0).unwrap();
    assert!(RUNS.load(Relaxed) > 8, "{RUNS:?}");
}

#[test]
fn an_engine_that_computes_other_angles_than_the_file_is_refused() {
    let scenario = scenario(&[]);
    let file = ActorRecipe::fitting(&scenario).file();
    let mut actor = Actor::load(&file, &scenario, &FixedEngine(0.5)).unwrap();
    let error = actor.try_out(&file, &scenario, || 0).unwrap_err();
    assert_contains(&error, &["test.onnx", "8 of 8 observations", "0.5 by the engine", "0.25 by the reference"]);
}

#[test]
fn the_contract_lists_action_version_and_output_of_a_file() {
    let contract = include_str!("../../../../CONTRACT.md");
    let recipe = ActorRecipe::fitting(&scenario(&[]));
    let row = contract.lines().find(|line| line.starts_with("| angles |")).expect("a row of the kind");
    let [_, _, action, version, output, ..] = row.split('|').map(str::trim).collect::<Vec<_>>()[..] else {
        panic!("{row}")
    };
    let entry = |wanted| recipe.metadata.iter().find(|(name, _)| *name == wanted).map(|(_, value)| value.as_str());
    assert_eq!(Some(version), entry(key::OBSERVATION_VERSION));
    assert!(action.contains(&format!("`{ANGLES}`")), "{row}");
    assert!(output.starts_with(&format!("`{}`", recipe.output_name)), "{row}");
}
