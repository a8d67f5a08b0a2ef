//! Dense graphs as ONNX files, for the tests of the dense engine.

use heliostat_core::observation::{ObservationEncoder, USERS_CAPACITY};
use heliostat_core::policy::actor_file::{ANGLES, INPUT_NAME, room_entries};
use heliostat_onnx::{
    AttributeProto, ModelProto, TensorProto,
    attribute_proto::AttributeType,
    graph::{Ends, Graph},
    tensor_shape_proto::dimension::Value as Extent,
    type_proto,
};
use heliostat_scenario::Scenario;
use prost::Message;

/// A chain under construction. The last node computes the output "y".
#[derive(Default)]
pub struct Chain {
    graph: Graph,
    value: String,
    inputs: usize,
    attributes: Vec<(String, AttributeProto)>,
}

impl Chain {
    pub fn new(inputs: usize) -> Self {
        Self { value: "x".into(), inputs, ..Self::default() }
    }

    /// A node that reads the last value, at the place `at` among these constants.
    pub fn node(&mut self, operator: &str, at: usize, constants: &[(&[usize], Vec<f32>)]) -> &mut Self {
        let mut names = Vec::new();
        for (shape, values) in constants {
            let name = format!("{}_{}_{}", operator, self.value, names.len());
            names.push(self.graph.constant(&name, shape, values));
        }
        names.insert(at, self.value.clone());
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        self.value = self.graph.node(operator, &names);
        self
    }

    /// An attribute of the last node.
    pub fn float(&mut self, name: &str, value: f32) -> &mut Self {
        let attribute = AttributeProto { r#type: AttributeType::Float as i32, f: value, ..named(name) };
        self.attributes.push((self.value.clone(), attribute));
        self
    }

    /// An attribute of the last node.
    pub fn integer(&mut self, name: &str, value: i64) -> &mut Self {
        let attribute = AttributeProto { r#type: AttributeType::Int as i32, i: value, ..named(name) };
        self.attributes.push((self.value.clone(), attribute));
        self
    }

    /// The model, whose output has rows of this length.
    pub fn model(&mut self, outputs: usize) -> ModelProto {
        let ends = Ends { name: "test", input: ("x", self.inputs), output: ("y", outputs) };
        let file = std::mem::take(&mut self.graph).finish(&ends, &[]);
        let mut model = ModelProto::decode(&file[..]).expect("just written");
        let nodes = &mut model.graph.as_mut().expect("a graph").node;
        for (name, attribute) in std::mem::take(&mut self.attributes) {
            let node = nodes.iter_mut().find(|node| node.name == name).expect("it was added");
            node.attribute.push(attribute);
        }
        model
    }
}

fn named(name: &str) -> AttributeProto {
    AttributeProto { name: name.into(), ..AttributeProto::default() }
}

/// Leaves the number of rows of a model open.
pub fn with_open_rows(mut model: ModelProto) -> ModelProto {
    let graph = model.graph.as_mut().expect("a graph");
    for port in graph.input.iter_mut().chain(&mut graph.output) {
        let Some(type_proto::Value::TensorType(tensor)) = port.r#type.as_mut().and_then(|kind| kind.value.as_mut())
        else {
            panic!("a tensor");
        };
        tensor.shape.as_mut().expect("a shape").dim[0].value = Some(Extent::DimParam("rows".into()));
    }
    model
}

/// The tensor of a model with this prefix of its name.
pub fn tensor<'a>(model: &'a mut ModelProto, prefix: &str) -> &'a mut TensorProto {
    let tensors = &mut model.graph.as_mut().expect("a graph").initializer;
    tensors.iter_mut().find(|tensor| tensor.name.starts_with(prefix)).expect("it was added")
}

/// The file of an actor for a scenario: a dense network with two hidden layers.
#[allow(dead_code)]
pub fn dense_actor(scenario: &Scenario) -> Vec<u8> {
    let encoder = ObservationEncoder::new(USERS_CAPACITY, scenario.mirror_count());
    let (inputs, outputs) = (encoder.len(), 2 * scenario.mirror_count());
    let (mut graph, mut value) = (Graph::default(), INPUT_NAME.to_owned());
    for (seed, [from, to]) in [[inputs, 64], [64, 32], [32, outputs]].into_iter().enumerate() {
        let scale = (2.0 / from as f32).sqrt();
        let weights: Vec<f32> =
            (0..from * to).map(|index| scale * ((index * (seed + 3)) as f32 * 0.731).sin()).collect();
        let weights = graph.constant(&format!("weights_{seed}"), &[from, to], &weights);
        let bias = graph.constant(&format!("bias_{seed}"), &[1, to], &vec![0.01; to]);
        let product = graph.node("MatMul", &[&value, &weights]);
        let sum = graph.node("Add", &[&product, &bias]);
        value = graph.node(if seed < 2 { "Relu" } else { "Tanh" }, &[&sum]);
    }
    let scale = graph.scalar(0.1);
    graph.node("Mul", &[&value, &scale]);
    let ends = Ends { name: "test", input: (INPUT_NAME, inputs), output: (ANGLES, outputs) };
    graph.finish(&ends, &room_entries(scenario, USERS_CAPACITY))
}
