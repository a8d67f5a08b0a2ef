//! The tables of a running room: actuators, and the limits of the controller.

use heliostat_channel::Mechanical;
use serde::{Deserialize, Serialize};

/// A predefined actuator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActuatorProfile {
    /// Instant and exact.
    Ideal,
    /// A fast-steering mirror: second order, limited slew, quantised.
    Mems,
    /// A hobby servo: slow.
    Servo,
}

/// The dynamics of a mirror; a missing key has the value of the profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Actuator {
    /// The source of the values that are not given here.
    pub profile: ActuatorProfile,
    /// Natural frequency of an axis in Hz.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub natural_frequency_hz: Option<f64>,
    /// Damping ratio of an axis.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub damping_ratio: Option<f64>,
    /// Cut-off of the drive's low-pass in Hz.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub low_pass_hz: Option<f64>,
    /// Maximum slew rate, mechanical, in degrees per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slew_deg_per_s: Option<f64>,
    /// Mechanical range of each axis, plus and minus, in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range_deg: Option<f64>,
    /// Bits of the digital-to-analogue converter over the full range; 0 is no quantisation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resolution_bits: Option<u32>,
    /// Time from command to the start of the movement in ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delay_ms: Option<f64>,
    /// Standard deviation of the pointing jitter in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jitter_deg: Option<f64>,
    /// Standard deviation of the fixed offset of each axis in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub offset_deg: Option<f64>,
    /// Random-walk drift of each axis in degrees after one hour.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drift_deg_per_sqrt_hour: Option<f64>,
    /// Standard deviation of the fixed scale error of each axis, relative to the angle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_error_relative: Option<f64>,
    /// Distance between the final angles of an axis from below and from above, in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hysteresis_deg: Option<f64>,
    /// Fraction of the mirrors that do not move from their position of rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stuck_share: Option<f64>,
}

impl Default for Actuator {
    fn default() -> Self {
        Self {
            profile: ActuatorProfile::Ideal,
            natural_frequency_hz: None,
            damping_ratio: None,
            low_pass_hz: None,
            slew_deg_per_s: None,
            range_deg: None,
            resolution_bits: None,
            delay_ms: None,
            jitter_deg: None,
            offset_deg: None,
            drift_deg_per_sqrt_hour: None,
            scale_error_relative: None,
            hysteresis_deg: None,
            stuck_share: None,
        }
    }
}

/// An actuator with all values, in radians and seconds; `None` is "not limited" or "instant".
///
/// All angles are mechanical.
#[derive(Clone, Debug, PartialEq)]
pub struct ActuatorParameters {
    /// Natural frequency in rad/s and damping ratio.
    pub second_order: Option<(f64, f64)>,
    /// Cut-off of the low-pass in rad/s.
    pub low_pass_rad_per_s: Option<f64>,
    /// Maximum slew rate, mechanical, in rad/s.
    pub slew_rad_per_s: Option<f64>,
    /// Mechanical range of each axis, plus and minus, in rad.
    pub range_rad: f64,
    /// Bits over the full range.
    pub resolution_bits: Option<u32>,
    /// Time from command to the start of the movement in s.
    pub delay_s: f64,
    /// Standard deviation of the pointing jitter in rad.
    pub jitter_rad: f64,
    /// Standard deviation of the fixed offset of each axis in rad.
    pub offset_rad: f64,
    /// Random-walk drift in rad per square root of a second.
    pub drift_rad_per_sqrt_s: f64,
    /// Standard deviation of the fixed scale error of each axis, relative to the angle.
    pub scale_error_relative: f64,
    /// Width of the hysteresis loop in rad: the distance between the final angles from below and
    /// from above.
    pub hysteresis_rad: f64,
}

impl Actuator {
    /// The values of the profile, replaced by the keys of this table.
    pub fn parameters(&self) -> ActuatorParameters {
        // Typical values of a gimbal-less two-axis MEMS mirror of a few millimetres, and of a
        // digital hobby servo (0.1 s for 60 degrees).
        let profile = match self.profile {
            ActuatorProfile::Ideal => Profile { range_deg: 90.0, ..Profile::default() },
            ActuatorProfile::Mems => Profile {
                natural_frequency_hz: 250.0,
                damping_ratio: 0.7,
                low_pass_hz: 400.0,
                slew_deg_per_s: 6000.0,
                range_deg: 60.0,
                resolution_bits: 12,
                delay_ms: 0.2,
                jitter_deg: 0.02,
            },
            ActuatorProfile::Servo => Profile {
                natural_frequency_hz: 6.0,
                damping_ratio: 0.9,
                low_pass_hz: 0.0,
                slew_deg_per_s: 400.0,
                range_deg: 60.0,
                resolution_bits: 10,
                delay_ms: 10.0,
                jitter_deg: 0.1,
            },
        };
        let natural_frequency_hz = self.natural_frequency_hz.unwrap_or(profile.natural_frequency_hz);
        let low_pass_hz = self.low_pass_hz.unwrap_or(profile.low_pass_hz);
        let slew = self.slew_deg_per_s.unwrap_or(profile.slew_deg_per_s);
        let bits = self.resolution_bits.unwrap_or(profile.resolution_bits);
        let radians = |degrees: f64| Mechanical::from_degrees(degrees).radians();
        let positive = |value: f64| (value > 0.0).then_some(value);
        ActuatorParameters {
            second_order: positive(natural_frequency_hz)
                .map(|hz| (hz * std::f64::consts::TAU, self.damping_ratio.unwrap_or(profile.damping_ratio))),
            low_pass_rad_per_s: positive(low_pass_hz).map(|hz| hz * std::f64::consts::TAU),
            slew_rad_per_s: positive(slew).map(radians),
            range_rad: radians(self.range_deg.unwrap_or(profile.range_deg)),
            resolution_bits: (bits > 0).then_some(bits),
            delay_s: self.delay_ms.unwrap_or(profile.delay_ms) * 1e-3,
            jitter_rad: radians(self.jitter_deg.unwrap_or(profile.jitter_deg)),
            offset_rad: radians(self.offset_deg.unwrap_or(0.0)),
            drift_rad_per_sqrt_s: radians(self.drift_deg_per_sqrt_hour.unwrap_or(0.0)) / 60.0,
            scale_error_relative: self.scale_error_relative.unwrap_or(0.0),
            hysteresis_rad: radians(self.hysteresis_deg.unwrap_or(0.0)),
        }
    }
}

/// The values of a profile; 0 is "none".
#[derive(Default)]
struct Profile {
    natural_frequency_hz: f64,
    damping_ratio: f64,
    low_pass_hz: f64,
    slew_deg_per_s: f64,
    range_deg: f64,
    resolution_bits: u32,
    delay_ms: f64,
    jitter_deg: f64,
}

/// The degraded mode when the policy fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fallback {
    /// The model-based fixed point decides.
    FixedPoint,
    /// Each mirror serves the user with its largest steering gain.
    Nearest,
    /// All mirrors face straight into the room.
    Flat,
    /// The controller publishes the last angles again, with a new validity.
    LastGood,
    /// The controller publishes no command; see [`DegradedAction::Hold`].
    Hold,
}

/// The controller's action in a degraded mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DegradedAction {
    /// The policy decides, as in normal operation.
    Policy,
    /// `control.fallback` decides.
    Fallback,
    /// The controller publishes the last angles again, with a new validity.
    LastGood,
    /// The controller publishes no command. The array keeps its angles until the validity of the
    /// last command plus the driver's `park_after_ms` has passed, then moves to its park position.
    Hold,
    /// The controller publishes a command with all mirrors flat. This is not the array state
    /// *parked*, which needs no command.
    Park,
}

/// What the controller believes about users between two position reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Belief {
    /// Users are at their reported positions.
    None,
    /// Users move at their reported velocity, until the middle of the time in force of the command.
    ConstantVelocity,
    /// Users move as a filter of all their reports predicts, until the same time.
    Filter,
}

impl std::fmt::Display for Belief {
    /// The name as in a scenario file.
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(match self {
            Self::None => "none",
            Self::ConstantVelocity => "constant-velocity",
            Self::Filter => "filter",
        })
    }
}

/// Prior knowledge about walks, for the filter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Walk {
    /// Changes of direction or speed per second.
    pub changes_per_s: f64,
    /// Standard deviation of each velocity component in m/s.
    pub speed_m_s: f64,
    /// Probability that a user stands after a change.
    pub standing: f64,
    /// Probability that a user walks on a curve after a change.
    pub curving: f64,
    /// Turn rate on a curve in degrees per second.
    pub turn_rate_deg_per_s: f64,
}

impl Default for Walk {
    fn default() -> Self {
        Self { changes_per_s: 0.3, speed_m_s: 0.8, standing: 0.1, curving: 0.2, turn_rate_deg_per_s: 45.0 }
    }
}

/// Mean angles between the vertical and the normal of a receiver that users tilt towards the face.
///
/// Source of the defaults: Soltani, Purwita, Zeng, Haas and Safari, IEEE Trans. Commun. 67(3), 2019.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AssumedTilt {
    /// The angle of a user who walks, in degrees.
    pub walking_deg: f64,
    /// The angle of a user who sits or stands, in degrees.
    pub sitting_deg: f64,
    /// Speed in m/s from which a user walks.
    pub walking_from_m_s: f64,
}

impl Default for AssumedTilt {
    fn default() -> Self {
        Self { walking_deg: 29.67, sitting_deg: 41.39, walking_from_m_s: 0.1 }
    }
}

/// Limits and degraded modes of the controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Control {
    /// Validity of a command in ms. After it the array holds its angles for the driver's
    /// `park_after_ms`, then moves to its park position.
    pub validity_ms: f64,
    /// Maximum age of a report in ms; an older one causes no decision.
    pub report_age_max_ms: f64,
    /// Time without reports in ms after which another source may publish the reports of the room.
    pub source_timeout_ms: f64,
    /// Largest commanded mechanical angle of each axis, plus and minus, in degrees.
    pub range_deg: f64,
    /// Maximum commanded slew rate in degrees per second; 0 is no limit.
    pub slew_deg_per_s: f64,
    /// The degraded mode when the policy fails.
    pub fallback: Fallback,
    /// Deadline of a decision after the arrival of its report, in ms; 0 is the time between two
    /// position reports.
    pub deadline_ms: f64,
    /// The action if the predicted latency of a decision exceeds `deadline_ms`.
    ///
    /// It is not executed twice in a row, so that a policy that is always late still decides.
    pub when_late: DegradedAction,
    /// The action for a position report older than `report_age_max_ms`.
    pub when_stale: DegradedAction,
    /// The action without a channel report newer than `report_age_max_ms`. With `policy`, modelled
    /// gains replace the reported ones.
    pub when_channel_missing: DegradedAction,
    /// The action if no position report was accepted for `report_age_max_ms`.
    pub when_silent: DegradedAction,
    /// The action at a policy timeout, always `hold`: the policy does not return for 0.1 s.
    pub when_unanswered: DegradedAction,
    /// What the controller believes about users between two position reports.
    pub belief: Belief,
    /// Prior knowledge about walks, for the belief `filter`.
    pub walk: Walk,
    /// How users are assumed to hold receivers whose orientation is not reported. If absent, measured
    /// gains decide between the default angles and receivers that face up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tilt: Option<AssumedTilt>,
    /// Maximum number of evaluations of a metaheuristic policy per decision.
    pub search_evaluations: u32,
    /// Maximum search time of a metaheuristic policy per decision, in us; 0 is no limit.
    pub search_time_us: f64,
}

impl Control {
    /// Validity of a command in whole ms, as a command states it.
    pub fn command_validity_ms(&self) -> u32 {
        self.validity_ms.round() as u32
    }

    /// Maximum age of a report in ns.
    pub fn report_age_max_ns(&self) -> u64 {
        (self.report_age_max_ms * 1e6) as u64
    }
}

impl Default for Control {
    fn default() -> Self {
        Self {
            validity_ms: 200.0,
            report_age_max_ms: 500.0,
            source_timeout_ms: 1000.0,
            range_deg: 90.0,
            slew_deg_per_s: 0.0,
            fallback: Fallback::FixedPoint,
            deadline_ms: 0.0,
            when_late: DegradedAction::LastGood,
            when_stale: DegradedAction::Hold,
            when_channel_missing: DegradedAction::Policy,
            when_silent: DegradedAction::Hold,
            when_unanswered: DegradedAction::Hold,
            belief: Belief::Filter,
            walk: Walk::default(),
            tilt: None,
            search_evaluations: 2000,
            search_time_us: 500.0,
        }
    }
}
