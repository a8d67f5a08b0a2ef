//! The exported actor: observation in, mirror angles out, all in one ONNX graph.
//!
//! Three parts follow each other in the graph: the features of [`crate::features`], the trained network, and the geometric
//! decoder, the same that `heliostat_channel::decode` computes in Rust. A controller therefore needs no knowledge of how an
//! actor was trained, and no actor can point a mirror where the geometry does not allow.

mod network;

use std::ops::Range;

use candle_core::Result;
use heliostat_channel::mirrors::MirrorArray;
use heliostat_channel::{ChannelModel, Mode, Vec3};
use heliostat_controller::policy::actor_file::{INPUT_NAME, OUTPUT_NAME};

use crate::actor::{Actor, EXPONENT, NO_CLAIM, SQUARINGS};
use crate::features::{Head, Layout, Prior, TINY};
use crate::onnx::{Ends, Graph, Value};

pub use network::NetworkNodes;

/// Writes an actor for the room of a channel as an ONNX file with the given metadata.
///
/// # Errors
/// Those of candle, when a parameter cannot be read.
pub fn export(actor: &Actor, model: &ChannelModel, metadata: &[(String, String)]) -> Result<Vec<u8>> {
    let mut graph = Graph::default();
    let observed = observe(&mut graph, &actor.layout, actor.head.prior);
    let network = NetworkNodes::new(&mut graph, &actor.network)?;
    let mut logits = graph.constant("no_logits", &[actor.layout.slots(), 1], &vec![0.0; actor.layout.slots()]);
    for _ in 0..actor.rounds {
        let amplitude = amplitude(&mut graph, &observed, &logits, actor.head.range);
        let input = graph.concat(&[&observed.features, &logits, &amplitude], 1);
        // Also keeps tract from splitting the product that follows into one for each column.
        let input = graph.node("Mul", &[&input, &observed.present]);
        logits = network.apply(&mut graph, &input, &observed.present);
    }
    let weights = weigh(&mut graph, &observed, &logits, actor.head);
    let normal = match model.mode {
        Mode::Specular => specular(&mut graph, model, &observed, &weights),
        Mode::Paper { .. } => paper(&mut graph, model, &observed, &weights),
    };
    let mirrors = model.mirrors.len();
    angles(&mut graph, &normal);
    let input = (INPUT_NAME, actor.layout.encoder.len());
    Ok(graph.finish(&Ends { name: "heliostat-actor", input, output: (OUTPUT_NAME, 2 * mirrors) }, metadata))
}

/// The parts of the observation that later stages use.
struct Observed {
    slots: usize,
    mirrors: usize,
    /// (slots, 1)
    present: Value,
    /// (slots, 3)
    positions: Value,
    /// (slots, mirrors)
    steering: Value,
    /// (slots, 1), with [`TINY`] added
    total: Value,
    /// (slots, 1)
    direct: Value,
    /// (p_k a_km / sum_j p_j a_jm)^8 with the weights p of logits of zero, (slots, mirrors)
    claims: Value,
    /// The same times a_km, (slots, mirrors)
    gains: Value,
    /// (slots, features)
    features: Value,
}

fn observe(graph: &mut Graph, layout: &Layout, prior: Prior) -> Observed {
    let (encoder, slots) = (layout.encoder, layout.slots());
    let part = |graph: &mut Graph, range: Range<usize>| {
        let width = range.len() / slots;
        let flat = graph.slice(INPUT_NAME, 1, range);
        graph.reshape(&flat, &[slots, width])
    };
    let present = part(graph, encoder.present());
    let positions = part(graph, encoder.positions());
    let direct = part(graph, encoder.los_amplitude());
    let need = part(graph, encoder.need());
    let steering = part(graph, encoder.steering_amplitude());

    let one = graph.scalar(1.0);
    let tiny = graph.scalar(TINY);
    let sum = graph.sum(&steering, 1);
    let total = graph.node("Add", &[&sum, &tiny]);
    let no_claim = graph.scalar(NO_CLAIM);
    let asked = match prior {
        Prior::Uniform => steering.clone(),
        Prior::EqualShare => graph.node("Div", &[&steering, &total]),
    };
    let all = graph.sum(&asked, 0);
    let all = graph.node("Add", &[&all, &no_claim]);
    let mut claims = graph.node("Div", &[&asked, &all]);
    for _ in 0..SQUARINGS {
        claims = graph.node("Mul", &[&claims, &claims]);
    }
    let gains = graph.node("Mul", &[&claims, &steering]);
    let half_room = graph.constant("half_room", &[1, 2], &layout.half_room_m);
    let plane = graph.slice(&positions, 1, 0..2);
    let plane = graph.node("Div", &[&plane, &half_room]);
    let log = |graph: &mut Graph, value: &str| {
        let value = graph.node("Add", &[value, &one]);
        graph.node("Log", &[&value])
    };
    let log_direct = log(graph, &direct);
    let log_total = log(graph, &sum);
    let slot_count = graph.scalar(slots as f32);
    let users = graph.sum(&present, 0);
    let crowd = graph.node("Mul", &[&present, &users]);
    let crowd = graph.node("Div", &[&crowd, &slot_count]);
    let features = graph.concat(&[&present, &plane, &log_direct, &log_total, &need, &crowd], 1);
    Observed { slots, mirrors: encoder.mirrors(), present, positions, total, direct, claims, gains, features, steering }
}

/// ln(1 + amplitude) of each user under the logits by the smooth decoder; (slots, 1).
fn amplitude(graph: &mut Graph, observed: &Observed, logits: &str, range: f32) -> Value {
    let (one, no_claim) = (graph.scalar(1.0), graph.scalar(NO_CLAIM));
    let exponent = graph.scalar(EXPONENT * range);
    let weights = graph.node("Mul", &[logits, &exponent]);
    let weights = graph.node("Exp", &[&weights]);
    let weights = graph.node("Mul", &[&weights, &observed.present]);
    let row = graph.reshape(&weights, &[1, observed.slots]);
    let all = graph.node("MatMul", &[&row, &observed.claims]);
    let all = graph.node("Add", &[&all, &no_claim]);
    let inverse = graph.node("Div", &[&one, &all]);
    let inverse = graph.reshape(&inverse, &[observed.mirrors, 1]);
    let given = graph.node("MatMul", &[&observed.gains, &inverse]);
    let given = graph.node("Mul", &[&given, &weights]);
    let amplitude = graph.node("Add", &[&observed.direct, &given]);
    let amplitude = graph.node("Add", &[&amplitude, &one]);
    graph.node("Log", &[&amplitude])
}

fn weigh(graph: &mut Graph, observed: &Observed, logits: &str, head: Head) -> Value {
    let range = graph.scalar(head.range);
    let exponent = graph.node("Mul", &[logits, &range]);
    let weight = graph.node("Exp", &[&exponent]);
    let weight = graph.node("Mul", &[&weight, &observed.present]);
    match head.prior {
        Prior::Uniform => weight,
        Prior::EqualShare => graph.node("Div", &[&weight, &observed.total]),
    }
}

/// The coordinates of the mirrors' centres, (1, mirrors) each, in the frame of the wall.
fn centres(graph: &mut Graph, mirrors: &MirrorArray) -> [Value; 3] {
    let inside: Vec<Vec3> = mirrors.positions().iter().map(|centre| mirrors.wall_from_room(centre)).collect();
    rows(graph, "centre", &inside)
}

/// Vectors as constants of their x, y and z, (1, n) each.
fn rows(graph: &mut Graph, name: &str, vectors: &[Vec3]) -> [Value; 3] {
    [0, 1, 2].map(|axis| {
        let values: Vec<f32> = vectors.iter().map(|vector| vector[axis] as f32).collect();
        graph.constant(&format!("{name}_{axis}"), &[1, vectors.len()], &values)
    })
}

/// The coordinates of the users, (slots, 1) each, in the frame of the wall.
fn users(graph: &mut Graph, mirrors: &MirrorArray, observed: &Observed) -> [Value; 3] {
    let room = [0, 1, 2].map(|axis| graph.slice(&observed.positions, 1, axis..axis + 1));
    let axes = [Vec3::x(), Vec3::y(), Vec3::z()].map(|axis| mirrors.wall_from_room(&axis));
    [0, 1, 2].map(|row| {
        // Each coordinate of one frame is plus or minus one of the other, since walls stand at right angles.
        let column = (0..3).find(|&column| axes[column][row] != 0.0).expect("a rotation has no empty row");
        if axes[column][row] > 0.0 { room[column].clone() } else { graph.node("Neg", &[&room[column]]) }
    })
}

/// The length of vectors from their coordinates.
fn length(graph: &mut Graph, [x, y, z]: &[Value; 3]) -> Value {
    let [x, y, z] = [x, y, z].map(|value| graph.node("Mul", &[value, value]));
    let sum = graph.node("Add", &[&x, &y]);
    let sum = graph.node("Add", &[&sum, &z]);
    graph.node("Sqrt", &[&sum])
}

/// Each mirror serves the user with the largest weighted amplitude, at the bisector; normals of any length, (1, mirrors) each.
fn specular(graph: &mut Graph, model: &ChannelModel, observed: &Observed, weights: &str) -> [Value; 3] {
    let (mirrors, led) = (&model.mirrors, model.leds[0].position);
    let scores = graph.node("Mul", &[&observed.steering, weights]);
    let served = graph.argmax(&scores, 0);
    let [users, centres] = [users(graph, mirrors, observed), centres(graph, mirrors)];
    let towards_user = [0, 1, 2].map(|axis| {
        let target = graph.gather(&users[axis], &served);
        let target = graph.reshape(&target, &[1, observed.mirrors]);
        graph.node("Sub", &[&target, &centres[axis]])
    });
    let towards_led: Vec<Vec3> =
        mirrors.positions().iter().map(|centre| mirrors.wall_from_room(&(led - centre).normalize())).collect();
    let towards_led = rows(graph, "towards_led", &towards_led);
    // The bisector of two directions, times the distance to the user: its length does not matter.
    let distance = length(graph, &towards_user);
    [0, 1, 2].map(|axis| {
        let scaled = graph.node("Mul", &[&towards_led[axis], &distance]);
        graph.node("Add", &[&scaled, &towards_user[axis]])
    })
}

/// The sum over users of weight, coefficient and direction, flat where it is zero; normals of any length, (1, mirrors) each.
fn paper(graph: &mut Graph, model: &ChannelModel, observed: &Observed, weights: &str) -> [Value; 3] {
    let mirrors = &model.mirrors;
    let [users, centres] = [users(graph, mirrors, observed), centres(graph, mirrors)];
    let towards_users = [0, 1, 2].map(|axis| graph.node("Sub", &[&users[axis], &centres[axis]]));
    let distance = length(graph, &towards_users);
    let pull = graph.node("Mul", &[&observed.steering, weights]);
    let pull = graph.node("Div", &[&pull, &distance]);
    let normal = towards_users.map(|coordinate| {
        let parts = graph.node("Mul", &[&coordinate, &pull]);
        graph.sum(&parts, 0)
    });
    // Far below any pull that carries data; it decides only where there is none.
    let inward = graph.scalar(-1e-12);
    let [x, y, z] = normal;
    [x, graph.node("Add", &[&y, &inward]), z]
}

/// Roll and yaw of normals in the frame of the wall; adds the output node.
fn angles(graph: &mut Graph, [x, y, z]: &[Value; 3]) {
    let quotient = graph.node("Div", &[x, y]);
    let yaw = graph.node("Atan", &[&quotient]);
    let [xx, yy] = [x, y].map(|value| graph.node("Mul", &[value, value]));
    let across = graph.node("Add", &[&xx, &yy]);
    let across = graph.node("Sqrt", &[&across]);
    let down = graph.node("Neg", &[z]);
    let quotient = graph.node("Div", &[&down, &across]);
    let roll = graph.node("Atan", &[&quotient]);
    graph.concat(&[&roll, &yaw], 1);
}
