//! Learned policies on the real inference engine.

use std::panic;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use allocation_counter::measure;
use heliostat_channel::MirrorAngles;
use heliostat_core::observation::Observation;
use heliostat_core::policy::actor_file::ActorFile;
use heliostat_core::policy::{Policy, PolicyKind};
use heliostat_models::{
    ActorSource, BuildError, EngineChoice, SourceError, build, embedded_network, load_actor, source,
};
use heliostat_onnx::{GraphProto, ModelProto};
use heliostat_scenario::Scenario;
use prost::Message;
use support::{ActorRecipe, model, scenario};

#[path = "../../controller/core/tests/core/support.rs"]
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
    let words = [
        "ddpg with 3 x 3 mirrors in the mode specular",
        "ddpg-specular-3x3.onnx",
        "heliostat train",
        "give its file",
        "policy fixed-point",
    ];
    assert!(words.iter().all(|word| text.contains(word)), "{text}");
}

#[test]
fn a_file_for_a_policy_that_reads_none_is_refused() {
    let file = ActorSource::Path("actor.onnx".into());
    let refusal = build(PolicyKind::FixedPoint, &Scenario::default(), &file).err().expect("a refusal").to_string();
    assert!(refusal.contains("fixed-point, which reads none"), "{refusal}");
}

/// The refusal of the embedded engine for a small network after a change.
fn embedded_refusal(change: fn(&mut GraphProto)) -> String {
    let recipe = ActorRecipe::fitting(&scenario(&[]));
    let mut model = ModelProto::decode(&recipe.bytes()[..]).unwrap();
    change(model.graph.as_mut().unwrap());
    let network = embedded_network(&model.encode_to_vec(), recipe.input_length);
    let mut network = match network {
        Ok(network) => network,
        Err(refusal) => return refusal,
    };
    network.run().expect_err("a refusal at the load or at the first run").to_string()
}

/// A panic would print the frames of the engine into the log of an operator.
#[test]
fn a_graph_whose_output_no_node_computes_is_refused_without_a_panic() {
    static PANICS: AtomicUsize = AtomicUsize::new(0);
    let before = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        if thread::current().name() == Some("refused graphs") {
            PANICS.fetch_add(1, Ordering::Relaxed);
        }
        before(info);
    }));
    let refusals = || {
        [
            embedded_refusal(|graph| graph.node.clear()),
            embedded_refusal(|graph| {
                graph.node.clear();
                graph.output = graph.input.clone();
            }),
            embedded_refusal(|graph| graph.node[1].output[0] = "other".into()),
            embedded_refusal(|graph| graph.output.clear()),
        ]
    };
    let refusals = thread::Builder::new().name("refused graphs".into()).spawn(refusals).unwrap().join().unwrap();
    assert_eq!(PANICS.load(Ordering::Relaxed), 0);
    for refusal in refusals {
        assert!(refusal.contains("output"), "{refusal}");
    }
}

#[test]
fn an_operator_of_another_domain_is_refused_by_the_embedded_engine() {
    let refusal = embedded_refusal(|graph| graph.node[1].domain = "com.example".into());
    assert!(refusal.contains("Add") && refusal.contains("com.example"), "{refusal}");
}

/// Allocations of one run of the embedded engine on a network, and their bytes.
fn engine_allocations(file: &ActorFile, scenario: &Scenario) -> (u64, u64) {
    let mut actor = EngineChoice::Embedded.load_actor(file, scenario).unwrap();
    (0..20).for_each(|_| actor.run_engine_alone().unwrap());
    let run = measure(|| actor.run_engine_alone().unwrap());
    (run.count_total, run.bytes_total)
}

#[test]
fn only_the_embedded_engine_allocates_in_a_decision() {
    let scenario = scenario(&["mirrors.rows=10", "mirrors.columns=10"]);
    let (model, file) = (model(&scenario), ActorRecipe::fitting(&scenario).file());
    let (alone, _) = engine_allocations(&file, &scenario);
    let mut actor = EngineChoice::Embedded.load_actor(&file, &scenario).unwrap();
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
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("actors/ddpg-specular-10x10.onnx");
    let file = source::read(&file).unwrap();
    let scenario = Scenario::builtin("specular").unwrap();
    let (count, bytes) = engine_allocations(&file, &scenario);
    println!("the inference engine allocates {count} times a run of the shipped actor, {bytes} bytes in all");
    assert_eq!((count, bytes), engine_allocations(&file, &scenario));
}

/// Resident memory of this process in bytes.
#[cfg(target_os = "linux")]
fn resident_bytes() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux has /proc");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("it states the resident memory");
    1024.0 * line.trim_end_matches("kB").trim().parse::<f64>().expect("a number of kB")
}

/// Resident memory after each of 30 parts of so many decisions of the shipped actor: its slope in
/// bytes a decision by least squares, and the standard error.
#[cfg(target_os = "linux")]
fn resident_slope(decisions: usize) -> (f64, f64) {
    const PARTS: usize = 30;
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("actors/ddpg-specular-10x10.onnx");
    let scenario = Scenario::builtin("specular").unwrap();
    let model = model(&scenario);
    let mut actor = load_actor(&source::read(&file).unwrap(), &scenario).unwrap();
    let (observation, mut angles) = (Observation::new(&model, scenario.users.count), MirrorAngles::flat(100));
    let mut decide = |count: usize| (0..count).for_each(|_| actor.act(&model, &observation, &mut angles).unwrap());
    decide(2000);
    let each = decisions / PARTS;
    let samples: Vec<(f64, f64)> = (1..=PARTS)
        .map(|part| {
            decide(each);
            ((part * each) as f64, resident_bytes())
        })
        .collect();
    let mean = |of: fn(&(f64, f64)) -> f64| samples.iter().map(of).sum::<f64>() / PARTS as f64;
    let (x, y) = (mean(|sample| sample.0), mean(|sample| sample.1));
    let spread: f64 = samples.iter().map(|sample| (sample.0 - x).powi(2)).sum();
    let slope = samples.iter().map(|sample| (sample.0 - x) * (sample.1 - y)).sum::<f64>() / spread;
    let residual: f64 = samples.iter().map(|sample| (sample.1 - y - slope * (sample.0 - x)).powi(2)).sum();
    (slope, (residual / (PARTS - 2) as f64 / spread).sqrt())
}

/// The bound allows for the other tests of this process, which run at the same time.
#[cfg(target_os = "linux")]
#[test]
fn decisions_do_not_fill_the_memory() {
    let (slope, error) = resident_slope(30_000);
    println!("resident memory grows by {slope:.3} +- {error:.3} bytes a decision");
    assert!(slope < 32.0, "{slope} bytes a decision");
}

/// Run by hand: `cargo test --release -p heliostat-models -- --ignored --nocapture million`.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "takes minutes"]
fn a_million_decisions_do_not_fill_the_memory() {
    let (slope, error) = resident_slope(1_000_000);
    println!("resident memory grows by {slope:.4} +- {error:.4} bytes a decision");
    assert!(slope < 1.0, "{slope} bytes a decision");
}
