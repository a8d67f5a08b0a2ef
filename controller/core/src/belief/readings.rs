//! Measured gains, and the resolution of the receivers.

use heliostat_proto::LedReport;
use heliostat_scenario::ChannelStream;

/// The measured gains of one user.
#[derive(Clone, Copy, Debug)]
pub(super) struct MeasuredGains<'a> {
    pub los: f64,
    pub irs: f64,
    pub leds: MeasuredLeds<'a>,
}

/// What a receiver tells about the LEDs that it detects.
#[derive(Clone, Copy, Debug)]
pub(super) enum MeasuredLeds<'a> {
    Unknown,
    /// The LED that serves it.
    Serving(usize),
    /// The gain of the direct path from each LED.
    Each(&'a [f64]),
}

/// The LED report of one measurement, user by user; its buffer is allocated once.
#[derive(Clone, Debug)]
pub(super) struct LedReadings {
    gains: Vec<f64>,
}

impl LedReadings {
    pub fn new(leds: usize) -> Self {
        Self { gains: vec![0.0; leds] }
    }

    /// What a report tells about the LEDs of a user.
    pub fn of<'a>(&'a mut self, report: Option<&LedReport>, user: u32) -> MeasuredLeds<'a> {
        let Some(report) = report else { return MeasuredLeds::Unknown };
        match report.users.iter().find(|entry| entry.user == user) {
            Some(entry) if entry.measures_each => {
                self.gains.fill(0.0);
                for gain in report.gains.iter().filter(|gain| gain.user == user) {
                    self.gains[gain.led as usize] = f64::from(gain.los_gain);
                }
                MeasuredLeds::Each(&self.gains)
            }
            Some(entry) => entry.serving.map_or(MeasuredLeds::Unknown, |led| MeasuredLeds::Serving(led as usize)),
            None => MeasuredLeds::Unknown,
        }
    }
}

/// The resolution of the receivers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Readings {
    /// The largest reading of a blocked path; see `ChannelStream::detectable_gain`.
    pub detectable_gain: f64,
    /// Variance of a reading that does not depend on the gain.
    pub gain_variance: f64,
    /// Time between two reports in s.
    pub interval_s: f64,
}

impl Readings {
    pub fn new(settings: &ChannelStream) -> Self {
        Self {
            detectable_gain: settings.detectable_gain(),
            gain_variance: settings.gain_variance(),
            interval_s: 1.0 / settings.rate_hz,
        }
    }

    /// Whether a direct gain shows a path that is not blocked.
    pub fn shows(&self, los_gain: f64) -> bool {
        los_gain > self.detectable_gain
    }
}
