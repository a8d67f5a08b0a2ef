//! What the array is and can do, held against the scenario before it is commanded; and who may stop it.
//!
//! Everything here is worked out when an announcement or an order arrives, off the way from a report to its command. What the
//! decision then looks at is a flag, two ranges and a list: [`Guard`].

use heliostat_channel::specular::bisector;
use heliostat_channel::{ChannelModel, Vec3};
use heliostat_proto::{AxisLimits, Capabilities, EmergencyStop, MirrorTelemetry, Nanos, NodeKind, StopAction};
use heliostat_scenario::{ChannelMode, Scenario};
use thiserror::Error;

/// Distance between the points of the floor whose reach is tried, in m.
const FLOOR_STEP_M: f64 = 0.25;

/// Why an array is not commanded.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Unfit {
    /// An array of another shape.
    #[error(
        "the array \"{hardware}\" has {found_rows} x {found_columns} mirrors, the scenario {rows} x {columns}: set mirrors.rows and mirrors.columns to those of the array"
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
    /// Mirrors that cannot turn far enough.
    #[error(
        "the array \"{hardware}\" turns from {min_deg:.1} to {max_deg:.1} degrees at most: {:.0} % of the floor stays reachable by any mirror, {:.0} % of all pairs of a mirror and a place; --accept-small-range goes on with that", .floor * 100.0, .pairs * 100.0
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
        /// Share of the pairs of a mirror and a place on the floor.
        pairs: f64,
    },
    /// Angles that mean nothing to a real mirror.
    #[error(
        "a driver turns real mirrors in this room, and the scenario's channel mode gives angles of the paper's equations (2) and (3), under which a mirror that reflects light gains nothing: use channel.mode = \"specular\", or force it with --force-paper-angles"
    )]
    PaperAngles,
}

/// What of an array that does not fit is accepted all the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Force {
    /// Mirrors that cannot reach all of the floor.
    pub small_range: bool,
    /// Angles of the paper's equations on real mirrors.
    pub paper_angles: bool,
}

/// Holds announcements against a scenario.
#[derive(Clone, Debug)]
pub struct Examiner {
    model: ChannelModel,
    paper: bool,
    force: Force,
    half_floor_m: [f64; 2],
    receiver_height_m: f64,
}

impl Examiner {
    /// For the array of a scenario.
    pub fn new(scenario: &Scenario, model: &ChannelModel, force: Force) -> Self {
        Self {
            model: model.clone(),
            paper: scenario.channel.mode != ChannelMode::Specular,
            force,
            half_floor_m: [scenario.room.length_x_m / 2.0, scenario.room.length_y_m / 2.0],
            receiver_height_m: scenario.receiver.height_m,
        }
    }

    /// Whether the array can be commanded in this scenario.
    ///
    /// # Errors
    /// [`Unfit`], by name.
    pub fn examine(&self, capabilities: &Capabilities) -> Result<(), Unfit> {
        let hardware = capabilities.hardware.clone();
        let (rows, columns) = (self.model.mirrors.rows(), self.model.mirrors.columns());
        let (found_rows, found_columns) = (capabilities.rows, capabilities.columns);
        if (found_rows as usize, found_columns as usize) != (rows, columns) {
            return Err(Unfit::Shape { hardware, found_rows, found_columns, rows, columns });
        }
        if self.paper || self.force.small_range {
            return Ok(());
        }
        let (floor, pairs) = self.reach(&capabilities.roll, &capabilities.yaw);
        if floor < 1.0 {
            let axes = [capabilities.roll, capabilities.yaw];
            let min_deg = f64::from(axes.iter().map(|axis| axis.min_rad).fold(f32::INFINITY, f32::min)).to_degrees();
            let max_deg =
                f64::from(axes.iter().map(|axis| axis.max_rad).fold(f32::NEG_INFINITY, f32::max)).to_degrees();
            return Err(Unfit::Range { hardware, min_deg, max_deg, floor, pairs });
        }
        Ok(())
    }

    /// Whether the one who turns the mirrors may be told these angles.
    ///
    /// # Errors
    /// [`Unfit::PaperAngles`] where a driver of real mirrors meets a mode for comparison with the paper.
    pub fn meet(&self, node: NodeKind) -> Result<(), Unfit> {
        if node == NodeKind::Driver && self.paper && !self.force.paper_angles {
            Err(Unfit::PaperAngles)
        } else {
            Ok(())
        }
    }

    /// Shares of the floor that at least one mirror can light, and of all pairs of a mirror and a place: those where the bisector of the
    /// ways to the first LED and to the place is within the range.
    pub fn reach(&self, roll: &AxisLimits, yaw: &AxisLimits) -> (f64, f64) {
        let within = |angle: f64, axis: &AxisLimits| {
            (f64::from(axis.min_rad) - 1e-6..=f64::from(axis.max_rad) + 1e-6).contains(&angle)
        };
        let mirrors = &self.model.mirrors;
        let led = self.model.leds[0].position;
        let (mut places, mut lit, mut pairs) = (0.0, 0.0, 0.0);
        for place in self.floor() {
            let reaches = |mirror: &&Vec3| {
                bisector(mirror, &led, &place).is_some_and(|normal| {
                    let angles = mirrors.angles_of(&normal);
                    within(angles.0, roll) && within(angles.1, yaw)
                })
            };
            let reaching = mirrors.positions().iter().filter(reaches).count() as f64;
            places += 1.0;
            lit += f64::from(u8::from(reaching > 0.0));
            pairs += reaching / mirrors.len() as f64;
        }
        (lit / places, pairs / places)
    }

    /// The middles of equal squares that cover the floor, at the height of the receivers.
    fn floor(&self) -> impl Iterator<Item = Vec3> {
        let middles = |half: f64| {
            let count = (2.0 * half / FLOOR_STEP_M).round().max(1.0);
            (0..count as usize).map(move |index| 2.0 * half * ((index as f64 + 0.5) / count) - half)
        };
        let [half_x, half_y] = self.half_floor_m;
        let height = self.receiver_height_m;
        middles(half_x).flat_map(move |x| middles(half_y).map(move |y| Vec3::new(x, y, height)))
    }
}

/// What the decision looks at.
#[derive(Clone, Debug, Default)]
pub struct Guard {
    unfit: Option<Unfit>,
    /// Whatever the array announces.
    forbidden: Option<Unfit>,
    stopped: bool,
    /// Time of the last stop.
    stopped_ns: Nanos,
}

impl Guard {
    /// Takes a verdict over.
    pub fn set_verdict(&mut self, verdict: Result<(), Unfit>) {
        self.unfit = verdict.err();
    }

    /// Never sends anything here.
    pub fn forbid(&mut self, unfit: Unfit) {
        self.forbidden = Some(unfit);
    }

    /// Why the array is not commanded; nothing where it is.
    pub fn unfit(&self) -> Option<&Unfit> {
        self.forbidden.as_ref().or(self.unfit.as_ref())
    }

    /// Whether commands may be sent, by the operator's orders and by what the array says of itself.
    pub fn may_command(&self, telemetry: Option<&MirrorTelemetry>) -> bool {
        let array_stopped = telemetry.is_some_and(|told| told.state == heliostat_proto::ArrayState::Stopped);
        self.unfit().is_none() && !self.stopped && !array_stopped
    }

    /// Whether an operator's stop is latched.
    pub fn is_stopped(&self) -> bool {
        self.stopped
    }

    /// Heeds a stop or a re-arm by the rules of a driver.
    pub fn heed(&mut self, order: &EmergencyStop) {
        match order.action {
            StopAction::Stop => {
                self.stopped = true;
                self.stopped_ns = self.stopped_ns.max(order.stamp.time_ns);
            }
            StopAction::Rearm => self.stopped &= order.stamp.time_ns <= self.stopped_ns,
        }
    }
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
    fn an_array_of_another_shape_is_refused_by_both_shapes() {
        let examiner = examiner("specular", Force::default());
        assert_eq!(examiner.examine(&array(10, 10, 90.0)), Ok(()));
        let problem = examiner.examine(&array(7, 10, 90.0)).unwrap_err().to_string();
        assert!(problem.contains("7 x 10") && problem.contains("10 x 10"), "{problem}");
    }

    #[test]
    fn a_small_range_is_refused_with_what_stays_reachable() {
        let examiner_of = |force| examiner("specular", force);
        let problem = examiner_of(Force::default()).examine(&array(10, 10, 5.0)).unwrap_err();
        let Unfit::Range { floor, pairs, .. } = &problem else { panic!("{problem}") };
        assert!(*floor > 0.0 && *floor < 1.0 && pairs < floor, "{problem}");
        assert!(problem.to_string().contains("--accept-small-range"));
        let forced = Force { small_range: true, ..Force::default() };
        assert_eq!(examiner_of(forced).examine(&array(10, 10, 5.0)), Ok(()));
    }

    /// docs/physics.md: +-10 degrees reaches 23 % of mirror-point pairs, +-20 53 %, +-30 76 %.
    #[test]
    fn the_reach_of_a_range_is_that_of_the_physics() {
        let examiner = examiner("specular", Force::default());
        for (range_deg, expected) in [(10.0, 0.23), (20.0, 0.53), (30.0, 0.76), (60.0, 1.0)] {
            let array = array(10, 10, range_deg);
            let (_, pairs) = examiner.reach(&array.roll, &array.yaw);
            assert!((pairs - expected).abs() < 0.03, "{range_deg} degrees: {pairs}");
        }
    }

    #[test]
    fn paper_angles_are_for_simulated_mirrors_only() {
        for mode in ["paper", "paper-calibrated"] {
            let plain = examiner(mode, Force::default());
            assert_eq!(plain.meet(NodeKind::SimNode), Ok(()));
            assert_eq!(plain.meet(NodeKind::Driver), Err(Unfit::PaperAngles));
            let forced = Force { paper_angles: true, ..Force::default() };
            assert_eq!(examiner(mode, forced).meet(NodeKind::Driver), Ok(()));
        }
        assert_eq!(examiner("specular", Force::default()).meet(NodeKind::Driver), Ok(()));
    }

    #[test]
    fn a_stop_is_latched_here_too_and_the_array_may_say_so_itself() {
        let mut guard = Guard::default();
        assert!(guard.may_command(None));
        let order = |action, time_ns| {
            let stamp = heliostat_proto::Stamp { time_ns, ..Default::default() };
            EmergencyStop { stamp, action, ..EmergencyStop::default() }
        };
        guard.heed(&order(StopAction::Stop, 10));
        guard.heed(&order(StopAction::Rearm, 10));
        assert!(!guard.may_command(None) && guard.is_stopped());
        guard.heed(&order(StopAction::Rearm, 11));
        assert!(guard.may_command(None));
        let stopped = MirrorTelemetry { state: heliostat_proto::ArrayState::Stopped, ..MirrorTelemetry::default() };
        assert!(!guard.may_command(Some(&stopped)));
    }
}
