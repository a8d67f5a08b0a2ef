//! Actors that give the angles of all mirrors themselves: their state, their network, and the patterns in which a critic may see angles.

use std::f64::consts::PI;

use candle_core::{Device, Result, Tensor};
use heliostat_channel::MirrorAngles;
use heliostat_decide::observation::{ObservationEncoder, USERS_CAPACITY};
use heliostat_decide::policy::actor_file::{INPUT_NAME, OUTPUT_NAME};
use heliostat_decide::safety::Limits;
use heliostat_scenario::Scenario;

use crate::export::{Column, NetworkNodes};
use crate::networks::Network;
use crate::onnx::{Ends, Graph, Value};

/// How an observation vector becomes the state of a raw actor.
///
/// presence, x, y and z over the room's extent, ln(1 + direct amplitude) and need of each slot, then the current angles over their range where
/// they are part of the state. The gain over the mirrors is no entry of its own: positions and angles determine it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawLayout {
    encoder: ObservationEncoder,
    extent_m: [f32; 3],
    /// Largest angle in rad.
    pub range_rad: f32,
    angles: bool,
}

impl RawLayout {
    /// The layout for a scenario; `angles` says whether the current angles are part of the state.
    pub fn of(scenario: &Scenario, angles: bool) -> Self {
        let room = &scenario.room;
        let extent_m = [0.5 * room.length_x_m, 0.5 * room.length_y_m, room.height_m].map(|extent| extent as f32);
        Self {
            encoder: ObservationEncoder::new(USERS_CAPACITY, scenario.mirror_count()),
            extent_m,
            range_rad: Limits::new(&scenario.control).range_rad() as f32,
            angles,
        }
    }

    /// Angles of an answer: roll of each mirror, then yaw of each.
    pub fn outputs(&self) -> usize {
        2 * self.encoder.mirrors()
    }

    /// Entries of a state.
    pub fn inputs(&self) -> usize {
        self.encoder.need().end + if self.angles { self.outputs() } else { 0 }
    }

    /// The state of what an observation vector says.
    pub fn state(&self, vector: &[f32]) -> Vec<f32> {
        let mut state = vector[..self.encoder.need().end].to_vec();
        state[self.encoder.positions()].iter_mut().zip(self.extents()).for_each(|(place, extent)| *place /= extent);
        state[self.encoder.los_amplitude()].iter_mut().for_each(|amplitude| *amplitude = (1.0 + *amplitude).ln());
        if self.angles {
            state.extend(vector[self.encoder.angles()].iter().map(|angle| angle / self.range_rad));
        }
        state
    }

    /// What divides the positions, slot by slot.
    fn extents(&self) -> Vec<f32> {
        self.extent_m.repeat(self.encoder.users_max())
    }

    /// Angles in rad from actions in [-1, 1].
    pub fn angles(&self, action: &[f32]) -> MirrorAngles {
        let angle = |value: &f32| f64::from(value * self.range_rad);
        let (roll, yaw) = action.split_at(self.encoder.mirrors());
        MirrorAngles { roll: roll.iter().map(angle).collect(), yaw: yaw.iter().map(angle).collect() }
    }

    /// Adds the nodes of [`RawLayout::state`]: (1, inputs).
    pub fn state_nodes(&self, graph: &mut Graph) -> Value {
        let encoder = self.encoder;
        let part = |graph: &mut Graph, range| graph.slice(INPUT_NAME, 1, range);
        let present = part(graph, encoder.present());
        let positions = part(graph, encoder.positions());
        let extents = graph.constant("extents", &[1, encoder.positions().len()], &self.extents());
        let positions = graph.node("Div", &[&positions, &extents]);
        let direct = part(graph, encoder.los_amplitude());
        let one = graph.scalar(1.0);
        let direct = graph.node("Add", &[&direct, &one]);
        let direct = graph.node("Log", &[&direct]);
        let need = part(graph, encoder.need());
        let mut parts = vec![present, positions, direct, need];
        if self.angles {
            let (angles, range) = (part(graph, encoder.angles()), graph.scalar(self.range_rad));
            parts.push(graph.node("Div", &[&angles, &range]));
        }
        graph.concat(&parts.iter().map(String::as_str).collect::<Vec<_>>(), 1)
    }

    /// The actor as an ONNX file: the same state, the network, the same angles.
    ///
    /// # Errors
    /// Those of candle, when a parameter cannot be read.
    pub fn export(&self, network: &Network, metadata: &[(String, String)]) -> Result<Vec<u8>> {
        let mut graph = Graph::default();
        let state = self.state_nodes(&mut graph);
        let nodes = NetworkNodes::new(&mut graph, network)?;
        let columns: Vec<Column> = (0..self.inputs()).map(|input| vec![(input, 1.0)]).collect();
        let entry = nodes.entry(&mut graph, &columns)?;
        let raw = nodes.plain(&mut graph, &entry, &state);
        let action = graph.node("Tanh", &[&raw]);
        let range = graph.scalar(self.range_rad);
        graph.node("Mul", &[&action, &range]);
        let (input, output) = ((INPUT_NAME, self.encoder.len()), (OUTPUT_NAME, self.outputs()));
        Ok(graph.finish(&Ends { name: "heliostat-raw-actor", input, output }, metadata))
    }
}

/// Smooth patterns over the grid of mirrors: the lowest two-dimensional cosine modes, for roll and for yaw alike.
///
/// Mode (i, j) at row r and column c is n_i n_j cos(pi i (r + 1/2) / rows) cos(pi j (c + 1/2) / columns) with n_0 = 1 and otherwise
/// sqrt 2, so that the mean square of each is 1 and modes are orthogonal.
#[derive(Clone, Debug)]
pub struct Basis {
    /// (2 modes, 2 mirrors): roll's patterns on roll, yaw's on yaw.
    patterns: Tensor,
    modes: usize,
}

impl Basis {
    /// The modes (i, j) with i and j below `order`, or below rows and columns where these are fewer.
    ///
    /// # Errors
    /// Those of candle.
    pub fn new(rows: usize, columns: usize, order: usize) -> Result<Self> {
        let wave = |index: usize, place: usize, extent: usize| {
            let norm = if index == 0 { 1.0 } else { 2.0_f64.sqrt() };
            norm * (PI * index as f64 * (place as f64 + 0.5) / extent as f64).cos()
        };
        let (mirrors, mut patterns) = (rows * columns, Vec::new());
        let modes = order.min(rows) * order.min(columns);
        for axis in 0..2 {
            for (i, j) in (0..order.min(rows)).flat_map(|i| (0..order.min(columns)).map(move |j| (i, j))) {
                let mode = (0..mirrors).map(|m| (wave(i, m / columns, rows) * wave(j, m % columns, columns)) as f32);
                let zeros = |count: usize| std::iter::repeat_n(0.0, count);
                patterns.extend(zeros(axis * mirrors).chain(mode).chain(zeros((1 - axis) * mirrors)));
            }
        }
        Ok(Self { patterns: Tensor::from_vec(patterns, (2 * modes, 2 * mirrors), &Device::Cpu)?, modes: 2 * modes })
    }

    /// How many patterns, of roll and of yaw.
    pub fn modes(&self) -> usize {
        self.modes
    }

    /// The strength of each pattern in actions (batch, 2 mirrors): (batch, modes).
    ///
    /// # Errors
    /// Those of candle.
    pub fn project(&self, action: &Tensor) -> Result<Tensor> {
        let mirrors = self.patterns.dim(1)? / 2;
        action.matmul(&self.patterns.t()?)? / mirrors as f64
    }

    /// The sum of the patterns with these strengths, an entry an angle.
    ///
    /// # Errors
    /// Those of candle.
    pub fn sum(&self, strengths: &[f32]) -> Result<Vec<f32>> {
        let strengths = Tensor::from_slice(strengths, (1, self.modes), &Device::Cpu)?;
        strengths.matmul(&self.patterns)?.squeeze(0)?.to_vec1()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_are_orthogonal_and_of_one_size() {
        let basis = Basis::new(4, 5, 3).expect("a basis");
        assert_eq!(basis.modes(), 18);
        for mode in 0..18 {
            let strengths: Vec<f32> = (0..18).map(|index| if index == mode { 0.7 } else { 0.0 }).collect();
            let action = basis.sum(&strengths).expect("a sum");
            let action = Tensor::from_vec(action, (1, 40), &Device::Cpu).expect("an action");
            let found = basis.project(&action).and_then(|found| found.squeeze(0)?.to_vec1::<f32>()).expect("strengths");
            assert!(found.iter().zip(&strengths).all(|(found, wanted)| (found - wanted).abs() < 1e-5), "{found:?}");
        }
    }

    #[test]
    fn no_more_patterns_than_mirrors() {
        assert_eq!(Basis::new(2, 3, 5).expect("a basis").modes(), 12);
    }
}
