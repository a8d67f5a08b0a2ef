//! The exported actor: observation in, mirror angles out, all in one ONNX graph.
//!
//! Three parts follow each other in the graph: the scaling of the features (in the weights of the first layer), the trained network, and the
//! geometric decoder, the same that `heliostat_channel::decode` computes in Rust. A controller therefore needs no knowledge of how an
//! actor was trained, and no actor can point a mirror where the geometry does not allow.

mod network;

use candle_core::Result;
use heliostat_channel::mirrors::MirrorArray;
use heliostat_channel::{ChannelModel, Mode, Vec3};
use heliostat_decide::observation::Summary;
use heliostat_decide::policy::actor_file::{INPUT_NAME, OUTPUT_NAME};

use crate::actor::{Actor, EXPONENT, SQUARINGS};
use crate::features::{FEATURES, Head, Layout, Prior};
use crate::onnx::{Ends, Graph, Value};

pub use network::{Column, Entry, NetworkNodes};

/// Writes an actor for the room of a channel as an ONNX file with the given metadata.
///
/// An engine spends more on starting a node than on the arithmetic in it, so the graph has few nodes that do much, of those kinds that engines do quickly.
///
/// # Errors
/// Those of candle, when a parameter cannot be read.
pub fn export(actor: &Actor, model: &ChannelModel, metadata: &[(String, String)]) -> Result<Vec<u8>> {
    let mut graph = Graph::default();
    let observed = observe(&mut graph, actor);
    let network = NetworkNodes::new(&mut graph, &actor.network)?;
    let sharpness = EXPONENT * actor.head.range;
    let mut columns = columns(&actor.layout);
    let mut first = columns.clone();
    // Before the first round nobody has a logit, and so everybody the balanced share.
    first[Summary::LogBalanced as usize].push((AMPLITUDE, 1.0));
    let entry = network.entry(&mut graph, &first)?;
    let users = graph.transpose(&observed.summary);
    let mut logits = network.apply(&mut graph, &entry, &users);
    if actor.rounds > 1 {
        columns.extend([vec![(LOGIT, 1.0 / sharpness)], vec![(AMPLITUDE, 1.0)]]);
        let entry = network.entry(&mut graph, &columns)?;
        let claims = Claims::new(&mut graph, &observed, actor.head);
        let sharpness = graph.scalar(sharpness);
        let present = column(&mut graph, &observed, Summary::Present as usize);
        for _ in 1..actor.rounds {
            let exponents = graph.node("Mul", &[&logits, &sharpness]);
            let amplitude = claims.amplitude(&mut graph, &exponents);
            let input = graph.concat(&[&users, &exponents, &amplitude], 1);
            // Empties absent slots, and keeps tract from splitting the product that follows into one for each part.
            let input = graph.node("Mul", &[&input, &present]);
            logits = network.apply(&mut graph, &entry, &input);
        }
    }
    let weighed = weigh(&mut graph, &observed, &logits, actor.head);
    let normal = match model.mode {
        Mode::Specular => specular(&mut graph, model, &observed, &weighed),
        Mode::Paper { .. } => paper(&mut graph, model, &observed, &weighed),
    };
    angles(&mut graph, &normal);
    let input = (INPUT_NAME, actor.layout.encoder.len());
    Ok(graph.finish(&Ends { name: "heliostat-actor", input, output: (OUTPUT_NAME, 2 * model.mirrors.len()) }, metadata))
}

/// The place of the logit of the round before among the inputs of the actor's network.
const LOGIT: usize = FEATURES;

/// The place of ln(1 + amplitude) under that logit.
const AMPLITUDE: usize = FEATURES + 1;

/// In the place of [`NO_CLAIM`](crate::actor::NO_CLAIM): claims are not divided by their sum here, and may be small.
const NOTHING: f32 = 1e-35;

/// Which of the network's inputs each column of the summary makes.
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
struct Claims {
    /// (s p_k a_km)^8 with the weights p of logits of zero and one s for all, (slots, mirrors).
    claims: Value,
    /// The same times a_km.
    gains: Value,
    /// 1 + direct amplitude, (slots, 1).
    raised_direct: Value,
}

impl Claims {
    fn new(graph: &mut Graph, observed: &Observed, head: Head) -> Self {
        let nothing = graph.scalar(NOTHING);
        let mut claims = match head.prior {
            // Of any size: only beside each other do their powers stay within f32.
            Prior::Uniform => {
                let something = graph.node("Add", &[&observed.steering, &nothing]);
                let share = over_all(graph, &something);
                graph.node("Mul", &[&observed.steering, &share])
            }
            Prior::Balanced => {
                let weight = column(graph, observed, Summary::LogWeight as usize);
                let weight = graph.node("Exp", &[&weight]);
                graph.node("Mul", &[&observed.steering, &weight])
            }
        };
        for _ in 0..SQUARINGS {
            claims = graph.node("Mul", &[&claims, &claims]);
        }
        let gains = graph.node("Mul", &[&claims, &observed.steering]);
        // So that no sum of claims is zero.
        let claims = graph.node("Add", &[&claims, &nothing]);
        let log_direct = column(graph, observed, Summary::LogDirect as usize);
        let raised_direct = graph.node("Exp", &[&log_direct]);
        Self { claims, gains, raised_direct }
    }

    /// ln(1 + amplitude) of each user, from [`EXPONENT`] times what the weights are the exponential of; (slots, 1).
    fn amplitude(&self, graph: &mut Graph, exponents: &str) -> Value {
        let weights = graph.node("Exp", &[exponents]);
        let claims = graph.node("Mul", &[&self.claims, &weights]);
        let share = over_all(graph, &claims);
        let share = graph.transpose(&share);
        let given = graph.node("MatMul", &[&self.gains, &share]);
        let given = graph.node("Mul", &[&given, &weights]);
        let raised = graph.node("Add", &[&given, &self.raised_direct]);
        graph.node("Log", &[&raised])
    }
}

/// One over the sum of each mirror's column, (1, mirrors).
fn over_all(graph: &mut Graph, table: &str) -> Value {
    let all = graph.sum(table, 0);
    graph.node("Reciprocal", &[&all])
}

/// What each user asks of each mirror: steering amplitudes times weights, up to a factor for all; (slots, mirrors).
fn weigh(graph: &mut Graph, observed: &Observed, logits: &str, head: Head) -> Value {
    let range = graph.scalar(head.range);
    let mut exponent = graph.node("Mul", &[logits, &range]);
    if head.prior == Prior::Balanced {
        let prior = column(graph, observed, Summary::LogWeight as usize);
        exponent = graph.node("Add", &[&exponent, &prior]);
    }
    let weight = graph.node("Exp", &[&exponent]);
    graph.node("Mul", &[&observed.steering, &weight])
}

/// A point or direction as the graph has it: along the wall, into the wall, and down.
fn seen(mirrors: &MirrorArray, vector: &Vec3) -> Vec3 {
    let turned = mirrors.wall_from_room(vector);
    Vec3::new(turned.x, turned.y, -turned.z)
}

/// Vectors as a constant of their components, (3, n).
fn rows(graph: &mut Graph, name: &str, vectors: impl Iterator<Item = Vec3> + Clone) -> Value {
    let values: Vec<f32> =
        [0, 1, 2].iter().flat_map(|&axis| vectors.clone().map(move |vector| vector[axis] as f32)).collect();
    graph.constant(name, &[3, values.len() / 3], &values)
}

/// The mirrors' centres.
fn centres(mirrors: &MirrorArray) -> impl Iterator<Item = Vec3> + Clone {
    mirrors.positions().iter().map(|centre| seen(mirrors, centre))
}

/// Where the users are, (3, slots).
fn places(graph: &mut Graph, observed: &Observed, mirrors: &MirrorArray) -> Value {
    let first = Summary::Place as usize;
    let places = graph.slice(&observed.summary, 0, first..first + 3);
    let axes = [Vec3::x(), Vec3::y(), Vec3::z()];
    let turn = rows(graph, "turn", axes.iter().map(|axis| seen(mirrors, axis)));
    graph.node("MatMul", &[&turn, &places])
}

/// Each mirror serves the user with the largest weighted amplitude, the first where nobody sees it, at the bisector; normals of any length, (3, mirrors).
fn specular(graph: &mut Graph, model: &ChannelModel, observed: &Observed, scores: &str) -> Value {
    let (mirrors, led) = (&model.mirrors, model.leds[0].position);
    let served = graph.best_row(scores, [observed.slots, observed.mirrors]);
    let places = places(graph, observed, mirrors);
    let target = graph.gather(&places, &served, 1);
    let from = rows(graph, "centres", centres(mirrors));
    let towards_user = graph.node("Sub", &[&target, &from]);
    let towards_led = centres(mirrors).map(|centre| (seen(mirrors, &led) - centre).normalize());
    let towards_led = rows(graph, "towards_led", towards_led);
    // The bisector of two directions, times the distance to the user: its length does not matter.
    let squares = graph.node("Mul", &[&towards_user, &towards_user]);
    let distance = graph.sum(&squares, 0);
    let distance = graph.node("Sqrt", &[&distance]);
    let scaled = graph.node("Mul", &[&towards_led, &distance]);
    graph.node("Add", &[&scaled, &towards_user])
}

/// The sum over users of weight, coefficient and direction, flat where it is zero; normals of any length, (3, mirrors).
fn paper(graph: &mut Graph, model: &ChannelModel, observed: &Observed, pull: &str) -> Value {
    let mirrors = &model.mirrors;
    let squares = [0, 1, 2].map(|axis| {
        let place = column(graph, observed, Summary::Place as usize + axis);
        let centre: Vec<f32> = mirrors.positions().iter().map(|centre| centre[axis] as f32).collect();
        let centre = graph.constant(&format!("centre_{axis}"), &[1, centre.len()], &centre);
        let way = graph.node("Sub", &[&place, &centre]);
        graph.node("Mul", &[&way, &way])
    });
    let squared = graph.node("Add", &[&squares[0], &squares[1]]);
    let squared = graph.node("Add", &[&squared, &squares[2]]);
    let distance = graph.node("Sqrt", &[&squared]);
    let pull = graph.node("Div", &[pull, &distance]);
    let places = places(graph, observed, mirrors);
    let towards_users = graph.node("MatMul", &[&places, &pull]);
    let from = rows(graph, "centres", centres(mirrors));
    let all = graph.sum(&pull, 0);
    let from = graph.node("Mul", &[&from, &all]);
    let normal = graph.node("Sub", &[&towards_users, &from]);
    // Far below any pull that carries data; it decides only where there is none.
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
