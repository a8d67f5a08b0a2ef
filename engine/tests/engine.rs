//! Learned policies on the real inference engine.

use std::path::Path;

use allocation_counter::measure;
use heliostat_channel::MirrorAngles;
use heliostat_decide::observation::Observation;
use heliostat_decide::policy::actor_file::ActorFile;
use heliostat_decide::policy::{Policy, PolicyKind};
use heliostat_engine::{ActorSource, BuildError, SourceError, build, load_actor, source};
use heliostat_scenario::Scenario;
use support::{ActorRecipe, model, scenario};

#[path = "../../decide/tests/decide/support.rs"]
#[allow(dead_code)]
mod support;

#[test]
fn an_actor_acts_on_the_engine() {
    let scenario = scenario(&[]);
    let model = model(&scenario);
    let mut actor = load_actor(&ActorRecipe::fitting(&scenario).file(), &scenario).unwrap();
    let mut angles = MirrorAngles::flat(9);
    actor.act(&model, &Observation::new(&model, 3), &mut angles).unwrap();
    assert!(angles.roll.iter().chain(&angles.yaw).all(|angle| *angle == 0.25));
}

#[test]
fn a_missing_file_says_how_to_get_one() {
    let source = ActorSource::Path("/nowhere/actor.onnx".into());
    let Err(error) = build(PolicyKind::Ddpg, &scenario(&[]), &source) else { panic!("accepted") };
    assert_eq!(error, BuildError::Source(SourceError::Missing { path: "/nowhere/actor.onnx".into() }));
    let text = error.to_string();
    assert!(["/nowhere/actor.onnx", "heliostat train", "policy fixed-point"].iter().all(|word| text.contains(word)));
}

#[test]
fn a_folder_is_no_file() {
    let error = source::read(Path::new("/")).unwrap_err();
    assert!(matches!(error, SourceError::Unreadable { .. }), "{error}");
}

#[test]
fn an_array_without_a_built_in_actor_is_told_what_to_do() {
    let Err(error) = build(PolicyKind::Ddpg, &scenario(&[]), &ActorSource::Shipped) else { panic!("accepted") };
    let text = error.to_string();
    let words = ["ddpg-specular-3x3.onnx", "heliostat train", "give its file", "policy fixed-point"];
    assert!(words.iter().all(|word| text.contains(word)), "{text}");
}

#[test]
fn a_file_for_a_policy_that_reads_none_is_refused() {
    let file = ActorSource::Path("actor.onnx".into());
    let refusal = build(PolicyKind::FixedPoint, &Scenario::default(), &file).err().expect("a refusal").to_string();
    assert!(refusal.contains("fixed-point, which reads none"), "{refusal}");
}

/// Allocations of one run of the engine on a network, and their bytes.
fn engine_allocations(file: &ActorFile, scenario: &Scenario) -> (u64, u64) {
    let mut actor = load_actor(file, scenario).unwrap();
    (0..20).for_each(|_| actor.run_engine_alone().unwrap());
    let run = measure(|| actor.run_engine_alone().unwrap());
    (run.count_total, run.bytes_total)
}

#[test]
fn only_the_engine_allocates_in_a_decision() {
    let scenario = scenario(&["mirrors.rows=10", "mirrors.columns=10"]);
    let (model, file) = (model(&scenario), ActorRecipe::fitting(&scenario).file());
    let (alone, _) = engine_allocations(&file, &scenario);
    let mut actor = load_actor(&file, &scenario).unwrap();
    let (observation, mut angles) = (Observation::new(&model, 3), MirrorAngles::flat(100));
    (0..20).for_each(|_| actor.act(&model, &observation, &mut angles).unwrap());
    let decision = measure(|| actor.act(&model, &observation, &mut angles).unwrap()).count_total;
    println!("the inference engine allocates {alone} times a run of the test's network");
    assert!(alone > 0 && decision == alone, "engine alone {alone}, a decision {decision}");
}

/// The engine's own allocations for the shipped actor; a dependency's, and printed for the results
/// page.
#[test]
fn allocations_for_the_shipped_actor_do_not_grow() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/actors/ddpg-specular-10x10.onnx");
    let file = source::read(&file).unwrap();
    let scenario = Scenario::builtin("specular").unwrap();
    let (count, bytes) = engine_allocations(&file, &scenario);
    println!("the inference engine allocates {count} times a run of the shipped actor, {bytes} bytes in all");
    assert_eq!((count, bytes), engine_allocations(&file, &scenario));
}
