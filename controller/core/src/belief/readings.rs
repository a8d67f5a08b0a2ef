//! Measured gains, and the resolution of the receivers.

use heliostat_scenario::ChannelStream;

/// The measured gains of one user.
#[derive(Clone, Copy, Debug)]
pub(super) struct MeasuredGains {
    pub los: f64,
    pub irs: f64,
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
