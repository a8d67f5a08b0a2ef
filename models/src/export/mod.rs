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

use crate::actor::{Actor, EXPONENT, NO_CLAIM, SQUARINGS};
use crate::features::{Head, Layout, Prior, TINY};
use crate::onnx::{Ends, Graph, Value};

pub use network::NetworkNodes;

/// Writes an actor for the room of a channel as an ONNX file with the given metadata.
///
/// An engine spends more on starting a node than on the arithmetic in it, so the graph has few nodes that do much: one product picks and scales
/// what the observation says of each user, and one gathers where each mirror has to look.
///
/// # Errors
/// Those of candle, when a parameter cannot be read.
pub fn export(actor: &Actor, model: &ChannelModel, metadata: &[(String, String)]) -> Result<Vec<u8>> {
    let mut graph = Graph::default();
    let observed = observe(&mut graph, actor, &model.mirrors);
    let network = NetworkNodes::new(&mut graph, &actor.network, &INPUT_ROWS)?;
    let (slots, one) = (actor.layout.slots(), graph.scalar(1.0));
    let mut logits: Option<Value> = None;
    for _ in 0..actor.rounds {
        let amplitude = match &logits {
            None => first_amplitude(&mut graph, &observed),
            Some(logits) => amplitude(&mut graph, &observed, logits, actor.head.range),
        };
        let amplitude = graph.node("Add", &[&amplitude, &one]);
        let amplitude = graph.node("Log", &[&amplitude]);
        let before = logits.unwrap_or_else(|| graph.constant("no_logits", &[slots, 1], &vec![0.0; slots]));
        let input = graph.concat(&[&observed.picked, &observed.logs, &before, &amplitude], 1);
        // Empties absent slots, and keeps tract from splitting the product that follows into one for each column.
        let input = graph.node("Mul", &[&input, &observed.present]);
        logits = Some(network.apply(&mut graph, &input, &observed.present, &observed.share));
    }
    let logits = logits.expect("an actor has a round");
    let weights = weigh(&mut graph, &observed, &logits, actor.head);
    let normal = match model.mode {
        Mode::Specular => specular(&mut graph, model, &observed, &weights),
        Mode::Paper { .. } => paper(&mut graph, model, &observed, &weights),
    };
    angles(&mut graph, &normal);
    let input = (INPUT_NAME, actor.layout.encoder.len());
    Ok(graph.finish(&Ends { name: "heliostat-actor", input, output: (OUTPUT_NAME, 2 * model.mirrors.len()) }, metadata))
}

/// What is picked from the observation for each user, in this order.
#[derive(Clone, Copy)]
enum Picked {
    /// Direct amplitude.
    Direct,
    /// The user's place in the frame of the wall, x, y and z in m.
    Place,
    Present = 4,
    /// x and y over half the room.
    Plane,
    Need = 7,
    /// Number of users over the number of slots, in absent slots too.
    Crowd,
}

/// Values picked for each user.
const PICKED: usize = 9;

/// Which input of the actor's network stands in each column of what it is given: what was picked, both logarithms, the logit and the amplitude.
const INPUT_ROWS: [Option<usize>; PICKED + 4] =
    [None, None, None, None, Some(0), Some(1), Some(2), Some(5), Some(6), Some(3), Some(4), Some(7), Some(8)];

/// The parts of the observation that later stages use.
struct Observed {
    slots: usize,
    mirrors: usize,
    /// See [`Picked`]; (slots, [`PICKED`])
    picked: Value,
    /// ln(1 + direct amplitude) and ln(1 + sum of the steering amplitudes), (slots, 2)
    logs: Value,
    /// (slots, 1)
    present: Value,
    /// Present over the number of users, (slots, 1)
    share: Value,
    /// (slots, 1)
    direct: Value,
    /// (slots, mirrors)
    steering: Value,
    /// 1 / (sum of the steering amplitudes + [`TINY`]), (slots, 1)
    inverse_total: Value,
    /// (p_k a_km / sum_j p_j a_jm)^8 with the weights p of logits of zero, (slots, mirrors)
    claims: Value,
    /// The same times a_km, (slots, mirrors)
    gains: Value,
}

impl Observed {
    /// Columns of what was picked, (slots, columns).
    fn columns(&self, graph: &mut Graph, first: Picked, columns: usize) -> Value {
        graph.slice(&self.picked, 1, first as usize..first as usize + columns)
    }
}

/// From the presence, places, direct amplitudes and needs in a row to [`Picked`], user by user: (6 slots, slots x picked).
fn picking(layout: &Layout, mirrors: &MirrorArray) -> Vec<f32> {
    let (encoder, slots) = (layout.encoder, layout.slots());
    let width = slots * PICKED;
    let mut matrix = vec![0.0; encoder.need().end * width];
    let axes = [Vec3::x(), Vec3::y(), Vec3::z()].map(|axis| mirrors.wall_from_room(&axis));
    for slot in 0..slots {
        let mut put = |row: usize, picked: Picked, offset: usize, value: f32| {
            matrix[row * width + slot * PICKED + picked as usize + offset] = value;
        };
        let place = encoder.positions().start + 3 * slot;
        put(encoder.los_amplitude().start + slot, Picked::Direct, 0, 1.0);
        put(encoder.present().start + slot, Picked::Present, 0, 1.0);
        put(encoder.need().start + slot, Picked::Need, 0, 1.0);
        for other in encoder.present() {
            put(other, Picked::Crowd, 0, 1.0 / slots as f32);
        }
        for (axis, turned) in axes.iter().enumerate() {
            for to in 0..3 {
                put(place + axis, Picked::Place, to, turned[to] as f32);
            }
        }
        for (axis, half) in layout.half_room_m.iter().enumerate() {
            put(place + axis, Picked::Plane, axis, 1.0 / half);
        }
    }
    matrix
}

fn observe(graph: &mut Graph, actor: &Actor, array: &MirrorArray) -> Observed {
    let (layout, encoder) = (&actor.layout, actor.layout.encoder);
    let (slots, mirrors) = (layout.slots(), encoder.mirrors());
    let matrix = graph.constant("picking", &[encoder.need().end, slots * PICKED], &picking(layout, array));
    let row = graph.slice(INPUT_NAME, 1, 0..encoder.need().end);
    let picked = graph.node("MatMul", &[&row, &matrix]);
    let picked = graph.reshape(&picked, &[slots, PICKED]);
    let steering = graph.slice(INPUT_NAME, 1, encoder.steering_amplitude());
    let steering = graph.reshape(&steering, &[slots, mirrors]);

    let (one, tiny, no_claim) = (graph.scalar(1.0), graph.scalar(TINY), graph.scalar(NO_CLAIM));
    let column =
        |graph: &mut Graph, picked: &str, column: Picked| graph.slice(picked, 1, column as usize..column as usize + 1);
    let direct = column(graph, &picked, Picked::Direct);
    let present = column(graph, &picked, Picked::Present);
    let crowd = column(graph, &picked, Picked::Crowd);
    let users = graph.scalar(slots as f32);
    let users = graph.node("Mul", &[&crowd, &users]);
    let share = graph.node("Div", &[&present, &users]);
    let total = graph.sum(&steering, 1);
    let logs = graph.concat(&[&direct, &total], 1);
    let logs = graph.node("Add", &[&logs, &one]);
    let logs = graph.node("Log", &[&logs]);
    let total = graph.node("Add", &[&total, &tiny]);
    let inverse_total = graph.node("Div", &[&one, &total]);
    let asked = match actor.head.prior {
        Prior::Uniform => steering.clone(),
        Prior::EqualShare => graph.node("Mul", &[&steering, &inverse_total]),
    };
    let all = graph.sum(&asked, 0);
    let all = graph.node("Add", &[&all, &no_claim]);
    let mut claims = graph.node("Div", &[&asked, &all]);
    for _ in 0..SQUARINGS {
        claims = graph.node("Mul", &[&claims, &claims]);
    }
    let gains = graph.node("Mul", &[&claims, &steering]);
    Observed { slots, mirrors, picked, logs, present, share, direct, steering, inverse_total, claims, gains }
}

/// The amplitude of each user at logits of zero by the smooth decoder; (slots, 1).
fn first_amplitude(graph: &mut Graph, observed: &Observed) -> Value {
    let given = given(graph, observed, &observed.claims);
    graph.node("Add", &[&observed.direct, &given])
}

/// The amplitude of each user under the logits by the smooth decoder; (slots, 1).
fn amplitude(graph: &mut Graph, observed: &Observed, logits: &str, range: f32) -> Value {
    let exponent = graph.scalar(EXPONENT * range);
    let weights = graph.node("Mul", &[logits, &exponent]);
    let weights = graph.node("Exp", &[&weights]);
    let claims = graph.node("Mul", &[&observed.claims, &weights]);
    let given = given(graph, observed, &claims);
    let given = graph.node("Mul", &[&given, &weights]);
    graph.node("Add", &[&observed.direct, &given])
}

/// What each user gets of the gains when every mirror is shared by these claims, over the user's own weight; (slots, 1).
fn given(graph: &mut Graph, observed: &Observed, claims: &str) -> Value {
    let no_claim = graph.scalar(NO_CLAIM);
    let all = graph.sum(claims, 0);
    let all = graph.node("Add", &[&all, &no_claim]);
    let given = graph.node("Div", &[&observed.gains, &all]);
    graph.sum(&given, 1)
}

/// The weight of each user, (slots, 1); of no meaning in absent slots, whose amplitudes are zero.
fn weigh(graph: &mut Graph, observed: &Observed, logits: &str, head: Head) -> Value {
    let range = graph.scalar(head.range);
    let exponent = graph.node("Mul", &[logits, &range]);
    let weight = graph.node("Exp", &[&exponent]);
    match head.prior {
        Prior::Uniform => weight,
        Prior::EqualShare => graph.node("Mul", &[&weight, &observed.inverse_total]),
    }
}

/// Vectors as a constant of their x, y and z, (3, n).
fn rows(graph: &mut Graph, name: &str, vectors: impl Iterator<Item = Vec3> + Clone) -> Value {
    let values: Vec<f32> =
        [0, 1, 2].iter().flat_map(|&axis| vectors.clone().map(move |vector| vector[axis] as f32)).collect();
    graph.constant(name, &[3, values.len() / 3], &values)
}

/// The mirrors' centres in the frame of the wall.
fn centres(mirrors: &MirrorArray) -> impl Iterator<Item = Vec3> + Clone {
    mirrors.positions().iter().map(|centre| mirrors.wall_from_room(centre))
}

/// The sum over users of the share of each mirror (slots, mirrors) times the way from mirror to user; (3, mirrors), in the frame of the wall.
fn ways(graph: &mut Graph, observed: &Observed, mirrors: &MirrorArray, shares: &str) -> Value {
    // With a fourth coordinate of 1 the product gives the sum of the shares too, which the mirror's own place is to be multiplied by.
    let places = observed.columns(graph, Picked::Place, 4);
    let places = graph.transpose(&places);
    let sums = graph.node("MatMul", &[&places, shares]);
    let [sum, shares] = [0..3, 3..4].map(|rows| graph.slice(&sums, 0, rows));
    let centres = rows(graph, "centres", centres(mirrors));
    let from = graph.node("Mul", &[&centres, &shares]);
    graph.node("Sub", &[&sum, &from])
}

/// Each mirror serves the user with the largest weighted amplitude, at the bisector; normals of any length, (3, mirrors).
fn specular(graph: &mut Graph, model: &ChannelModel, observed: &Observed, weights: &str) -> Value {
    let (mirrors, led) = (&model.mirrors, model.leds[0].position);
    let scores = graph.node("Mul", &[&observed.steering, weights]);
    // Far below any score that counts; it gives the mirrors that nobody sees to the first user.
    let first: Vec<f32> = (0..observed.slots).map(|slot| if slot == 0 { 1e-30 } else { 0.0 }).collect();
    let first = graph.constant("first", &[observed.slots, 1], &first);
    let scores = graph.node("Add", &[&scores, &first]);
    let best = graph.max_of_rows(&scores, [observed.slots, observed.mirrors]);
    let served = graph.node("GreaterOrEqual", &[&scores, &best]);
    let served = graph.as_numbers(&served);
    let towards_user = ways(graph, observed, mirrors, &served);
    let towards_led = centres(mirrors).map(|centre| (mirrors.wall_from_room(&led) - centre).normalize());
    let towards_led = rows(graph, "towards_led", towards_led);
    // The bisector of two directions, times the distance to the user: its length does not matter.
    let squares = graph.node("Mul", &[&towards_user, &towards_user]);
    let distance = graph.sum(&squares, 0);
    let distance = graph.node("Sqrt", &[&distance]);
    let scaled = graph.node("Mul", &[&towards_led, &distance]);
    graph.node("Add", &[&scaled, &towards_user])
}

/// The sum over users of weight, coefficient and direction, flat where it is zero; normals of any length, (3, mirrors).
fn paper(graph: &mut Graph, model: &ChannelModel, observed: &Observed, weights: &str) -> Value {
    let mirrors = &model.mirrors;
    let pull = graph.node("Mul", &[&observed.steering, weights]);
    let squares = [0, 1, 2].map(|axis| {
        let place = graph.slice(&observed.picked, 1, Picked::Place as usize + axis..Picked::Place as usize + axis + 1);
        let centre: Vec<f32> = centres(mirrors).map(|centre| centre[axis] as f32).collect();
        let centre = graph.constant(&format!("centre_{axis}"), &[1, centre.len()], &centre);
        let way = graph.node("Sub", &[&place, &centre]);
        graph.node("Mul", &[&way, &way])
    });
    let squared = graph.node("Add", &[&squares[0], &squares[1]]);
    let squared = graph.node("Add", &[&squared, &squares[2]]);
    let distance = graph.node("Sqrt", &[&squared]);
    let pull = graph.node("Div", &[&pull, &distance]);
    let normal = ways(graph, observed, mirrors, &pull);
    // Far below any pull that carries data; it decides only where there is none.
    let inward = graph.constant("inward", &[3, 1], &[0.0, -1e-12, 0.0]);
    graph.node("Add", &[&normal, &inward])
}

/// Roll and yaw of normals (3, mirrors) in the frame of the wall; adds the output node.
fn angles(graph: &mut Graph, normal: &str) {
    let [x, y, z] = [0, 1, 2].map(|axis| graph.slice(normal, 0, axis..axis + 1));
    let [xx, yy] = [&x, &y].map(|value| graph.node("Mul", &[value, value]));
    let across = graph.node("Add", &[&xx, &yy]);
    let across = graph.node("Sqrt", &[&across]);
    let down = graph.node("Neg", &[&z]);
    let roll = graph.node("Div", &[&down, &across]);
    let yaw = graph.node("Div", &[&x, &y]);
    let both = graph.concat(&[&roll, &yaw], 1);
    graph.node("Atan", &[&both]);
}
