//! Noise, SINR, rate, bit error rate and fairness.
//!
//! ```
//! use heliostat_channel::{LinkBudget, NoiseBudget, PowerLaw, ber_ook};
//!
//! let budget = LinkBudget {
//!     power_w: 2.0,
//!     power_law: PowerLaw::Linear,
//!     responsivity_a_per_w: 0.4,
//!     noise: NoiseBudget { variance_a2: Some(4e-15), ..NoiseBudget::default() },
//!     bandwidth_hz: 20e6,
//! };
//! let sinr = budget.sinr(1e-6);
//! assert!((sinr / 80.0 - 1.0).abs() < 1e-12, "0.4^2 * 2 * (1e-6)^2 / 4e-15");
//! assert!(budget.rate_bps(sinr, 5) > 20e6 && ber_ook(sinr) < 1e-15);
//! ```

use std::f64::consts::{E, FRAC_1_SQRT_2, PI};

use serde::{Deserialize, Serialize};

use crate::domain::{not_negative, positive};
use crate::error::ChannelError;

/// The dependence of eq. (6) on the transmitted power.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PowerLaw {
    /// R0^2 P H^2: as printed.
    Linear,
    /// (R0 P H)^2: the squared photocurrent.
    Squared,
}

/// Noise of one detector: the terms as spectral densities.
///
/// The paper names the terms but gives no values; docs/physics.md has the source of each default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NoiseBudget {
    /// Shot noise of the background light in A2/Hz.
    pub background_shot_a2_per_hz: f64,
    /// Thermal noise in A2/Hz.
    pub thermal_a2_per_hz: f64,
    /// Preamplifier noise in A2/Hz: the square of the input noise current density.
    pub preamplifier_a2_per_hz: f64,
    /// Noise variance in A2; replaces the sum of the terms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub variance_a2: Option<f64>,
}

impl Default for NoiseBudget {
    fn default() -> Self {
        Self {
            background_shot_a2_per_hz: 1.85e-22,
            thermal_a2_per_hz: 3e-24,
            preamplifier_a2_per_hz: 2e-23,
            variance_a2: None,
        }
    }
}

impl NoiseBudget {
    /// Variance of the noise current over a bandwidth: sigma^2 = (S_shot + S_thermal +
    /// S_preamplifier) B.
    ///
    /// `variance_a2`, where it is given, replaces the result. Units: bandwidth in Hz, variance in
    /// A2.
    pub fn variance_over(&self, bandwidth_hz: f64) -> f64 {
        let density = self.background_shot_a2_per_hz + self.thermal_a2_per_hz + self.preamplifier_a2_per_hz;
        self.variance_a2.unwrap_or(density * bandwidth_hz)
    }
}

/// Power, responsivity, noise and bandwidth: the quantities that relate a gain to a rate.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkBudget {
    /// Optical power P of an LED in W, above 0.
    pub power_w: f64,
    /// Whether eq. (6) has P or P^2.
    pub power_law: PowerLaw,
    /// Responsivity R0 of a detector in A/W, above 0.
    pub responsivity_a_per_w: f64,
    /// Noise of one detector.
    pub noise: NoiseBudget,
    /// Modulation bandwidth B in Hz, above 0; the users share it equally.
    pub bandwidth_hz: f64,
}

impl LinkBudget {
    /// Variance sigma^2 of the noise current over the bandwidth, in A2.
    pub fn noise_variance_a2(&self) -> f64 {
        self.noise.variance_over(self.bandwidth_hz)
    }

    /// SINR of a gain, linear.
    ///
    /// SINR = R0^2 P H^2 / sigma^2, with P^2 in place of P under [`PowerLaw::Squared`].
    ///
    /// Source: paper eq. (6) with I_k = 0, since each user has a band of its own, B/K.
    /// Units: dimensionless gain and SINR.
    #[inline]
    pub fn sinr(&self, gain: f64) -> f64 {
        self.sinr_of_unit_gain() * gain * gain
    }

    /// Rate of one user, when K = `users` users share the bandwidth.
    ///
    /// R = B/K log2(1 + e/(2 pi) SINR), for a linear SINR of at least 0.
    ///
    /// Source: paper eq. (7). Units: bit/s.
    #[inline]
    pub fn rate_bps(&self, sinr: f64, users: usize) -> f64 {
        self.bandwidth_hz / users as f64 * (E / (2.0 * PI) * sinr).ln_1p() * std::f64::consts::LOG2_E
    }

    /// Amplitude scale s with (s H)^2 = e/(2 pi) SINR, so that R = B/K log2(1 + (s H)^2).
    ///
    /// Source: paper eqs. (6) and (7). Units: dimensionless.
    pub fn amplitude_scale(&self) -> f64 {
        (E / (2.0 * PI) * self.sinr_of_unit_gain()).sqrt()
    }

    #[inline]
    fn sinr_of_unit_gain(&self) -> f64 {
        let power = match self.power_law {
            PowerLaw::Linear => self.power_w,
            PowerLaw::Squared => self.power_w * self.power_w,
        };
        self.responsivity_a_per_w * self.responsivity_a_per_w * power / self.noise_variance_a2()
    }

    /// Refuses a value outside its domain.
    pub(crate) fn check(&self) -> Result<(), ChannelError> {
        positive("optical power in W", self.power_w)?;
        positive("responsivity in A/W", self.responsivity_a_per_w)?;
        positive("bandwidth in Hz", self.bandwidth_hz)?;
        not_negative("background shot noise in A2/Hz", self.noise.background_shot_a2_per_hz)?;
        not_negative("thermal noise in A2/Hz", self.noise.thermal_a2_per_hz)?;
        not_negative("preamplifier noise in A2/Hz", self.noise.preamplifier_a2_per_hz)?;
        positive("noise variance in A2", self.noise_variance_a2())?;
        Ok(())
    }
}

/// Bit error rate of on-off keying.
///
/// BER = Q(sqrt(SINR)) = erfc(sqrt(SINR / 2)) / 2 for a linear SINR; a negative SINR counts as 0.
pub fn ber_ook(sinr: f64) -> f64 {
    0.5 * erfc(sinr.max(0.0).sqrt() * FRAC_1_SQRT_2)
}

/// Jain's fairness index: (sum x)^2 / (n sum x^2), within [1/n, 1].
///
/// NaN if every value is zero or the list is empty: the index is 0 / 0 there, so that it is not defined.
///
/// Source: Jain, Chiu and Hawe, DEC Research Report TR-301, 1984. Units: dimensionless.
pub fn jain(values: &[f64]) -> f64 {
    let sum: f64 = values.iter().sum();
    let squares: f64 = values.iter().map(|value| value * value).sum();
    if squares == 0.0 { f64::NAN } else { sum * sum / (values.len() as f64 * squares) }
}

/// Complementary error function for x >= 0, with a relative error of about 1e-14.
///
/// Below 1.5: one minus the series exp(-x^2) sum 2^n x^(2n+1) / (2n+1)!! 2/sqrt(pi), whose terms
/// are all positive. From 1.5 on: the continued fraction. Source: NIST Digital Library of
/// Mathematical Functions, 7.6.2 and 7.9.1.
fn erfc(x: f64) -> f64 {
    let gaussian = (-x * x).exp() / PI.sqrt();
    if x < 1.5 {
        let mut term = x;
        let mut sum = x;
        let mut n = 0.0;
        while term > sum * 1e-17 {
            n += 1.0;
            term *= 2.0 * x * x / (2.0 * n + 1.0);
            sum += term;
        }
        1.0 - 2.0 * gaussian * sum
    } else {
        let tail = (1..=80).rev().fold(x, |below, n| x + 0.5 * f64::from(n) / below);
        gaussian / tail
    }
}
