//! Actors that are refused, and the text of the refusals.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering::Relaxed},
};

use heliostat_channel::{ChannelModel, MirrorAngles, Vec3, decode::decode};
use heliostat_core::{
    observation::{Observation, ObservationEncoder, RoomState, Summary},
    policy::{
        Actor, Engine, Network, Policy, PolicyResult,
        actor_file::{ANGLES, ActionKind, ActorError, ActorFile, ObservationKind, WEIGHTS, key},
        weights::Head,
    },
};
use heliostat_onnx::{
    TypeProto, ValueInfoProto, f32_row, f32_rows, tensor_proto::DataType, tensor_shape_proto::dimension, type_proto,
    type_proto::Value,
};
use heliostat_scenario::Scenario;

use crate::support::{ActorRecipe, load_actor, model, scenario};

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

/// An actor that fits the room of these tests.
fn fitting() -> ActorRecipe {
    ActorRecipe::fitting(&scenario(&[]))
}

/// The actor is refused in the room of these tests, with these words.
#[track_caller]
fn expect_refusal(recipe: &ActorRecipe, words: &[&str]) {
    assert_contains(&refusal(recipe, &scenario(&[])), words);
}

#[test]
fn a_truncated_file_is_refused() {
    let scenario = scenario(&[]);
    let bytes = fitting().bytes();
    for length in [1, bytes.len() / 2, bytes.len() - 1] {
        let file = ActorFile { origin: "cut.onnx".into(), bytes: bytes[..length].to_vec().into() };
        assert!(load_actor(&file, &scenario).is_err(), "{length} bytes were accepted");
    }
}

#[test]
fn other_ports_are_refused() {
    let input = ActorRecipe { input_name: "state", ..fitting() };
    expect_refusal(&input, &["inputs", "state", "\"observation\"; export it", "input_names=[\"observation\"]"]);
    let output = ActorRecipe { output_name: "action", ..fitting() };
    expect_refusal(&output, &["outputs", "action", "\"angles\"; export it", "output_names=[\"angles\"]"]);
}

#[test]
fn an_unknown_action_is_named_with_the_known_ones() {
    let with = |action: &str| fitting().with_metadata(key::ACTION, action);
    assert!(load_actor(&with("angles").file(), &scenario(&[])).is_ok());
    for action in ["COMPACT", ""] {
        expect_refusal(
            &with(action),
            &[&format!("unknown action \"{action}\""), "\"angles\"", "\"codebook\"", "heliostat.action"],
        );
    }
    let error = refusal(&with(&"\u{1b}x".repeat(5000)), &scenario(&[]));
    assert!(error.to_string().len() < 600 && !error.to_string().contains('\u{1b}'), "{error}");
}

#[test]
fn an_opset_that_is_not_known_is_refused_with_the_known_ones() {
    for opset in [6, 29, -5] {
        let recipe = ActorRecipe { opset, ..fitting() };
        expect_refusal(&recipe, &["test.onnx", &format!("the opset {opset}"), "from 7 to 28", "export it again"]);
    }
}

#[test]
fn other_shapes_are_refused() {
    // 4 users and 9 mirrors: 4 * (17 + 9) + 18 = 122.
    let recipe = ActorRecipe { input_length: 117, ..fitting() };
    expect_refusal(&recipe, &["observation", "f32 [1, 117]", "f32 [1, 122]", "users.count = 4", "size 9"]);
    expect_refusal(&ActorRecipe { output_length: 9, ..fitting() }, &["angles", "f32 [1, 9]", "f32 [1, 18]"]);
}

#[test]
fn missing_and_unreadable_metadata_is_named() {
    for key in [key::OBSERVATION_VERSION, key::USERS_MAX, key::MIRRORS, key::MODE, key::GEOMETRY] {
        expect_refusal(&fitting().without_metadata(key), &[key]);
    }
    expect_refusal(&fitting().with_metadata(key::MIRRORS, "nine"), &[key::MIRRORS, "nine"]);
}

#[test]
fn an_actor_of_another_observation_version_is_refused() {
    // As long as these versions were, 4 * (6 + 9) + 18 and 4 * (16 + 9) + 18: it is the version
    // that is wrong, not the shape.
    for (version, input_length) in [("1", 122), ("1", 78), ("2", 118)] {
        let former = ActorRecipe { input_length, ..fitting() }.with_metadata(key::OBSERVATION_VERSION, version);
        expect_refusal(&former, &[&format!("observation version {version}"), "expected 3", "train it again"]);
    }
}

#[test]
fn an_actor_of_another_room_is_refused_with_what_differs_and_one_of_another_noise_is_not() {
    let recipe = fitting();
    for (change, words) in [
        ("mirrors.rows=4", &["mirrors of 9", "12 (4 x 3)", "heliostat-lab train", "policy fixed-point"][..]),
        ("users.count=5", &["at most 4", "expected 5"]),
        ("channel.mode=paper", &["specular", "expected paper"]),
        ("mirrors.centre_height_m=1.8", &["optical geometry", "heliostat-lab train"]),
    ] {
        assert_contains(&refusal(&recipe, &scenario(&[change])), words);
    }
    let noisier = scenario(&["noise.variance_a2=1e-13", "led.power_w=1.0", "users.speed_max_m_s=1.0"]);
    assert!(load_actor(&recipe.file(), &noisier).is_ok());
}

#[test]
fn a_file_with_nan_or_infinite_weights_is_refused_with_the_name_of_the_tensor() {
    for bias in [f32::NAN, f32::INFINITY] {
        let recipe = ActorRecipe { bias: vec![bias; 18], ..fitting() };
        expect_refusal(&recipe, &["test.onnx", "tensor bias", "NaN or infinity"]);
    }
}

#[test]
fn a_file_without_any_metadata_says_which_command_prints_what_is_needed() {
    let recipe = ActorRecipe { metadata: vec![("author".into(), "a stranger".into())], ..fitting() };
    expect_refusal(
        &recipe,
        &["without the metadata of an actor", "heliostat config --as-json actor", "heliostat-lab train"],
    );
    let error = refusal(&fitting().without_metadata(key::USERS_MAX), &scenario(&[])).to_string();
    assert!(error.contains("found none") && !error.contains("None"), "{error}");
}

/// A network that counts its runs, and whose outputs change by this step from run to run.
#[derive(Clone, Default)]
struct Stepping {
    step: f32,
    runs: Arc<AtomicU64>,
    input: Vec<f32>,
    output: [f32; 18],
}

impl Engine for Stepping {
    fn load(&self, _: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
        Ok(Box::new(Self { input: vec![0.0; input_length], ..self.clone() }))
    }
}

impl Network for Stepping {
    fn engine(&self) -> &'static str {
        "stepping"
    }

    fn set_rows(&mut self, rows: usize) -> PolicyResult {
        assert_eq!(rows, 1, "an actor has one row");
        Ok(())
    }

    fn input_mut(&mut self) -> &mut [f32] {
        &mut self.input
    }

    fn run(&mut self) -> PolicyResult<&[f32]> {
        self.runs.fetch_add(1, Relaxed);
        self.output[7] += self.step;
        Ok(&self.output)
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
    let file = fitting().file();
    let engine = Stepping::default();
    let mut actor = Actor::load(&file, &scenario, &engine).unwrap();
    let verified = engine.runs.load(Relaxed);
    actor.try_out(&scenario, slow_clock).unwrap();
    assert_eq!(engine.runs.load(Relaxed), verified + 1);
    actor.try_out(&scenario, || 0).unwrap();
    assert!(engine.runs.load(Relaxed) > verified + 8, "{:?}", engine.runs);
}

#[test]
fn a_network_that_samples_is_refused() {
    let scenario = scenario(&[]);
    let file = fitting().file();
    let error =
        Actor::load(&file, &scenario, &Stepping { step: 1e-6, ..Stepping::default() }).err().expect("a refusal");
    assert_contains(&error, &["test.onnx", "two runs on one observation differ", "export the mean"]);
}

#[test]
fn outputs_for_fixed_inputs_are_compared_with_those_of_the_trainer() {
    let scenario = scenario(&[]);
    let line = |first: &str| format!("{first} {}", ["0.25"; 17].join(" "));
    let check = |lines: [&str; 4]| {
        let recipe = fitting().with_metadata(key::CHECK, &lines.map(line).join("; "));
        let file = recipe.file();
        let actor = load_actor(&file, &scenario);
        actor.map(|mut actor| actor.try_out(&scenario, || 0).unwrap())
    };
    let findings = check(["0.25"; 4]).expect("equal outputs");
    assert!(!format!("{findings:?}").contains("not verified"), "{findings:?}");
    let findings = load_actor(&fitting().file(), &scenario).unwrap().try_out(&scenario, || 0);
    assert!(format!("{findings:?}").contains("not verified"), "{findings:?}");
    let error = check(["0.25", "0.25", "0.2502", "0.25"]).expect_err("another output");
    assert_contains(&error, &["output 0", "fixed input 2", "0.25 on the engine dense", "0.2502", key::CHECK]);
    assert!(check(["nan", "0.25", "0.25", "0.25"]).is_err() && check(["0.25 0.25", "", "", ""]).is_err());
}

#[test]
fn an_actor_without_angles_on_any_observation_is_refused() {
    let scenario = scenario(&[]);
    let file = fitting().file();
    let infinite = Stepping { step: f32::INFINITY, ..Stepping::default() };
    let mut actor = Actor::load(&file, &scenario, &infinite).unwrap();
    let error = actor.try_out(&scenario, || 0).unwrap_err();
    assert_contains(&error, &["test.onnx", "no angles on 32 of 32", "mirror 7"]);
}

/// A file with rows of users and the map from actions to weights.
fn of_users(scenario: &Scenario, bias: f32) -> ActorRecipe {
    let recipe = ActorRecipe {
        output_name: WEIGHTS,
        input_length: Summary::COLUMNS,
        output_length: 1,
        bias: vec![bias],
        port: f32_rows,
        ..ActorRecipe::fitting(scenario)
    };
    let recipe = recipe.with_metadata(key::OBSERVATION, "users").with_metadata(key::ACTION, WEIGHTS);
    recipe.without_metadata(key::USERS_MAX).without_metadata(key::MIRRORS).without_metadata(key::GEOMETRY)
}

#[test]
fn a_file_of_users_serves_any_array_and_any_number_of_users() {
    let recipe = of_users(&scenario(&[]), 0.5);
    for overrides in [&["users.count=1"][..], &["mirrors.rows=6", "users.count=17"]] {
        let scenario = scenario(overrides);
        let model = model(&scenario);
        let mut actor = load_actor(&recipe.file(), &scenario).unwrap();
        let (mut angles, mut balanced) = (MirrorAngles::flat(scenario.mirror_count()), Vec::new());
        let mut observation = Observation::new(&model, scenario.users.count);
        samples(&scenario, &model, &mut observation);
        actor.act(&model, &observation, &mut angles).unwrap();
        // Equal actions change all weights by one factor, so that the balanced weights decide.
        let encoder = ObservationEncoder::new(scenario.users.count, scenario.mirror_count());
        let mut vector = vec![0.0; encoder.len()];
        encoder.encode(&model, &observation, &mut vector).unwrap();
        balanced.extend(vector[encoder.column(Summary::LogWeight as usize)].iter().map(|log| f64::from(log.exp())));
        let mut expected = angles.clone();
        decode(&model, &observation.scene, &balanced, &mut expected);
        assert_eq!(angles, expected);
        assert_eq!(actor.users_max(), heliostat_proto::MAX_USERS);
    }
    let error =
        load_actor(&of_users(&scenario(&[]), f32::MAX).with_metadata(key::WEIGHT_RANGE, "inf").file(), &scenario(&[]));
    assert_contains(&error.err().expect("a refusal"), &[key::WEIGHT_RANGE]);
}

/// Users on a diagonal of the room.
fn samples(scenario: &Scenario, model: &ChannelModel, observation: &mut Observation) {
    let users = scenario.users.count;
    let place = |user: usize| Vec3::new(1.5 - 0.1 * user as f64, 0.15 * user as f64 - 1.0, 0.85);
    let state = RoomState {
        positions: &(0..users).map(place).collect::<Vec<_>>(),
        velocities: &vec![Vec3::zeros(); users],
        min_rate_bps: &vec![1e6; users],
        forced: &vec![false; users],
        ..RoomState::default()
    };
    observation.set_state(model, &state);
}

#[test]
fn kinds_that_do_not_go_together_are_refused() {
    let with = |observation: &str, action: &str| {
        fitting().with_metadata(key::OBSERVATION, observation).with_metadata(key::ACTION, action)
    };
    expect_refusal(&with("users", "angles"), &["\"angles\"", "\"users\"", "expected weights"]);
    expect_refusal(&with("cell", "weights"), &["\"weights\"", "\"cell\"", "expected codebook"]);
    expect_refusal(&with("pixels", "angles"), &["unknown observation \"pixels\"", "codewords", key::OBSERVATION]);
}

#[test]
fn a_file_that_holds_no_network_is_named() {
    let scenario = scenario(&[]);
    for (bytes, words) in [
        (&b""[..], "is empty, expected an ONNX file"),
        (b"version https://git-lfs", "pointer of git-lfs, expected an ONNX file: run `git lfs pull`"),
        (b"<html>", "web page"),
        (b"PK\x03\x04x", "zip archive, as `torch.save` writes"),
        (b"\x80\x04x", "is a pickle of Python"),
        ("# Room\n\tµ = 2\n".as_bytes(), "is a text file, expected an ONNX file"),
        (&[0xff; 64], "own.onnx"),
    ] {
        let file = ActorFile { origin: "own.onnx".into(), bytes: bytes.to_vec().into() };
        assert_contains(&load_actor(&file, &scenario).err().expect("a refusal"), &["own.onnx", words]);
    }
}

#[test]
fn an_open_first_extent_admits_one_row_and_a_batch_does_not() {
    assert!(load_actor(&ActorRecipe { port: f32_rows, ..fitting() }.file(), &scenario(&[])).is_ok());
    fn batch(name: &str, length: usize) -> ValueInfoProto {
        row_with(name, length, |tensor| {
            tensor.shape.as_mut().expect("a shape").dim[0].value = Some(dimension::Value::DimValue(4));
        })
    }
    expect_refusal(&ActorRecipe { port: batch, ..fitting() }, &["f32 [4, 122]", "f32 [1, 122]", "fixed batch of 1"]);
}

#[test]
fn another_element_type_and_an_absent_shape_are_refused_as_such() {
    fn double(name: &str, length: usize) -> ValueInfoProto {
        row_with(name, length, |tensor| tensor.elem_type = DataType::Double as i32)
    }
    let words = ["\"observation\" is f64 [1, 122], expected f32 [1, 122]", "export the actor with 32-bit floats"];
    expect_refusal(&ActorRecipe { port: double, ..fitting() }, &words);
    fn shapeless(name: &str, length: usize) -> ValueInfoProto {
        row_with(name, length, |tensor| tensor.shape = None)
    }
    let words = ["\"observation\" is f32 without a shape, expected f32 [1, 122]", "in this shape"];
    expect_refusal(&ActorRecipe { port: shapeless, ..fitting() }, &words);
}

/// A row of 32-bit floats, changed.
fn row_with(name: &str, length: usize, change: fn(&mut type_proto::Tensor)) -> ValueInfoProto {
    let mut port = f32_row(name, length);
    let Some(TypeProto { value: Some(Value::TensorType(tensor)), .. }) = &mut port.r#type else { panic!("a tensor") };
    change(tensor);
    port
}

#[test]
fn the_contract_lists_the_kinds_of_files() {
    let (_, contract) = include_str!("../../../../CONTRACT.md").split_once(". Actor files\n").expect("the section");
    for kind in ObservationKind::ALL {
        let row = contract.lines().find(|line| line.starts_with(&format!("| `{}`", kind.name())));
        let row = row.unwrap_or_else(|| panic!("no row of {}", kind.name()));
        assert!(kind.actions().iter().all(|action| row.contains(&format!("`{action}`"))), "{row}");
    }
    let head = Head::BALANCED;
    for action in [ActionKind::Angles, ActionKind::Weights(head), ActionKind::Codebook] {
        let row = contract.lines().find(|line| line.starts_with(&format!("| `{}`", action.name())));
        let row = row.unwrap_or_else(|| panic!("no row of {}", action.name()));
        assert!(row.contains(&format!("`{}`", action.output())), "{row}");
    }
    assert!(contract.contains(key::CHECK) && contract.contains(key::WEIGHT_RANGE) && contract.contains(ANGLES));
}
