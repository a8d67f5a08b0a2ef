//! Codebooks of quantised angles: the actions of the learners that choose among a fixed number of
//! entries.
//!
//! The paper's deep Q-learning acts by "the quantization of the angle values" and gives no further
//! detail. Quantised angles of each mirror are too many: five values an axis make 25^100 actions.
//! Here an entry of a codebook turns the complete array, so that a table or a network's output
//! layer can hold all entries:
//!
//! - **paper modes**: 5 x 5 angles that all mirrors share, roll from 0 to 60 and yaw from -60 to 60
//!   degrees ([`ROLLS_DEG`], [`YAWS_DEG`]).
//! - **`specular`**: mirrors with the same angles send their spots to as many positions, and no
//!   user gets a rate. Each entry aims the complete array at one point of a grid of 12 x 12 over
//!   the floor ([`GRID`]), at the height of the receivers.
//!
//! The ceiling of a codebook is the score of a policy that evaluates every entry in each state
//! ([`BestEntry`]; `codebook` in comparisons). `models/experiments.md` compares several codebooks.

use heliostat_channel::solver::QOS_PENALTY;
use heliostat_channel::{ChannelModel, MirrorAngles, Vec3, decode};
use heliostat_decide::observation::Observation;
use heliostat_decide::policy::{Policy, PolicyError};
use heliostat_decide::safety::Limits;
use heliostat_onnx::graph::{Graph, Value};
use heliostat_scenario::{ChannelMode, Scenario};

use super::room::{Environment, Outcome, Reward};

/// Points of the grid along each side of the room, in `specular`; `models/experiments.md` has other
/// numbers.
pub const GRID: usize = 12;

/// Rolls common to all mirrors in degrees, in the paper's modes.
pub const ROLLS_DEG: [f64; 5] = [0.0, 15.0, 30.0, 45.0, 60.0];

/// Yaws common to all mirrors in degrees, in the paper's modes.
pub const YAWS_DEG: [f64; 5] = [-60.0, -30.0, 0.0, 30.0, 60.0];

/// The entries among which a learner chooses, each with the angles of all mirrors.
#[derive(Clone, Debug, PartialEq)]
pub struct Codebook {
    entries: Vec<MirrorAngles>,
    coordinates: Vec<[f32; 2]>,
    kind: &'static str,
}

impl Codebook {
    /// The codebook for a scenario's mode and geometry; every angle lies within the range of its
    /// mirrors.
    ///
    /// # Errors
    /// The scenario describes no channel.
    pub fn of(scenario: &Scenario) -> anyhow::Result<Self> {
        let model = scenario.channel_model()?;
        let range_rad = Limits::new(&scenario.control).range_rad();
        let (columns, mut entries, kind) = match scenario.channel.mode {
            ChannelMode::Specular => (GRID, focuses(&model, scenario), "the array aimed at a point of a 12 x 12 grid"),
            ChannelMode::Paper | ChannelMode::PaperCalibrated => {
                (YAWS_DEG.len(), common(model.mirrors.len()), "5 x 5 angles common to all mirrors")
            }
        };
        let rows = entries.len() / columns;
        let middle = |index: usize, count: usize| index as f32 - 0.5 * (count - 1) as f32;
        let coordinates =
            (0..entries.len()).map(|entry| [middle(entry % columns, columns), middle(entry / columns, rows)]).collect();
        for angle in entries.iter_mut().flat_map(|entry| entry.roll.iter_mut().chain(&mut entry.yaw)) {
            *angle = angle.clamp(-range_rad, range_rad);
        }
        Ok(Self { entries, coordinates, kind })
    }

    /// The angles of each entry.
    pub fn entries(&self) -> &[MirrorAngles] {
        &self.entries
    }

    /// The coordinates of each entry in the codebook's grid, from its middle: along x and y, or in
    /// steps of yaw and roll.
    pub fn coordinates(&self) -> &[[f32; 2]] {
        &self.coordinates
    }

    /// A short description of an entry.
    pub fn kind(&self) -> &'static str {
        self.kind
    }

    /// Applies an entry in a room. Returns the reward minus that of flat mirrors, over the
    /// bandwidth, and the entry's own outcome.
    pub fn act(&self, environment: &mut Environment, entry: usize, reward: Reward) -> (f32, Outcome) {
        let (users, mirrors) = (environment.users(), environment.observation().mirrors());
        let mut parts = vec![0.0; users];
        environment.act(&MirrorAngles::flat(mirrors), reward, &mut parts);
        let flat: f32 = parts.iter().sum();
        let outcome = environment.act(&self.entries[entry], reward, &mut parts);
        ((parts.iter().sum::<f32>() - flat) / users as f32, outcome)
    }

    /// The entry with the largest true [`objective_bps`] in a state, found by evaluating each.
    pub fn best(&self, model: &ChannelModel, seen: &Observation) -> &MirrorAngles {
        let mut rates_bps = vec![0.0; seen.users()];
        let mut objective = |angles: &MirrorAngles| {
            seen.scene.rates_bps(model, angles, &mut rates_bps);
            objective_bps(&rates_bps, &seen.min_rate_bps)
        };
        let mut best = (&self.entries[0], objective(&self.entries[0]));
        for entry in &self.entries[1..] {
            let value = objective(entry);
            if value > best.1 {
                best = (entry, value);
            }
        }
        best.0
    }

    /// Adds the nodes that choose the entry with the largest of `values` (1, entries): its angles,
    /// (1, 2 mirrors).
    pub fn choose_nodes(&self, graph: &mut Graph, values: &str) -> Value {
        let angles = |entry: &MirrorAngles| entry.roll.iter().chain(&entry.yaw).map(|angle| *angle as f32).collect();
        let rows: Vec<Vec<f32>> = self.entries.iter().map(angles).collect();
        let shape = [rows.len(), rows[0].len()];
        let book = graph.constant("codebook", &shape, &rows.concat());
        let best = graph.argmax(values, 1);
        graph.gather(&book, &best, 0)
    }
}

fn common(mirrors: usize) -> Vec<MirrorAngles> {
    let entry = |roll: f64, yaw: f64| MirrorAngles {
        roll: vec![roll.to_radians(); mirrors],
        yaw: vec![yaw.to_radians(); mirrors],
    };
    ROLLS_DEG.iter().flat_map(|roll| YAWS_DEG.iter().map(move |yaw| entry(*roll, *yaw))).collect()
}

fn focuses(model: &ChannelModel, scenario: &Scenario) -> Vec<MirrorAngles> {
    let coordinate = |index: usize, extent_m: f64| extent_m * ((index as f64 + 0.5) / GRID as f64 - 0.5);
    let focus = |index: usize| {
        let (x, y) =
            (coordinate(index % GRID, scenario.room.length_x_m), coordinate(index / GRID, scenario.room.length_y_m));
        let mut angles = MirrorAngles::flat(model.mirrors.len());
        decode::aim_at_point(model, &Vec3::new(x, y, scenario.receiver.height_m), &mut angles);
        angles
    };
    (0..GRID * GRID).map(focus).collect()
}

/// The policy that evaluates every entry of a codebook in each state: the codebook's ceiling.
pub struct BestEntry {
    codebook: Codebook,
}

impl BestEntry {
    /// The policy for a scenario.
    ///
    /// # Errors
    /// As [`Codebook::of`].
    pub fn new(scenario: &Scenario) -> anyhow::Result<Self> {
        Ok(Self { codebook: Codebook::of(scenario)? })
    }
}

/// The objective of the oracle in bit/s: sum_k [R_k - p max(0, R_min,k - R_k)] with p =
/// [`QOS_PENALTY`].
pub fn objective_bps(rates_bps: &[f64], min_rate_bps: &[f64]) -> f64 {
    let pairs = rates_bps.iter().zip(min_rate_bps);
    pairs.map(|(rate, min_rate)| rate - QOS_PENALTY * (min_rate - rate).max(0.0)).sum()
}

impl Policy for BestEntry {
    fn name(&self) -> &str {
        "codebook"
    }

    fn act(&mut self, model: &ChannelModel, seen: &Observation, out: &mut MirrorAngles) -> Result<(), PolicyError> {
        out.clone_from(self.codebook.best(model, seen));
        Ok(())
    }
}
