//! The dense engine beside ONNX Runtime.

use crate::dense_graphs::{Chain, with_open_rows};
use crate::support;
use heliostat_channel::MirrorAngles;
use heliostat_core::observation::Observation;
use heliostat_core::policy::{DENSE, DenseEngine, Engine, Network, Policy, PolicyKind};
use heliostat_models::{ActorSource, ORT, load_actor, load_actor_on_onnxruntime, onnxruntime_network};
use heliostat_needs::needs;
use heliostat_onnx::ModelProto;
use heliostat_scenario::Scenario;
use prost::Message;
use rand::{RngExt, SeedableRng, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

/// Nodes of random networks; each name is an operator, or one with a variant.
const NODES: [&str; 20] = [
    "MatMul",
    "Gemm",
    "Gemm transposed",
    "Gemm scaled",
    "Gemm without bias",
    "Add",
    "Add scalar",
    "Add first",
    "Sub",
    "Sub from",
    "Mul",
    "Div",
    "Div into",
    "Relu",
    "LeakyRelu",
    "Elu",
    "Tanh",
    "Sigmoid",
    "Softplus",
    "Identity",
];

/// Appends a node to a chain, and returns the length of the rows after it.
fn append(chain: &mut Chain, name: &str, width: usize, rng: &mut ChaCha8Rng) -> usize {
    let outputs = rng.random_range(1..70);
    let mut values = |count: usize, low: f32, high: f32| (0..count).map(|_| rng.random_range(low..high)).collect();
    let scale = (3.0 / width as f32).sqrt();
    let weights: Vec<f32> = values(width * outputs, -scale, scale);
    let (bias, row, positive): (Vec<f32>, Vec<f32>, Vec<f32>) =
        (values(outputs, -1.0, 1.0), values(width, -1.0, 1.0), values(width, 0.5, 2.0));
    let (table, turned): ([usize; 2], [usize; 2]) = ([width, outputs], [outputs, width]);
    match name {
        "MatMul" => chain.node("MatMul", 0, &[(&table, weights)]),
        "Gemm" => chain.node("Gemm", 0, &[(&table, weights), (&[outputs], bias)]),
        "Gemm transposed" => chain.node("Gemm", 0, &[(&turned, weights), (&[1, outputs], bias)]).integer("transB", 1),
        "Gemm scaled" => {
            let constants: [(&[usize], Vec<f32>); 2] = [(&table, weights), (&[], bias[..1].to_vec())];
            chain.node("Gemm", 0, &constants).float("alpha", 0.7).float("beta", -1.3)
        }
        "Gemm without bias" => chain.node("Gemm", 0, &[(&table, weights)]),
        "Add" => chain.node("Add", 0, &[(&[1, width], row)]),
        "Add scalar" => chain.node("Add", 0, &[(&[], row[..1].to_vec())]),
        "Add first" => chain.node("Add", 1, &[(&[width], row)]),
        "Sub" => chain.node("Sub", 0, &[(&[width], row)]),
        "Sub from" => chain.node("Sub", 1, &[(&[width], row)]),
        "Mul" => chain.node("Mul", 0, &[(&[width], row)]),
        "Div" => chain.node("Div", 0, &[(&[width], positive)]),
        // Bounds keep the divisor away from zero.
        "Div into" => {
            chain.node("Clip", 0, &[(&[], vec![0.5]), (&[], vec![3.0])]).node("Div", 1, &[(&[1, width], row)])
        }
        "LeakyRelu" => chain.node("LeakyRelu", 0, &[]).float("alpha", 0.2),
        "Elu" => chain.node("Elu", 0, &[]).float("alpha", 0.8),
        other => chain.node(other, 0, &[]),
    };
    if name.starts_with("Gemm") || name == "MatMul" { outputs } else { width }
}

/// A random network that begins with this node, and the lengths of its rows.
fn random_network(first: &str, rng: &mut ChaCha8Rng) -> (ModelProto, [usize; 2]) {
    let inputs = rng.random_range(1..90);
    let mut chain = Chain::new(inputs);
    let mut width = append(&mut chain, first, inputs, rng);
    for _ in 0..rng.random_range(1..7) {
        let name = NODES.choose(rng).expect("it is not empty");
        width = append(&mut chain, name, width, rng);
    }
    (chain.model(width), [inputs, width])
}

/// The outputs of a network for these rows.
fn outputs(network: &mut dyn Network, rows: usize, input: &[f32]) -> Vec<f32> {
    network.set_rows(rows).expect("any number");
    network.input_mut().copy_from_slice(input);
    network.run().expect("it runs").to_vec()
}

#[needs("onnxruntime")]
#[test]
fn dense_equals_onnxruntime_on_random_networks_of_every_operator_and_any_rows() {
    let mut compared = 0;
    for (index, first) in NODES.iter().cycle().take(6 * NODES.len()).enumerate() {
        let mut rng = ChaCha8Rng::seed_from_u64(index as u64);
        let (model, [length, width]) = random_network(first, &mut rng);
        let model = if index % 2 == 0 { model } else { with_open_rows(model) };
        let file = model.encode_to_vec();
        let mut dense = DenseEngine.load(&file, length).unwrap_or_else(|refusal| panic!("{first}: {refusal}"));
        let mut embedded = onnxruntime_network(&file, length).unwrap_or_else(|refusal| panic!("{first}: {refusal}"));
        for rows in [1, 5, 2, 64, 3] {
            let input: Vec<f32> = (0..rows * length).map(|_| rng.random_range(-2.0..2.0)).collect();
            let ours = outputs(dense.as_mut(), rows, &input);
            let theirs = outputs(embedded.as_mut(), rows, &input);
            assert_eq!((ours.len(), theirs.len()), (rows * width, rows * width));
            for (ours, theirs) in ours.iter().zip(&theirs) {
                let error = (ours - theirs).abs();
                assert!(error <= 1e-5 * theirs.abs().max(1.0), "network {index} ({first}): {ours} and {theirs}");
                compared += 1;
            }
        }
    }
    assert!(compared > 10_000, "{compared}");
}

#[needs("onnxruntime")]
#[test]
fn the_dense_engine_equals_onnxruntime_on_every_shipped_actor() {
    use PolicyKind::{Analytic, Ddpg, DdpgRaw, Dql, QLearning, Sarsa};
    for mode in ["specular", "paper", "paper-calibrated"] {
        let scenario = Scenario::builtin(mode).unwrap();
        let model = support::model(&scenario);
        for kind in [Ddpg, DdpgRaw, Analytic, Dql, QLearning, Sarsa] {
            let Ok(file) = ActorSource::Shipped.fetch(kind, &scenario) else { continue };
            let mut engines =
                [load_actor(&file, &scenario), load_actor_on_onnxruntime(&file, &scenario)].map(Result::unwrap);
            assert_eq!(engines.each_ref().map(|actor| actor.engine()), [DENSE, ORT].map(Some));
            let (observation, flat) = (Observation::new(&model, scenario.users.count), MirrorAngles::flat(100));
            let [dense, ort] = engines.each_mut().map(|actor| {
                let mut angles = flat.clone();
                actor.act(&model, &observation, &mut angles).unwrap();
                angles
            });
            let pairs = dense.roll.iter().chain(&dense.yaw).zip(ort.roll.iter().chain(&ort.yaw));
            let worst = pairs.map(|(dense, ort)| (dense - ort).abs()).fold(0.0, f64::max);
            assert!(worst < 1e-5, "{}: {worst}", file.origin);
        }
    }
}
