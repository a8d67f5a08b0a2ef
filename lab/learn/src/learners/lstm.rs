//! A Gauss-Markov prediction of each user that a long short-term memory corrects; the model-based
//! solver then places the mirrors.
//!
//! Source: Ncube, Qidan, El-Gorashi and Elmirghani, "A hybrid Gauss Markov LSTM mobility model for
//! indoor OWC", arXiv 2604.19935, 2026. There, as here, the Gauss-Markov model predicts the
//! correlated part of a walk, and the LSTM learns what it leaves.
//! [`heliostat_core::walk_history`] has the Gauss-Markov prediction and the rows that the network
//! reads, and [`crate::networks::lstm`] the network.
//!
//! # The loss
//! The mean of |p - g - L r|^2 for the true place p in the middle of the command's time in force,
//! the Gauss-Markov prediction g, the lead L and the output r of the network in m/s. The exported
//! graph gives L r. Each episode draws new rooms with Gauss-Markov walks
//! ([`crate::environment::reported`]) and learns from their reports once. The head starts at zero:
//! an untrained network gives the Gauss-Markov prediction.
//!
//! # Deviations from the source
//! 1. **Places only.** The source also predicts how devices are held. Here the belief of the
//!    scenario does that, as for the other policies, so that a comparison shows the prediction of
//!    places alone.
//! 2. **Reports.** The network reads late and noisy reports, and predicts the time in which the
//!    command acts. It knows the lead and the nearest walls, and rates, latencies and noises are
//!    drawn in each room.
//! 3. **Symmetry.** Turned and mirrored rooms are equally likely, so each example is turned and
//!    mirrored at random.
//! 4. **Sizes.** This follows the abstract of the source, which states none: 10 reports, a state of
//!    32 values and Adam were chosen here.

use candle_core::{Device, Result, Tensor};
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::policy::actor_file::{ActorFile, INPUT_NAME};
use heliostat_core::policy::compact_file::DISPLACEMENTS;
use heliostat_core::policy::{Policy, PolicyKind};
use heliostat_core::walk_history::{DISPLACEMENT_VALUES, LEAD, REPORT_VALUES, REPORTS, WALK_VALUES};
use heliostat_models::{ActorSource, build};
use heliostat_onnx::graph::{Ends, Graph};
use heliostat_scenario::Scenario;
use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::residual::{actor::act_on_truth, shuffle};
use crate::environment::reported::{RoomChoice, Walks, decisions, later};
use crate::environment::room::{Environment, Outcome};
use crate::export::lstm::add;
use crate::export::rows::metadata;
use crate::networks::adam::Adam;
use crate::networks::lstm::{Lstm as Network, LstmShape};
use crate::training::algorithm::{Algorithm, start};
use crate::training::learner::{Episode, Learner, Part, part};
use crate::training::settings::RunSettings;

/// The row in the table of algorithms.
pub const ALGORITHM: Algorithm = Algorithm {
    name: "lstm",
    policy: PolicyKind::Lstm,
    help: "An LSTM that corrects the Gauss-Markov prediction of positions; one actor for every room",
    summary: "an LSTM on the Gauss-Markov prediction; deviations from its source at the head of `lab/learn/src/learners/lstm.rs`",
    has_paper_preset: false,
    start: |scenario, _, options| {
        let seed = scenario.seed;
        start(scenario, Settings::new(seed), options, Lstm::new)
    },
};

const SHAPE: LstmShape = LstmShape {
    steps: REPORTS,
    inputs: REPORT_VALUES,
    further: WALK_VALUES - LEAD,
    hidden: 32,
    outputs: DISPLACEMENT_VALUES,
};

/// The hyperparameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Learning rate at the start.
    pub rate: f64,
    /// Factor on the learning rate at the end.
    pub rate_end: f64,
    /// Examples of a step of the optimiser.
    pub batch: usize,
    /// Rooms of an episode.
    pub room_count: usize,
    /// Time in each room in s.
    pub room_s: f64,
    /// The rooms.
    #[serde(flatten)]
    pub choice: RoomChoice,
    /// The hyperparameters that every run has; those of the reward and of static rooms are not
    /// used.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl Settings {
    /// Gauss-Markov walks in rooms that the controller knows.
    pub fn new(seed: u64) -> Self {
        Self {
            rate: 3e-3,
            rate_end: 0.03,
            batch: 256,
            room_count: 24,
            room_s: 10.0,
            choice: RoomChoice {
                walks: vec![Walks::GaussMarkov],
                mismatch: Vec::new(),
                offices: 0.0,
                scenario_only: false,
            },
            run: RunSettings { episodes: 60, steps: 1, ..RunSettings::paper(seed) },
        }
    }
}

impl AsRef<RunSettings> for Settings {
    fn as_ref(&self) -> &RunSettings {
        &self.run
    }
}

/// A row with the truth about its user.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Example {
    /// The row that the actor reads.
    pub row: [f32; WALK_VALUES],
    /// The true place less the Gauss-Markov prediction in m.
    pub left: [f32; DISPLACEMENT_VALUES],
    /// The true place less that of the last report in m.
    pub moved: [f32; DISPLACEMENT_VALUES],
}

/// The examples of a room in which a policy that predicts places decides for `seconds`.
///
/// # Errors
/// As [`decisions`].
pub fn examples(scenario: &Scenario, seed: u64, policy: Box<dyn Policy>, seconds: f64) -> anyhow::Result<Vec<Example>> {
    let mut all = Vec::new();
    decisions(scenario, seed, (policy, seconds), &mut |room| {
        let Some(walks) = room.controller().observer().walks() else { return };
        let Some((world, indices)) = later(room) else { return };
        let predicted = walks.expected_m().zip(walks.reported_m());
        all.extend(walks.rows().iter().zip(predicted).zip(indices).map(|((row, (expected, reported)), index)| {
            let place = world.positions()[index];
            let less = |[x, y]: [f64; 2]| [(place.x - x) as f32, (place.y - y) as f32];
            Example { row: *row, left: less(expected), moved: less(reported) }
        }));
    })?;
    Ok(all)
}

/// The learner with its state between two episodes.
pub struct Lstm {
    settings: Settings,
    scenario: Scenario,
    network: Network,
    adam: Adam,
    /// Root mean squares in m in the last episode: of the error, of that of the Gauss-Markov
    /// prediction, and of that of the last report.
    errors_m: [f64; 3],
}

impl Lstm {
    /// The learner before its first episode.
    ///
    /// # Errors
    /// Errors of candle, when memory runs out.
    pub fn new(scenario: &Scenario, settings: Settings, rng: &mut ChaCha8Rng) -> anyhow::Result<Self> {
        let network = Network::new(SHAPE, rng)?;
        let adam = Adam::new(&network).clipped(1.0);
        Ok(Self { adam, network, scenario: scenario.clone(), settings, errors_m: [0.0; 3] })
    }

    /// The examples of newly drawn rooms. No command changes where users walk.
    fn examples(&self, rng: &mut ChaCha8Rng) -> anyhow::Result<Vec<Example>> {
        let file = ActorFile { origin: "the network in training".into(), bytes: file(&self.network, &[])?.into() };
        let run = |room: &Scenario, seed| {
            let policy = build(PolicyKind::Lstm, room, &ActorSource::Bytes(file.clone()))?;
            examples(room, seed, policy, self.settings.room_s)
        };
        Ok(self.settings.choice.in_rooms((&self.scenario, self.settings.room_count), rng, run)?.concat())
    }

    /// One pass over shuffled examples.
    fn learn(&mut self, mut all: Vec<Example>, rate: f64, rng: &mut ChaCha8Rng) -> anyhow::Result<()> {
        for example in &mut all {
            turn(example, rng);
        }
        shuffle(&mut all, rng);
        let (mut sum, mut count) = (0.0, 0.0);
        for batch in all.chunks_exact(self.settings.batch.min(all.len().max(1))) {
            let loss = loss(&self.network, batch)?;
            self.adam.step(&self.network, &loss.backward()?, rate)?;
            sum += f64::from(loss.to_scalar::<f32>()?);
            count += 1.0;
        }
        let mean = |vector: fn(&Example) -> &[f32; DISPLACEMENT_VALUES]| {
            let squares = all.iter().flat_map(vector).map(|value| f64::from(*value).powi(2));
            squares.sum::<f64>() / f64::max(all.len() as f64, 1.0)
        };
        let expected = [mean(|example| &example.left), mean(|example| &example.moved)];
        self.errors_m = [sum / f64::max(count, 1.0), expected[0], expected[1]].map(f64::sqrt);
        Ok(())
    }
}

/// Mirrors the room of an example along each axis, and exchanges the axes, each with probability
/// 1/2.
fn turn(example: &mut Example, rng: &mut impl Rng) {
    for axis in 0..2 {
        if rng.random_bool(0.5) {
            for vector in vectors(example) {
                vector[axis] = -vector[axis];
            }
            example.row.swap(LEAD + 1 + 2 * axis, LEAD + 2 + 2 * axis);
        }
    }
    if rng.random_bool(0.5) {
        vectors(example).for_each(|vector| vector.reverse());
        let walls = LEAD + 1;
        example.row[walls..walls + 4].rotate_left(2);
    }
}

/// The vectors of an example: places and velocities of the reports, and the truth.
fn vectors(example: &mut Example) -> impl Iterator<Item = &mut [f32]> {
    let Example { row, left, moved } = example;
    let reports = row[..LEAD].chunks_exact_mut(REPORT_VALUES);
    let of_reports = reports.flat_map(|report| report[..4].chunks_exact_mut(2));
    of_reports.chain([left.as_mut_slice(), moved.as_mut_slice()])
}

/// The mean loss of a network; the [module](self) has the equation.
fn loss(network: &Network, batch: &[Example]) -> Result<Tensor> {
    let table = |values: Vec<f32>, width: usize| Tensor::from_vec(values, (batch.len(), width), &Device::Cpu);
    let rows = table(batch.iter().flat_map(|example| example.row).collect(), WALK_VALUES)?;
    let left = table(batch.iter().flat_map(|example| example.left).collect(), DISPLACEMENT_VALUES)?;
    let found = network.forward(&rows)?.broadcast_mul(&rows.narrow(1, LEAD, 1)?)?;
    (found - left)?.sqr()?.sum_keepdim(1)?.mean_all()
}

/// The network as a file with this metadata, besides the entries without which no policy reads it.
fn file(network: &Network, entries: &[(String, String)]) -> Result<Vec<u8>> {
    let mut graph = Graph::default();
    let output = add(network, &mut graph, INPUT_NAME)?;
    let lead = graph.slice(INPUT_NAME, 1, LEAD..LEAD + 1);
    graph.node("Mul", &[&output, &lead]);
    let ends = Ends { name: "heliostat-lstm", input: (INPUT_NAME, WALK_VALUES), output: DISPLACEMENTS.output };
    Ok(graph.finish_rows(&ends, &metadata(&DISPLACEMENTS, entries)))
}

impl Learner for Lstm {
    fn rooms(&self) -> usize {
        0
    }

    fn is_scored(&self) -> bool {
        false
    }

    fn step(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<Vec<Outcome>> {
        let Settings { rate, rate_end, .. } = self.settings;
        let rate = rate * rate_end.powf(episode.progress());
        let all = self.examples(episode.rng)?;
        self.learn(all, rate, episode.rng)?;
        Ok(Vec::new())
    }

    fn act(&self, room: &Environment) -> anyhow::Result<MirrorAngles> {
        Ok(act_on_truth(room))
    }

    fn notes(&self) -> Vec<(&'static str, String)> {
        let [found, expected, reported] = self.errors_m;
        let text = format!("{found:.4} m; Gauss-Markov prediction {expected:.4} m, last report {reported:.4} m");
        vec![("root mean square error in the last episode", text)]
    }

    fn state(&mut self) -> Vec<Part<'_>> {
        vec![part("predictions", &mut self.network), part("predictions", &mut self.adam)]
    }

    fn export(&self, _: &ChannelModel, entries: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        Ok(file(&self.network, entries)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::networks::layers::assign;
    use heliostat_onnx::{ModelProto, reference::Reference};
    use prost::Message;
    use rand::SeedableRng;

    /// The distance in a row of the wall to which a vector along an axis points.
    fn wall_m(row: &[f32; WALK_VALUES], [x, y]: [f32; 2]) -> f32 {
        let index = if x == 0.0 { 2 + usize::from(y > 0.0) } else { usize::from(x > 0.0) };
        row[LEAD + 1 + index]
    }

    #[test]
    fn a_turned_example_keeps_its_walls_beside_its_vectors() {
        let mut row = [0.0; WALK_VALUES];
        row[LEAD - REPORT_VALUES..].copy_from_slice(&[0.0, 0.5, -0.7, 0.0, 0.0, 1.0, 0.25, 0.1, 0.2, 0.3, 0.4]);
        let original = Example { row, left: [0.0, 0.4], moved: [-0.1, 0.0] };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut found = Vec::new();
        for _ in 0..100 {
            let mut example = original;
            turn(&mut example, &mut rng);
            let report = &example.row[LEAD - REPORT_VALUES..LEAD];
            assert_eq!([wall_m(&example.row, example.left), wall_m(&example.row, example.moved)], [0.4, 0.1]);
            assert_eq!(wall_m(&example.row, [report[0], report[1]]), 0.4);
            assert_eq!(wall_m(&example.row, [report[2], report[3]]), 0.1);
            assert_eq!([report[4], report[5], example.row[LEAD]], [0.0, 1.0, 0.25]);
            found.push(example.left);
        }
        found.sort_by(|one, other| one.partial_cmp(other).unwrap());
        found.dedup();
        assert_eq!(found, [[-0.4, 0.0], [0.0, -0.4], [0.0, 0.4], [0.4, 0.0]]);
    }

    #[test]
    fn the_exported_graph_gives_the_outputs_of_the_network_times_the_lead() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let network = Network::new(SHAPE, &mut rng).unwrap();
        for layer in network.layers() {
            for parameter in [&layer.weight, &layer.bias] {
                let values = (0..parameter.elem_count()).map(|_| rng.random_range(-0.5..0.5_f32)).collect();
                assign(parameter, &Tensor::from_vec(values, parameter.shape(), &Device::Cpu).unwrap()).unwrap();
            }
        }
        let model = ModelProto::decode(&file(&network, &[]).unwrap()[..]).unwrap();
        let reference = Reference::new(&model).unwrap();
        for _ in 0..20 {
            let row: [f32; WALK_VALUES] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
            let rows = Tensor::from_slice(&row, (1, WALK_VALUES), &Device::Cpu).unwrap();
            let expected = network.forward(&rows).unwrap().to_vec2::<f32>().unwrap().concat();
            let found = reference.run(INPUT_NAME, &row).unwrap();
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - row[LEAD] * expected).abs() < 1e-5, "{found} for {} * {expected}", row[LEAD]);
            }
            assert!(found.len() == 2 && found[0] != 0.0);
        }
    }
}
