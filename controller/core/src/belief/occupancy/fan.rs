//! The cells near the paths from one point to several others.

use heliostat_channel::Vec3;

use super::grid::Grid;

/// Paths of a fan: two vectors of AVX2.
pub(super) const LANES: usize = 16;

/// One value for each path of a fan.
pub(super) type Lanes = [f32; LANES];

/// A path with less extent than this in m along an axis has none.
const FLAT_M: f32 = 1e-6;

/// A cell near some of the paths.
#[derive(Clone, Copy, Debug)]
pub(super) struct Near {
    pub cell: usize,
    /// How surely an obstacle in the cell blocks each path, from 0 to 1.
    pub blocks: Lanes,
}

/// The cells near up to [`LANES`] paths from one point. Numbers are in f32, so that eight paths fit
/// into a vector; its precision is far below the width of an edge.
#[derive(Clone, Debug, Default)]
pub(super) struct Fan {
    pub near: Vec<Near>,
}

/// The parts of the paths below the height of obstacles, in plan view from the common point.
struct LowParts {
    x: Lanes,
    y: Lanes,
    /// 1 / the squared length; 0 for a path without a length.
    inverse: Lanes,
    /// 1 / y, within bounds.
    inverse_y: Lanes,
    /// Distance in m at which an obstacle begins to block; 0 for a lane without a path.
    reach_m: Lanes,
}

impl LowParts {
    #[inline(always)]
    fn new(grid: &Grid, from: &Vec3, to: &[Vec3]) -> Self {
        let zero = [0.0; LANES];
        let mut parts = Self { x: zero, y: zero, inverse: zero, inverse_y: zero, reach_m: zero };
        for (lane, to) in to.iter().enumerate() {
            let low = grid.low_part(from, to);
            let [x, y] = low.along.map(|part| part as f32);
            (parts.x[lane], parts.y[lane]) = (x, y);
            parts.inverse[lane] = low.inverse as f32;
            parts.inverse_y[lane] = 1.0 / if y.abs() > FLAT_M { y } else { FLAT_M };
            parts.reach_m[lane] = grid.reach_m() as f32;
        }
        parts
    }

    /// The smallest and the largest x of the parts that are within reach of a row at `y`.
    #[inline(always)]
    fn extent_at(&self, y: f32) -> [f32; 2] {
        let (mut least, mut most) = ([f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]);
        for lane in 0..LANES {
            let [one, two] = [y - self.reach_m[lane], y + self.reach_m[lane]]
                .map(|bound| (bound * self.inverse_y[lane]).clamp(0.0, 1.0));
            let (x_one, x_two) = (one * self.x[lane], two * self.x[lane]);
            let is_within = one != two;
            least[lane] = if is_within { if x_one < x_two { x_one } else { x_two } } else { f32::INFINITY };
            most[lane] = if is_within { if x_one < x_two { x_two } else { x_one } } else { f32::NEG_INFINITY };
        }
        [least.into_iter().fold(f32::INFINITY, f32::min), most.into_iter().fold(f32::NEG_INFINITY, f32::max)]
    }

    /// How surely an obstacle at `off` blocks each path, as [`Grid::blocks`].
    #[inline(always)]
    fn blocks(&self, off: [f32; 2], per_m: f32) -> Lanes {
        std::array::from_fn(
            #[inline(always)]
            |lane| {
                let share = ((off[0] * self.x[lane] + off[1] * self.y[lane]) * self.inverse[lane]).clamp(0.0, 1.0);
                let gap = [off[0] - share * self.x[lane], off[1] - share * self.y[lane]];
                let distance = (gap[0] * gap[0] + gap[1] * gap[1]).sqrt();
                ((self.reach_m[lane] - distance) * per_m).clamp(0.0, 1.0)
            },
        )
    }
}

impl Fan {
    /// A fan with memory for all cells.
    pub fn with_capacity(cells: usize) -> Self {
        Self { near: Vec::with_capacity(cells) }
    }

    /// Lists the cells near the paths from a point to at most [`LANES`] others, row by row.
    #[inline(always)]
    pub fn trace(&mut self, grid: &Grid, from: &Vec3, to: &[Vec3]) {
        self.near.clear();
        if from.z >= grid.height_m {
            return;
        }
        let parts = LowParts::new(grid, from, to);
        let reach = grid.reach_m();
        let least = parts.y.into_iter().fold(0.0, f32::min);
        let most = parts.y.into_iter().fold(0.0, f32::max);
        let per_m = grid.blocks_per_m() as f32;
        for row in grid.index(from.y + f64::from(least) - reach, 1)..=grid.index(from.y + f64::from(most) + reach, 1) {
            let y = (grid.centre_of(row, 1) - from.y) as f32;
            let [left, right] = parts.extent_at(y);
            if left > right {
                continue;
            }
            let first = grid.index(from.x + f64::from(left) - reach, 0);
            let last = grid.index(from.x + f64::from(right) + reach, 0);
            for column in first..=last {
                let blocks = parts.blocks([(grid.centre_of(column, 0) - from.x) as f32, y], per_m);
                if blocks.iter().any(|blocks| *blocks > 0.0) {
                    self.near.push(Near { cell: row * grid.columns + column, blocks });
                }
            }
        }
    }

    /// The probability that no obstacle blocks each path, for these probabilities of the cells.
    #[inline(always)]
    pub fn clear(&self, probability: &[f64]) -> Lanes {
        let mut clear = [1.0; LANES];
        for Near { cell, blocks } in &self.near {
            let occupied = probability[*cell] as f32;
            for (clear, blocks) in clear.iter_mut().zip(blocks) {
                *clear *= 1.0 - occupied * blocks;
            }
        }
        clear
    }

    /// Calls `add` with each cell and with the sum of `clear` b / (1 - p b) over the paths: b is
    /// how surely an obstacle in the cell blocks a path, and p the probability of one.
    #[inline(always)]
    pub fn influence(&self, probability: &[f64], clear: &Lanes, mut add: impl FnMut(usize, f64)) {
        for Near { cell, blocks } in &self.near {
            let occupied = probability[*cell] as f32;
            let mut parts = [0.0; LANES];
            for lane in 0..LANES {
                parts[lane] = clear[lane] * blocks[lane] / (1.0 - occupied * blocks[lane]);
            }
            let mut sums: [f32; 8] = std::array::from_fn(|lane| parts[lane] + parts[lane + 8]);
            for half in [4, 2, 1] {
                for lane in 0..half {
                    sums[lane] += sums[lane + half];
                }
            }
            add(*cell, f64::from(sums[0]));
        }
    }
}
