//! The network of `residual`: from rows of evidence to corrections, its file, and its gate with a
//! gradient.

use std::path::PathBuf;

use candle_core::{Device, Result, Tensor};
use heliostat_channel::solver::Solver;
use heliostat_channel::{MirrorAngles, Vec3};
use heliostat_core::correction::{Correction, Frame, LOG_VARIANCE, LOG_VARIANCE_OFFSET, LOG_VARIANCE_SCALE};
use heliostat_core::evidence::{FEATURES, correction_of};
use heliostat_core::policy::actor_file::{ActorFile, INPUT_NAME};
use heliostat_core::policy::compact_file::CORRECTIONS;
use heliostat_core::policy::{Policy, PolicyKind};
use heliostat_models::{ActorSource, build};
use heliostat_onnx::graph::Ends;
use heliostat_onnx::tensor::{Data, Tensor as Constant};
use heliostat_scenario::Scenario;
use rand::Rng;

use crate::environment::room::Environment;
use crate::evaluation::held_out::best_angles;
use crate::export::rows::{export, metadata};
use crate::networks::layers::{Encoder, Network, Shape, assign};

/// Widths of the two hidden layers.
const HIDDEN: [usize; 2] = [64, 64];

/// An output that stands for the smallest variance, so that only the measured gains decide whether
/// a change counts.
pub const CERTAIN: f32 = -1e3;

/// Width of the gate in the logarithm of the square of a change over its variance, with a gradient.
const GATE_WIDTH: f64 = 0.5;

/// Smallest square of a change in a logarithm.
const SQUARE_MIN: f64 = 1e-6;

/// A network that changes nothing: its output layer is zero.
///
/// # Errors
/// Errors of candle, when memory runs out.
pub fn untrained(rng: &mut impl Rng) -> Result<Network> {
    let outputs = Correction::VALUES;
    let shape = Shape { encoder: Encoder::Mlp, slots: 1, inputs: FEATURES, hidden: HIDDEN, outputs };
    let network = Network::new(shape, rng)?;
    let head = network.layer("head");
    assign(&head.weight, &head.weight.zeros_like()?)?;
    assign(&head.bias, &head.bias.zeros_like()?)?;
    Ok(network)
}

/// The network of a file that [`file`] wrote, or of the built-in actor of a training seed where the
/// path is empty.
///
/// # Errors
/// The file cannot be read, is no compact actor, or has other layers.
pub fn trained(path: &str, scenario: &Scenario, seed: u64, rng: &mut impl Rng) -> anyhow::Result<Network> {
    let source = match path {
        "" => ActorSource::ShippedSeed(u32::try_from(seed)?),
        path => ActorSource::Path(PathBuf::from(path)),
    };
    let found = source.fetch(PolicyKind::Residual, scenario)?;
    let graph = CORRECTIONS.check(&found)?.graph.unwrap_or_default();
    let network = untrained(rng)?;
    for layer in network.layers() {
        for (parameter, kind) in [(&layer.weight, "weight"), (&layer.bias, "bias")] {
            let name = format!("{}.{kind}", layer.name);
            let constant = graph.initializer.iter().find(|constant| constant.name == name);
            let expected = parameter.dims();
            match constant.and_then(Constant::read) {
                Some(Constant { shape, data: Data::Floats(values) }) if shape == expected => {
                    assign(parameter, &Tensor::from_vec(values, expected, &Device::Cpu)?)?;
                }
                other => anyhow::bail!(
                    "{}: {name} has the shape {:?}, expected {expected:?} as `heliostat train residual` writes it",
                    found.origin,
                    other.map(|constant| constant.shape)
                ),
            }
        }
    }
    Ok(network)
}

/// The network as a file with this metadata, besides the entries without which no policy reads it.
///
/// # Errors
/// Errors of candle, when a parameter cannot be read.
pub fn file(network: &Network, entries: &[(String, String)]) -> Result<Vec<u8>> {
    let ends = Ends { name: "heliostat-residual", input: (INPUT_NAME, FEATURES), output: CORRECTIONS.output };
    export(network, &ends, &metadata(&CORRECTIONS, entries))
}

/// The network as a file of the present moment, from which [`policy`] makes policies.
///
/// # Errors
/// As [`file`].
pub fn present(network: &Network) -> Result<ActorFile> {
    Ok(ActorFile { origin: "the network in training".into(), bytes: file(network, &[])?.into() })
}

/// The policy of a file in a room.
///
/// # Errors
/// The engine refuses the network.
pub fn policy(file: &ActorFile, room: &Scenario) -> anyhow::Result<Box<dyn Policy>> {
    Ok(build(PolicyKind::Residual, room, &ActorSource::Bytes(file.clone()))?)
}

/// The angles for a known room. A true state needs no correction, so these are the angles of the
/// solver.
pub fn act_on_truth(room: &Environment) -> MirrorAngles {
    let seen = room.observation();
    let mut solver = Solver::new(seen.users(), seen.mirrors());
    best_angles(&mut solver, room.model(), &seen.scene, &seen.min_rate_bps)
}

/// The logarithms of the variances in the outputs of a network, (rows, 1).
///
/// # Errors
/// Errors of candle.
pub fn log_variance(output: &Tensor) -> Result<Tensor> {
    let [least, most] = LOG_VARIANCE;
    ((output.narrow(1, 2, 1)? * LOG_VARIANCE_SCALE)? + LOG_VARIANCE_OFFSET)?.clamp(least, most)
}

/// The changes of the normals that outputs of a network stand for, with a gradient: (rows, 2).
///
/// A sigmoid of the logarithm of the square over the variance replaces the first condition of
/// [`heliostat_core::correction`], which jumps. The second is a constant factor of 0 or 1.
///
/// # Errors
/// Errors of candle.
pub fn smooth_change(output: &Tensor, rows: &[[f32; FEATURES]]) -> Result<Tensor> {
    let change = output.narrow(1, 0, 2)?;
    let square = (change.sqr()?.sum_keepdim(1)? + SQUARE_MIN)?;
    let excess = ((square.log()? - log_variance(output)?)? / GATE_WIDTH)?;
    let open = ((excess.neg()?.exp()? + 1.0)?.recip())?;
    let outputs = output.to_vec2::<f32>()?;
    let explains = rows.iter().zip(&outputs).map(|(row, output)| {
        let found = change_of(row, &[output[0], output[1], CERTAIN]);
        f32::from(u8::from(found != [0.0; 2]))
    });
    let explains = Tensor::from_vec(explains.collect(), (rows.len(), 1), &Device::Cpu)?;
    change.broadcast_mul(&open.mul(&explains)?)
}

/// The change of the normal that an output stands for, in the frame of its row.
pub fn change_of(row: &[f32; FEATURES], output: &[f32; Correction::VALUES]) -> [f64; 2] {
    let frame = Frame::towards(&Vec3::x());
    frame.of_room(&correction_of(row, &frame, output).tilt())
}
