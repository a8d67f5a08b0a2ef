//! The state of learners that value each codeword of a codebook.

use heliostat_scenario::Scenario;

use crate::{
    observe::{angle_state::AngleState, target_user::TargetUser},
    policy::codewords::GRID,
};

/// Coordinates of a codeword in its codebook, and of a user on the floor.
pub const POSITION: usize = 2;

/// The position of the target user in steps of the codebook's grid, then presence, positions,
/// direct gains and minimum rates of all slots ([`AngleState`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CodewordState {
    /// Finds the target user.
    pub target_user: TargetUser,
    users: AngleState,
    /// Steps of the codebook's grid per metre, along x and y.
    steps_per_m: [f32; POSITION],
}

impl CodewordState {
    /// The layout for a scenario.
    pub fn of(scenario: &Scenario) -> Self {
        let extents_m = [scenario.room.length_x_m, scenario.room.length_y_m];
        Self {
            target_user: TargetUser::of(scenario),
            users: AngleState::of(scenario, false),
            steps_per_m: extents_m.map(|extent_m| (GRID as f64 / extent_m) as f32),
        }
    }

    /// Number of components of a state.
    pub fn inputs(&self) -> usize {
        POSITION + self.users.inputs()
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
        let (position, users) = out.split_at_mut(POSITION);
        let found = self.target_user.position(vector);
        for axis in 0..POSITION {
            position[axis] = found[axis] * self.steps_per_m[axis];
        }
        self.users.write(vector, users);
    }
}
