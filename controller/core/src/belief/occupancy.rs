//! Where unreported obstacles stand: a map of probabilities over the floor.
//!
//! A cell holds the probability that an obstacle's axis is in it. Radius, height and mean density
//! are the scenario's. The path from a user to an LED or to a column of mirrors is blocked by an
//! axis that is nearer than the radius to the part of the path below the obstacle's height, in plan
//! view. Each measurement updates the cells near its paths by Bayes' rule; the cells are treated as
//! independent, as in occupancy grids (Elfes, 1989). With each report one row of cells relaxes
//! towards the mean density, so that an obstacle that has moved is forgotten.

mod fan;
mod grid;

use heliostat_channel::{Vec3, simd::with_widest_simd};
use heliostat_scenario::Scenario;
use serde::{Deserialize, Serialize};

use fan::{Fan, LANES, Lanes};
use grid::{Grid, LowPart, Sector};

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

/// Points of a tabulated function.
const KNOTS: usize = 65;

/// A function of a share from 0 to 1, interpolated linearly in a table: the function is evaluated
/// once for each point instead of twice for each cell.
struct Tabulated([f64; KNOTS]);

impl Tabulated {
    #[inline(always)]
    fn new(function: impl Fn(f64) -> f64) -> Self {
        let mut values = [0.0; KNOTS];
        for (knot, value) in values.iter_mut().enumerate() {
            *value = function(knot as f64 / (KNOTS - 1) as f64);
        }
        Self(values)
    }

    fn at(&self, share: f64) -> f64 {
        let place = share.clamp(0.0, 1.0) * (KNOTS - 1) as f64;
        let knot = (place as usize).min(KNOTS - 2);
        self.0[knot] + (place - knot as f64) * (self.0[knot + 1] - self.0[knot])
    }
}

/// The map.
#[derive(Clone, Debug)]
pub struct Occupancy {
    grid: Grid,
    probability: Vec<f64>,
    mean: f64,
    /// The next row to relax.
    row: usize,
    /// The paths of the present measurement to the LEDs, [`LANES`] in each fan.
    direct: Vec<Fan>,
    /// Those to the columns of mirrors, [`LANES`] in each fan.
    reflected: Vec<Fan>,
    /// How much each cell influences the expected share of the light; see [`Fan::influence`].
    influence: Vec<f64>,
    /// The cells with an influence.
    influential: Vec<usize>,
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
    /// Whether a scenario has obstacles that no survey reports.
    pub fn is_needed(scenario: &Scenario) -> bool {
        scenario.blockage.obstacles_per_m2 > 0.0 && scenario.streams.obstacles.rate_hz <= 0.0
    }

    /// The map of a scenario; `None` where none [is needed](Self::is_needed).
    pub fn new(scenario: &Scenario) -> Option<Self> {
        if !Self::is_needed(scenario) {
            return None;
        }
        let grid = Grid::new(scenario);
        let cells = grid.len();
        let mean = (scenario.blockage.obstacles_per_m2 * grid.cell_m2()).clamp(BOUNDS[0], BOUNDS[1]);
        Some(Self {
            grid,
            probability: vec![mean; cells],
            mean,
            row: 0,
            direct: vec![Fan::with_capacity(cells); scenario.led.positions_m.len().div_ceil(LANES)],
            reflected: vec![Fan::with_capacity(cells); scenario.mirrors.columns().div_ceil(LANES)],
            influence: vec![0.0; cells],
            influential: Vec::with_capacity(cells),
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

    /// Lists the cells near the paths from a user to the LEDs and to the columns of mirrors, for the
    /// methods about a measurement.
    pub fn trace(&mut self, from: &Vec3, leds: &[Vec3], columns: &[Vec3]) {
        let Self { grid, direct, reflected, .. } = self;
        with_widest_simd(
            #[inline(always)]
            || {
                for (fans, points) in [(direct, leds), (reflected, columns)] {
                    for (fan, points) in fans.iter_mut().zip(points.chunks(LANES)) {
                        fan.trace(grid, from, points);
                    }
                }
            },
        );
    }

    /// Probability that no unreported obstacle blocks the path to an LED.
    pub fn clear_direct(&self, led: usize) -> f64 {
        f64::from(self.direct[led / LANES].clear(&self.probability)[led % LANES])
    }

    /// Writes the probability that no unreported obstacle blocks the path to each column.
    pub fn clear_columns(&self, out: &mut [f64]) {
        with_widest_simd(
            #[inline(always)]
            || {
                for (fan, out) in self.reflected.iter().zip(out.chunks_mut(LANES)) {
                    let clear = fan.clear(&self.probability);
                    out.iter_mut().zip(clear).for_each(|(out, clear)| *out = f64::from(clear));
                }
            },
        );
    }

    /// Multiplies each entry of `clear` by the probability that no suspected obstacle blocks the
    /// path from a user to the point of the same index. The points lie on a line.
    pub fn weigh(&self, from: &Vec3, points: &[Vec3], clear: &mut [f64]) {
        if from.z >= self.grid.height_m {
            return;
        }
        for (points, clear) in points.chunks(CHUNK).zip(clear.chunks_mut(CHUNK)) {
            let mut paths = [LowPart::default(); CHUNK];
            paths.iter_mut().zip(points).for_each(|(path, point)| *path = self.grid.low_part(from, point));
            let paths = &paths[..points.len()];
            let sector = Sector::new([&paths[0], &paths[paths.len() - 1]], self.grid.reach_m());
            for suspect in &self.suspects {
                let off = [suspect.at_m[0] - from.x, suspect.at_m[1] - from.y];
                if !sector.excludes(&off) {
                    for (clear, path) in clear.iter_mut().zip(paths) {
                        *clear *= 1.0 - suspect.probability * self.grid.blocks(path, off);
                    }
                }
            }
        }
    }

    /// Takes how far the path to an LED was shown as clear, and how far as blocked, each from 0 to 1;
    /// `otherwise` is the probability that bodies leave it clear.
    pub fn handle_direct(&mut self, led: usize, [clear, blocked]: [f64; 2], otherwise: f64) {
        let Self { direct, probability, influence, influential, .. } = self;
        let (fan, lane) = (&direct[led / LANES], led % LANES);
        let mut lanes: Lanes = [0.0; LANES];
        lanes[lane] = otherwise as f32 * fan.clear(probability)[lane];
        fan.influence(probability, &lanes, |cell, of_cell| add(influence, influential, (cell, of_cell)));
        self.update(f64::from(lanes[lane]), |expected| {
            let expected = expected.clamp(0.0, 1.0);
            let likelihood = |share: f64| UNEXPLAINED + (1.0 - 2.0 * UNEXPLAINED) * share;
            clear * likelihood(expected) + blocked * likelihood(1.0 - expected) + 0.5 * (1.0 - clear - blocked)
        });
    }

    /// Takes a measured gain over the mirrors. `shares` are the parts of the gain without obstacles
    /// that come by way of each column; `density` is that of the measured gain for an expected one.
    pub fn handle_reflected(&mut self, shares: impl Iterator<Item = f64>, density: impl Fn(f64) -> f64) {
        let Self { reflected, probability, influence, influential, .. } = self;
        let (mut shares, mut expected) = (shares, 0.0);
        let table = with_widest_simd(
            #[inline(always)]
            || {
                for fan in reflected {
                    let mut clear = fan.clear(probability);
                    for clear in &mut clear {
                        *clear *= shares.next().unwrap_or(0.0) as f32;
                        expected += f64::from(*clear);
                    }
                    fan.influence(probability, &clear, |cell, of_cell| add(influence, influential, (cell, of_cell)));
                }
                Tabulated::new(density)
            },
        );
        self.update(expected, |expected| table.at(expected));
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

    /// Updates the influential cells, and removes their entries. A cell has the probability p and
    /// the influence w. With certainly no obstacle in it the expected share grows by p w, and with
    /// certainly one it falls by (1 - p) w.
    fn update(&mut self, expected: f64, likelihood: impl Fn(f64) -> f64) {
        for cell in self.influential.drain(..) {
            let influence = std::mem::take(&mut self.influence[cell]);
            let probability = &mut self.probability[cell];
            let free = 1.0 - *probability;
            let without = likelihood(expected + *probability * influence);
            let occupied = *probability * likelihood(expected - free * influence);
            *probability = (occupied / (occupied + free * without)).clamp(BOUNDS[0], BOUNDS[1]);
        }
    }
}

/// Adds to the influence of a cell, and lists the cell where it had none.
#[inline(always)]
fn add(influence: &mut [f64], influential: &mut Vec<usize>, (cell, of_cell): (usize, f64)) {
    if of_cell > 0.0 {
        if influence[cell] == 0.0 {
            influential.push(cell);
        }
        influence[cell] += of_cell;
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

    fn handle_direct(map: &mut Occupancy, from: &Vec3, is_clear: bool, otherwise: f64) {
        map.trace(from, &[LED], &[]);
        map.handle_direct(0, if is_clear { [1.0, 0.0] } else { [0.0, 1.0] }, otherwise);
    }

    fn clear_probability(map: &mut Occupancy, from: &Vec3, to: Vec3) -> f64 {
        map.trace(from, &[to], &[]);
        map.clear_direct(0)
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
            handle_direct(&mut map, &at, !blocked, 1.0);
        }
        map.finish_report();
        let found: f64 = map.suspects.iter().map(|suspect| suspect.probability).sum();
        assert!(found > 0.5, "{:?}", map.suspects);
        let near = |suspect: &Suspect| (suspect.at_m[0] - 1.7).hypot(suspect.at_m[1]) < 0.7;
        assert!(map.suspects.iter().filter(|suspect| suspect.probability > 0.3).all(near), "{:?}", map.suspects);
        // The path of a new device behind it is blocked, and that of one beside it is not.
        assert!(clear_probability(&mut map, &device(2.1, 0.0), LED) < 0.4);
        assert!(clear_probability(&mut map, &device(1.5, 1.2), LED) > 0.8);
    }

    #[test]
    fn a_clear_path_frees_its_cells_and_another_cause_leaves_them() {
        let (mut map, at) = (map(), device(2.0, 0.0));
        let before = probability(&map, 1.7, 0.0);
        handle_direct(&mut map, &at, false, 0.05);
        assert!(probability(&map, 1.7, 0.0) < 1.3 * before, "a body explains the blockage");
        handle_direct(&mut map, &at, true, 0.95);
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
        map.trace(&at, &[LED], &columns);
        for (shares, measured) in [([1.0, 0.0], 1.0), ([0.5, 0.5], 0.5)] {
            for _ in 0..5 {
                let density = |expected: f64| (-0.5 * ((measured - expected) / 0.1_f64).powi(2)).exp() + 0.05;
                map.handle_reflected(shares.into_iter(), density);
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
        for cell in [64, 65, 83, 192, 264] {
            map.probability[cell] = 0.6;
        }
        map.finish_report();
        let columns: Vec<Vec3> = (0..10).map(|index| Vec3::new(0.2 * f64::from(index) - 0.9, 2.5, 1.5)).collect();
        for at in [device(-2.0, -2.0), device(1.0, 0.3), device(0.0, 2.0)] {
            let mut clear = vec![1.0; 10];
            map.weigh(&at, &columns, &mut clear);
            for (clear, column) in clear.iter().zip(&columns) {
                let all = clear_probability(&mut map, &at, *column);
                assert!((clear - all).abs() < 0.2 && *clear >= all, "{clear} for {all}");
            }
        }
    }
}
