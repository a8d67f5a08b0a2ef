//! Actors from other programs: a network as an ONNX file becomes a file that a controller accepts.

use heliostat_core::observation::{OBSERVATION_VERSION, ObservationEncoder, USERS_CAPACITY};
use heliostat_core::policy::actor_file::{ActorFile, ActorInfo, INPUT_NAME, OUTPUT_NAME, key};
use heliostat_environment::action::Head;
use heliostat_environment::angle_state::AngleState;
use heliostat_environment::decoder_graph::{Observed, decode};
use heliostat_onnx::graph::{Ends, Graph, Value};
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

    /// Adds the network after the value `seen`; returns its output within [-1, 1].
    fn add(mut self, graph: &mut Graph, seen: &str) -> Value {
        let rename = |name: &mut String| {
            if *name == self.input {
                *name = seen.into();
            } else if !name.is_empty() {
                name.insert_str(0, PREFIX);
            }
        };
        for node in &mut self.nodes {
            node.input.iter_mut().chain(&mut node.output).chain([&mut node.name]).for_each(rename);
        }
        self.constants.iter_mut().for_each(|constant| rename(&mut constant.name));
        graph.insert(self.nodes, self.constants);
        let output = format!("{PREFIX}{}", self.output);
        let (low, high) = (graph.scalar(-1.0), graph.scalar(1.0));
        let bounded = graph.node("Max", &[&output, &low]);
        graph.node("Min", &[&bounded, &high])
    }
}

/// Puts a network with actions in [-1, 1] between the observation and the angles, with the metadata
/// that a controller needs.
///
/// `network`: an ONNX file with one input and one output of shape (1, n), opset 17 or lower.
/// `action`: "angles" or "weights". `observation`: "flat" or "paper". `slots`: slots of the
/// observation.
#[pyfunction]
#[pyo3(signature = (network, scenario, action, observation, slots))]
pub fn finish_actor<'py>(
    py: Python<'py>,
    network: &[u8],
    scenario: &Scenario,
    action: &str,
    observation: &str,
    slots: usize,
) -> PyResult<Bound<'py, PyBytes>> {
    let bytes = guarded(|| finished(network, scenario, (action, observation), slots))?;
    Ok(PyBytes::new(py, &bytes))
}

/// The bytes of the finished file.
fn finished(
    network: &[u8],
    scenario: &Scenario,
    (action, observation): (&str, &str),
    slots: usize,
) -> PyResult<Vec<u8>> {
    let bytes = angles(Part::read(network)?, scenario, (action, observation), slots)?;
    // The checks of a controller, so that a file that it would refuse is not written.
    let file = ActorFile { origin: "the exported network".into(), bytes: bytes.clone().into() };
    ActorInfo::read(&file).and_then(|info| info.check_fits(&scenario.inner)).map_err(refused)?;
    Ok(bytes)
}

/// The file of a network for the angles of all mirrors, or for one weight per user.
fn angles(part: Part, scenario: &Scenario, (action, observation): (&str, &str), slots: usize) -> PyResult<Vec<u8>> {
    let room = &scenario.inner;
    let encoder = ObservationEncoder::new(slots, room.mirror_count());
    let mut graph = Graph::default();
    let seen = match observation {
        "flat" => INPUT_NAME.to_owned(),
        "paper" if slots == USERS_CAPACITY => AngleState::of(room, true).state_nodes(&mut graph),
        other => {
            return Err(refused(format!(
                "observation = {other:?}: a controller gives an actor the observation \"flat\" or, for up to \
                 {USERS_CAPACITY} users, \"paper\""
            )));
        }
    };
    let bounded = part.add(&mut graph, &seen);
    if action == "weights" {
        let model = room.channel_model().map_err(refused)?;
        let (arrays, leds) = (model.mirrors.arrays().len(), model.leds.len());
        if arrays != 1 || leds != 1 {
            return Err(refused(format!(
                "a room with {arrays} arrays and {leds} access points: the decoder in a file is for one of each; \
                 train in an environment with action=\"angles\""
            )));
        }
        let observed = Observed::new(&mut graph, encoder);
        let actions = graph.reshape(&bounded, &[slots, 1]);
        decode(&mut graph, &model, &observed, (&actions, Head::BALANCED));
    } else {
        let range = graph.scalar(scenario.range() as f32);
        graph.node("Mul", &[&bounded, &range]);
    }
    let entry = |key: &str, value: String| (key.to_owned(), value);
    let metadata = [
        entry(key::OBSERVATION_VERSION, OBSERVATION_VERSION.to_string()),
        entry(key::USERS_MAX, slots.to_string()),
        entry(key::MIRRORS, room.mirror_count().to_string()),
        entry(key::MODE, room.channel.mode.name().to_owned()),
        entry(key::GEOMETRY, room.geometry_hash()),
        entry(key::SCENARIO, room.name.clone()),
    ];
    let ends = Ends {
        name: "heliostat-python-actor",
        input: (INPUT_NAME, encoder.len()),
        output: (OUTPUT_NAME, 2 * room.mirror_count()),
    };
    Ok(graph.finish(&ends, &metadata))
}
