//! A value at each point of the floor for one additional detector.

use heliostat_channel::{Scene, Vec3};
use heliostat_room::World;
use heliostat_scenario::Scenario;

use crate::figure::Floor;

/// Evaluates `value` at each point of a grid, for the scene of one additional detector. Obstacles
/// and the bodies of the users block its light; it has no body of its own.
///
/// `step_m`: approximate distance between points; each side has at least one point.
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
