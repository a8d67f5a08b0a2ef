//! The array's capabilities compared with the scenario.
//!
//! [`Examiner`] compares when an announcement arrives, outside the decision path. A decision reads
//! only the flags of the guard.

use heliostat_channel::specular::bisector;
use heliostat_channel::{ChannelModel, Led, MirrorArray, Vec3, los};
use heliostat_proto::{AxisLimits, Capabilities, NodeKind};
use heliostat_scenario::{ChannelMode, Scenario};
use thiserror::Error;

/// Distance between the points of the floor whose reachability is tested, in m.
const FLOOR_STEP_M: f64 = 0.25;

/// About the largest number of these points: on larger floors they are farther apart.
const FLOOR_POINTS_MAX: f64 = 10_000.0;

/// Why an array receives no commands.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Unfit {
    /// The array has another shape than the scenario.
    #[error(
        "the array \"{hardware}\" has {found_rows} x {found_columns} mirrors, expected {rows} x {columns} as in the scenario: set mirrors.rows and mirrors.columns to those of the array"
    )]
    Shape {
        /// Hardware, as announced.
        hardware: String,
        /// Rows of the array.
        found_rows: u32,
        /// Columns of the array.
        found_columns: u32,
        /// Rows of the scenario.
        rows: usize,
        /// Columns of the scenario.
        columns: usize,
    },
    /// The range of the mirrors does not reach all of the floor.
    #[error(
        "the array \"{hardware}\" turns from {min_deg:.1} to {max_deg:.1} degrees at most: {:.0} % of the floor is within reach of at least one mirror, and {:.0} % of all pairs of a mirror and a floor point, expected 100 % of the floor", .floor * 100.0, .pairs * 100.0
    )]
    Range {
        /// Hardware, as announced.
        hardware: String,
        /// Smallest angle of either axis in degrees.
        min_deg: f64,
        /// Largest angle of either axis in degrees.
        max_deg: f64,
        /// Share of the floor that at least one mirror can light.
        floor: f64,
        /// Share of the pairs of a mirror and a floor point.
        pairs: f64,
    },
    /// Real mirrors in a channel mode whose angles do not follow the law of reflection.
    #[error(
        "a driver turns real mirrors in this room, and the scenario's channel mode gives angles of the paper's equations (2) and (3), which aim no real mirror: use channel.mode = \"specular\""
    )]
    PaperAngles,
}

/// Mismatches that the operator accepts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Force {
    /// A range that does not reach all of the floor.
    pub small_range: bool,
    /// Angles of the paper's equations on real mirrors.
    pub paper_angles: bool,
}

/// Compares announcements of an array with a scenario.
#[derive(Clone, Debug)]
pub struct Examiner {
    model: ChannelModel,
    /// The LEDs without their extent.
    leds: Vec<Led>,
    paper: bool,
    force: Force,
    half_floor_m: [f64; 2],
    receiver_height_m: f64,
}

impl Examiner {
    /// For the arrays of a scenario.
    pub fn new(scenario: &Scenario, model: &ChannelModel, force: Force) -> Self {
        Self {
            model: model.clone(),
            leds: model.leds.iter().map(|led| Led { side_m: 0.0, points_per_side: 1, ..led.clone() }).collect(),
            paper: scenario.channel.mode != ChannelMode::Specular,
            force,
            half_floor_m: [scenario.room.length_x_m / 2.0, scenario.room.length_y_m / 2.0],
            receiver_height_m: scenario.receiver.height_m,
        }
    }

    /// Whether this array can be commanded as array `index` of the scenario.
    ///
    /// # Errors
    /// [`Unfit`] where the shape differs or the range is too small.
    ///
    /// # Panics
    /// When the scenario has no such array.
    pub fn examine(&self, index: usize, capabilities: &Capabilities) -> Result<(), Unfit> {
        let hardware = capabilities.hardware.clone();
        let array = &self.model.mirrors.arrays()[index];
        let (rows, columns) = (array.rows(), array.columns());
        let (found_rows, found_columns) = (capabilities.rows, capabilities.columns);
        if (found_rows as usize, found_columns as usize) != (rows, columns) {
            return Err(Unfit::Shape { hardware, found_rows, found_columns, rows, columns });
        }
        if self.paper || self.force.small_range {
            return Ok(());
        }
        let (floor, pairs) = self.reach(index, &capabilities.roll, &capabilities.yaw);
        if floor < 1.0 {
            let axes = [capabilities.roll, capabilities.yaw];
            let min_deg = f64::from(axes.iter().map(|axis| axis.min_rad).fold(f32::INFINITY, f32::min)).to_degrees();
            let max_deg =
                f64::from(axes.iter().map(|axis| axis.max_rad).fold(f32::NEG_INFINITY, f32::max)).to_degrees();
            return Err(Unfit::Range { hardware, min_deg, max_deg, floor, pairs });
        }
        Ok(())
    }

    /// Whether a node of this kind may receive angles of the scenario's channel mode.
    ///
    /// # Errors
    /// [`Unfit::PaperAngles`] for a driver of real mirrors in a mode for comparison with the paper.
    pub fn examine_node(&self, node: NodeKind) -> Result<(), Unfit> {
        if node == NodeKind::Driver && self.paper && !self.force.paper_angles {
            Err(Unfit::PaperAngles)
        } else {
            Ok(())
        }
    }

    /// Shares of the floor that at least one mirror of an array can light, and of all pairs of its
    /// mirrors and a floor point.
    ///
    /// A mirror reaches a point if the bisector of the directions to the point and to any LED is within its range: a
    /// user whose direct paths are blocked can be served by each of them.
    pub fn reach(&self, index: usize, roll: &AxisLimits, yaw: &AxisLimits) -> (f64, f64) {
        let mirrors = &self.model.mirrors.arrays()[index];
        let (mut places, mut lit, mut pairs) = (0.0, 0.0, 0.0);
        for place in self.floor() {
            let is_reaching = |mirror: &&Vec3| {
                self.leds.iter().any(|led| reaches(mirrors, mirror, [&led.position, &place], [roll, yaw]))
            };
            let reaching = mirrors.positions().iter().filter(is_reaching).count() as f64;
            places += 1.0;
            lit += f64::from(u8::from(reaching > 0.0));
            pairs += reaching / mirrors.len() as f64;
        }
        (lit / places, pairs / places)
    }

    /// Share of the floor that at least one mirror of all arrays can light from the LED that serves each place, where
    /// both axes turn by this angle in rad, plus and minus.
    pub fn reach_of_all(&self, range_rad: f64) -> f64 {
        let axis = AxisLimits { min_rad: -range_rad as f32, max_rad: range_rad as f32, ..AxisLimits::default() };
        let is_lit = |place: &Vec3| {
            let led = self.serving_led(place);
            let is_reached = |array: &MirrorArray| {
                array.positions().iter().any(|mirror| reaches(array, mirror, [&led, place], [&axis; 2]))
            };
            self.model.mirrors.arrays().iter().any(is_reached)
        };
        let (mut places, mut lit) = (0.0, 0.0);
        for place in self.floor() {
            places += 1.0;
            lit += f64::from(u8::from(is_lit(&place)));
        }
        lit / places
    }

    /// The position of the LED with the largest direct gain at an upright receiver; that of the first one
    /// where none has a gain.
    fn serving_led(&self, place: &Vec3) -> Vec3 {
        let (mut serving, mut largest) = (self.leds[0].position, 0.0);
        for led in &self.leds {
            let gain = los::combined_gain(led, &self.model.receiver, place).unwrap_or(0.0);
            if gain > largest {
                (serving, largest) = (led.position, gain);
            }
        }
        serving
    }

    /// The centres of equal squares that cover the floor, at the height of the receivers.
    fn floor(&self) -> impl Iterator<Item = Vec3> {
        let [half_x, half_y] = self.half_floor_m;
        let step_m = (4.0 * half_x * half_y / FLOOR_POINTS_MAX).sqrt().max(FLOOR_STEP_M);
        let middles = move |half: f64| {
            let count = (2.0 * half / step_m).round().max(1.0);
            (0..count as usize).map(move |index| 2.0 * half * ((index as f64 + 0.5) / count) - half)
        };
        let height = self.receiver_height_m;
        middles(half_x).flat_map(move |x| middles(half_y).map(move |y| Vec3::new(x, y, height)))
    }
}

/// Whether a mirror of an array can turn light from the first point to the second one within these limits
/// of roll and yaw.
fn reaches(array: &MirrorArray, mirror: &Vec3, [led, place]: [&Vec3; 2], [roll, yaw]: [&AxisLimits; 2]) -> bool {
    let within = |angle: f64, axis: &AxisLimits| {
        (f64::from(axis.min_rad) - 1e-6..=f64::from(axis.max_rad) + 1e-6).contains(&angle)
    };
    bisector(mirror, led, place).is_some_and(|normal| {
        let angles = array.angles_of(&normal);
        within(angles.0, roll) && within(angles.1, yaw)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn examiner(mode: &str, force: Force) -> Examiner {
        let scenario = Scenario::builtin(mode).unwrap();
        Examiner::new(&scenario, &scenario.channel_model().unwrap(), force)
    }

    fn array(rows: u32, columns: u32, range_deg: f32) -> Capabilities {
        let range = range_deg.to_radians();
        let axis = AxisLimits { min_rad: -range, max_rad: range, ..AxisLimits::default() };
        Capabilities { hardware: "lab".into(), rows, columns, roll: axis, yaw: axis, ..Capabilities::default() }
    }

    #[test]
    fn an_array_of_another_shape_is_refused_and_both_shapes_are_named() {
        let examiner = examiner("specular", Force::default());
        assert_eq!(examiner.examine(0, &array(10, 10, 90.0)), Ok(()));
        let problem = examiner.examine(0, &array(7, 10, 90.0)).unwrap_err().to_string();
        assert!(problem.contains("7 x 10") && problem.contains("10 x 10"), "{problem}");
    }

    #[test]
    fn a_small_range_is_refused_with_the_reachable_share() {
        let examiner_of = |force| examiner("specular", force);
        let problem = examiner_of(Force::default()).examine(0, &array(10, 10, 5.0)).unwrap_err();
        let Unfit::Range { floor, pairs, .. } = &problem else { panic!("{problem}") };
        assert!(*floor > 0.0 && *floor < 1.0 && pairs < floor, "{problem}");
        assert!(problem.to_string().contains("expected 100 % of the floor"));
        let forced = Force { small_range: true, ..Force::default() };
        assert_eq!(examiner_of(forced).examine(0, &array(10, 10, 5.0)), Ok(()));
    }

    /// The shares of mirror-point pairs for a range are those of docs/physics.md.
    #[test]
    fn the_reach_of_a_range_matches_the_documented_shares() {
        let examiner = examiner("specular", Force::default());
        for (range_deg, expected) in [(10.0, 0.23), (20.0, 0.53), (30.0, 0.76), (60.0, 1.0)] {
            let array = array(10, 10, range_deg);
            let (_, pairs) = examiner.reach(0, &array.roll, &array.yaw);
            assert!((pairs - expected).abs() < 0.03, "{range_deg} degrees: {pairs}");
        }
    }

    /// The nearest of the LEDs of the corridor serves a user below it, by mirrors that turn far to the side.
    #[test]
    fn an_array_that_reaches_each_place_from_some_led_is_accepted_and_the_share_of_the_serving_leds_is_smaller() {
        let examiner = examiner("corridor", Force::default());
        for (range_deg, served) in [(60.0, false), (90.0, true)] {
            let array = array(10, 10, range_deg);
            assert_eq!(examiner.examine(0, &array), Ok(()), "{range_deg} degrees");
            let floor = examiner.reach_of_all(f64::from(range_deg).to_radians());
            assert_eq!(floor == 1.0, served, "{range_deg} degrees: {floor}");
        }
        assert!(examiner.examine(0, &array(10, 10, 5.0)).is_err(), "no LED reaches some places");
        let places = [(5.0, 4.0), (-1.0, 0.0), (-3.0, -4.0)];
        for (x, led_x) in places {
            let place = Vec3::new(x, 0.3, examiner.receiver_height_m);
            assert_eq!(examiner.serving_led(&place).x, led_x, "{x}");
        }
    }

    #[test]
    fn the_number_of_points_on_a_large_floor_is_bounded() {
        let size = ["room.length_x_m=200", "room.length_y_m=150", "blockage.obstacles_per_m2=0.001"];
        let large = Scenario::builtin("specular").unwrap().with_overrides(&size).unwrap();
        let examiner = Examiner::new(&large, &large.channel_model().unwrap(), Force::default());
        assert!((9_000..11_000).contains(&examiner.floor().count()));
    }

    #[test]
    fn paper_angles_are_for_simulated_mirrors_only() {
        for mode in ["paper", "paper-calibrated"] {
            let plain = examiner(mode, Force::default());
            assert_eq!(plain.examine_node(NodeKind::SimNode), Ok(()));
            assert_eq!(plain.examine_node(NodeKind::Driver), Err(Unfit::PaperAngles));
            let forced = Force { paper_angles: true, ..Force::default() };
            assert_eq!(examiner(mode, forced).examine_node(NodeKind::Driver), Ok(()));
        }
        assert_eq!(examiner("specular", Force::default()).examine_node(NodeKind::Driver), Ok(()));
    }
}
