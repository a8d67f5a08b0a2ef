//! The tables that describe time: actuators, report streams, and the controller's limits.

use serde::{Deserialize, Serialize};

/// A ready-made actuator.
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

/// How a mirror follows its command; a key that is left out takes the profile's value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Actuator {
    /// Where the values come from that are not given here.
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
    /// Fastest mechanical turn in degrees a second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slew_deg_per_s: Option<f64>,
    /// Mechanical range of each axis, plus and minus, in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range_deg: Option<f64>,
    /// Bits of the digital-to-analogue converter over the whole range; 0 is no quantisation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resolution_bits: Option<u32>,
    /// Time from command to the start of the turn in ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delay_ms: Option<f64>,
    /// Standard deviation of the pointing jitter in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jitter_deg: Option<f64>,
    /// Standard deviation of each axis' fixed offset in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub offset_deg: Option<f64>,
    /// Random-walk drift of each axis in degrees after one hour.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drift_deg_per_sqrt_hour: Option<f64>,
    /// Standard deviation of each axis' fixed scale error, relative to the angle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_error_relative: Option<f64>,
    /// Between where an axis comes to rest from below and from above, in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hysteresis_deg: Option<f64>,
    /// Share of the mirrors that are stuck in their position of rest from the start.
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

/// An actuator with every value filled in, in radians and seconds; `None` is "not limited" or "instant".
#[derive(Clone, Debug, PartialEq)]
pub struct ActuatorParameters {
    /// Natural frequency in rad/s and damping ratio.
    pub second_order: Option<(f64, f64)>,
    /// Cut-off of the low-pass in rad/s.
    pub low_pass_rad_per_s: Option<f64>,
    /// Fastest mechanical turn in rad/s.
    pub slew_rad_per_s: Option<f64>,
    /// Mechanical range of each axis, plus and minus, in rad.
    pub range_rad: f64,
    /// Bits over the whole range.
    pub resolution_bits: Option<u32>,
    /// Time from command to the start of the turn in s.
    pub delay_s: f64,
    /// Standard deviation of the pointing jitter in rad.
    pub jitter_rad: f64,
    /// Standard deviation of each axis' fixed offset in rad.
    pub offset_rad: f64,
    /// Random-walk drift in rad a square root of a second.
    pub drift_rad_per_sqrt_s: f64,
    /// Standard deviation of each axis' fixed scale error, relative to the angle.
    pub scale_error_relative: f64,
    /// Width of the hysteresis loop in rad: between where an axis comes to rest from below and from above.
    pub hysteresis_rad: f64,
}

impl Actuator {
    /// The profile's values with this table's keys laid over them.
    pub fn parameters(&self) -> ActuatorParameters {
        // natural frequency, damping, low-pass, slew, range, bits, delay, jitter: values of a gimbal-less two-axis MEMS
        // mirror of a few millimetres, and of a digital hobby servo (0.1 s for 60 degrees).
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
        let positive = |value: f64| (value > 0.0).then_some(value);
        ActuatorParameters {
            second_order: positive(natural_frequency_hz)
                .map(|hz| (hz * std::f64::consts::TAU, self.damping_ratio.unwrap_or(profile.damping_ratio))),
            low_pass_rad_per_s: positive(low_pass_hz).map(|hz| hz * std::f64::consts::TAU),
            slew_rad_per_s: positive(slew).map(f64::to_radians),
            range_rad: self.range_deg.unwrap_or(profile.range_deg).to_radians(),
            resolution_bits: (bits > 0).then_some(bits),
            delay_s: self.delay_ms.unwrap_or(profile.delay_ms) * 1e-3,
            jitter_rad: self.jitter_deg.unwrap_or(profile.jitter_deg).to_radians(),
            offset_rad: self.offset_deg.unwrap_or(0.0).to_radians(),
            drift_rad_per_sqrt_s: self.drift_deg_per_sqrt_hour.unwrap_or(0.0).to_radians() / 60.0,
            scale_error_relative: self.scale_error_relative.unwrap_or(0.0),
            hysteresis_rad: self.hysteresis_deg.unwrap_or(0.0).to_radians(),
        }
    }
}

/// A profile's values; 0 is "none".
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

/// Where the users are, as a tracker reports it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PositionStream {
    /// Reports a second.
    pub rate_hz: f64,
    /// From measurement to publication in ms.
    pub latency_ms: f64,
    /// Standard deviation of each coordinate in m.
    pub noise_m: f64,
    /// Standard deviation of each velocity component in m/s.
    pub velocity_noise_m_s: f64,
}

impl Default for PositionStream {
    fn default() -> Self {
        Self { rate_hz: 100.0, latency_ms: 0.0, noise_m: 0.0, velocity_noise_m_s: 0.0 }
    }
}

/// The gains that the users measure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ChannelStream {
    /// Reports a second.
    pub rate_hz: f64,
    /// From measurement to publication in ms.
    pub latency_ms: f64,
    /// Standard deviation of a gain, relative to it.
    pub noise_relative: f64,
}

impl Default for ChannelStream {
    fn default() -> Self {
        Self { rate_hz: 100.0, latency_ms: 0.0, noise_relative: 0.0 }
    }
}

/// A stream that has only a rate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlainStream {
    /// Reports a second; 0 switches the stream off where that is allowed.
    pub rate_hz: f64,
}

/// What the room publishes, and how well.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Streams {
    /// The users' positions; a report completes a tick.
    pub positions: PositionStream,
    /// The users' channel gains.
    pub channel: ChannelStream,
    /// What the mirrors do.
    pub telemetry: PlainStream,
    /// The obstacles, as a survey of the room; 0 leaves the controller to find out.
    pub obstacles: PlainStream,
    /// The truth beside its yardsticks, for viewers; simulator only.
    pub truth: PlainStream,
}

impl Default for Streams {
    fn default() -> Self {
        Self {
            positions: PositionStream::default(),
            channel: ChannelStream::default(),
            telemetry: PlainStream { rate_hz: 20.0 },
            obstacles: PlainStream { rate_hz: 1.0 },
            truth: PlainStream { rate_hz: 20.0 },
        }
    }
}

/// What the controller does when its policy fails or its reports are too old.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fallback {
    /// The model-based fixed point decides.
    FixedPoint,
    /// Each mirror serves the user it can give most.
    Nearest,
    /// All mirrors face straight into the room.
    Flat,
    /// The last command again, valid anew.
    LastGood,
    /// No command is sent: the array holds, then parks.
    Hold,
}

/// What the controller answers where the plain way is closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Answer {
    /// The policy decides all the same.
    Policy,
    /// What `control.fallback` names decides.
    Fallback,
    /// The last command again, valid anew.
    LastGood,
    /// No command: the array holds the last one, then parks.
    Hold,
    /// Every mirror faces straight into the room.
    Park,
}

/// What the controller makes of the age of a position report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Prediction {
    /// Users are taken to be where they were reported.
    None,
    /// Users are taken to have walked on at their reported velocity, up to the middle of the time that the command will stand.
    ConstantVelocity,
}

/// The controller's limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Control {
    /// A command is valid for this long, in ms; the array then parks.
    pub validity_ms: f64,
    /// An older report is not acted on, in ms.
    pub report_age_max_ms: f64,
    /// A room source that is silent for this long loses its hold on the room, in ms.
    pub source_timeout_ms: f64,
    /// Largest commanded angle of each axis, plus and minus, in degrees.
    pub range_deg: f64,
    /// Fastest commanded turn in degrees a second; 0 is no limit.
    pub slew_deg_per_s: f64,
    /// What decides when the policy fails.
    pub fallback: Fallback,
    /// A decision that would take longer than this from the arrival of its report is late, in ms; 0 is the time between two position reports.
    pub deadline_ms: f64,
    /// The answer where a decision would be late. Never given twice in a row, so that a policy that is always late still decides.
    pub when_late: Answer,
    /// The answer to a position report older than `report_age_max_ms`.
    pub when_stale: Answer,
    /// The answer while no channel report of acceptable age is there; the policy would act on modelled gains.
    pub when_channel_missing: Answer,
    /// The answer once no position report came for `report_age_max_ms`.
    pub when_silent: Answer,
    /// The answer once the policy gives none for a tenth of a second.
    pub when_unanswered: Answer,
    /// Where users are taken to be.
    pub prediction: Prediction,
    /// Most trials that a metaheuristic policy makes for one decision.
    pub search_evaluations: u32,
    /// Longest time that a metaheuristic policy searches for one decision, in us; 0 is no limit.
    pub search_time_us: f64,
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
            when_late: Answer::LastGood,
            when_stale: Answer::Hold,
            when_channel_missing: Answer::Policy,
            when_silent: Answer::Hold,
            when_unanswered: Answer::Hold,
            prediction: Prediction::None,
            search_evaluations: 2000,
            search_time_us: 500.0,
        }
    }
}
