//! Actors from other programs: a network as an ONNX file becomes a file that a controller accepts.

use heliostat_decide::observation::{OBSERVATION_VERSION, ObservationEncoder, USERS_CAPACITY};
use heliostat_decide::policy::actor_file::{ActorFile, ActorInfo, INPUT_NAME, OUTPUT_NAME, key};
use heliostat_environment::angle_state::AngleState;
use heliostat_onnx::graph::{Ends, Graph};
use heliostat_onnx::{ModelProto, NodeProto, TensorProto};
use prost::Message;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::error::refused;
use crate::scenario::Scenario;

/// Beginning of the names of the network's values, which cannot meet those of the builder.
const PREFIX: &str = "network/";

/// The network's values under other names; `input` is the value that replaces its input.
fn renamed(
    nodes: Vec<NodeProto>,
    constants: Vec<TensorProto>,
    own: &str,
    input: &str,
) -> (Vec<NodeProto>, Vec<TensorProto>) {
    let rename = |name: &mut String| {
        if name == own {
            *name = input.into();
        } else if !name.is_empty() {
            name.insert_str(0, PREFIX);
        }
    };
    let mut nodes = nodes;
    for node in &mut nodes {
        node.input.iter_mut().chain(&mut node.output).chain([&mut node.name]).for_each(rename);
    }
    let mut constants = constants;
    constants.iter_mut().for_each(|constant| rename(&mut constant.name));
    (nodes, constants)
}

/// Puts a network with actions in [-1, 1] between the observation and the angles, with the metadata
/// that a controller needs.
///
/// `network`: an ONNX file with one input and one output of shape (1, n), opset 17 or lower.
/// `observation`: "flat" or "paper". `slots`: slots of the observation.
#[pyfunction]
#[pyo3(signature = (network, scenario, observation, slots))]
pub fn finish_actor<'py>(
    py: Python<'py>,
    network: &[u8],
    scenario: &Scenario,
    observation: &str,
    slots: usize,
) -> PyResult<Bound<'py, PyBytes>> {
    let room = &scenario.inner;
    let model = ModelProto::decode(network).map_err(|error| refused(format!("not an ONNX file: {error}")))?;
    let part = model.graph.ok_or_else(|| refused("the ONNX file holds no graph"))?;
    let is_constant = |name: &str| part.initializer.iter().any(|constant| constant.name == name);
    let inputs: Vec<String> =
        part.input.iter().map(|port| port.name.clone()).filter(|name| !is_constant(name)).collect();
    let ([own_input], [own_output]) = (&inputs[..], &part.output[..]) else {
        let outputs = part.output.len();
        return Err(refused(format!(
            "a network with {} inputs and {outputs} outputs, expected one of each",
            inputs.len()
        )));
    };

    let encoder = ObservationEncoder::new(slots, room.mirror_count());
    let mut graph = Graph::default();
    let seen = match observation {
        "flat" | "dict" => INPUT_NAME.to_owned(),
        "paper" if slots == USERS_CAPACITY => AngleState::of(room, true).state_nodes(&mut graph),
        other => {
            return Err(refused(format!(
                "observation = {other:?}: a controller gives an actor the observation \"flat\"; \"paper\" and \"dict\" are parts of it"
            )));
        }
    };
    let output = format!("{PREFIX}{}", own_output.name);
    let (nodes, constants) = renamed(part.node, part.initializer, own_input, &seen);
    graph.insert(nodes, constants);
    let (low, high) = (graph.scalar(-1.0), graph.scalar(1.0));
    let bounded = graph.node("Max", &[&output, &low]);
    let bounded = graph.node("Min", &[&bounded, &high]);
    let range = graph.scalar(scenario.range() as f32);
    graph.node("Mul", &[&bounded, &range]);

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
    let bytes = graph.finish(&ends, &metadata);
    // The checks of a controller, so that a file that it would refuse is not written.
    let file = ActorFile { origin: "the exported network".into(), bytes: bytes.clone().into() };
    ActorInfo::read(&file).and_then(|info| info.check_fits(room)).map_err(refused)?;
    Ok(PyBytes::new(py, &bytes))
}
