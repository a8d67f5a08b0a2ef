//! Actors from other programs: a network as an ONNX file becomes a file that a controller accepts.

use heliostat_core::angle_state::AngleState;
use heliostat_core::observation::{ObservationEncoder, USERS_CAPACITY};
use heliostat_core::policy::actor_file::{
    ActionKind, ActorFile, ActorInfo, INPUT_NAME, ObservationKind, key, room_entries,
};
use heliostat_core::policy::fixed_input;
use heliostat_environment::action::Head;
use heliostat_onnx::graph::{Ends, Graph};
use heliostat_onnx::{ModelProto, NodeProto, TensorProto};
use prost::Message;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::error::{guarded, refused};
use crate::scenario::Scenario;

/// Beginning of the names of the network's values, which cannot meet those of the builder.
const PREFIX: &str = "network/";

/// A network with one input and one output.
struct Part {
    nodes: Vec<NodeProto>,
    constants: Vec<TensorProto>,
    input: String,
    output: String,
}

impl Part {
    fn read(network: &[u8]) -> PyResult<Self> {
        let model = ModelProto::decode(network).map_err(|error| refused(format!("not an ONNX file: {error}")))?;
        let graph = model.graph.ok_or_else(|| refused("the ONNX file holds no graph"))?;
        let is_constant = |name: &str| graph.initializer.iter().any(|constant| constant.name == name);
        let inputs: Vec<String> =
            graph.input.iter().map(|port| port.name.clone()).filter(|name| !is_constant(name)).collect();
        let ([input], [output]) = (&inputs[..], &graph.output[..]) else {
            let (inputs, outputs) = (inputs.len(), graph.output.len());
            return Err(refused(format!("a network with {inputs} inputs and {outputs} outputs, expected one of each")));
        };
        let (input, output) = (input.clone(), output.name.clone());
        Ok(Self { nodes: graph.node, constants: graph.initializer, input, output })
    }

    /// Adds the network after the input of the file, and the factor after its output within [-1, 1].
    fn add(mut self, graph: &mut Graph, factor: f32) {
        let rename = |name: &mut String| {
            if *name == self.input {
                *name = INPUT_NAME.into();
            } else if !name.is_empty() {
                name.insert_str(0, PREFIX);
            }
        };
        for node in &mut self.nodes {
            node.input.iter_mut().chain(&mut node.output).chain([&mut node.name]).for_each(rename);
        }
        self.constants.iter_mut().for_each(|constant| rename(&mut constant.name));
        graph.insert(self.nodes, self.constants);
        let (low, high) = (graph.scalar(-1.0), graph.scalar(1.0));
        let bounded = graph.node("Clip", &[&format!("{PREFIX}{}", self.output), &low, &high]);
        if factor != 1.0 {
            let factor = graph.scalar(factor);
            graph.node("Mul", &[&bounded, &factor]);
        }
    }
}

/// The fixed input of a number from 0 to 3 for a network with this many inputs, by which a
/// controller verifies its engine.
#[pyfunction]
pub fn check_input(number: usize, inputs: usize) -> Vec<f32> {
    (0..inputs).map(|index| fixed_input(number, index)).collect()
}

/// Adds the names and metadata that a controller needs to a network with actions in [-1, 1].
///
/// `network`: an ONNX file with one input and one output of shape (1, n), opset 17 or lower.
/// `action`: "angles" or "weights". `observation`: "flat" or "paper". `slots`: slots of the
/// observation. `check`: the outputs of the trainer's own network for [`check_input`].
#[pyfunction]
#[pyo3(signature = (network, scenario, action, observation, slots, check))]
pub fn finish_actor<'py>(
    py: Python<'py>,
    network: &[u8],
    scenario: &Scenario,
    action: &str,
    observation: &str,
    slots: usize,
    check: Vec<Vec<f32>>,
) -> PyResult<Bound<'py, PyBytes>> {
    let bytes = guarded(|| {
        let form = Form::new(scenario, (action, observation), slots)?;
        let bytes = form.file(Part::read(network)?, scenario, &check);
        // The checks of a controller, so that a file that it would refuse is not written.
        let file = ActorFile { origin: "the exported network".into(), bytes: bytes.clone().into() };
        ActorInfo::read(&file).and_then(|info| info.check_fits(&scenario.inner)).map_err(refused)?;
        Ok(bytes)
    })?;
    Ok(PyBytes::new(py, &bytes))
}

/// Encoder and decoder of the file.
struct Form {
    observation: ObservationKind,
    action: ActionKind,
    inputs: usize,
    outputs: usize,
    slots: usize,
    /// What the bounded output is multiplied by.
    factor: f32,
}

impl Form {
    fn new(scenario: &Scenario, (action, observation): (&str, &str), slots: usize) -> PyResult<Self> {
        let room = &scenario.inner;
        let mirrors = room.mirror_count();
        let (observation, inputs) = match observation {
            "flat" => (ObservationKind::Flat, ObservationEncoder::new(slots, mirrors).len()),
            "paper" if slots == USERS_CAPACITY => (ObservationKind::Paper, AngleState::of(room, true).inputs()),
            other => {
                return Err(refused(format!(
                    "observation = {other:?}: a controller gives an actor the observation \"flat\" or, for up to \
                     {USERS_CAPACITY} users, \"paper\""
                )));
            }
        };
        let (action, outputs, factor) = match action {
            "weights" => (ActionKind::Weights(Head::BALANCED), slots, 1.0),
            _ => (ActionKind::Angles, 2 * mirrors, scenario.range() as f32),
        };
        Ok(Self { observation, action, inputs, outputs, slots, factor })
    }

    fn file(&self, part: Part, scenario: &Scenario, check: &[Vec<f32>]) -> Vec<u8> {
        let room = &scenario.inner;
        let mut graph = Graph::default();
        part.add(&mut graph, self.factor);
        let expected = |value: &f32| (self.factor * value.clamp(-1.0, 1.0)).to_string();
        let line = |values: &Vec<f32>| values.iter().map(expected).collect::<Vec<_>>().join(" ");
        let entry = |key: &str, value: String| (key.to_owned(), value);
        let mut metadata = room_entries(room, self.slots);
        metadata.extend([
            entry(key::OBSERVATION, self.observation.name().to_owned()),
            entry(key::SCENARIO, room.name.clone()),
            entry(key::CHECK, check.iter().map(line).collect::<Vec<_>>().join("; ")),
        ]);
        metadata.extend(self.action.entries());
        let (input, output) = ((INPUT_NAME, self.inputs), (self.action.output(), self.outputs));
        graph.finish(&Ends { name: "heliostat-python-actor", input, output }, &metadata)
    }
}
