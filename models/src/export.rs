//! The exported actor: observation in, mirror angles out, all in one ONNX graph.
//!
//! Three parts follow each other in the graph: the features of [`crate::features`], the trained network, and the geometric
//! decoder, the same that `heliostat_channel::decode` computes in Rust. A controller therefore needs no knowledge of how an
//! actor was trained, and no actor can point a mirror where the geometry does not allow.

use std::ops::Range;

use candle_core::Result;
use heliostat_channel::{ChannelModel, Mode, Vec3};
use heliostat_controller::policy::actor_file::{INPUT_NAME, OUTPUT_NAME};

use crate::actor::{Actor, NO_CLAIM, SQUARINGS};
use crate::features::{Head, Layout, Prior, TINY};
use crate::networks::{Encoder, Network, Shape};
use crate::onnx::{Ends, Graph, Value};

/// Writes an actor for the room of a channel as an ONNX file with the given metadata.
///
/// # Errors
/// Those of candle, when a parameter cannot be read.
pub fn export(actor: &Actor, model: &ChannelModel, metadata: &[(String, String)]) -> Result<Vec<u8>> {
    let mut graph = Graph::default();
    let observed = observe(&mut graph, &actor.layout);
    let network = NetworkNodes::new(&mut graph, &actor.network)?;
    let mut logits = graph.constant("no_logits", &[actor.layout.slots(), 1], &vec![0.0; actor.layout.slots()]);
    for _ in 0..actor.rounds {
        let weights = weigh(&mut graph, &observed, &logits, actor.head);
        let amplitude = amplitude(&mut graph, &observed, &weights);
        let input = graph.concat(&[&observed.features, &logits, &amplitude], 1);
        logits = network.apply(&mut graph, &input, &observed.present);
    }
    let weights = weigh(&mut graph, &observed, &logits, actor.head);
    let normal = match model.mode {
        Mode::Specular => specular(&mut graph, model, &observed, &weights),
        Mode::Paper { .. } => paper(&mut graph, model, &observed, &weights),
    };
    let mirrors = model.mirrors.len();
    angles(&mut graph, &normal, mirrors);
    let input = (INPUT_NAME, actor.layout.encoder.len());
    Ok(graph.finish(&Ends { name: "heliostat-actor", input, output: (OUTPUT_NAME, 2 * mirrors) }, metadata))
}

/// The parts of the observation that later stages use.
struct Observed {
    slots: usize,
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
    /// (slots, features)
    features: Value,
}

fn observe(graph: &mut Graph, layout: &Layout) -> Observed {
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
    Observed { slots, present, positions, steering, total, direct, features }
}

/// ln(1 + amplitude) of each user under the weights by the smooth decoder, zero in absent slots; (slots, 1).
fn amplitude(graph: &mut Graph, observed: &Observed, weights: &str) -> Value {
    let (one, tiny) = (graph.scalar(1.0), graph.scalar(NO_CLAIM));
    let claim = graph.node("Mul", &[&observed.steering, weights]);
    let largest = graph.max(&claim, 0);
    let largest = graph.node("Add", &[&largest, &tiny]);
    let mut claim = graph.node("Div", &[&claim, &largest]);
    for _ in 0..SQUARINGS {
        claim = graph.node("Mul", &[&claim, &claim]);
    }
    let all = graph.sum(&claim, 0);
    let all = graph.node("Add", &[&all, &tiny]);
    let share = graph.node("Div", &[&claim, &all]);
    let given = graph.node("Mul", &[&observed.steering, &share]);
    let given = graph.sum(&given, 1);
    let amplitude = graph.node("Add", &[&observed.direct, &given]);
    let amplitude = graph.node("Add", &[&amplitude, &one]);
    let amplitude = graph.node("Log", &[&amplitude]);
    graph.node("Mul", &[&amplitude, &observed.present])
}

/// The parameters of a network as constants of the graph, so that every round uses the same.
struct NetworkNodes {
    shape: Shape,
    /// Name, weight and bias of each layer.
    layers: Vec<(&'static str, Value, Value)>,
}

impl NetworkNodes {
    fn new(graph: &mut Graph, network: &Network) -> Result<Self> {
        let mut layers = Vec::new();
        for layer in network.layers() {
            let (inputs, outputs) = layer.weight.dims2()?;
            let weight = layer.weight.flatten_all()?.to_vec1::<f32>()?;
            let weight = graph.constant(&format!("{}.weight", layer.name), &[inputs, outputs], &weight);
            let bias = graph.constant(&format!("{}.bias", layer.name), &[1, outputs], &layer.bias.to_vec1::<f32>()?);
            layers.push((layer.name, weight, bias));
        }
        Ok(Self { shape: network.shape(), layers })
    }

    fn linear(&self, graph: &mut Graph, name: &str, input: &str) -> Value {
        let (_, weight, bias) =
            self.layers.iter().find(|layer| layer.0 == name).expect("the encoder fixes layer names");
        let product = graph.node("MatMul", &[input, weight]);
        graph.node("Add", &[&product, bias])
    }

    fn rectified(&self, graph: &mut Graph, name: &str, input: &str) -> Value {
        let raw = self.linear(graph, name, input);
        graph.node("Relu", &[&raw])
    }

    /// Logits in [-1, 1] from inputs (slots, inputs), zero in absent slots; (slots, 1).
    fn apply(&self, graph: &mut Graph, input: &str, present: &str) -> Value {
        let Shape { encoder, slots, inputs, .. } = self.shape;
        let outputs = match encoder {
            Encoder::Mlp => {
                let flat = graph.reshape(input, &[1, slots * inputs]);
                let first = self.rectified(graph, "first", &flat);
                let second = self.rectified(graph, "second", &first);
                let raw = self.linear(graph, "head", &second);
                graph.reshape(&raw, &[slots, 1])
            }
            Encoder::Set => {
                let first = self.rectified(graph, "first", input);
                let pooled = pool(graph, &first, present);
                let context = self.linear(graph, "context", &pooled);
                let second = self.linear(graph, "second", &first);
                let second = graph.node("Add", &[&second, &context]);
                let second = graph.node("Relu", &[&second]);
                self.linear(graph, "head", &second)
            }
        };
        let logits = graph.node("Tanh", &[&outputs]);
        graph.node("Mul", &[&logits, present])
    }
}

/// Mean and maximum over the users present of rows that are nowhere negative, (1, 2 width).
fn pool(graph: &mut Graph, rows: &str, present: &str) -> Value {
    let masked = graph.node("Mul", &[rows, present]);
    let sum = graph.sum(&masked, 0);
    let users = graph.sum(present, 0);
    let mean = graph.node("Div", &[&sum, &users]);
    let max = graph.max(&masked, 0);
    graph.concat(&[&mean, &max], 1)
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

/// Mirror centres (mirrors, 3) and user positions (slots, 3) in the frame of the wall.
fn in_wall_frame(graph: &mut Graph, model: &ChannelModel, observed: &Observed) -> (Value, Value) {
    let mirrors = &model.mirrors;
    let centres: Vec<f32> =
        mirrors.positions().iter().flat_map(|centre| single(&mirrors.wall_from_room(centre))).collect();
    let centres = graph.constant("centres", &[mirrors.len(), 3], &centres);
    // Positions are rows, so the rotation stands on the right, transposed: its rows are the images of the room's axes.
    let axes = [Vec3::x(), Vec3::y(), Vec3::z()];
    let rotation: Vec<f32> = axes.iter().flat_map(|axis| single(&mirrors.wall_from_room(axis))).collect();
    let rotation = graph.constant("wall_from_room_transposed", &[3, 3], &rotation);
    let users = graph.node("MatMul", &[&observed.positions, &rotation]);
    (centres, users)
}

fn single(vector: &Vec3) -> [f32; 3] {
    [vector.x as f32, vector.y as f32, vector.z as f32]
}

/// Vectors scaled to length 1 along the last axis.
fn unit(graph: &mut Graph, vectors: &str, axis: usize) -> Value {
    let squares = graph.node("Mul", &[vectors, vectors]);
    let squares = graph.sum(&squares, axis);
    let length = graph.node("Sqrt", &[&squares]);
    graph.node("Div", &[vectors, &length])
}

/// Each mirror serves the user with the largest weighted amplitude, at the bisector; (mirrors, 3), any length.
fn specular(graph: &mut Graph, model: &ChannelModel, observed: &Observed, weights: &str) -> Value {
    let (mirrors, led) = (&model.mirrors, model.leds[0].position);
    let (centres, users) = in_wall_frame(graph, model, observed);
    let scores = graph.node("Mul", &[&observed.steering, weights]);
    let served = graph.argmax(&scores, 0);
    let target = graph.gather(&users, &served);
    let towards_user = graph.node("Sub", &[&target, &centres]);
    let towards_user = unit(graph, &towards_user, 1);
    let towards = |centre: &Vec3| single(&mirrors.wall_from_room(&(led - centre).normalize()));
    let towards_led: Vec<f32> = mirrors.positions().iter().flat_map(towards).collect();
    let towards_led = graph.constant("towards_led", &[mirrors.len(), 3], &towards_led);
    graph.node("Add", &[&towards_user, &towards_led])
}

/// The sum over users of weight, coefficient and direction, flat where it is zero; (mirrors, 3), any length.
fn paper(graph: &mut Graph, model: &ChannelModel, observed: &Observed, weights: &str) -> Value {
    let mirrors = model.mirrors.len();
    let (centres, users) = in_wall_frame(graph, model, observed);
    let users = graph.reshape(&users, &[observed.slots, 1, 3]);
    let centres = graph.reshape(&centres, &[1, mirrors, 3]);
    let directions = graph.node("Sub", &[&users, &centres]);
    let directions = unit(graph, &directions, 2);
    let scores = graph.node("Mul", &[&observed.steering, weights]);
    let scores = graph.reshape(&scores, &[observed.slots, mirrors, 1]);
    let pulls = graph.node("Mul", &[&directions, &scores]);
    let pull = graph.sum(&pulls, 0);
    let pull = graph.reshape(&pull, &[mirrors, 3]);
    // Far below any pull that carries data; it decides only where there is none.
    let flat = graph.constant("flat", &[1, 3], &[0.0, -1e-12, 0.0]);
    graph.node("Add", &[&pull, &flat])
}

/// Roll and yaw of normals in the frame of the wall; adds the output node.
fn angles(graph: &mut Graph, normal: &str, mirrors: usize) {
    let [x, y, z] = [0, 1, 2].map(|axis| graph.slice(normal, 1, axis..axis + 1));
    let quotient = graph.node("Div", &[&x, &y]);
    let yaw = graph.node("Atan", &[&quotient]);
    let plane = graph.slice(normal, 1, 0..2);
    let squares = graph.node("Mul", &[&plane, &plane]);
    let squares = graph.sum(&squares, 1);
    let across = graph.node("Sqrt", &[&squares]);
    let down = graph.node("Neg", &[&z]);
    let quotient = graph.node("Div", &[&down, &across]);
    let roll = graph.node("Atan", &[&quotient]);
    let both = graph.concat(&[&roll, &yaw], 0);
    graph.reshape(&both, &[1, 2 * mirrors]);
}
