//! The probability of two quantities on a grid, by Bayes' rule: the deviations of a mirror's roll and
//! yaw, or the place of a spot.

/// Cells along each side.
const SIDE: usize = 33;

/// Half of the grid's extent in prior standard deviations.
const EXTENT: f64 = 3.0;

/// Share of readings that a passing body or another fault spoils.
const OUTLIER_SHARE: f64 = 0.03;

/// Probabilities on a grid around a centre.
#[derive(Clone, Debug)]
pub struct Grid {
    centre: [f64; 2],
    /// Distance between two cells along each axis.
    step: [f64; 2],
    /// Probability of each cell, the second axis within the first.
    weights: Vec<f64>,
}

/// A likelihood: the reading, and the model's gain and standard deviation in a cell.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// Gain of the model.
    pub gain: f64,
    /// Standard deviation of a reading.
    pub deviation: f64,
}

impl Grid {
    /// A normal distribution of two independent quantities.
    pub fn normal(centre: [f64; 2], deviation: [f64; 2]) -> Self {
        let step = deviation.map(|deviation| EXTENT * deviation / (SIDE / 2) as f64);
        let mut grid = Self { centre, step, weights: vec![1.0; SIDE * SIDE] };
        for cell in 0..SIDE * SIDE {
            let [a, b] = [0, 1].map(|axis| (grid.at(cell)[axis] - centre[axis]) / deviation[axis]);
            grid.weights[cell] = (-0.5 * (a * a + b * b)).exp();
        }
        grid.normalise();
        grid
    }

    /// The values of a cell.
    fn at(&self, cell: usize) -> [f64; 2] {
        let index = [cell / SIDE, cell % SIDE];
        [0, 1].map(|axis| self.centre[axis] + (index[axis] as f64 - (SIDE / 2) as f64) * self.step[axis])
    }

    /// Applies a reading by its [`likelihood`] in each cell.
    pub fn observe(&mut self, reading: f64, peak: f64, expected: impl Fn([f64; 2]) -> Expected) {
        for cell in 0..SIDE * SIDE {
            if self.weights[cell] < 1e-12 {
                self.weights[cell] = 0.0;
                continue;
            }
            self.weights[cell] *= likelihood(reading, peak, expected(self.at(cell)));
        }
        self.normalise();
    }

    /// Mean and standard deviation of each quantity.
    pub fn moments(&self) -> ([f64; 2], [f64; 2]) {
        let (mut mean, mut square) = ([0.0; 2], [0.0; 2]);
        for (cell, weight) in self.weights.iter().enumerate() {
            let at = self.at(cell);
            for axis in 0..2 {
                mean[axis] += weight * at[axis];
                square[axis] += weight * (at[axis] - self.centre[axis]).powi(2);
            }
        }
        // A cell is uniform over its side.
        let deviation = [0, 1].map(|axis| {
            let variance = square[axis] - (mean[axis] - self.centre[axis]).powi(2);
            (variance.max(0.0) + self.step[axis].powi(2) / 12.0).sqrt()
        });
        (mean, deviation)
    }

    /// The centre of the window of these half widths that holds the most probability, and its
    /// probability. After dark readings the mean would repeat one place; this does not.
    pub fn best_window(&self, half: [f64; 2]) -> ([f64; 2], f64) {
        // Sums over all cells below and left of each corner.
        let mut sums = vec![0.0; (SIDE + 1) * (SIDE + 1)];
        let at = |a: usize, b: usize| a * (SIDE + 1) + b;
        for a in 0..SIDE {
            for b in 0..SIDE {
                sums[at(a + 1, b + 1)] =
                    self.weights[a * SIDE + b] + sums[at(a, b + 1)] + sums[at(a + 1, b)] - sums[at(a, b)];
            }
        }
        let reach = [0, 1].map(|axis| (half[axis] / self.step[axis]) as usize);
        let mut best = (self.centre, -1.0, f64::INFINITY);
        for cell in 0..SIDE * SIDE {
            let (a, b) = (cell / SIDE, cell % SIDE);
            let low = [a.saturating_sub(reach[0]), b.saturating_sub(reach[1])];
            let high = [(a + reach[0] + 1).min(SIDE), (b + reach[1] + 1).min(SIDE)];
            let mass = sums[at(high[0], high[1])] - sums[at(low[0], high[1])] - sums[at(high[0], low[1])]
                + sums[at(low[0], low[1])];
            // Of equal windows the one nearest to the centre, since all of the prior fits in some.
            let [da, db] = [a.abs_diff(SIDE / 2) as f64, b.abs_diff(SIDE / 2) as f64];
            let distance = da * da + db * db;
            if mass > best.1 + 1e-9 || (mass > best.1 - 1e-9 && distance < best.2) {
                best = (self.at(cell), mass.max(best.1), distance);
            }
        }
        (best.0, best.1)
    }

    fn normalise(&mut self) {
        let sum: f64 = self.weights.iter().sum();
        if sum > 0.0 {
            self.weights.iter_mut().for_each(|weight| *weight /= sum);
        } else {
            let uniform = 1.0 / self.weights.len() as f64;
            self.weights.fill(uniform);
        }
    }
}

/// The likelihood of a reading: that of the normal distribution, or that of a spoiled reading, which is
/// uniform between 0 and the largest gain, `peak`.
pub fn likelihood(reading: f64, peak: f64, Expected { gain, deviation }: Expected) -> f64 {
    let z = (reading - gain) / deviation;
    let normal = (-0.5 * z * z).exp() / (deviation * std::f64::consts::TAU.sqrt());
    (1.0 - OUTLIER_SHARE) * normal + OUTLIER_SHARE / peak
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A light of half widths 1 and 3 whose edge has a width of 0.1.
    fn light([x, y]: [f64; 2]) -> f64 {
        let edge = |distance: f64| 1.0 / (1.0 + (-10.0 * distance).exp());
        edge(1.0 - x.abs()) * edge(3.0 - y.abs())
    }

    fn probe(grid: &mut Grid, truth: [f64; 2], aim: [f64; 2]) -> f64 {
        let reading = light([truth[0] + aim[0], truth[1] + aim[1]]);
        grid.observe(reading, 1.0, |[x, y]| Expected { gain: light([x + aim[0], y + aim[1]]), deviation: 0.05 });
        reading
    }

    #[test]
    fn dark_readings_move_the_search_and_edges_locate_the_light() {
        let truth = [1.7, -0.6];
        let mut grid = Grid::normal([0.0; 2], [0.8, 0.8]);
        let mut tried: Vec<[f64; 2]> = Vec::new();
        for _ in 0..6 {
            let (centre, mass) = grid.best_window([1.0, 3.0]);
            assert!(mass > 0.2, "{mass}");
            assert!(tried.iter().all(|other| (other[0] - centre[0]).abs() > 0.2), "{tried:?} again at {centre:?}");
            tried.push(centre);
            if probe(&mut grid, truth, centre.map(|at| -at)) > 0.5 {
                break;
            }
        }
        assert!(tried.len() < 6, "not found: {tried:?}");
        for aim in [[1.0, 0.0], [-1.0, 0.0], [0.0, 3.0], [0.0, -3.0]] {
            let (mean, _) = grid.moments();
            probe(&mut grid, truth, [aim[0] - mean[0], aim[1] - mean[1]]);
        }
        let (mean, deviation) = grid.moments();
        assert!((mean[0] - truth[0]).abs() < 0.1 && (mean[1] - truth[1]).abs() < 0.1, "{mean:?}");
        assert!(deviation[0] < grid.step[0] && deviation[1] < grid.step[1], "within one cell: {deviation:?}");
    }

    #[test]
    fn one_spoiled_reading_does_not_exclude_the_truth() {
        let mut grid = Grid::normal([0.0; 2], [0.8, 0.8]);
        for aim in [[0.9, 0.0], [-0.9, 0.0], [0.0, 2.9], [0.0, -2.9]] {
            probe(&mut grid, [0.2, 0.1], aim);
        }
        grid.observe(0.0, 1.0, |at| Expected { gain: light(at), deviation: 0.05 });
        let (mean, _) = grid.moments();
        assert!((mean[0] - 0.2).abs() < 0.2 && (mean[1] - 0.1).abs() < 0.2, "{mean:?}");
    }
}
