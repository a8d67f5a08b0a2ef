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
//! whom many mirrors reach, and zero in an empty slot. Of equal users the first is taken. The Rust
//! code and the exported graph compute the same in f32.

use heliostat_core::observation::{ObservationEncoder, USERS_CAPACITY};
use heliostat_core::policy::actor_file::INPUT_NAME;
use heliostat_onnx::graph::{Graph, Value};
use heliostat_scenario::Scenario;

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

    /// The layout of the observation vector.
    pub fn encoder(&self) -> ObservationEncoder {
        self.encoder
    }

    /// The benefit of each slot.
    pub fn benefits(&self, vector: &[f32]) -> Vec<f32> {
        let steering = vector[self.encoder.steering_amplitude()].chunks_exact(self.encoder.mirrors());
        let direct = &vector[self.encoder.los_amplitude()];
        steering.zip(direct).map(|(row, direct)| row.iter().sum::<f32>() / (1.0 + direct)).collect()
    }

    /// The slot of the target user.
    pub fn slot(&self, vector: &[f32]) -> usize {
        let benefits = self.benefits(vector);
        (1..benefits.len()).fold(0, |best, slot| if benefits[slot] > benefits[best] { slot } else { best })
    }

    /// Position of the target user: x and y in m.
    pub fn position(&self, vector: &[f32]) -> [f32; 2] {
        let position = &vector[self.encoder.positions()][3 * self.slot(vector)..];
        [position[0], position[1]]
    }

    /// Adds the nodes of [`TargetUser::position`]: (1, 2).
    pub fn position_nodes(&self, graph: &mut Graph) -> Value {
        let (slots, mirrors) = (self.encoder.users_max(), self.encoder.mirrors());
        let steering = graph.slice(INPUT_NAME, 1, self.encoder.steering_amplitude());
        let steering = graph.reshape(&steering, &[slots, mirrors]);
        let total = graph.sum(&steering, 1);
        let direct = graph.slice(INPUT_NAME, 1, self.encoder.los_amplitude());
        let direct = graph.reshape(&direct, &[slots, 1]);
        let one = graph.scalar(1.0);
        let direct = graph.node("Add", &[&direct, &one]);
        let benefit = graph.node("Div", &[&total, &direct]);
        let benefit = graph.reshape(&benefit, &[1, slots]);
        let slot = graph.argmax(&benefit, 1);
        let positions = graph.slice(INPUT_NAME, 1, self.encoder.positions());
        let positions = graph.reshape(&positions, &[slots, 3]);
        let position = graph.gather(&positions, &slot, 0);
        graph.slice(&position, 1, 0..2)
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

    /// The centre of a cell in m.
    pub fn centre(&self, cell: usize) -> [f32; 2] {
        let scale = self.scale();
        let position = |index: usize, axis: usize| (index as f32 + 0.5) / scale[axis] - self.half_room_m[axis];
        [position(cell % self.side, 0), position(cell / self.side, 1)]
    }

    /// Adds the nodes of [`Cells::cell`] for a position (1, 2): the cell's number, (1).
    pub fn cell_nodes(&self, graph: &mut Graph, position: &str) -> Value {
        let half = graph.constant("half_room", &[1, 2], &self.half_room_m);
        let scale = graph.constant("cells_per_m", &[1, 2], &self.scale());
        let (zero, last) = (graph.scalar(0.0), graph.scalar((self.side - 1) as f32));
        let fraction = graph.node("Add", &[position, &half]);
        let fraction = graph.node("Mul", &[&fraction, &scale]);
        let index = graph.node("Floor", &[&fraction]);
        let index = graph.node("Max", &[&index, &zero]);
        let index = graph.node("Min", &[&index, &last]);
        let strides = graph.constant("strides", &[1, 2], &[1.0, self.side as f32]);
        let index = graph.node("Mul", &[&index, &strides]);
        let index = graph.sum(&index, 1);
        // The index as a float becomes an integer as the argument of the nearest number's maximum.
        let numbers: Vec<f32> = (0..self.count()).map(|cell| cell as f32).collect();
        let numbers = graph.constant("cells", &[1, numbers.len()], &numbers);
        let distance = graph.node("Sub", &[&numbers, &index]);
        let distance = graph.node("Abs", &[&distance]);
        let nearness = graph.node("Neg", &[&distance]);
        graph.argmax(&nearness, 1)
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
            let numbers: Vec<usize> = (0..cells.count()).map(|cell| cells.cell(cells.centre(cell))).collect();
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
