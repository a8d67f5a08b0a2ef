//! The decoder of `heliostat_channel::decode` as nodes of an ONNX graph.
//!
//! An exported network gives one action per slot. The nodes turn the actions into decoder weights
//! by [`Head`], and the weights into the angles of all mirrors. A controller needs no knowledge of
//! the training, and no network can turn a mirror to an angle that the geometry does not allow.

use heliostat_channel::mirrors::MirrorArray;
use heliostat_channel::{ChannelModel, Mode, Vec3};
use heliostat_core::observation::{ObservationEncoder, Summary};
use heliostat_core::policy::actor_file::INPUT_NAME;
use heliostat_onnx::graph::{Graph, Value};

use crate::action::{BaselineWeight, Head};

/// The parts of the observation that the decoder reads.
#[derive(Clone, Debug)]
pub struct Observed {
    /// Slots of the observation.
    pub slots: usize,
    /// Mirrors of the array.
    pub mirrors: usize,
    /// ([`Summary::COLUMNS`], slots)
    pub summary: Value,
    /// Steering amplitudes, (slots, mirrors).
    pub steering: Value,
}

impl Observed {
    /// Adds the nodes that take these parts from the graph's input.
    pub fn new(graph: &mut Graph, encoder: ObservationEncoder) -> Self {
        let (slots, mirrors) = (encoder.users_max(), encoder.mirrors());
        let summary = graph.slice(INPUT_NAME, 1, encoder.summary());
        let summary = graph.reshape(&summary, &[Summary::COLUMNS, slots]);
        let steering = graph.slice(INPUT_NAME, 1, encoder.steering_amplitude());
        let steering = graph.reshape(&steering, &[slots, mirrors]);
        Self { slots, mirrors, summary, steering }
    }

    /// A column of the summary, (slots, 1).
    pub fn column(&self, graph: &mut Graph, column: usize) -> Value {
        let column = graph.slice(&self.summary, 0, column..column + 1);
        graph.reshape(&column, &[self.slots, 1])
    }
}

/// Adds the nodes from actions in [-1, 1], (slots, 1), to the graph's output: roll of each mirror,
/// then yaw of each, (1, 2 M).
///
/// # Panics
/// The room has several arrays.
pub fn decode(graph: &mut Graph, model: &ChannelModel, observed: &Observed, (actions, head): (&str, Head)) {
    assert_eq!(model.mirrors.arrays().len(), 1, "the decoder in a graph is for one array");
    let weighted = weigh(graph, observed, actions, head);
    let normal = match model.mode {
        Mode::Specular => specular(graph, model, observed, &weighted),
        Mode::Paper { .. } => paper(graph, model, observed, &weighted),
    };
    angles(graph, &normal);
}

/// Steering amplitudes times decoder weights, up to a common factor; (slots, mirrors).
fn weigh(graph: &mut Graph, observed: &Observed, actions: &str, head: Head) -> Value {
    let range = graph.scalar(head.range);
    let mut exponent = graph.node("Mul", &[actions, &range]);
    if head.baseline_weight == BaselineWeight::Balanced {
        let log_baseline = observed.column(graph, Summary::LogWeight as usize);
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
        let place = observed.column(graph, Summary::Place as usize + axis);
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
