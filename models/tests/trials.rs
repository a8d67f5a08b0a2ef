//! The trial of actors when they are loaded, on the real inference engine.

use std::time::Instant;

use heliostat_core::observation::{OBSERVATION_VERSION, ObservationEncoder, USERS_CAPACITY};
use heliostat_core::policy::actor_file::{ActorFile, INPUT_NAME, OUTPUT_NAME, key};
use heliostat_core::policy::{Finding, PolicyKind};
use heliostat_models::{ActorSource, build, build_tried, shipped};
use heliostat_onnx::graph::{Ends, Graph};
use heliostat_scenario::Scenario;

/// The file of a network that computes its outputs from the current angles.
fn file(scenario: &Scenario, layers: impl FnOnce(&mut Graph, &str, usize)) -> ActorSource {
    let encoder = ObservationEncoder::new(USERS_CAPACITY, scenario.mirror_count());
    let mut graph = Graph::default();
    let angles = graph.slice(INPUT_NAME, 1, encoder.angles());
    layers(&mut graph, &angles, encoder.angles().len());
    let metadata = [
        (key::OBSERVATION_VERSION, OBSERVATION_VERSION.to_string()),
        (key::USERS_MAX, USERS_CAPACITY.to_string()),
        (key::MIRRORS, scenario.mirror_count().to_string()),
        (key::MODE, scenario.channel.mode.name().to_owned()),
        (key::GEOMETRY, scenario.geometry_hash()),
    ];
    let (input, output) = ((INPUT_NAME, encoder.len()), (OUTPUT_NAME, encoder.angles().len()));
    let metadata = metadata.map(|(key, value)| (key.to_owned(), value));
    let bytes = graph.finish(&Ends { name: "test", input, output }, &metadata);
    ActorSource::Bytes(ActorFile { origin: "own.onnx".into(), bytes: bytes.into() })
}

fn warnings(findings: &[Finding]) -> Vec<&str> {
    findings
        .iter()
        .filter_map(|finding| if let Finding::Warning(text) = finding { Some(text.as_str()) } else { None })
        .collect()
}

#[test]
fn nan_weights_before_a_tanh_are_refused_with_the_name_of_the_tensor() {
    let scenario = Scenario::default();
    let nan = file(&scenario, |graph, angles, outputs| {
        let weights = graph.constant("head.weight", &[1, outputs], &vec![f32::NAN; outputs]);
        let sum = graph.node("Add", &[angles, &weights]);
        graph.node("Tanh", &[&sum]);
    });
    for refusal in
        [build(PolicyKind::Ddpg, &scenario, &nan).err(), build_tried(PolicyKind::Ddpg, &scenario, &nan).err()]
    {
        let text = refusal.expect("a refusal").to_string();
        assert!(text.contains("own.onnx") && text.contains("head.weight"), "{text}");
    }
}

#[test]
fn a_network_whose_nan_the_engine_hides_is_refused() {
    let scenario = Scenario::default();
    // 0/0 in each output, and tract's hyperbolic tangent of NaN is finite.
    let hidden = file(&scenario, |graph, angles, _| {
        let zero = graph.scalar(0.0);
        let zeros = graph.node("Mul", &[angles, &zero]);
        let nan = graph.node("Div", &[&zeros, &zeros]);
        graph.node("Tanh", &[&nan]);
    });
    let text = build_tried(PolicyKind::Ddpg, &scenario, &hidden).err().expect("a refusal").to_string();
    assert!(text.contains("own.onnx") && text.contains("reference evaluation") && text.contains("8 of 8"), "{text}");
}

#[test]
fn an_actor_that_is_worse_than_flat_mirrors_causes_a_warning_with_both_rates() {
    let scenario = Scenario::default();
    let away = file(&scenario, |graph, angles, _| {
        let far = graph.scalar(-1.5);
        graph.node("Add", &[angles, &far]);
    });
    let (_, findings) = build_tried(PolicyKind::Ddpg, &scenario, &away).expect("it runs");
    let warnings = warnings(&findings);
    assert!(
        matches!(warnings[..], [text] if text.contains("worse than flat mirrors") && text.contains("32")),
        "{findings:?}"
    );
}

#[test]
fn an_actor_without_finite_output_causes_a_warning() {
    let scenario = Scenario::default();
    let nan = file(&scenario, |graph, angles, _| {
        let far = graph.scalar(-100.0);
        let below = graph.node("Add", &[angles, &far]);
        graph.node("Log", &[&below]);
    });
    let (_, findings) = build_tried(PolicyKind::Ddpg, &scenario, &nan).expect("it runs");
    assert!(warnings(&findings)[0].contains("no angles on 32 of 32"), "{findings:?}");
}

#[test]
fn an_operator_without_a_reference_is_noted() {
    let scenario = Scenario::default();
    let erf = file(&scenario, |graph, angles, _| {
        graph.node("Erf", &[angles]);
    });
    let (_, findings) = build_tried(PolicyKind::Ddpg, &scenario, &erf).expect("it runs");
    let notes: Vec<_> = findings.iter().filter(|finding| matches!(finding, Finding::Note(_))).collect();
    assert!(
        matches!(notes[..], [Finding::Note(text)] if text.contains("not compared") && text.contains("Erf")),
        "{findings:?}"
    );
}

#[test]
fn every_built_in_actor_agrees_with_the_reference() {
    use PolicyKind::{Analytic, Ddpg, DdpgRaw, Dql, QLearning, Sarsa};
    let mut tried = 0;
    let overrides = |shape: &str| {
        let (rows, columns) = shape.split_once('x').unwrap();
        [format!("mirrors.rows={rows}"), format!("mirrors.columns={columns}")]
    };
    for (mode, shape) in [("specular", "10x10"), ("specular", "7x7"), ("paper", "10x10"), ("paper-calibrated", "10x10")]
    {
        let scenario = Scenario::builtin(mode).and_then(|room| room.with_overrides(&overrides(shape))).unwrap();
        for kind in [Ddpg, DdpgRaw, Analytic, Dql, QLearning, Sarsa] {
            if shipped::find(kind, &scenario, 1).is_ok() {
                let started = Instant::now();
                let (policy, findings) = build_tried(kind, &scenario, &ActorSource::Shipped).unwrap();
                println!("{} {mode} {shape}: {:.0?} {findings:?}", policy.name(), started.elapsed());
                let differ = |finding: &Finding| format!("{finding:?}").contains("reference");
                assert!(!findings.iter().any(differ), "{findings:?}");
                assert!(kind != Ddpg || findings.is_empty(), "{mode} {shape}: {findings:?}");
                tried += 1;
            }
        }
    }
    assert_eq!(tried, shipped::names().count());
}
