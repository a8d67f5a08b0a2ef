//! The exported actor: one ONNX graph from the observation to the mirror angles.
//!
//! The graph has three parts: the scaling of the features (in the weights of the first layer), the
//! trained network, and the geometric decoder of `heliostat_channel::decode`. A controller
//! therefore needs no knowledge of the training, and no actor can turn a mirror to an angle that
//! the geometry does not allow.

use candle_core::Result;
use heliostat_channel::mirrors::MirrorArray;
use heliostat_channel::{ChannelModel, Mode, Vec3};
use heliostat_decide::observation::Summary;
use heliostat_decide::policy::actor_file::{INPUT_NAME, OUTPUT_NAME};

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
    let observed = observe(&mut graph, actor);
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
        let present = column(&mut graph, &observed, Summary::Present as usize);
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
    let weighted = weigh(&mut graph, &observed, &actions, actor.head);
    let normal = match model.mode {
        Mode::Specular => specular(&mut graph, model, &observed, &weighted),
        Mode::Paper { .. } => paper(&mut graph, model, &observed, &weighted),
    };
    angles(&mut graph, &normal);
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

/// The parts of the observation that several stages use.
struct Observed {
    slots: usize,
    mirrors: usize,
    /// ([`Summary::COLUMNS`], slots)
    summary: Value,
    /// Steering amplitudes, (slots, mirrors).
    steering: Value,
}

fn observe(graph: &mut Graph, actor: &Actor) -> Observed {
    let encoder = actor.layout.encoder;
    let (slots, mirrors) = (actor.layout.slots(), encoder.mirrors());
    let summary = graph.slice(INPUT_NAME, 1, encoder.summary());
    let summary = graph.reshape(&summary, &[Summary::COLUMNS, slots]);
    let steering = graph.slice(INPUT_NAME, 1, encoder.steering_amplitude());
    let steering = graph.reshape(&steering, &[slots, mirrors]);
    Observed { slots, mirrors, summary, steering }
}

/// A column of the summary, (slots, 1).
fn column(graph: &mut Graph, observed: &Observed, column: usize) -> Value {
    let column = graph.slice(&observed.summary, 0, column..column + 1);
    graph.reshape(&column, &[observed.slots, 1])
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
                let weight = column(graph, observed, Summary::LogWeight as usize);
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
        let log_direct = column(graph, observed, Summary::LogDirect as usize);
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

/// Steering amplitudes times decoder weights, up to a common factor; (slots, mirrors).
fn weigh(graph: &mut Graph, observed: &Observed, actions: &str, head: Head) -> Value {
    let range = graph.scalar(head.range);
    let mut exponent = graph.node("Mul", &[actions, &range]);
    if head.baseline_weight == BaselineWeight::Balanced {
        let log_baseline = column(graph, observed, Summary::LogWeight as usize);
        exponent = graph.node("Add", &[&exponent, &log_baseline]);
    }
    let weight = graph.node("Exp", &[&exponent]);
    graph.node("Mul", &[&observed.steering, &weight])
}

/// A point or direction in the graph's frame: along the wall, into the wall, and down.
fn in_graph_frame(mirrors: &MirrorArray, vector: &Vec3) -> Vec3 {
    let turned = mirrors.wall_from_room(vector);
    Vec3::new(turned.x, turned.y, -turned.z)
}

/// Vectors as a constant of their components, (3, n).
fn rows(graph: &mut Graph, name: &str, vectors: impl Iterator<Item = Vec3> + Clone) -> Value {
    let values: Vec<f32> =
        [0, 1, 2].iter().flat_map(|&axis| vectors.clone().map(move |vector| vector[axis] as f32)).collect();
    graph.constant(name, &[3, values.len() / 3], &values)
}

/// The centres of the mirrors.
fn centres(mirrors: &MirrorArray) -> impl Iterator<Item = Vec3> + Clone {
    mirrors.positions().iter().map(|centre| in_graph_frame(mirrors, centre))
}

/// Positions of the users, (3, slots).
fn positions(graph: &mut Graph, observed: &Observed, mirrors: &MirrorArray) -> Value {
    let first = Summary::Place as usize;
    let positions = graph.slice(&observed.summary, 0, first..first + 3);
    let axes = [Vec3::x(), Vec3::y(), Vec3::z()];
    let turn = rows(graph, "turn", axes.iter().map(|axis| in_graph_frame(mirrors, axis)));
    graph.node("MatMul", &[&turn, &positions])
}

/// Normals, not normalised, (3, mirrors): each mirror is at the bisector for the user with the
/// largest weighted amplitude.
///
/// A mirror that reaches no user takes the first.
fn specular(graph: &mut Graph, model: &ChannelModel, observed: &Observed, scores: &str) -> Value {
    let (mirrors, led) = (&model.mirrors.arrays()[0], model.leds[0].position);
    let served = graph.best_row(scores, [observed.slots, observed.mirrors]);
    let positions = positions(graph, observed, mirrors);
    let target = graph.gather(&positions, &served, 1);
    let from = rows(graph, "centres", centres(mirrors));
    let towards_user = graph.node("Sub", &[&target, &from]);
    let towards_led = centres(mirrors).map(|centre| (in_graph_frame(mirrors, &led) - centre).normalize());
    let towards_led = rows(graph, "towards_led", towards_led);
    // The bisector of two directions, times the distance to the user. Its length has no effect.
    let squares = graph.node("Mul", &[&towards_user, &towards_user]);
    let distance = graph.sum(&squares, 0);
    let distance = graph.node("Sqrt", &[&distance]);
    let scaled = graph.node("Mul", &[&towards_led, &distance]);
    graph.node("Add", &[&scaled, &towards_user])
}

/// Normals, not normalised, (3, mirrors): the sum over users of weight, coefficient and direction;
/// flat where it is zero.
fn paper(graph: &mut Graph, model: &ChannelModel, observed: &Observed, weighted: &str) -> Value {
    let mirrors = &model.mirrors.arrays()[0];
    let squares = [0, 1, 2].map(|axis| {
        let place = column(graph, observed, Summary::Place as usize + axis);
        let centre: Vec<f32> = mirrors.positions().iter().map(|centre| centre[axis] as f32).collect();
        let centre = graph.constant(&format!("centre_{axis}"), &[1, centre.len()], &centre);
        let offset = graph.node("Sub", &[&place, &centre]);
        graph.node("Mul", &[&offset, &offset])
    });
    let squared = graph.node("Add", &[&squares[0], &squares[1]]);
    let squared = graph.node("Add", &[&squared, &squares[2]]);
    let distance = graph.node("Sqrt", &[&squared]);
    let pull = graph.node("Div", &[weighted, &distance]);
    let positions = positions(graph, observed, mirrors);
    let towards_users = graph.node("MatMul", &[&positions, &pull]);
    let from = rows(graph, "centres", centres(mirrors));
    let total = graph.sum(&pull, 0);
    let from = graph.node("Mul", &[&from, &total]);
    let normal = graph.node("Sub", &[&towards_users, &from]);
    // Far below any weighted coefficient that matters. It decides only where there is none.
    let inward = graph.constant("inward", &[3, 1], &[0.0, -1e-12, 0.0]);
    graph.node("Add", &[&normal, &inward])
}

/// Roll and yaw of normals (3, mirrors); adds the output node.
fn angles(graph: &mut Graph, normal: &str) {
    let [x, y, down] = [0, 1, 2].map(|axis| graph.slice(normal, 0, axis..axis + 1));
    let [xx, yy] = [&x, &y].map(|value| graph.node("Mul", &[value, value]));
    let across = graph.node("Add", &[&xx, &yy]);
    let across = graph.node("Sqrt", &[&across]);
    let roll = graph.node("Div", &[&down, &across]);
    let yaw = graph.node("Div", &[&x, &y]);
    let both = graph.concat(&[&roll, &yaw], 1);
    graph.node("Atan", &[&both]);
}
