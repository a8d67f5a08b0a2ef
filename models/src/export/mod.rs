//! The exported actor: observation in, mirror angles out, all in one ONNX graph.
//!
//! Three parts follow each other in the graph: the features of [`crate::features`], the trained network, and the geometric
//! decoder, the same that `heliostat_channel::decode` computes in Rust. A controller therefore needs no knowledge of how an
//! actor was trained, and no actor can point a mirror where the geometry does not allow.

mod network;

use candle_core::Result;
use heliostat_channel::mirrors::MirrorArray;
use heliostat_channel::{ChannelModel, Mode, Vec3};
use heliostat_controller::policy::actor_file::{INPUT_NAME, OUTPUT_NAME};

use crate::actor::{Actor, EXPONENT, SQUARINGS};
use crate::features::{FEATURES, Head, LOG_DIRECT, Layout, PRESENT, Prior, TINY};
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
    let known = columns(&actor.layout, Some(AMPLITUDE));
    let entry = network.entry(&mut graph, &known)?;
    let mut logits = run(&mut graph, &network, &entry, &observed, &[]);
    if actor.rounds > 1 {
        let before = [Some((LOGIT, 1.0 / sharpness)), Some((AMPLITUDE, 1.0))];
        let entry = network.entry(&mut graph, &[columns(&actor.layout, None), before.to_vec()].concat())?;
        let sharpness = graph.scalar(sharpness);
        for _ in 1..actor.rounds {
            let exponents = graph.node("Mul", &[&logits, &sharpness]);
            let amplitude = amplitude(&mut graph, &observed, &exponents);
            logits = run(&mut graph, &network, &entry, &observed, &[&exponents, &amplitude]);
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

/// What is picked from the observation for each user, in this order.
#[derive(Clone, Copy)]
enum Picked {
    Present,
    /// x, y and z in m.
    Place,
    /// Direct amplitude.
    Direct = 4,
    Need,
}

/// Values picked for each user.
const PICKED: usize = 6;

/// Which inputs of the actor's network stand in the columns that all rounds have: what was picked, the number of users, and the three logarithms.
fn columns(layout: &Layout, first_amplitude: Option<usize>) -> Vec<Column> {
    let [x, y] = layout.half_room_m.map(|half| 1.0 / half);
    let mut columns = vec![None; PICKED];
    columns[Picked::Present as usize] = Some((PRESENT, 1.0));
    columns[Picked::Place as usize] = Some((1, x));
    columns[Picked::Place as usize + 1] = Some((2, y));
    columns[Picked::Need as usize] = Some((5, 1.0));
    columns.push(Some((6, 1.0 / layout.slots() as f32)));
    columns.extend([Some((LOG_DIRECT, 1.0)), Some((4, 1.0)), first_amplitude.map(|input| (input, 1.0))]);
    columns
}

/// The parts of the observation that later stages use.
struct Observed {
    slots: usize,
    mirrors: usize,
    /// See [`Picked`]; (slots, [`PICKED`])
    picked: Value,
    /// What all rounds are given of each user, as [`columns`] says; (slots, columns).
    known: Value,
    /// (slots, 1)
    present: Value,
    /// 1 / number of users, (1, 1)
    per_user: Value,
    /// 1 + direct amplitude, (slots, 1)
    raised_direct: Value,
    /// Steering amplitudes times the weights of logits of zero, or as many times as much for all, (slots, mirrors)
    asked: Value,
    /// (s p_k a_km)^8 with the weights p of logits of zero and one s for all, (slots, mirrors)
    claims: Value,
    /// The same times a_km, (slots, mirrors)
    gains: Value,
}

fn observe(graph: &mut Graph, actor: &Actor) -> Observed {
    let (layout, encoder) = (&actor.layout, actor.layout.encoder);
    let (slots, mirrors) = (layout.slots(), encoder.mirrors());
    let of_slot = |slot: usize| {
        let place = encoder.positions().start + 3 * slot;
        let [present, direct, need] =
            [encoder.present(), encoder.los_amplitude(), encoder.need()].map(|part| part.start + slot);
        [present, place, place + 1, place + 2, direct, need]
    };
    let places: Vec<usize> = (0..slots).flat_map(of_slot).collect();
    let picked = graph.picked(INPUT_NAME, &places, [slots, PICKED]);
    let column = |graph: &mut Graph, value: &str, column: usize| graph.slice(value, 1, column..column + 1);
    let present = column(graph, &picked, Picked::Present as usize);
    let direct = column(graph, &picked, Picked::Direct as usize);
    let users = graph.sum(&present, 0);
    let per_user = graph.node("Reciprocal", &[&users]);
    let crowd = graph.node("Mul", &[&present, &users]);

    let steering = graph.slice(INPUT_NAME, 1, encoder.steering_amplitude());
    let steering = graph.reshape(&steering, &[slots, mirrors]);
    let total = graph.sum(&steering, 1);
    let (asked, mut claims) = match actor.head.prior {
        // Of any size: only beside each other do their powers stay within f32.
        Prior::Uniform => {
            let nothing = graph.scalar(NOTHING);
            let something = graph.node("Add", &[&steering, &nothing]);
            let share = over_all(graph, &something);
            (steering.clone(), graph.node("Mul", &[&steering, &share]))
        }
        Prior::EqualShare => {
            let inverse_total = inverse_total(graph, &total, mirrors);
            let asked = graph.node("Mul", &[&steering, &inverse_total]);
            (asked.clone(), asked)
        }
    };
    for _ in 0..SQUARINGS {
        claims = graph.node("Mul", &[&claims, &claims]);
    }
    let gains = graph.node("Mul", &[&claims, &steering]);
    // So that no sum of claims is zero.
    let nothing = graph.scalar(NOTHING);
    let claims = graph.node("Add", &[&claims, &nothing]);

    let given = given(graph, &gains, &claims);
    let amplitude = graph.node("Add", &[&direct, &given]);
    let one = graph.scalar(1.0);
    let raised = graph.concat(&[&direct, &total, &amplitude], 1);
    let raised = graph.node("Add", &[&raised, &one]);
    let logs = graph.node("Log", &[&raised]);
    let known = graph.concat(&[&picked, &crowd, &logs], 1);
    let raised_direct = column(graph, &raised, 0);
    Observed { slots, mirrors, picked, known, present, per_user, raised_direct, asked, claims, gains }
}

/// sqrt(mirrors) / (total + [`TINY`]): with it a mirror's claims are about as far below 1 where all are alike as they are above where one has everything,
/// and their powers stay within f32.
fn inverse_total(graph: &mut Graph, total: &str, mirrors: usize) -> Value {
    let scale = 1.0 / (mirrors as f32).sqrt();
    let (scale, tiny) = (graph.scalar(scale), graph.scalar(TINY * scale));
    let total = graph.node("Mul", &[total, &scale]);
    let total = graph.node("Add", &[&total, &tiny]);
    graph.node("Reciprocal", &[&total])
}

/// The logits of one round: the network on what is known, and on what the round before found.
fn run(graph: &mut Graph, network: &NetworkNodes<'_>, entry: &Entry, observed: &Observed, found: &[&str]) -> Value {
    let input = match found {
        [] => observed.known.clone(),
        [..] => graph.concat(&[&[observed.known.as_str()], found].concat(), 1),
    };
    // Empties absent slots, and keeps tract from splitting the product that follows into one for each column.
    let input = graph.node("Mul", &[&input, &observed.present]);
    network.apply(graph, entry, &input, &observed.per_user)
}

/// ln(1 + amplitude) of each user by the smooth decoder, from [`EXPONENT`] times what the weights are the exponential of; (slots, 1).
fn amplitude(graph: &mut Graph, observed: &Observed, exponents: &str) -> Value {
    let weights = graph.node("Exp", &[exponents]);
    let claims = graph.node("Mul", &[&observed.claims, &weights]);
    let given = given(graph, &observed.gains, &claims);
    let given = graph.node("Mul", &[&given, &weights]);
    let raised = graph.node("Add", &[&given, &observed.raised_direct]);
    graph.node("Log", &[&raised])
}

/// What each user gets of the gains when every mirror is shared by these claims, over the user's own weight; (slots, 1).
fn given(graph: &mut Graph, gains: &str, claims: &str) -> Value {
    let share = over_all(graph, claims);
    let share = graph.transpose(&share);
    graph.node("MatMul", &[gains, &share])
}

/// One over the sum of each mirror's column, (1, mirrors).
fn over_all(graph: &mut Graph, table: &str) -> Value {
    let all = graph.sum(table, 0);
    graph.node("Reciprocal", &[&all])
}

/// In the place of [`NO_CLAIM`](crate::actor::NO_CLAIM): claims are not divided by their sum here, and may be small.
const NOTHING: f32 = 1e-35;

/// What each user asks of each mirror: steering amplitudes times weights, up to a factor for all; (slots, mirrors).
fn weigh(graph: &mut Graph, observed: &Observed, logits: &str, head: Head) -> Value {
    let range = graph.scalar(head.range);
    let exponent = graph.node("Mul", &[logits, &range]);
    let weight = graph.node("Exp", &[&exponent]);
    graph.node("Mul", &[&observed.asked, &weight])
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
    let first = Picked::Place as usize;
    let places = graph.slice(&observed.picked, 1, first..first + 3);
    let places = graph.transpose(&places);
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
        let place = graph.slice(&observed.picked, 1, Picked::Place as usize + axis..Picked::Place as usize + axis + 1);
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
