//! The places of a calibration where none are named.

use heliostat_scenario::Scenario;

use crate::session::Place;

/// Spots in a wide triangle, as shares of half the room along x and y.
const SPOTS: [[f64; 2]; 3] = [[-0.6, 0.3], [0.56, 0.4], [0.08, -0.56]];

/// The place of the verification, as a share of half the room.
const VERIFY: [f64; 2] = [-0.28, -0.16];

/// Three spots in a wide triangle, at the height of the scenario's receiver.
pub fn default_spots(scenario: &Scenario) -> Vec<Place> {
    SPOTS.map(|share| at(scenario, share)).to_vec()
}

/// A place for the verification, away from these spots.
pub fn default_verification(scenario: &Scenario) -> Place {
    at(scenario, VERIFY)
}

fn at(scenario: &Scenario, share: [f64; 2]) -> Place {
    let half = [0.5 * scenario.room.length_x_m, 0.5 * scenario.room.length_y_m];
    Place { floor_m: Some([0, 1].map(|axis| share[axis] * half[axis])), height_m: scenario.receiver.height_m }
}
