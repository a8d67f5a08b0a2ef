//! Checks of a scenario: each value against its domain, and values against each other.

use std::ops::RangeInclusive;

use heliostat_channel::receiver::BRANCHES_MAX;

use crate::error::ScenarioError;
use crate::runtime::DegradedAction;
use crate::scenario::Scenario;
use crate::streams::Streams;
use crate::tables::{ChannelMode, MinRate, ReceiverPreset};
use crate::user_orientation::UserOrientation;

/// Largest number of users of a room.
pub const USERS_MAX: usize = heliostat_proto::MAX_USERS;
/// Largest rate of arrivals: 1000 a second.
const ARRIVALS_PER_MIN_MAX: f64 = 60_000.0;
/// Mean durations of a stay in s.
const STAY_S: RangeInclusive<f64> = 0.01..=1e6;
/// Share of lost reports.
const LOSS: RangeInclusive<f64> = 0.0..=0.99;
/// Mean number of reports lost in a row, where losses are not independent.
const BURST_REPORTS: RangeInclusive<f64> = 1.0..=1e4;
/// Frequencies of an actuator that has them, in Hz.
const FREQUENCY_HZ: RangeInclusive<f64> = 0.01..=1e6;
/// Coherence times of the users' orientations in s.
const COHERENCE_S: RangeInclusive<f64> = 0.001..=1e4;
/// Ranges of mirrors in degrees: an axis turns by so much, plus and minus.
pub const RANGE_DEG: RangeInclusive<f64> = 0.01..=90.0;
/// Optical power of an LED in W.
pub const POWER_W: RangeInclusive<f64> = 1e-6..=1e4;
/// Walking speed in m/s of users who do not stand still. A user who walks faster crosses the
/// smallest room so often that a step of the walk has no bounded cost.
pub const SPEED_M_S: RangeInclusive<f64> = 1e-3..=50.0;
/// Largest mean number of obstacles. A report holds 1024, and the drawn number varies.
const OBSTACLES_MEAN_MAX: f64 = 800.0;
/// Largest number of rays: points of all panels x mirrors x users x branches of a receiver. The
/// time of one evaluation of the channel grows with it.
const RAYS_MAX: usize = 1 << 30;

impl Scenario {
    /// Checks every value.
    ///
    /// # Errors
    /// [`ScenarioError::Invalid`] for the first value outside its domain.
    pub(crate) fn check(&self) -> Result<(), ScenarioError> {
        if self.name.is_empty() || self.name.len() > 64 || self.name.contains(char::is_control) {
            return invalid("name", self.name.escape_debug(), "expected 1 to 64 characters in one line");
        }
        self.check_room()?;
        self.check_optics()?;
        self.check_users()?;
        let points = self.led.positions_m.len() * self.led.points_per_side.pow(2);
        // An empty list stands for a preset; see `build`.
        let rays = points * self.mirror_count() * self.users.largest() * self.receiver.branches.len().max(1);
        count("led.points_per_side (points x mirrors x users x branches)", rays, 1..=RAYS_MAX)?;
        self.check_runtime()
    }

    fn check_room(&self) -> Result<(), ScenarioError> {
        let room = &self.room;
        within("room.length_x_m", room.length_x_m, 0.5..=200.0)?;
        within("room.length_y_m", room.length_y_m, 0.5..=200.0)?;
        within("room.height_m", room.height_m, 0.5..=50.0)?;
        let channel = &self.channel;
        within("channel.gain_scale", channel.gain_scale, 1e-6..=1e6)?;
        if channel.mode != ChannelMode::PaperCalibrated && channel.gain_scale != 1.0 {
            return invalid(
                "channel.gain_scale",
                channel.gain_scale,
                "expected 1, unless channel.mode is \"paper-calibrated\"",
            );
        }
        within("led.power_w", self.led.power_w, POWER_W)?;
        within("led.half_power_semi_angle_deg", self.led.half_power_semi_angle_deg, 1.0..=89.0)?;
        within("led.side_m", self.led.side_m, 0.0..=5.0)?;
        count("led.points_per_side", self.led.points_per_side, 1..=64)?;
        count("led.positions_m (panels)", self.led.positions_m.len(), 1..=64)?;
        let unknown = &self.mismatch.unknown_leds_m;
        let leds = self.led.positions_m.len() + unknown.len();
        count("mismatch.unknown_leds_m (with led.positions_m)", leds, 1..=64)?;
        if !unknown.is_empty() && !self.streams.channel.leds.is_none() {
            return invalid(
                "mismatch.unknown_leds_m",
                list(unknown.iter().map(|position| numbers(position))),
                "expected none while streams.channel.leds tells the LEDs apart",
            );
        }
        let [x, y] = room.floor_m();
        let domains = [("x", x), ("y", y), ("z", self.receiver.height_m..=room.height_m)];
        for (key, positions) in [("led.positions_m", &self.led.positions_m), ("mismatch.unknown_leds_m", unknown)] {
            positions.iter().try_for_each(|position| place(key, position, &domains))?;
        }
        Ok(())
    }

    fn check_optics(&self) -> Result<(), ScenarioError> {
        self.check_arrays()?;
        let receiver = &self.receiver;
        within("receiver.height_m", receiver.height_m, 0.0..=self.room.height_m)?;
        within("receiver.area_mm2", receiver.area_mm2, 1e-4..=1e6)?;
        within("receiver.responsivity_a_per_w", receiver.responsivity_a_per_w, 1e-3..=10.0)?;
        within("receiver.fov_deg", receiver.fov_deg, 1.0..=90.0)?;
        within("receiver.filter_gain", receiver.filter_gain, 1e-6..=1.0)?;
        within("receiver.concentrator_index", receiver.concentrator_index, 1.0..=4.0)?;
        count("receiver.branches", receiver.branches.len(), 0..=BRANCHES_MAX)?;
        for branch in &receiver.branches {
            within("receiver.branches.tilt_deg", branch.tilt_deg, 0.0..=180.0)?;
            within("receiver.branches.azimuth_deg", branch.azimuth_deg, -360.0..=360.0)?;
            within("receiver.branches.fov_deg", branch.fov_deg, 1.0..=90.0)?;
        }
        let is_single = match receiver.branches.len() {
            0 => receiver.preset == ReceiverPreset::Single,
            branches => branches == 1,
        };
        if self.streams.channel.branches && is_single {
            let expected = "expected a receiver of several branches, for example receiver.preset = \"angle-diversity\"; \
                            channel reports have the gains of a single detector";
            return invalid("streams.channel.branches", true, expected);
        }
        let noise = &self.noise;
        within("noise.background_shot_a2_per_hz", noise.background_shot_a2_per_hz, 0.0..=1.0)?;
        within("noise.thermal_a2_per_hz", noise.thermal_a2_per_hz, 0.0..=1.0)?;
        within("noise.preamplifier_a2_per_hz", noise.preamplifier_a2_per_hz, 0.0..=1.0)?;
        within("noise.variance_a2", noise.variance_a2.unwrap_or(1e-15), 1e-30..=1.0)?;
        within("link.bandwidth_mhz", self.link.bandwidth_mhz, 1e-6..=1e6)
    }

    fn check_users(&self) -> Result<(), ScenarioError> {
        let users = &self.users;
        count("users.count", users.count, 1..=USERS_MAX)?;
        // Both 0: all users stand still. With a minimum of 0 alone, a user could walk at speed 0
        // and never arrive.
        if (users.speed_min_m_s, users.speed_max_m_s) != (0.0, 0.0) {
            within("users.speed_min_m_s", users.speed_min_m_s, SPEED_M_S)?;
            within("users.speed_max_m_s", users.speed_max_m_s, users.speed_min_m_s..=*SPEED_M_S.end())?;
        }
        users.check_mobility(&self.room)?;
        match &users.min_rate_mbps {
            MinRate::All(rate) => within("users.min_rate_mbps", *rate, 0.0..=1e6)?,
            MinRate::Each(rates) => {
                count("users.min_rate_mbps (entries)", rates.len(), users.count..=users.count)?;
                rates.iter().try_for_each(|rate| within("users.min_rate_mbps", *rate, 0.0..=1e6))?;
            }
        }
        if let Some(arrivals) = &users.arrivals {
            within("users.arrivals.rate_per_min", arrivals.rate_per_min, 0.0..=ARRIVALS_PER_MIN_MAX)?;
            within("users.arrivals.mean_stay_s", arrivals.mean_stay_s, STAY_S)?;
            count("users.arrivals.max_users", arrivals.max_users, users.count..=USERS_MAX)?;
            if let Some(trace) = &users.trace {
                let expected = "expected no recorded walk, since its users do not enter and leave: remove users.trace or users.arrivals";
                return invalid("users.trace", trace, expected);
            }
        }
        if let Some(orientation) = &users.orientation {
            check_orientation("users.orientation", orientation)?;
        }
        let blockage = &self.blockage;
        if blockage.forced_users > users.count {
            let expected = format!("expected at most users.count, which is {}", users.count);
            invalid("blockage.forced_users", blockage.forced_users, &expected)?;
        }
        within("blockage.body_radius_m", blockage.body_radius_m, 0.01..=2.0)?;
        within("blockage.body_height_m", blockage.body_height_m, 0.0..=self.room.height_m)?;
        within("blockage.body_offset_m", blockage.body_offset_m, 0.0..=2.0)?;
        within("blockage.obstacle_radius_m", blockage.obstacle_radius_m, 0.01..=5.0)?;
        within("blockage.obstacle_height_m", blockage.obstacle_height_m, 0.0..=self.room.height_m)?;
        within("blockage.obstacle_min_distance_m", blockage.obstacle_min_distance_m, 0.0..=10.0)?;
        // A type II Matern hard-core process retains at most 1 / (pi d^2) points per square metre.
        let densest = 1.0 / (std::f64::consts::PI * blockage.obstacle_min_distance_m.max(0.05).powi(2));
        let most = OBSTACLES_MEAN_MAX / (self.room.length_x_m * self.room.length_y_m);
        within("blockage.obstacles_per_m2", blockage.obstacles_per_m2, 0.0..=most.min(0.99 * densest))
    }

    fn check_runtime(&self) -> Result<(), ScenarioError> {
        let actuator = &self.actuator;
        zero_or("actuator.natural_frequency_hz", actuator.natural_frequency_hz.unwrap_or(1.0), FREQUENCY_HZ)?;
        within("actuator.damping_ratio", actuator.damping_ratio.unwrap_or(1.0), 0.0..=100.0)?;
        zero_or("actuator.low_pass_hz", actuator.low_pass_hz.unwrap_or(1.0), FREQUENCY_HZ)?;
        within("actuator.slew_deg_per_s", actuator.slew_deg_per_s.unwrap_or(1.0), 0.0..=1e6)?;
        within("actuator.range_deg", actuator.range_deg.unwrap_or(1.0), RANGE_DEG)?;
        count("actuator.resolution_bits", actuator.resolution_bits.unwrap_or(0) as usize, 0..=32)?;
        within("actuator.delay_ms", actuator.delay_ms.unwrap_or(0.0), 0.0..=1e4)?;
        within("actuator.jitter_deg", actuator.jitter_deg.unwrap_or(0.0), 0.0..=90.0)?;
        within("actuator.offset_deg", actuator.offset_deg.unwrap_or(0.0), 0.0..=90.0)?;
        within("actuator.drift_deg_per_sqrt_hour", actuator.drift_deg_per_sqrt_hour.unwrap_or(0.0), 0.0..=90.0)?;
        within("actuator.scale_error_relative", actuator.scale_error_relative.unwrap_or(0.0), 0.0..=0.2)?;
        within("actuator.hysteresis_deg", actuator.hysteresis_deg.unwrap_or(0.0), 0.0..=90.0)?;
        within("actuator.stuck_share", actuator.stuck_share.unwrap_or(0.0), 0.0..=1.0)?;
        check_streams(&self.streams)?;
        let control = &self.control;
        within("control.validity_ms", control.validity_ms, 1.0..=10_000.0)?;
        within("control.report_age_max_ms", control.report_age_max_ms, 1.0..=60_000.0)?;
        within("control.source_timeout_ms", control.source_timeout_ms, 10.0..=600_000.0)?;
        within("control.range_deg", control.range_deg, RANGE_DEG)?;
        within("control.slew_deg_per_s", control.slew_deg_per_s, 0.0..=1e6)?;
        within("control.deadline_ms", control.deadline_ms, 0.0..=60_000.0)?;
        let walk = &control.walk;
        within("control.walk.changes_per_s", walk.changes_per_s, 0.0..=100.0)?;
        within("control.walk.speed_m_s", walk.speed_m_s, 0.01..=100.0)?;
        within("control.walk.standing", walk.standing, 0.0..=1.0)?;
        within("control.walk.curving", walk.curving, 0.0..=1.0 - walk.standing)?;
        within("control.walk.turn_rate_deg_per_s", walk.turn_rate_deg_per_s, 1.0..=720.0)?;
        if let Some(tilt) = &control.tilt {
            within("control.tilt.walking_deg", tilt.walking_deg, 0.0..=90.0)?;
            within("control.tilt.sitting_deg", tilt.sitting_deg, 0.0..=90.0)?;
            within("control.tilt.walking_from_m_s", tilt.walking_from_m_s, 0.0..=100.0)?;
        }
        let no_positions = "the policy has no positions";
        without_decision("control.when_stale", control.when_stale, no_positions)?;
        without_decision("control.when_silent", control.when_silent, no_positions)?;
        only_hold(control.when_unanswered)?;
        count("control.search_evaluations", control.search_evaluations as usize, 1..=100_000_000)?;
        within("control.search_time_us", control.search_time_us, 0.0..=60e6)
    }
}

fn check_streams(streams: &Streams) -> Result<(), ScenarioError> {
    within("streams.positions.rate_hz", streams.positions.rate_hz, 0.01..=10_000.0)?;
    within("streams.positions.latency_ms", streams.positions.latency_ms, 0.0..=10_000.0)?;
    within("streams.positions.noise_m", streams.positions.noise_m, 0.0..=10.0)?;
    within("streams.positions.velocity_noise_m_s", streams.positions.velocity_noise_m_s, 0.0..=10.0)?;
    within("streams.channel.rate_hz", streams.channel.rate_hz, 0.01..=10_000.0)?;
    within("streams.channel.latency_ms", streams.channel.latency_ms, 0.0..=10_000.0)?;
    within("streams.channel.noise_relative", streams.channel.noise_relative, 0.0..=1.0)?;
    within("streams.channel.noise_gain", streams.channel.noise_gain, 0.0..=1.0)?;
    count("streams.channel.resolution_bits", streams.channel.resolution_bits as usize, 0..=24)?;
    within("streams.channel.full_scale_gain", streams.channel.full_scale_gain, 0.0..=1.0)?;
    if streams.channel.resolution_bits > 0 && streams.channel.full_scale_gain == 0.0 {
        let expected = "expected streams.channel.full_scale_gain, the largest gain that the receiver measures; \
                        `heliostat link` prints the gains of a user";
        return invalid("streams.channel.resolution_bits", streams.channel.resolution_bits, expected);
    }
    check_loss("streams.positions", streams.positions.loss, streams.positions.loss_burst_reports)?;
    check_loss("streams.channel", streams.channel.loss, streams.channel.loss_burst_reports)?;
    within("streams.telemetry.rate_hz", streams.telemetry.rate_hz, 0.1..=10_000.0)?;
    within("streams.obstacles.rate_hz", streams.obstacles.rate_hz, 0.0..=1000.0)?;
    within("streams.truth.rate_hz", streams.truth.rate_hz, 0.1..=1000.0)?;
    if let Some(orientation) = &streams.orientation {
        within("streams.orientation.rate_hz", orientation.rate_hz, 0.01..=10_000.0)?;
        within("streams.orientation.latency_ms", orientation.latency_ms, 0.0..=10_000.0)?;
        within("streams.orientation.noise_deg", orientation.noise_deg, 0.0..=180.0)?;
    }
    Ok(())
}

/// Checks the share of lost reports, and their mean number in a row.
fn check_loss(table: &str, loss: f64, burst_reports: f64) -> Result<(), ScenarioError> {
    zero_or(&format!("{table}.loss_burst_reports"), burst_reports, BURST_REPORTS)?;
    // At least one report arrives between two bursts.
    let between_bursts = if burst_reports == 0.0 { 1.0 } else { burst_reports / (burst_reports + 1.0) };
    within(&format!("{table}.loss"), loss, *LOSS.start()..=LOSS.end().min(between_bursts))
}

/// Checks the table at this key of how users hold their receivers.
pub(crate) fn check_orientation(key: &str, held: &UserOrientation) -> Result<(), ScenarioError> {
    let within = |name: &str, value: f64, domain| within(&format!("{key}.{name}"), value, domain);
    within("sitting_polar_mean_deg", held.sitting_polar_mean_deg, 0.0..=90.0)?;
    within("sitting_polar_std_deg", held.sitting_polar_std_deg, 0.0..=90.0)?;
    within("sitting_azimuth_std_deg", held.sitting_azimuth_std_deg, 0.0..=180.0)?;
    within("sitting_coherence_s", held.sitting_coherence_s, COHERENCE_S)?;
    within("walking_polar_mean_deg", held.walking_polar_mean_deg, 0.0..=90.0)?;
    within("walking_polar_std_deg", held.walking_polar_std_deg, 0.0..=90.0)?;
    within("walking_azimuth_std_deg", held.walking_azimuth_std_deg, 0.0..=180.0)?;
    within("walking_coherence_s", held.walking_coherence_s, COHERENCE_S)?;
    within("walking_from_m_s", held.walking_from_m_s, 0.0..=*SPEED_M_S.end())
}

/// Accepts an action that requires no decision of a policy.
fn without_decision(key: &str, action: DegradedAction, why: &str) -> Result<(), ScenarioError> {
    match action {
        DegradedAction::LastGood | DegradedAction::Hold | DegradedAction::Park => Ok(()),
        DegradedAction::Policy | DegradedAction::Fallback => {
            let name = if action == DegradedAction::Policy { "policy" } else { "fallback" };
            invalid(key, name, &format!("expected last-good, hold or park, since {why}"))
        }
    }
}

/// The only action while the policy does not return.
fn only_hold(action: DegradedAction) -> Result<(), ScenarioError> {
    let name = match action {
        DegradedAction::Hold => return Ok(()),
        DegradedAction::LastGood => "last-good",
        DegradedAction::Park => "park",
        DegradedAction::Policy => "policy",
        DegradedAction::Fallback => "fallback",
    };
    let expected = "expected hold, since the controller gives no command until the policy returns, and the array \
                    holds its angles and then parks: delete the key";
    invalid("control.when_unanswered", name, expected)
}

pub(crate) fn within(key: &str, value: f64, domain: RangeInclusive<f64>) -> Result<(), ScenarioError> {
    // In this order -0 is below 0: a rate of -0 would give intervals of minus infinity.
    if value.total_cmp(domain.start()).is_ge() && value <= *domain.end() {
        return Ok(());
    }
    invalid(key, value, &format!("expected a number from {} to {}", domain.start(), domain.end()))
}

/// Accepts 0, which disables what the key describes, or a number of the domain.
fn zero_or(key: &str, value: f64, domain: RangeInclusive<f64>) -> Result<(), ScenarioError> {
    if value.to_bits() == 0 || domain.contains(&value) {
        return Ok(());
    }
    invalid(key, value, &format!("expected 0 or a number from {} to {}", domain.start(), domain.end()))
}

/// Accepts a place in m whose coordinates are all within their domains.
pub(crate) fn place(key: &str, place: &[f64], domains: &[(&str, RangeInclusive<f64>)]) -> Result<(), ScenarioError> {
    if place.iter().zip(domains).all(|(value, (_, domain))| domain.contains(value)) {
        return Ok(());
    }
    let bounds =
        |(axis, domain): &(&str, RangeInclusive<f64>)| format!("{axis} from {} to {} m", domain.start(), domain.end());
    let bounds: Vec<String> = domains.iter().map(bounds).collect();
    invalid(key, numbers(place), &format!("expected {}", bounds.join(", ")))
}

/// Numbers as a scenario file has them.
fn numbers(values: &[f64]) -> String {
    list(values.iter().map(f64::to_string))
}

fn list(entries: impl Iterator<Item = String>) -> String {
    format!("[{}]", entries.collect::<Vec<_>>().join(", "))
}

pub(crate) fn count(key: &str, value: usize, domain: RangeInclusive<usize>) -> Result<(), ScenarioError> {
    if domain.contains(&value) {
        return Ok(());
    }
    let (least, most) = (domain.start(), domain.end());
    let expected =
        if least == most { format!("expected {least}") } else { format!("expected an integer from {least} to {most}") };
    invalid(key, value, &expected)
}

pub(crate) fn invalid(key: &str, value: impl ToString, expected: &str) -> Result<(), ScenarioError> {
    Err(ScenarioError::Invalid { key: key.into(), value: value.to_string(), expected: expected.into(), line: None })
}
