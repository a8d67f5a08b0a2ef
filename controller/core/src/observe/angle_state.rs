//! The state of learners that read positions, gains and minimum rates directly, and actions that
//! are mirror angles.

use heliostat_channel::MirrorAngles;
use heliostat_scenario::Scenario;

use crate::{
    observe::observation::{ObservationEncoder, USERS_CAPACITY},
    output::safety::Limits,
};

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
        let mut state = vec![0.0; self.inputs()];
        self.write(vector, &mut state);
        state
    }

    /// Writes the state that an observation vector describes. Does not allocate.
    ///
    /// # Panics
    /// If the length of `out` is not [`inputs`](Self::inputs).
    pub fn write(&self, vector: &[f32], out: &mut [f32]) {
        assert_eq!(out.len(), self.inputs(), "the state has another length");
        let (users, angles) = out.split_at_mut(self.encoder.min_rate().end);
        users.copy_from_slice(&vector[..users.len()]);
        for (position, extent) in users[self.encoder.positions()].iter_mut().zip(self.extent_m.iter().cycle()) {
            *position /= extent;
        }
        users[self.encoder.los_amplitude()].iter_mut().for_each(|amplitude| *amplitude = (1.0 + *amplitude).ln());
        for (to, angle) in angles.iter_mut().zip(&vector[self.encoder.angles()]) {
            *to = angle / self.range_rad;
        }
    }

    /// Angles in rad from actions in [-1, 1].
    pub fn angles(&self, action: &[f32]) -> MirrorAngles {
        let angle = |value: &f32| f64::from(value * self.range_rad);
        let (roll, yaw) = action.split_at(self.encoder.mirrors());
        MirrorAngles { roll: roll.iter().map(angle).collect(), yaw: yaw.iter().map(angle).collect() }
    }
}
