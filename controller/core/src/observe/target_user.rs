//! The target user: the user whom the mirrors can help most, and the cell of the floor in which
//! that user stands.
//!
//! The target user k maximises the benefit, the quotient of the amplitude that all mirrors together
//! could give and of one plus the direct amplitude:
//!
//! ```text
//! sum_m a_km / (1 + d_k)
//! ```
//!
//! The amplitudes are those of the observation vector. The benefit is largest for a user in shadow
//! whom many mirrors reach, and zero in an empty slot. Of equal users the first is taken.

use heliostat_scenario::Scenario;

use crate::observe::observation::{ObservationEncoder, USERS_CAPACITY};

/// Finds the target user in an observation vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetUser {
    encoder: ObservationEncoder,
}

impl TargetUser {
    /// The finder for the array of a scenario.
    pub fn of(scenario: &Scenario) -> Self {
        Self { encoder: ObservationEncoder::new(USERS_CAPACITY, scenario.mirror_count()) }
    }

    /// The benefit of each slot.
    pub fn benefits<'a>(&self, vector: &'a [f32]) -> impl Iterator<Item = f32> + 'a {
        let steering = vector[self.encoder.steering_amplitude()].chunks_exact(self.encoder.mirrors());
        let direct = &vector[self.encoder.los_amplitude()];
        steering.zip(direct).map(|(row, direct)| row.iter().sum::<f32>() / (1.0 + direct))
    }

    /// The slot of the target user. Does not allocate.
    pub fn slot(&self, vector: &[f32]) -> usize {
        let larger = |best: (usize, f32), next: (usize, f32)| if next.1 > best.1 { next } else { best };
        self.benefits(vector).enumerate().fold((0, f32::NEG_INFINITY), larger).0
    }

    /// Position of the target user: x and y in m.
    pub fn position(&self, vector: &[f32]) -> [f32; 2] {
        let position = &vector[self.encoder.positions()][3 * self.slot(vector)..];
        [position[0], position[1]]
    }
}

/// The floor in `side` x `side` cells of equal size, numbered along x first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cells {
    side: usize,
    half_room_m: [f32; 2],
}

impl Cells {
    /// The cells of a scenario's room.
    pub fn of(scenario: &Scenario, side: usize) -> Self {
        let half_room_m = [scenario.room.length_x_m, scenario.room.length_y_m].map(|extent| (0.5 * extent) as f32);
        Self { side, half_room_m }
    }

    /// Number of cells.
    pub fn count(&self) -> usize {
        self.side * self.side
    }

    /// The cell of a position in m; a position outside the room belongs to the nearest cell.
    pub fn cell(&self, position: [f32; 2]) -> usize {
        let last = (self.side - 1) as f32;
        let [x, y] = [0, 1].map(|axis| {
            let fraction = (position[axis] + self.half_room_m[axis]) * self.scale()[axis];
            fraction.floor().max(0.0).min(last) as usize
        });
        y * self.side + x
    }

    /// Cells per metre along x and y.
    fn scale(&self) -> [f32; 2] {
        self.half_room_m.map(|half| self.side as f32 / (2.0 * half))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_have_one_number_each_and_cover_the_floor() {
        for side in [1, 6, 12] {
            let cells = Cells { side, half_room_m: [2.5, 2.0] };
            let middle =
                |index: usize, axis: usize| (index as f32 + 0.5) / cells.scale()[axis] - cells.half_room_m[axis];
            let centre = |cell: usize| [middle(cell % side, 0), middle(cell / side, 1)];
            let numbers: Vec<usize> = (0..cells.count()).map(|cell| cells.cell(centre(cell))).collect();
            assert_eq!(numbers, (0..side * side).collect::<Vec<_>>());
            assert_eq!([[-9.0, -9.0], [-2.5, -2.0]].map(|position| cells.cell(position)), [0, 0]);
            assert_eq!([[9.0, 9.0], [2.5, 2.0]].map(|position| cells.cell(position)), [side * side - 1; 2]);
        }
    }

    #[test]
    fn the_target_user_stands_in_shadow_within_reach_of_the_mirrors() {
        let target = TargetUser { encoder: ObservationEncoder::new(3, 2) };
        // Presence, positions, direct amplitudes, minimum rates, steering amplitudes, angles.
        let mut vector =
            vec![1.0, 1.0, 0.0, 1.0, -2.0, 0.85, 0.5, 2.0, 0.85, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0, 1.0, 1.0, 0.0];
        vector.extend([0.4, 0.1, 0.9, 0.9, 0.0, 0.0]);
        vector.extend([0.0; 4]);
        assert_eq!(target.position(&vector), [1.0, -2.0]);
        vector[target.encoder.los_amplitude().start] = 3.0;
        assert_eq!(target.position(&vector), [0.5, 2.0]);
    }
}
