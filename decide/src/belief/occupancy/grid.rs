//! The cells of a floor, and which of them are near a path.

use heliostat_channel::Vec3;
use heliostat_scenario::Scenario;

/// Side of a cell in m, in rooms of up to [`CELLS_MAX`] cells.
const CELL_M: f64 = 0.25;

/// Larger rooms have larger cells.
const CELLS_MAX: f64 = 10_000.0;

/// Half of the width in m over which a path becomes blocked: the error of the believed places and
/// of the cells.
const EDGE_M: f64 = 0.1;

/// Cells of a row that are examined together.
const LANES: usize = 8;

/// The part of a path below the height of obstacles, in plan view, as a vector from its start.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LowPart {
    pub along: [f64; 2],
    /// 1 / the squared length; 0 for a path without a length.
    inverse: f64,
}

impl LowPart {
    /// Length in m.
    pub fn length_m(&self) -> f64 {
        let [x, y] = self.along;
        (x * x + y * y).sqrt()
    }
}

/// The cells of the floor, and the shape of an obstacle.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    cell_m: f64,
    pub columns: usize,
    pub rows: usize,
    half_m: [f64; 2],
    pub radius_m: f64,
    pub height_m: f64,
}

impl Grid {
    /// The cells of a scenario's floor.
    pub fn new(scenario: &Scenario) -> Self {
        let (room, blockage) = (&scenario.room, &scenario.blockage);
        let cell_m = CELL_M.max((room.length_x_m * room.length_y_m / CELLS_MAX).sqrt());
        let count = |length: f64| (length / cell_m).ceil().max(1.0) as usize;
        Self {
            cell_m,
            columns: count(room.length_x_m),
            rows: count(room.length_y_m),
            half_m: [0.5 * room.length_x_m, 0.5 * room.length_y_m],
            radius_m: blockage.obstacle_radius_m,
            height_m: blockage.obstacle_height_m,
        }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// Area of a cell in m2.
    pub fn cell_m2(&self) -> f64 {
        self.cell_m * self.cell_m
    }

    /// The centre of a cell in m.
    pub fn centre(&self, cell: usize) -> [f64; 2] {
        let at = |index: usize, axis: usize| (index as f64 + 0.5) * self.cell_m - self.half_m[axis];
        [at(cell % self.columns, 0), at(cell / self.columns, 1)]
    }

    /// Distance in m at which an obstacle begins to block a path.
    pub fn reach_m(&self) -> f64 {
        self.radius_m + EDGE_M
    }

    /// The part of a path that obstacles can block.
    #[inline(always)]
    pub fn low_part(&self, from: &Vec3, to: &Vec3) -> LowPart {
        let low = if to.z > self.height_m { (self.height_m - from.z) / (to.z - from.z) } else { 1.0 };
        let low = low.max(0.0);
        let along = [low * (to.x - from.x), low * (to.y - from.y)];
        let squared = along[0] * along[0] + along[1] * along[1];
        LowPart { along, inverse: if squared > 0.0 { 1.0 / squared } else { 0.0 } }
    }

    /// How surely an obstacle at `off` from the start of a path blocks it, from 0 to 1.
    ///
    /// Without branches, so that a loop over paths or cells vectorises.
    #[inline(always)]
    pub fn blocks(&self, LowPart { along, inverse }: &LowPart, off: [f64; 2]) -> f64 {
        let share = ((off[0] * along[0] + off[1] * along[1]) * inverse).clamp(0.0, 1.0);
        let gap = [off[0] - share * along[0], off[1] - share * along[1]];
        let distance = (gap[0] * gap[0] + gap[1] * gap[1]).sqrt();
        ((self.reach_m() - distance) * (0.5 / EDGE_M)).clamp(0.0, 1.0)
    }

    /// Calls `visit` with each cell near a path and with how surely an obstacle there blocks it,
    /// above 0 and at most 1.
    #[inline(always)]
    pub fn near(&self, from: &Vec3, to: &Vec3, mut visit: impl FnMut(usize, f64)) {
        if from.z >= self.height_m {
            return;
        }
        let start = [from.x, from.y];
        let path = self.low_part(from, to);
        let along = path.along;
        let end = [start[0] + along[0], start[1] + along[1]];
        let reach = self.reach_m();
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
            for first in columns.clone().step_by(LANES) {
                let mut blocks = [0.0; LANES];
                for (lane, blocks) in blocks.iter_mut().enumerate() {
                    let x = ((first + lane) as f64 + 0.5) * self.cell_m - self.half_m[0];
                    *blocks = self.blocks(&path, [x - start[0], y - start[1]]);
                }
                for (column, blocks) in (first..=*columns.end()).zip(blocks).filter(|(_, blocks)| *blocks > 0.0) {
                    visit(row * self.columns + column, blocks);
                }
            }
        }
    }
}

/// The region of all paths between two, in plan view.
pub(super) struct Sector {
    ends: [[f64; 2]; 2],
    lengths_m: [f64; 2],
    /// The sign of the angle from the first path to the last one.
    side: f64,
    reach_m: f64,
}

impl Sector {
    /// The paths between a first and a last one; an obstacle blocks those within `reach_m`.
    pub fn new([first, last]: [&LowPart; 2], reach_m: f64) -> Self {
        let ends = [first.along, last.along];
        Self { ends, lengths_m: [first.length_m(), last.length_m()], side: cross(&ends[0], &ends[1]).signum(), reach_m }
    }

    /// Whether an obstacle at `off` is too far from all paths to matter.
    pub fn excludes(&self, off: &[f64; 2]) -> bool {
        let Self { ends: [first, last], lengths_m: [first_m, last_m], side, reach_m } = self;
        let beyond_first = -side * cross(first, off) > reach_m * first_m;
        let beyond_last = side * cross(last, off) > reach_m * last_m;
        let squared = off[0] * off[0] + off[1] * off[1];
        let is_behind = off[0] * (first[0] + last[0]) + off[1] * (first[1] + last[1]) < 0.0;
        let farthest = first_m.max(*last_m) + reach_m;
        beyond_first || beyond_last || is_behind && squared > reach_m * reach_m || squared > farthest * farthest
    }
}

fn cross(one: &[f64; 2], two: &[f64; 2]) -> f64 {
    one[0] * two[1] - one[1] * two[0]
}
