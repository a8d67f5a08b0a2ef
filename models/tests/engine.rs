//! Learned policies on their engines, and what they allocate. A binary of its own: one test measures
//! the memory of its process.

use std::fs;
use std::path::Path;

use allocation_counter::measure;
use heliostat_channel::MirrorAngles;
use heliostat_core::observation::Observation;
use heliostat_core::policy::actor_file::ActorFile;
use heliostat_core::policy::{Actor, DENSE, Policy, PolicyKind};
use heliostat_models::{
    ActorSource, BuildError, ORT, SourceError, build, load_actor, load_actor_on_onnxruntime, source,
};
use heliostat_needs::needs;
use heliostat_onnx::{ModelProto, StringStringEntryProto, tensor_proto::DataLocation};
use heliostat_scenario::Scenario;
use onnxruntime::SIN;
use prost::Message;
use support::{ActorRecipe, model, scenario};

mod onnxruntime;
#[path = "../../controller/core/tests/core/support.rs"]
#[allow(dead_code)]
mod support;

#[test]
fn an_actor_acts_on_the_dense_engine() {
    let scenario = scenario(&[]);
    let model = model(&scenario);
    let mut actor = load_actor(&ActorRecipe::fitting(&scenario).file(), &scenario).unwrap();
    let mut angles = MirrorAngles::flat(9);
    actor.act(&model, &Observation::new(&model, 3), &mut angles).unwrap();
    assert!(angles.roll.iter().chain(&angles.yaw).all(|angle| *angle == 0.25));
    assert_eq!(actor.engine(), Some(DENSE));
}

#[test]
fn a_missing_file_says_how_to_get_one() {
    let source = ActorSource::Path("/nowhere/actor.onnx".into());
    let Err(error) = build(PolicyKind::Ddpg, &scenario(&[]), &source) else { panic!("accepted") };
    assert_eq!(error, BuildError::Source(SourceError::Missing { path: "/nowhere/actor.onnx".into() }));
    let text = error.to_string();
    assert!(
        ["/nowhere/actor.onnx", "heliostat-lab train", "policy fixed-point"].iter().all(|word| text.contains(word))
    );
}

#[test]
fn a_folder_is_no_file() {
    let error = source::read(Path::new("/")).unwrap_err();
    assert!(matches!(error, SourceError::Unreadable { .. }), "{error}");
}

#[test]
fn weights_outside_the_folder_of_the_actor_are_refused_with_the_place_expected() {
    let mut file = ModelProto::decode(&ActorRecipe::fitting(&scenario(&[])).bytes()[..]).unwrap();
    let location = |value: &str| StringStringEntryProto { key: "location".into(), value: value.into() };
    file.graph.as_mut().unwrap().initializer[0].data_location = DataLocation::External as i32;
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("outside.onnx");
    for place in ["../weights.bin", "/weights.bin"] {
        file.graph.as_mut().unwrap().initializer[0].external_data = vec![location(place)];
        fs::write(&path, file.encode_to_vec()).unwrap();
        let text = source::read(&path).unwrap_err().to_string();
        let words = [place, "expected a file in the folder of the actor", "external_data=False"];
        assert!(words.iter().all(|word| text.contains(word)), "{text}");
    }
}

#[test]
fn an_array_without_a_built_in_actor_is_told_what_to_do() {
    let Err(error) = build(PolicyKind::DdpgRaw, &scenario(&[]), &ActorSource::Shipped) else { panic!("accepted") };
    let text = error.to_string();
    let words = [
        "ddpg-raw with 3 x 3 mirrors in the mode specular",
        "ddpg-raw-specular-3x3.onnx",
        "heliostat-lab train",
        "give its file",
        "policy fixed-point",
    ];
    assert!(words.iter().all(|word| text.contains(word)), "{text}");
}

#[test]
fn one_built_in_file_serves_every_array_and_number_of_users_of_a_mode() {
    for mode in ["specular", "paper", "paper-calibrated"] {
        for (rows, columns, users) in [(10, 10, 5), (6, 14, 7), (1, 3, 1), (2, 2, 23)] {
            let overrides = [("rows", rows), ("columns", columns)].map(|(key, value)| format!("mirrors.{key}={value}"));
            let further = [format!("users.count={users}"), "blockage.forced_users=0".into()];
            let overrides = [&overrides[..], &further].concat();
            let scenario = Scenario::builtin(mode).unwrap().with_overrides(&overrides).unwrap();
            let model = model(&scenario);
            let mut policy = build(PolicyKind::Ddpg, &scenario, &ActorSource::Shipped).unwrap();
            let mut angles = MirrorAngles::flat(rows * columns);
            policy.act(&model, &Observation::new(&model, users), &mut angles).unwrap();
            assert_eq!(policy.engine(), Some(DENSE), "{mode}");
        }
    }
}

#[test]
fn a_file_for_a_policy_that_reads_none_is_refused() {
    let file = ActorSource::Path("actor.onnx".into());
    let refusal = build(PolicyKind::FixedPoint, &Scenario::default(), &file).err().expect("a refusal").to_string();
    assert!(refusal.contains("fixed-point, which reads none"), "{refusal}");
}

#[test]
fn a_graph_that_is_not_dense_runs_on_onnxruntime_or_says_what_to_do() {
    let scenario = scenario(&[]);
    let file = SIN.actor(&scenario);
    match load_actor(&file, &scenario) {
        Ok(mut actor) => {
            assert_eq!(actor.engine(), Some(ORT));
            let (model, mut angles) = (model(&scenario), MirrorAngles::flat(9));
            actor.act(&model, &Observation::new(&model, 3), &mut angles).unwrap();
            assert!(angles.roll.iter().all(|angle| (angle - 0.25_f64.sin()).abs() < 1e-6), "{angles:?}");
        }
        Err(error) => {
            let text = error.to_string();
            assert!(
                ["sin.onnx", "Sin", "VIRTUAL_ENV", "pip install onnxruntime", "dense"]
                    .iter()
                    .all(|word| text.contains(word)),
                "{text}"
            );
        }
    }
}

#[test]
fn a_graph_that_is_invalid_in_itself_is_not_for_onnxruntime() {
    let scenario = scenario(&[]);
    let mut broken = ModelProto::decode(&SIN.actor(&scenario).bytes[..]).unwrap();
    broken.graph.as_mut().unwrap().node[1].input[0] = "nowhere".into();
    let file = ActorFile { origin: "broken.onnx".into(), bytes: broken.encode_to_vec().into() };
    let text = load_actor(&file, &scenario).err().expect("refused").to_string();
    assert!(text.contains("the graph is invalid") && text.contains("reads \"nowhere\""), "{text}");
    assert!(!text.contains("pip install"), "{text}");
}

#[needs("onnxruntime")]
#[test]
fn an_operator_that_no_engine_knows_is_named_with_what_to_do() {
    let scenario = scenario(&[]);
    let mut misspelt = ModelProto::decode(&SIN.actor(&scenario).bytes[..]).unwrap();
    misspelt.graph.as_mut().unwrap().node.last_mut().unwrap().op_type = "Tahn".into();
    let file = ActorFile { origin: "misspelt.onnx".into(), bytes: misspelt.encode_to_vec().into() };
    let text = load_actor(&file, &scenario).err().expect("refused").to_string();
    for words in ["has the operator Tahn of the domain \"ai.onnx\"", "in opset 17", "export it again"] {
        assert!(text.contains(words), "{text}");
    }
}

/// Allocations of one decision.
fn allocations(actor: &mut Actor, scenario: &Scenario) -> (u64, u64) {
    let (model, mirrors) = (model(scenario), scenario.mirror_count());
    let (observation, mut angles) = (Observation::new(&model, scenario.users.count), MirrorAngles::flat(mirrors));
    (0..20).for_each(|_| actor.act(&model, &observation, &mut angles).unwrap());
    let found = measure(|| actor.act(&model, &observation, &mut angles).unwrap());
    (found.count_total, found.bytes_total)
}

#[test]
fn a_decision_of_a_shipped_actor_allocates_nothing() {
    let scenario = Scenario::default();
    for kind in [PolicyKind::Ddpg, PolicyKind::DdpgRaw, PolicyKind::Dql, PolicyKind::QLearning, PolicyKind::Sarsa] {
        let file = ActorSource::Shipped.fetch(kind, &scenario).unwrap();
        let mut actor = load_actor(&file, &scenario).unwrap();
        assert_eq!((actor.engine(), allocations(&mut actor, &scenario)), (Some(DENSE), (0, 0)), "{}", file.origin);
    }
}

#[needs("onnxruntime")]
#[test]
fn the_allocations_of_a_decision_on_onnxruntime_are_the_same_each_time() {
    let scenario = Scenario::default();
    let file = ActorSource::Shipped.fetch(PolicyKind::Ddpg, &scenario).unwrap();
    let mut actor = load_actor_on_onnxruntime(&file, &scenario).unwrap();
    let found = allocations(&mut actor, &scenario);
    println!("a decision on ONNX Runtime allocates {} times in this process, {} bytes in all", found.0, found.1);
    assert_eq!(found, allocations(&mut actor, &scenario));
}

/// Resident memory of this process in bytes.
#[cfg(target_os = "linux")]
fn resident_bytes() -> f64 {
    let status = fs::read_to_string("/proc/self/status").expect("Linux has /proc");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("it states the resident memory");
    1024.0 * line.trim_end_matches("kB").trim().parse::<f64>().expect("a number of kB")
}

/// Resident memory after each of 30 parts of so many decisions: its slope in bytes a decision by
/// least squares, and the standard error.
#[cfg(target_os = "linux")]
fn resident_slope(actor: &mut Actor, scenario: &Scenario, decisions: usize) -> (f64, f64) {
    const PARTS: usize = 30;
    let model = model(scenario);
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

/// The actor of `ddpg` on ONNX Runtime, which could leak.
#[cfg(target_os = "linux")]
fn on_onnxruntime(scenario: &Scenario) -> Actor {
    let file: ActorFile = ActorSource::Shipped.fetch(PolicyKind::Ddpg, scenario).unwrap();
    load_actor_on_onnxruntime(&file, scenario).unwrap()
}

/// The bound allows for the other tests of this process, which run at the same time.
#[cfg(target_os = "linux")]
#[needs("onnxruntime")]
#[test]
fn decisions_do_not_fill_the_memory() {
    let scenario = Scenario::default();
    let mut actor = on_onnxruntime(&scenario);
    let (slope, error) = resident_slope(&mut actor, &scenario, 30_000);
    println!("resident memory grows by {slope:.3} +- {error:.3} bytes a decision");
    assert!(slope < 32.0, "{slope} bytes a decision");
}

/// Run by hand: `cargo test --release -p heliostat-models -- --ignored --nocapture million`.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "takes minutes"]
fn a_million_decisions_do_not_fill_the_memory() {
    let scenario = Scenario::default();
    let mut actor = on_onnxruntime(&scenario);
    let (slope, error) = resident_slope(&mut actor, &scenario, 1_000_000);
    println!("resident memory grows by {slope:.4} +- {error:.4} bytes a decision");
    assert!(slope < 1.0, "{slope} bytes a decision");
}
