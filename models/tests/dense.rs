//! The dense engine beside the embedded one.

use allocation_counter::measure;
use dense_graphs::{Chain, with_open_rows};
use heliostat_channel::MirrorAngles;
use heliostat_core::observation::Observation;
use heliostat_core::policy::actor_file::{ActorError, ActorFile};
use heliostat_core::policy::{DENSE, DenseEngine, Engine, Network, Policy, PolicyKind};
use heliostat_models::{ActorSource, EMBEDDED, EngineChoice, embedded_network, load_actor};
use heliostat_onnx::ModelProto;
use heliostat_scenario::Scenario;
use prost::Message;
use rand::{RngExt, SeedableRng, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;
use support::{ActorRecipe, scenario};

#[path = "../../controller/core/tests/core/dense_graphs.rs"]
#[allow(dead_code)]
mod dense_graphs;
#[path = "../../controller/core/tests/core/support.rs"]
#[allow(dead_code)]
mod support;

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

#[test]
fn dense_equals_the_embedded_engine_on_random_networks_of_every_operator_and_any_rows() {
    let mut compared = 0;
    for (index, first) in NODES.iter().cycle().take(6 * NODES.len()).enumerate() {
        let mut rng = ChaCha8Rng::seed_from_u64(index as u64);
        let (model, [length, width]) = random_network(first, &mut rng);
        let model = if index % 2 == 0 { model } else { with_open_rows(model) };
        let file = model.encode_to_vec();
        let mut dense = DenseEngine.load(&file, length).unwrap_or_else(|refusal| panic!("{first}: {refusal}"));
        let mut embedded = embedded_network(&file, length).unwrap_or_else(|refusal| panic!("{first}: {refusal}"));
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

#[test]
fn the_choice_of_the_engine_is_followed_and_auto_takes_the_dense_one_where_it_can() {
    let scenario = scenario(&[]);
    let file = ActorRecipe::fitting(&scenario).file();
    let engine = |choice: EngineChoice| choice.load_actor(&file, &scenario).expect("both read it").engine_name();
    assert_eq!(engine(EngineChoice::Auto), DENSE);
    assert_eq!(engine(EngineChoice::Dense), DENSE);
    assert_eq!(engine(EngineChoice::Embedded), EMBEDDED);
    let room = Scenario::default();
    let policy = EngineChoice::Auto.build(PolicyKind::Ddpg, &room, &ActorSource::Shipped).expect("it is built in");
    assert_eq!(policy.engine(), Some(EMBEDDED), "the decoder in the graph is not dense");
    let refusal = EngineChoice::Dense.build(PolicyKind::Ddpg, &room, &ActorSource::Shipped).err().expect("not dense");
    let refusal = refusal.to_string();
    assert!(
        ["built-in actor", "dense graph", "embedded engine"].iter().all(|word| refusal.contains(word)),
        "{refusal}"
    );
    let direct = EngineChoice::Dense.build(PolicyKind::Flat, &room, &ActorSource::Shipped).expect("it reads no file");
    assert_eq!(direct.engine(), None);
}

/// An actor whose network is the recipe's, with nodes before its output.
fn extended(recipe: &ActorRecipe, operators: &[(&str, Option<f32>)]) -> ActorFile {
    let mut model = ModelProto::decode(&recipe.bytes()[..]).expect("just written");
    let graph = model.graph.as_mut().expect("a graph");
    let output = graph.output[0].name.clone();
    for (index, (operator, operand)) in operators.iter().enumerate() {
        let last = graph.node.last_mut().expect("the recipe has nodes");
        last.output[0] = format!("value_{index}");
        let mut node = last.clone();
        (node.name, node.op_type) = (format!("added_{index}"), (*operator).into());
        (node.input, node.output) = (vec![format!("value_{index}")], vec![output.clone()]);
        if let Some(value) = operand {
            let name = format!("operand_{index}");
            let tensor =
                heliostat_onnx::TensorProto { name: name.clone(), dims: vec![1, 1], ..graph.initializer[0].clone() };
            graph.initializer.push(heliostat_onnx::TensorProto { float_data: vec![*value], ..tensor });
            node.input.push(name);
        }
        graph.node.push(node);
    }
    ActorFile { origin: "extended.onnx".into(), bytes: model.encode_to_vec().into() }
}

/// 0/0 in each output; tract's hyperbolic tangent of NaN is finite.
const HIDDEN_NAN: [(&str, Option<f32>); 3] = [("Mul", Some(0.0)), ("Div", Some(0.0)), ("Tanh", None)];

#[test]
fn an_actor_whose_nan_one_engine_hides_is_refused_on_every_choice() {
    let scenario = scenario(&[]);
    let recipe = ActorRecipe::fitting(&scenario);
    let sound = extended(&recipe, &[("Mul", Some(0.5)), ("Tanh", None)]);
    assert_eq!(load_actor(&sound, &scenario).expect("both agree").engine_name(), DENSE);
    let hidden = extended(&recipe, &HIDDEN_NAN);
    for choice in [EngineChoice::Auto, EngineChoice::Dense, EngineChoice::Embedded] {
        let refusal = choice.load_actor(&hidden, &scenario).err().expect("NaN is hidden");
        let ActorError::EnginesDisagree { engines, differing, compared, .. } = &refusal else { panic!("{refusal}") };
        assert_eq!((*engines, *differing, *compared), ([DENSE, EMBEDDED], 64, 64));
        let text = refusal.to_string();
        assert!(["extended.onnx", DENSE, EMBEDDED, "64 of 64", "NaN"].iter().all(|word| text.contains(word)), "{text}");
    }
}

#[test]
fn a_decision_on_the_dense_engine_allocates_nothing() {
    let scenario = scenario(&["mirrors.rows=10", "mirrors.columns=10"]);
    let model = support::model(&scenario);
    let mut actor = load_actor(&ActorRecipe::fitting(&scenario).file(), &scenario).unwrap();
    assert_eq!(actor.engine_name(), DENSE);
    let (observation, mut angles) = (Observation::new(&model, 3), MirrorAngles::flat(100));
    actor.act(&model, &observation, &mut angles).unwrap();
    assert_eq!(measure(|| actor.act(&model, &observation, &mut angles).unwrap()).count_total, 0);
}
