//! The tables of the report streams: rates, latencies, noise, resolution and losses.

use serde::{Deserialize, Serialize};

/// Position reports of a tracker.
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
    /// Probability that a report is lost.
    pub loss: f64,
    /// Mean number of reports lost in a row; 0: losses are independent.
    pub loss_burst_reports: f64,
}

impl PositionStream {
    /// Time between two reports in ns.
    pub fn interval_ns(&self) -> u64 {
        (1e9 / self.rate_hz) as u64
    }
}

impl Default for PositionStream {
    fn default() -> Self {
        Self {
            rate_hz: 100.0,
            latency_ms: 0.0,
            noise_m: 0.0,
            velocity_noise_m_s: 0.0,
            loss: 0.0,
            loss_burst_reports: 0.0,
        }
    }
}

/// Channel reports: the gains that the users measure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ChannelStream {
    /// Reports a second.
    pub rate_hz: f64,
    /// From measurement to publication in ms.
    pub latency_ms: f64,
    /// Standard deviation of a gain, relative to it.
    pub noise_relative: f64,
    /// Standard deviation of the noise of the receiver, as a gain; negative readings are 0.
    pub noise_gain: f64,
    /// Bits of the receiver's analogue-to-digital converter; 0 is no quantisation.
    pub resolution_bits: u32,
    /// The gain of the converter's largest value, at which readings saturate.
    pub full_scale_gain: f64,
    /// Probability that a report is lost.
    pub loss: f64,
    /// Mean number of reports lost in a row; 0: losses are independent.
    pub loss_burst_reports: f64,
    /// Whether the gains of each branch of the receivers are reported as well.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub branches: bool,
    /// What is reported of the LEDs that the receivers detect.
    #[serde(skip_serializing_if = "LedIdentity::is_none")]
    pub leds: LedIdentity,
}

/// What a receiver tells about the LEDs that it detects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LedIdentity {
    /// Nothing.
    #[default]
    None,
    /// The LED that serves it.
    Serving,
    /// That, and the gain of the direct path from each LED.
    Gains,
}

impl LedIdentity {
    /// Whether no report has any of it.
    pub fn is_none(&self) -> bool {
        *self == Self::None
    }
}

/// A direct gain within this many standard deviations of the noise counts as none.
const DETECTION_DEVIATIONS: f64 = 3.0;

impl Default for ChannelStream {
    fn default() -> Self {
        Self {
            rate_hz: 100.0,
            latency_ms: 0.0,
            noise_relative: 0.0,
            noise_gain: 0.0,
            resolution_bits: 0,
            full_scale_gain: 0.0,
            loss: 0.0,
            loss_burst_reports: 0.0,
            branches: false,
            leds: LedIdentity::None,
        }
    }
}

impl ChannelStream {
    /// The difference between two successive values of the converter; 0 without quantisation.
    ///
    /// step = `full_scale_gain` / (2^`resolution_bits` - 1). Units: a gain.
    pub fn step_gain(&self) -> f64 {
        if self.resolution_bits == 0 {
            return 0.0;
        }
        self.full_scale_gain / (f64::from(self.resolution_bits).exp2() - 1.0)
    }

    /// The largest reported gain that can come from a blocked path.
    ///
    /// max(3 `noise_gain`, step / 2): noise exceeds the first term once in 740 readings, and the
    /// converter rounds smaller gains than the second one to 0. Units: a gain.
    pub fn detectable_gain(&self) -> f64 {
        (DETECTION_DEVIATIONS * self.noise_gain).max(0.5 * self.step_gain())
    }

    /// Variance of a reported gain that does not depend on the gain.
    ///
    /// `noise_gain`^2 + step^2 / 12: the noise of the receiver, and a rounding error that is uniform
    /// over a step. Units: a squared gain.
    pub fn gain_variance(&self) -> f64 {
        self.noise_gain.powi(2) + self.step_gain().powi(2) / 12.0
    }
}

/// Orientation reports: how the users hold their receivers, as the receivers measure it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OrientationStream {
    /// Reports a second.
    pub rate_hz: f64,
    /// From measurement to publication in ms.
    pub latency_ms: f64,
    /// Standard deviation of a rotation about each axis in degrees.
    pub noise_deg: f64,
}

impl Default for OrientationStream {
    fn default() -> Self {
        Self { rate_hz: 100.0, latency_ms: 0.0, noise_deg: 0.0 }
    }
}

/// A report stream with a rate only.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlainStream {
    /// Reports per second; 0 switches the stream off if that is allowed.
    pub rate_hz: f64,
}

/// Rates, latencies and noise of the reports of a room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Streams {
    /// The positions of the users; each report starts a decision.
    pub positions: PositionStream,
    /// The channel gains of the users.
    pub channel: ChannelStream,
    /// Telemetry: the angles and states of the mirrors.
    pub telemetry: PlainStream,
    /// The positions of the obstacles; at 0 no report contains them.
    pub obstacles: PlainStream,
    /// The true state with reference rates, for viewers; simulator only.
    pub truth: PlainStream,
    /// How the users hold their receivers; absent: no report contains it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation: Option<OrientationStream>,
}

impl Default for Streams {
    fn default() -> Self {
        Self {
            positions: PositionStream::default(),
            channel: ChannelStream::default(),
            telemetry: PlainStream { rate_hz: 20.0 },
            obstacles: PlainStream { rate_hz: 1.0 },
            truth: PlainStream { rate_hz: 20.0 },
            orientation: None,
        }
    }
}
