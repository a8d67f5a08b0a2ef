//! Where unreported obstacles stand: a map of probabilities over the floor.
//!
//! A cell holds the probability that an obstacle's axis is in it. Radius, height and mean density
//! are the scenario's. The path from a user to an LED or to a column of mirrors is blocked by an
//! axis that is nearer than the radius to the part of the path below the obstacle's height, in plan
//! view. Each measurement updates the cells near its paths by Bayes' rule; the cells are treated as
//! independent, as in occupancy grids (Elfes, 1989). With each report one row of cells relaxes
//! towards the mean density, so that an obstacle that has moved is forgotten.

use heliostat_channel::Vec3;
use heliostat_scenario::Scenario;
use serde::{Deserialize, Serialize};

/// Side of a cell in m, in rooms of up to [`CELLS_MAX`] cells.
const CELL_M: f64 = 0.2;

/// Larger rooms have larger cells.
const CELLS_MAX: f64 = 10_000.0;

/// Half of the width in m over which a path becomes blocked: the error of the believed places and
/// of the cells.
const EDGE_M: f64 = 0.1;

/// Bounds of a cell's probability, so that it can still change.
const BOUNDS: [f64; 2] = [1e-4, 0.99];

/// Share of the difference from the mean density that a row loses when it relaxes.
const RELAXATION: f64 = 0.005;

/// A cell is suspected if its probability exceeds the mean one by this factor.
const SUSPECTED: f64 = 10.0;

/// Paths that are weighed together.
const CHUNK: usize = 16;

/// Probability that a measurement has another cause than the map and the bodies.
const UNEXPLAINED: f64 = 0.05;

/// The cells of the floor, and the shape of an obstacle.
#[derive(Clone, Debug)]
struct Grid {
    cell_m: f64,
    columns: usize,
    rows: usize,
    half_m: [f64; 2],
    radius_m: f64,
    height_m: f64,
}

impl Grid {
    fn centre(&self, cell: usize) -> [f64; 2] {
        let at = |index: usize, axis: usize| (index as f64 + 0.5) * self.cell_m - self.half_m[axis];
        [at(cell % self.columns, 0), at(cell / self.columns, 1)]
    }

    /// The part of a path below the height of obstacles, in plan view, as a vector from its start.
    #[inline(always)]
    fn low_part(&self, from: &Vec3, to: &Vec3) -> [f64; 2] {
        let low = if to.z > self.height_m { (self.height_m - from.z) / (to.z - from.z) } else { 1.0 };
        let low = low.max(0.0);
        [low * (to.x - from.x), low * (to.y - from.y)]
    }

    /// How surely an obstacle at `off` from the start of a path blocks it, from 0 to 1. `inverse` is
    /// 1 / the squared length of the path.
    #[inline(always)]
    fn blocks(&self, (along, inverse): ([f64; 2], f64), off: [f64; 2]) -> f64 {
        let share = ((off[0] * along[0] + off[1] * along[1]) * inverse).clamp(0.0, 1.0);
        let gap = [off[0] - share * along[0], off[1] - share * along[1]];
        let squared = gap[0] * gap[0] + gap[1] * gap[1];
        let (reach, core) = (self.radius_m + EDGE_M, self.radius_m - EDGE_M);
        if squared >= reach * reach {
            0.0
        } else if core > 0.0 && squared <= core * core {
            1.0
        } else {
            ((reach - squared.sqrt()) / (2.0 * EDGE_M)).min(1.0)
        }
    }

    /// Calls `visit` with each cell near a path and with how surely an obstacle there blocks it,
    /// from 0 to 1.
    #[inline(always)]
    fn near(&self, from: &Vec3, to: &Vec3, mut visit: impl FnMut(usize, f64)) {
        if from.z >= self.height_m {
            return;
        }
        let start = [from.x, from.y];
        let along = self.low_part(from, to);
        let inverse = inverse_square(along);
        let end = [start[0] + along[0], start[1] + along[1]];
        let reach = self.radius_m + EDGE_M;
        let index = |value: f64, axis: usize, count: usize| {
            ((value + self.half_m[axis]) / self.cell_m).floor().clamp(0.0, count as f64 - 1.0) as usize
        };
        let (bottom, top) = (start[1].min(end[1]) - reach, start[1].max(end[1]) + reach);
        for row in index(bottom, 1, self.rows)..=index(top, 1, self.rows) {
            let y = (row as f64 + 0.5) * self.cell_m - self.half_m[1];
            // The part of the path within reach of the row.
            let at = |y: f64| if along[1] == 0.0 { 0.5 } else { ((y - start[1]) / along[1]).clamp(0.0, 1.0) };
            let (one, two) = if along[1] == 0.0 { (0.0, 1.0) } else { (at(y - reach), at(y + reach)) };
            let (x_one, x_two) = (start[0] + one * along[0], start[0] + two * along[0]);
            let columns =
                index(x_one.min(x_two) - reach, 0, self.columns)..=index(x_one.max(x_two) + reach, 0, self.columns);
            for column in columns {
                let x = (column as f64 + 0.5) * self.cell_m - self.half_m[0];
                let blocks = self.blocks((along, inverse), [x - start[0], y - start[1]]);
                if blocks > 0.0 {
                    visit(row * self.columns + column, blocks);
                }
            }
        }
    }
}

/// Whether an obstacle at `off` is too far from all paths between two, to matter.
fn outside([first, last]: &[[f64; 2]; 2], off: [f64; 2], reach: f64) -> bool {
    let cross = |one: &[f64; 2], two: &[f64; 2]| one[0] * two[1] - one[1] * two[0];
    let length = |one: &[f64; 2]| (one[0] * one[0] + one[1] * one[1]).sqrt();
    let side = cross(first, last).signum();
    let beyond_first = -side * cross(first, &off) > reach * length(first);
    let beyond_last = side * cross(last, &off) > reach * length(last);
    let distance = length(&off);
    let behind = off[0] * (first[0] + last[0]) + off[1] * (first[1] + last[1]) < 0.0 && distance > reach;
    beyond_first || beyond_last || behind || distance > length(first).max(length(last)) + reach
}

/// 1 / the squared length of a vector; 0 for one without a length.
fn inverse_square(along: [f64; 2]) -> f64 {
    let squared = along[0] * along[0] + along[1] * along[1];
    if squared > 0.0 { 1.0 / squared } else { 0.0 }
}

/// How the expected share of the light changes if it is certain that a cell holds no obstacle, or
/// that it holds one.
#[derive(Clone, Copy, Debug, Default)]
struct Change {
    is_touched: bool,
    without: f64,
    with: f64,
}

/// The map.
#[derive(Clone, Debug)]
pub struct Occupancy {
    grid: Grid,
    probability: Vec<f64>,
    mean: f64,
    /// The next row to relax.
    row: usize,
    changes: Vec<Change>,
    /// The cells with an entry in `changes`.
    touched: Vec<usize>,
    /// The cells that probably hold an obstacle.
    suspects: Vec<Suspect>,
}

/// The state of a map, as a recording holds it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct OccupancyMemory {
    probability: Vec<f64>,
    row: usize,
}

/// A cell that probably holds an obstacle.
#[derive(Clone, Copy, Debug)]
struct Suspect {
    at_m: [f64; 2],
    probability: f64,
}

impl Occupancy {
    /// The map of a scenario; `None` where there are no obstacles, or surveys report them.
    pub fn new(scenario: &Scenario) -> Option<Self> {
        let (room, blockage) = (&scenario.room, &scenario.blockage);
        if blockage.obstacles_per_m2 <= 0.0 || scenario.streams.obstacles.rate_hz > 0.0 {
            return None;
        }
        let cell_m = CELL_M.max((room.length_x_m * room.length_y_m / CELLS_MAX).sqrt());
        let count = |length: f64| (length / cell_m).ceil().max(1.0) as usize;
        let (columns, rows) = (count(room.length_x_m), count(room.length_y_m));
        let mean = (blockage.obstacles_per_m2 * cell_m * cell_m).clamp(BOUNDS[0], BOUNDS[1]);
        let grid = Grid {
            cell_m,
            columns,
            rows,
            half_m: [0.5 * room.length_x_m, 0.5 * room.length_y_m],
            radius_m: blockage.obstacle_radius_m,
            height_m: blockage.obstacle_height_m,
        };
        let cells = columns * rows;
        Some(Self {
            grid,
            probability: vec![mean; cells],
            mean,
            row: 0,
            changes: vec![Change::default(); cells],
            touched: Vec::with_capacity(cells),
            suspects: Vec::with_capacity(cells),
        })
    }

    /// The probability of each cell, and the row that relaxes next.
    pub(super) fn memory(&self) -> OccupancyMemory {
        OccupancyMemory { probability: self.probability.clone(), row: self.row }
    }

    /// Replaces the probabilities; false, without a change, where they are not those of this floor.
    pub(super) fn restore(&mut self, memory: &OccupancyMemory) -> bool {
        let is_probability = |value: &f64| (0.0..=1.0).contains(value);
        let fits = memory.probability.len() == self.probability.len()
            && memory.row < self.grid.rows
            && memory.probability.iter().all(is_probability);
        if fits {
            self.probability.clone_from(&memory.probability);
            self.row = memory.row;
            self.list_suspects();
        }
        fits
    }

    /// Forgets everything but the mean density.
    pub fn clear(&mut self) {
        self.probability.fill(self.mean);
        self.suspects.clear();
    }

    /// Probability that no unreported obstacle blocks the path from a user to a point.
    pub fn clear_probability(&self, from: &Vec3, to: &Vec3) -> f64 {
        let mut clear = 1.0;
        self.grid.near(from, to, |cell, blocks| clear *= 1.0 - self.probability[cell] * blocks);
        clear
    }

    /// Multiplies each entry of `clear` by the probability that no suspected obstacle blocks the path
    /// from a user to the point of the same index. The points lie on a line.
    pub fn weigh(&self, from: &Vec3, points: &[Vec3], clear: &mut [f64]) {
        if from.z >= self.grid.height_m {
            return;
        }
        let reach = self.grid.radius_m + EDGE_M;
        for (points, clear) in points.chunks(CHUNK).zip(clear.chunks_mut(CHUNK)) {
            let mut paths = [([0.0; 2], 0.0); CHUNK];
            for (path, point) in paths.iter_mut().zip(points) {
                let along = self.grid.low_part(from, point);
                *path = (along, inverse_square(along));
            }
            let ends = [paths[0].0, paths[points.len() - 1].0];
            for suspect in &self.suspects {
                let off = [suspect.at_m[0] - from.x, suspect.at_m[1] - from.y];
                if outside(&ends, off, reach) {
                    continue;
                }
                for (clear, path) in clear.iter_mut().zip(&paths) {
                    *clear *= 1.0 - suspect.probability * self.grid.blocks(*path, off);
                }
            }
        }
    }

    /// Takes whether the path from a user to an LED was clear; `otherwise` is the probability that
    /// bodies leave it clear.
    pub fn handle_direct(&mut self, from: &Vec3, led: &Vec3, is_clear: bool, otherwise: f64) {
        let expected = self.expect(from, [(*led, otherwise)].into_iter());
        self.update(expected, |expected| {
            let clear = expected.clamp(0.0, 1.0);
            UNEXPLAINED + (1.0 - 2.0 * UNEXPLAINED) * if is_clear { clear } else { 1.0 - clear }
        });
    }

    /// Takes a measured gain over the mirrors. `shares` are the parts of the gain without obstacles
    /// that come from points on the array; `density` is that of the measured gain for an expected
    /// one.
    pub fn handle_reflected(
        &mut self,
        from: &Vec3,
        shares: impl Iterator<Item = (Vec3, f64)>,
        density: impl Fn(f64) -> f64,
    ) {
        let expected = self.expect(from, shares);
        self.update(expected, density);
    }

    /// Relaxes the next row and lists the suspects; to be called once for each report.
    pub fn finish_report(&mut self) {
        let cells = self.row * self.grid.columns..(self.row + 1) * self.grid.columns;
        self.probability[cells]
            .iter_mut()
            .for_each(|probability| *probability += RELAXATION * (self.mean - *probability));
        self.row = (self.row + 1) % self.grid.rows;
        self.list_suspects();
    }

    fn list_suspects(&mut self) {
        let Self { grid, probability, suspects, mean, .. } = self;
        suspects.clear();
        let suspected = SUSPECTED * *mean;
        let listed = probability.iter().enumerate().filter(|(_, probability)| **probability > suspected);
        suspects
            .extend(listed.map(|(cell, probability)| Suspect { at_m: grid.centre(cell), probability: *probability }));
    }

    /// The expected sum of the shares of these paths, by the map; fills `changes`.
    fn expect(&mut self, from: &Vec3, shares: impl Iterator<Item = (Vec3, f64)>) -> f64 {
        let Self { grid, probability, changes, touched, .. } = self;
        let mut sum = 0.0;
        for (to, share) in shares.filter(|(_, share)| *share > 0.0) {
            let mut clear = share;
            grid.near(from, &to, |cell, blocks| clear *= 1.0 - probability[cell] * blocks);
            sum += clear;
            grid.near(from, &to, |cell, blocks| {
                let change = &mut changes[cell];
                if !change.is_touched {
                    touched.push(cell);
                    change.is_touched = true;
                }
                let without = clear / (1.0 - probability[cell] * blocks);
                change.without += without - clear;
                change.with += without * (1.0 - blocks) - clear;
            });
        }
        sum
    }

    /// Updates the cells with an entry in `changes`, and removes the entries.
    fn update(&mut self, expected: f64, likelihood: impl Fn(f64) -> f64) {
        for cell in self.touched.drain(..) {
            let Change { without, with, .. } = std::mem::take(&mut self.changes[cell]);
            let (without, with) = (likelihood(expected + without), likelihood(expected + with));
            let probability = &mut self.probability[cell];
            let occupied = *probability * with;
            *probability = (occupied / (occupied + (1.0 - *probability) * without)).clamp(BOUNDS[0], BOUNDS[1]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LED: Vec3 = Vec3::new(0.0, 0.0, 3.0);

    fn map() -> Occupancy {
        Occupancy::new(&Scenario::builtin("hall").expect("a built-in scenario")).expect("hidden obstacles")
    }

    fn device(x: f64, y: f64) -> Vec3 {
        Vec3::new(x, y, 0.85)
    }

    fn probability(map: &Occupancy, x: f64, y: f64) -> f64 {
        let cell = (0..map.probability.len()).min_by(|one, two| {
            let distance = |cell: usize| (map.grid.centre(cell)[0] - x).hypot(map.grid.centre(cell)[1] - y);
            distance(*one).total_cmp(&distance(*two))
        });
        map.probability[cell.expect("a cell")]
    }

    #[test]
    fn paths_past_an_obstacle_find_it() {
        let mut map = map();
        // Devices on circles around an obstacle, with the LED at the origin: the paths of those
        // beyond it are blocked, as they would be by an obstacle at the device.
        let obstacle = heliostat_channel::Cylinder::new(1.5, 0.0, map.grid.radius_m, map.grid.height_m).expect("valid");
        for step in 0..200 {
            let angle = f64::from(step) * 0.7;
            let radius = 0.3 + 0.1 * f64::from(step % 5);
            let at = device(1.5 + radius * angle.cos(), radius * angle.sin());
            let blocked = heliostat_channel::blockage::blocks(&obstacle, &LED, &at);
            map.handle_direct(&at, &LED, !blocked, 1.0);
        }
        map.finish_report();
        let found: f64 = map.suspects.iter().map(|suspect| suspect.probability).sum();
        assert!(found > 0.5, "{:?}", map.suspects);
        let near = |suspect: &Suspect| (suspect.at_m[0] - 1.7).hypot(suspect.at_m[1]) < 0.7;
        assert!(map.suspects.iter().filter(|suspect| suspect.probability > 0.3).all(near), "{:?}", map.suspects);
        // The path of a new device behind it is blocked, and that of one beside it is not.
        assert!(map.clear_probability(&device(2.1, 0.0), &LED) < 0.4);
        assert!(map.clear_probability(&device(1.5, 1.2), &LED) > 0.8);
    }

    #[test]
    fn a_clear_path_frees_its_cells_and_another_cause_leaves_them() {
        let (mut map, at) = (map(), device(2.0, 0.0));
        let before = probability(&map, 1.7, 0.0);
        map.handle_direct(&at, &LED, false, 0.05);
        assert!(probability(&map, 1.7, 0.0) < 1.3 * before, "a body explains the blockage");
        map.handle_direct(&at, &LED, true, 0.95);
        assert!(probability(&map, 1.7, 0.0) < 0.3 * before);
        assert_eq!(probability(&map, -2.0, 2.0), before, "far from the path");
        map.clear();
        assert_eq!(probability(&map, 1.7, 0.0), before);
    }

    #[test]
    fn missing_reflected_light_is_explained_by_an_obstacle_on_its_path() {
        let (mut map, at) = (map(), device(0.0, -1.0));
        let columns = [Vec3::new(-1.0, 2.5, 1.5), Vec3::new(1.0, 2.5, 1.5)];
        // All of the light of the left column arrives, and none of the right one.
        for (shares, measured) in [([1.0, 0.0], 1.0), ([0.5, 0.5], 0.5)] {
            for _ in 0..5 {
                let density = |expected: f64| (-0.5 * ((measured - expected) / 0.1_f64).powi(2)).exp() + 0.05;
                map.handle_reflected(&at, columns.into_iter().zip(shares), density);
            }
        }
        map.finish_report();
        let mut clear = [1.0; 2];
        map.weigh(&at, &columns, &mut clear);
        assert!(clear[0] > 0.9 && clear[1] < 0.5, "{clear:?}");
    }

    #[test]
    fn suspects_weigh_paths_as_all_cells_do() {
        let mut map = map();
        for cell in [100, 101, 130, 300, 412] {
            map.probability[cell] = 0.6;
        }
        map.finish_report();
        let columns: Vec<Vec3> = (0..10).map(|index| Vec3::new(0.2 * f64::from(index) - 0.9, 2.5, 1.5)).collect();
        for at in [device(-2.0, -2.0), device(1.0, 0.3), device(0.0, 2.0)] {
            let mut clear = vec![1.0; 10];
            map.weigh(&at, &columns, &mut clear);
            for (clear, column) in clear.iter().zip(&columns) {
                let all = map.clear_probability(&at, column);
                assert!((clear - all).abs() < 0.2 && *clear >= all, "{clear} for {all}");
            }
        }
    }
}
