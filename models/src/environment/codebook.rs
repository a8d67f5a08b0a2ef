//! Codebooks of quantised angles: the only actions of the learners that choose among a fixed number of them.
//!
//! In the paper deep Q-learning acts by "the quantization of the angle values", and nothing more is said. Angles of each mirror by itself are
//! out of reach: five values an axis make 25^100 actions. So an entry of a codebook turns the whole array, and there are as many as a table or
//! a network's last layer can hold:
//!
//! - **paper modes**: 5 x 5 angles that all mirrors share, roll from 0 to 60 and yaw from -60 to 60 degrees ([`ROLLS_DEG`], [`YAWS_DEG`]). Other
//!   ranges of five values change the ceiling by less than .015.
//! - **`specular`**: mirrors that share their angles throw their spots to as many places, and nobody gets any rate. Each entry aims the whole array
//!   at one point of a grid of 12 x 12 over the floor ([`GRID`]), at the height of the receivers.
//!
//! The ceiling of a codebook is what a policy gets that tries every entry in each state ([`BestEntry`]; `codebook` in comparisons). Measured while
//! the grid was chosen, ratio to the oracle at noise 6.5e-15 A2 with 2 / 5 users forced off, on 40 states (25 for pairs):
//!
//! | entries | | |
//! | --- | --- | --- |
//! | one point of 8 x 8 | 64 | .63 / .44 |
//! | **one point of 12 x 12** | 144 | .70 / .51 |
//! | one point of 16 x 16 | 256 | .73 / .54 |
//! | one point of 20 x 20 | 400 | .74 / .54 |
//! | every second mirror at one point of 6 x 6, the others at another | 666 | .60 / .39 |
//! | the same of 8 x 8 | 2080 | .65 / .44 |

use heliostat_channel::solver::QOS_PENALTY;
use heliostat_channel::{ChannelModel, MirrorAngles, Vec3, decode};
use heliostat_decide::observation::Observation;
use heliostat_decide::policy::{Policy, PolicyError};
use heliostat_decide::safety::Limits;
use heliostat_scenario::{ChannelMode, Scenario};

use crate::env::{Environment, Outcome, Reward};
use crate::onnx::{Graph, Value};

/// Points of the grid along each side of the room, in `specular`.
pub const GRID: usize = 12;

/// Common rolls in degrees, in the paper's modes.
pub const ROLLS_DEG: [f64; 5] = [0.0, 15.0, 30.0, 45.0, 60.0];

/// Common yaws in degrees, in the paper's modes.
pub const YAWS_DEG: [f64; 5] = [-60.0, -30.0, 0.0, 30.0, 60.0];

/// The angles among which a learner chooses.
#[derive(Clone, Debug, PartialEq)]
pub struct Codebook {
    entries: Vec<MirrorAngles>,
    places: Vec<[f32; 2]>,
    kind: &'static str,
}

impl Codebook {
    /// The codebook for a scenario's mode and geometry; every angle lies within the range of its mirrors.
    ///
    /// # Errors
    /// A scenario that makes no channel.
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
        let places =
            (0..entries.len()).map(|entry| [middle(entry % columns, columns), middle(entry / columns, rows)]).collect();
        for angle in entries.iter_mut().flat_map(|entry| entry.roll.iter_mut().chain(&mut entry.yaw)) {
            *angle = angle.clamp(-range_rad, range_rad);
        }
        Ok(Self { entries, places, kind })
    }

    /// The angles of each entry.
    pub fn entries(&self) -> &[MirrorAngles] {
        &self.entries
    }

    /// The place of each entry in the codebook's grid, from its middle: along x and y, or in steps of yaw and roll.
    pub fn places(&self) -> &[[f32; 2]] {
        &self.places
    }

    /// What an entry is, in a few words.
    pub fn kind(&self) -> &'static str {
        self.kind
    }

    /// Turns the mirrors of a room as an entry says, and judges it: the reward beyond that of mirrors that face straight into the room, in units of
    /// the bandwidth, and what the entry itself brought.
    pub fn act(&self, environment: &mut Environment, entry: usize, reward: Reward) -> (f32, Outcome) {
        let (users, mirrors) = (environment.users(), environment.observation().mirrors());
        let mut parts = vec![0.0; users];
        environment.act(&MirrorAngles::flat(mirrors), reward, &mut parts);
        let flat: f32 = parts.iter().sum();
        let outcome = environment.act(&self.entries[entry], reward, &mut parts);
        ((parts.iter().sum::<f32>() - flat) / users as f32, outcome)
    }

    /// The entry that is truly best in a state, found by trying each, by what the oracle maximises: [`objective_bps`].
    pub fn best(&self, model: &ChannelModel, seen: &Observation) -> &MirrorAngles {
        let mut rates_bps = vec![0.0; seen.users()];
        let mut worth = |angles: &MirrorAngles| {
            seen.scene.rates_bps(model, angles, &mut rates_bps);
            objective_bps(&rates_bps, &seen.min_rate_bps)
        };
        let mut best = (&self.entries[0], worth(&self.entries[0]));
        for entry in &self.entries[1..] {
            let worth = worth(entry);
            if worth > best.1 {
                best = (entry, worth);
            }
        }
        best.0
    }

    /// Adds the nodes that choose the entry with the largest of `values`, (1, entries), and give its angles, (1, 2 mirrors).
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
    let place = |index: usize, extent_m: f64| extent_m * ((index as f64 + 0.5) / GRID as f64 - 0.5);
    let focus = |index: usize| {
        let (x, y) = (place(index % GRID, scenario.room.length_x_m), place(index / GRID, scenario.room.length_y_m));
        let mut angles = MirrorAngles::flat(model.mirrors.len());
        decode::aim_at_point(model, &Vec3::new(x, y, scenario.receiver.height_m), &mut angles);
        angles
    };
    (0..GRID * GRID).map(focus).collect()
}

/// The best possible policy of a codebook: tries every entry in each state.
pub struct BestEntry {
    codebook: Codebook,
}

impl BestEntry {
    /// For a scenario.
    ///
    /// # Errors
    /// As [`Codebook::of`].
    pub fn new(scenario: &Scenario) -> anyhow::Result<Self> {
        Ok(Self { codebook: Codebook::of(scenario)? })
    }
}

/// The sum rate less 50 times what is missing to the minimum rates, in bit/s.
pub fn objective_bps(rates_bps: &[f64], min_rate_bps: &[f64]) -> f64 {
    let pairs = rates_bps.iter().zip(min_rate_bps);
    pairs.map(|(rate, need)| rate - QOS_PENALTY * (need - rate).max(0.0)).sum()
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
