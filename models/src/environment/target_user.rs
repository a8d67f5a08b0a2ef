//! Whom the mirrors could help most, and in which cell of the floor that user stands.
//!
//! A user needs the mirrors by the quotient of what all of them could give together and of the direct light:
//!
//! ```text
//! sum_m a_km / (1 + d_k)
//! ```
//!
//! with the amplitudes of the observation vector. It is largest for a user in shadow whom mirrors reach well, and zero in an absent slot. The first of equals
//! counts. Rust and the exported graph compute the same in f32.

use heliostat_decide::observation::{ObservationEncoder, USERS_CAPACITY};
use heliostat_decide::policy::actor_file::INPUT_NAME;
use heliostat_scenario::Scenario;

use crate::onnx::{Graph, Value};

/// Finds the user in an observation vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Needy {
    encoder: ObservationEncoder,
}

impl Needy {
    /// For the array of a scenario.
    pub fn of(scenario: &Scenario) -> Self {
        Self { encoder: ObservationEncoder::new(USERS_CAPACITY, scenario.mirror_count()) }
    }

    /// The vector's layout.
    pub fn encoder(&self) -> ObservationEncoder {
        self.encoder
    }

    /// The need of each slot.
    pub fn needs(&self, vector: &[f32]) -> Vec<f32> {
        let steering = vector[self.encoder.steering_amplitude()].chunks_exact(self.encoder.mirrors());
        let direct = &vector[self.encoder.los_amplitude()];
        steering.zip(direct).map(|(row, direct)| row.iter().sum::<f32>() / (1.0 + direct)).collect()
    }

    /// The slot of the user.
    pub fn slot(&self, vector: &[f32]) -> usize {
        let needs = self.needs(vector);
        (1..needs.len()).fold(0, |best, slot| if needs[slot] > needs[best] { slot } else { best })
    }

    /// Where the user stands: x and y in m.
    pub fn place(&self, vector: &[f32]) -> [f32; 2] {
        let position = &vector[self.encoder.positions()][3 * self.slot(vector)..];
        [position[0], position[1]]
    }

    /// Adds the nodes of [`Needy::place`]: (1, 2).
    pub fn place_nodes(&self, graph: &mut Graph) -> Value {
        let (slots, mirrors) = (self.encoder.users_max(), self.encoder.mirrors());
        let steering = graph.slice(INPUT_NAME, 1, self.encoder.steering_amplitude());
        let steering = graph.reshape(&steering, &[slots, mirrors]);
        let total = graph.sum(&steering, 1);
        let direct = graph.slice(INPUT_NAME, 1, self.encoder.los_amplitude());
        let direct = graph.reshape(&direct, &[slots, 1]);
        let one = graph.scalar(1.0);
        let direct = graph.node("Add", &[&direct, &one]);
        let need = graph.node("Div", &[&total, &direct]);
        let need = graph.reshape(&need, &[1, slots]);
        let slot = graph.argmax(&need, 1);
        let positions = graph.slice(INPUT_NAME, 1, self.encoder.positions());
        let positions = graph.reshape(&positions, &[slots, 3]);
        let position = graph.gather(&positions, &slot, 0);
        graph.slice(&position, 1, 0..2)
    }
}

/// The floor in cells of equal size: `side` along x times `side` along y, numbered along x first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cells {
    side: usize,
    half_room_m: [f32; 2],
}

impl Cells {
    /// Cells of a scenario's room.
    pub fn of(scenario: &Scenario, side: usize) -> Self {
        let half_room_m = [scenario.room.length_x_m, scenario.room.length_y_m].map(|extent| (0.5 * extent) as f32);
        Self { side, half_room_m }
    }

    /// How many cells.
    pub fn count(&self) -> usize {
        self.side * self.side
    }

    /// The cell of a place in m; places outside the room belong to the cell that is nearest.
    pub fn cell(&self, place: [f32; 2]) -> usize {
        let last = (self.side - 1) as f32;
        let [x, y] = [0, 1].map(|axis| {
            let fraction = (place[axis] + self.half_room_m[axis]) * self.scale()[axis];
            fraction.floor().max(0.0).min(last) as usize
        });
        y * self.side + x
    }

    /// The centre of a cell in m.
    pub fn centre(&self, cell: usize) -> [f32; 2] {
        let scale = self.scale();
        let place = |index: usize, axis: usize| (index as f32 + 0.5) / scale[axis] - self.half_room_m[axis];
        [place(cell % self.side, 0), place(cell / self.side, 1)]
    }

    /// Adds the nodes of [`Cells::cell`] for a place (1, 2): the cell's number, (1).
    pub fn cell_nodes(&self, graph: &mut Graph, place: &str) -> Value {
        let half = graph.constant("half_room", &[1, 2], &self.half_room_m);
        let scale = graph.constant("cells_per_m", &[1, 2], &self.scale());
        let (zero, last) = (graph.scalar(0.0), graph.scalar((self.side - 1) as f32));
        let fraction = graph.node("Add", &[place, &half]);
        let fraction = graph.node("Mul", &[&fraction, &scale]);
        let index = graph.node("Floor", &[&fraction]);
        let index = graph.node("Max", &[&index, &zero]);
        let index = graph.node("Min", &[&index, &last]);
        let strides = graph.constant("strides", &[1, 2], &[1.0, self.side as f32]);
        let index = graph.node("Mul", &[&index, &strides]);
        let index = graph.sum(&index, 1);
        // A real number that is whole becomes an index by way of the number that is nearest to it.
        let numbers: Vec<f32> = (0..self.count()).map(|cell| cell as f32).collect();
        let numbers = graph.constant("cells", &[1, numbers.len()], &numbers);
        let distance = graph.node("Sub", &[&numbers, &index]);
        let distance = graph.node("Abs", &[&distance]);
        let nearness = graph.node("Neg", &[&distance]);
        graph.argmax(&nearness, 1)
    }

    /// Cells in a metre along x and y.
    fn scale(&self) -> [f32; 2] {
        self.half_room_m.map(|half| self.side as f32 / (2.0 * half))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_numbered_one_to_one_and_cover_the_floor() {
        for side in [1, 6, 12] {
            let cells = Cells { side, half_room_m: [2.5, 2.0] };
            let numbers: Vec<usize> = (0..cells.count()).map(|cell| cells.cell(cells.centre(cell))).collect();
            assert_eq!(numbers, (0..side * side).collect::<Vec<_>>());
            assert_eq!([[-9.0, -9.0], [-2.5, -2.0]].map(|place| cells.cell(place)), [0, 0]);
            assert_eq!([[9.0, 9.0], [2.5, 2.0]].map(|place| cells.cell(place)), [side * side - 1; 2]);
        }
    }

    #[test]
    fn the_needy_user_stands_in_shadow_where_mirrors_reach() {
        let needy = Needy { encoder: ObservationEncoder::new(3, 2) };
        // Presence, positions, direct amplitudes, needs, steering amplitudes, angles.
        let mut vector =
            vec![1.0, 1.0, 0.0, 1.0, -2.0, 0.85, 0.5, 2.0, 0.85, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0, 1.0, 1.0, 0.0];
        vector.extend([0.4, 0.1, 0.9, 0.9, 0.0, 0.0]);
        vector.extend([0.0; 4]);
        assert_eq!(needy.place(&vector), [1.0, -2.0]);
        vector[needy.encoder.los_amplitude().start] = 3.0;
        assert_eq!(needy.place(&vector), [0.5, 2.0]);
    }
}
