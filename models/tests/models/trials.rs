//! The trial of actors when they are loaded.

use std::time::Instant;

use heliostat_core::observation::{ObservationEncoder, USERS_CAPACITY};
use heliostat_core::policy::actor_file::{ANGLES, ActorFile, INPUT_NAME, room_entries};
use heliostat_core::policy::{DENSE, Finding, PolicyKind};
use heliostat_models::{ActorSource, build, build_tried, shipped};
use heliostat_onnx::graph::{Ends, Graph};
use heliostat_scenario::Scenario;

/// The file of a network whose layers follow a linear layer that passes the current angles on.
fn file(scenario: &Scenario, layers: impl FnOnce(&mut Graph, &str, usize)) -> ActorSource {
    let encoder = ObservationEncoder::new(USERS_CAPACITY, scenario.mirror_count());
    let mut graph = Graph::default();
    let (inputs, outputs) = (encoder.len(), encoder.angles().len());
    let mut passing = vec![0.0; inputs * outputs];
    encoder.angles().enumerate().for_each(|(output, input)| passing[input * outputs + output] = 1.0);
    let weights = graph.constant("passing", &[inputs, outputs], &passing);
    let angles = graph.node("MatMul", &[INPUT_NAME, &weights]);
    layers(&mut graph, &angles, outputs);
    let (input, output) = ((INPUT_NAME, encoder.len()), (ANGLES, encoder.angles().len()));
    let bytes = graph.finish(&Ends { name: "test", input, output }, &room_entries(scenario, USERS_CAPACITY));
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
fn an_actor_that_is_worse_than_flat_mirrors_causes_a_warning_with_both_rates() {
    let scenario = Scenario::default();
    let away = file(&scenario, |graph, angles, _| {
        let far = graph.scalar(-1.5);
        graph.node("Add", &[angles, &far]);
    });
    let (_, findings) = build_tried(PolicyKind::Ddpg, &scenario, &away).expect("it runs");
    let warnings = warnings(&findings);
    assert!(
        matches!(warnings[..], [text] if text.contains("own.onnx is worse than flat mirrors") && text.contains("sampled observations")),
        "{findings:?}"
    );
}

#[test]
fn an_actor_without_finite_output_is_refused() {
    let scenario = Scenario::default();
    let nan = file(&scenario, |graph, value, _| {
        let zero = graph.scalar(0.0);
        let zeros = graph.node("Mul", &[value, &zero]);
        graph.node("Div", &[&zeros, &zero]);
    });
    let text = build_tried(PolicyKind::Ddpg, &scenario, &nan).err().expect("a refusal").to_string();
    assert!(text.contains("own.onnx") && text.contains("gave no angles on"), "{text}");
}

#[test]
fn every_built_in_actor_is_verified_and_fits_its_room() {
    use PolicyKind::{Analytic, Ddpg, DdpgRaw, Dql, QLearning, Sarsa};
    let mut tried = 0;
    for mode in ["specular", "paper", "paper-calibrated"] {
        let scenario = Scenario::builtin(mode).unwrap();
        for kind in [Ddpg, DdpgRaw, Analytic, Dql, QLearning, Sarsa] {
            if shipped::find(kind, &scenario, 1).is_ok() {
                let started = Instant::now();
                let (policy, findings) = build_tried(kind, &scenario, &ActorSource::Shipped).unwrap();
                println!("{} {mode}: {:.0?} {findings:?}", policy.name(), started.elapsed());
                assert_eq!(policy.engine(), Some(DENSE));
                let notes = findings.iter().filter(|finding| matches!(finding, Finding::Note(_)));
                assert_eq!(notes.count(), 0, "{findings:?}");
                assert!(kind != Ddpg || findings.is_empty(), "{mode}: {findings:?}");
                tried += 1;
            }
        }
    }
    assert_eq!(tried, shipped::names().count());
}
