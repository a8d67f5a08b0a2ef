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

/// The part of a path below the height of obstacles, in plan view, as a vector from its start.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LowPart {
    pub along: [f64; 2],
    /// 1 / the squared length in m2; 0 for a path without a length.
    pub inverse: f64,
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
        [self.centre_of(cell % self.columns, 0), self.centre_of(cell / self.columns, 1)]
    }

    /// The centre of a column (axis 0) or of a row (axis 1) in m.
    #[inline(always)]
    pub fn centre_of(&self, index: usize, axis: usize) -> f64 {
        (index as f64 + 0.5) * self.cell_m - self.half_m[axis]
    }

    /// The column (axis 0) or the row (axis 1) of a coordinate in m, or the nearest one.
    #[inline(always)]
    pub fn index(&self, at_m: f64, axis: usize) -> usize {
        let count = [self.columns, self.rows][axis];
        // A negative number becomes 0.
        (((at_m + self.half_m[axis]) / self.cell_m) as usize).min(count - 1)
    }

    /// Distance in m at which an obstacle begins to block a path.
    pub fn reach_m(&self) -> f64 {
        self.radius_m + EDGE_M
    }

    /// How fast an obstacle blocks a path as it comes nearer, per m.
    pub fn blocks_per_m(&self) -> f64 {
        0.5 / EDGE_M
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
        ((self.reach_m() - distance) * self.blocks_per_m()).clamp(0.0, 1.0)
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
