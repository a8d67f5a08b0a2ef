//! A value at each place of the floor, as one more detector would find it.

use heliostat_channel::{Scene, Vec3};
use heliostat_scenario::Scenario;
use heliostat_sim::World;

use crate::figure::Floor;

/// Looks from each point of a grid: obstacles and the bodies of the users block the light of the detector there, a body of its own does not.
///
/// `step_m`: about the distance between points, of which there is one at least along each side. `value` takes the scene of the one detector.
pub fn over_floor(scenario: &Scenario, world: &World, step_m: f64, value: &mut dyn FnMut(&Scene) -> f64) -> Floor {
    let cells = |length_m: f64| (length_m / step_m).round().max(1.0) as usize;
    let half_m = [scenario.room.length_x_m / 2.0, scenario.room.length_y_m / 2.0];
    let (columns, rows) = (cells(scenario.room.length_x_m), cells(scenario.room.length_y_m));
    let mut floor = Floor { label: String::new(), columns, rows, half_m, values: Vec::with_capacity(rows * columns) };
    let mut scene = Scene::new(world.model(), 1);
    for index in 0..rows * columns {
        let [x, y] = floor.centre(index % columns, index / columns);
        let place = Vec3::new(x, y, scenario.receiver.height_m);
        scene.update(world.model(), &[place], world.blockers(), &[false]);
        floor.values.push(value(&scene));
    }
    floor
}
