//! The exported actor: one ONNX graph from the observation to the mirror angles.
//!
//! The graph has three parts: the scaling of the features (in the weights of the first layer), the
//! trained network, and the decoder ([`heliostat_environment::decoder_graph`]).

use candle_core::Result;
use heliostat_channel::ChannelModel;
use heliostat_core::observation::Summary;
use heliostat_core::policy::actor_file::{INPUT_NAME, OUTPUT_NAME};
use heliostat_environment::decoder_graph::{self, Observed};
use heliostat_onnx::graph::{Ends, Graph, Value};

use super::network::{Column, NetworkNodes};
use crate::environment::features::{BaselineWeight, FEATURES, Head, Layout};
use crate::networks::actor::{Actor, EXPONENT, SQUARINGS};

/// Writes an actor for the room of a channel as an ONNX file with the given metadata.
///
/// The start of a node costs an engine more than its arithmetic, so the graph has few nodes on
/// large tensors, of kinds that engines run fast.
///
/// # Errors
/// Errors of candle, when a parameter cannot be read.
pub fn export(actor: &Actor, model: &ChannelModel, metadata: &[(String, String)]) -> Result<Vec<u8>> {
    let mut graph = Graph::default();
    let observed = Observed::new(&mut graph, actor.layout.encoder);
    let network = NetworkNodes::new(&mut graph, &actor.network)?;
    let sharpness = EXPONENT * actor.head.range;
    let mut columns = columns(&actor.layout);
    let mut first = columns.clone();
    // The first round has actions of zero, so its amplitude is that of the balanced weights.
    first[Summary::LogBalanced as usize].push((AMPLITUDE, 1.0));
    let entry = network.entry(&mut graph, &first)?;
    let users = graph.transpose(&observed.summary);
    let mut actions = network.apply(&mut graph, &entry, &users);
    if actor.rounds > 1 {
        columns.extend([vec![(ACTION, 1.0 / sharpness)], vec![(AMPLITUDE, 1.0)]]);
        let entry = network.entry(&mut graph, &columns)?;
        let decoder = SmoothDecoder::new(&mut graph, &observed, actor.head);
        let sharpness = graph.scalar(sharpness);
        let present = observed.column(&mut graph, Summary::Present as usize);
        for _ in 1..actor.rounds {
            let exponents = graph.node("Mul", &[&actions, &sharpness]);
            let amplitude = decoder.amplitude(&mut graph, &exponents);
            let input = graph.concat(&[&users, &exponents, &amplitude], 1);
            // Zeroes empty slots. Without this node tract splits the product that follows into one
            // for each part.
            let input = graph.node("Mul", &[&input, &present]);
            actions = network.apply(&mut graph, &entry, &input);
        }
    }
    decoder_graph::decode(&mut graph, model, &observed, (&actions, actor.head));
    let input = (INPUT_NAME, actor.layout.encoder.len());
    Ok(graph.finish(&Ends { name: "heliostat-actor", input, output: (OUTPUT_NAME, 2 * model.mirrors.len()) }, metadata))
}

/// Index of the previous round's action among the inputs of the actor's network.
const ACTION: usize = FEATURES;

/// Index of ln(1 + amplitude) under that action.
const AMPLITUDE: usize = FEATURES + 1;

/// Replaces [`POWER_FLOOR`](crate::networks::actor::POWER_FLOOR): powers are not divided by their
/// sum here and can be small.
const POWER_FLOOR: f32 = 1e-35;

/// The network's inputs that each column of the summary gives.
fn columns(layout: &Layout) -> Vec<Column> {
    let mut columns = vec![Vec::new(); Summary::COLUMNS];
    for (input, (column, factor)) in layout.sources().into_iter().enumerate() {
        columns[column].push((input, factor));
    }
    columns
}

/// The smooth decoder.
struct SmoothDecoder {
    /// (s b_k a_km)^8 with the baseline weights b and one s for all, (slots, mirrors).
    powers: Value,
    /// The powers times a_km.
    gains: Value,
    /// 1 + direct amplitude, (slots, 1).
    raised_direct: Value,
}

impl SmoothDecoder {
    fn new(graph: &mut Graph, observed: &Observed, head: Head) -> Self {
        let floor = graph.scalar(POWER_FLOOR);
        let mut powers = match head.baseline_weight {
            // Relative to their sum, so that their powers stay within f32.
            BaselineWeight::Uniform => {
                let positive = graph.node("Add", &[&observed.steering, &floor]);
                let inverse_total = inverse_sum(graph, &positive);
                graph.node("Mul", &[&observed.steering, &inverse_total])
            }
            BaselineWeight::Balanced => {
                let weight = observed.column(graph, Summary::LogWeight as usize);
                let weight = graph.node("Exp", &[&weight]);
                graph.node("Mul", &[&observed.steering, &weight])
            }
        };
        for _ in 0..SQUARINGS {
            powers = graph.node("Mul", &[&powers, &powers]);
        }
        let gains = graph.node("Mul", &[&powers, &observed.steering]);
        // So that no sum of powers is zero.
        let powers = graph.node("Add", &[&powers, &floor]);
        let log_direct = observed.column(graph, Summary::LogDirect as usize);
        let raised_direct = graph.node("Exp", &[&log_direct]);
        Self { powers, gains, raised_direct }
    }

    /// ln(1 + amplitude) of each user from [`EXPONENT`] times the logarithms of the weights;
    /// (slots, 1).
    fn amplitude(&self, graph: &mut Graph, exponents: &str) -> Value {
        let weights = graph.node("Exp", &[exponents]);
        let powers = graph.node("Mul", &[&self.powers, &weights]);
        let inverse_total = inverse_sum(graph, &powers);
        let inverse_total = graph.transpose(&inverse_total);
        let given = graph.node("MatMul", &[&self.gains, &inverse_total]);
        let given = graph.node("Mul", &[&given, &weights]);
        let raised = graph.node("Add", &[&given, &self.raised_direct]);
        graph.node("Log", &[&raised])
    }
}

/// One over the sum of each mirror's column, (1, mirrors).
fn inverse_sum(graph: &mut Graph, table: &str) -> Value {
    let total = graph.sum(table, 0);
    graph.node("Reciprocal", &[&total])
}
