//! The state of learners that read positions, gains and minimum rates directly, and actions that
//! are mirror angles.

use heliostat_channel::MirrorAngles;
use heliostat_core::observation::{ObservationEncoder, USERS_CAPACITY};
use heliostat_core::policy::actor_file::INPUT_NAME;
use heliostat_core::safety::Limits;
use heliostat_onnx::graph::{Graph, Value};
use heliostat_scenario::Scenario;

/// The layout of a state of positions and, where the learner reads them, angles.
///
/// The components of all slots are presence, x, y and z over the room's extent, ln(1 + direct
/// amplitude) and minimum rate in bit/s/Hz. The current angles over their range follow where they
/// are part of the state. The gain over the mirrors is no component, because positions and angles
/// determine it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngleState {
    encoder: ObservationEncoder,
    extent_m: [f32; 3],
    /// Largest angle in rad.
    pub range_rad: f32,
    angles: bool,
}

impl AngleState {
    /// The layout for a scenario; `angles`: the current angles are part of the state.
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

    /// The layout of the observation vector.
    pub fn encoder(&self) -> ObservationEncoder {
        self.encoder
    }

    /// Number of angles in an action: roll of each mirror, then yaw of each.
    pub fn outputs(&self) -> usize {
        2 * self.encoder.mirrors()
    }

    /// Number of components of a state.
    pub fn inputs(&self) -> usize {
        self.encoder.min_rate().end + if self.angles { self.outputs() } else { 0 }
    }

    /// The state that an observation vector describes.
    pub fn state(&self, vector: &[f32]) -> Vec<f32> {
        let mut state = vector[..self.encoder.min_rate().end].to_vec();
        state[self.encoder.positions()]
            .iter_mut()
            .zip(self.extents())
            .for_each(|(position, extent)| *position /= extent);
        state[self.encoder.los_amplitude()].iter_mut().for_each(|amplitude| *amplitude = (1.0 + *amplitude).ln());
        if self.angles {
            state.extend(vector[self.encoder.angles()].iter().map(|angle| angle / self.range_rad));
        }
        state
    }

    /// Divisors of the positions, slot by slot.
    fn extents(&self) -> Vec<f32> {
        self.extent_m.repeat(self.encoder.users_max())
    }

    /// Angles in rad from actions in [-1, 1].
    pub fn angles(&self, action: &[f32]) -> MirrorAngles {
        let angle = |value: &f32| f64::from(value * self.range_rad);
        let (roll, yaw) = action.split_at(self.encoder.mirrors());
        MirrorAngles { roll: roll.iter().map(angle).collect(), yaw: yaw.iter().map(angle).collect() }
    }

    /// Adds the nodes of [`AngleState::state`]: (1, inputs).
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
        let min_rate = part(graph, encoder.min_rate());
        let mut parts = vec![present, positions, direct, min_rate];
        if self.angles {
            let (angles, range) = (part(graph, encoder.angles()), graph.scalar(self.range_rad));
            parts.push(graph.node("Div", &[&angles, &range]));
        }
        graph.concat(&parts.iter().map(String::as_str).collect::<Vec<_>>(), 1)
    }
}
