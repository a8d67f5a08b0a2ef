//! Noise, SINR, rate, bit error rate and fairness.
//!
//! ```
//! use heliostat_channel::{LinkBudget, NoiseBudget, PowerLaw, ber_ook};
//!
//! let budget = LinkBudget {
//!     power_w: 2.0,
//!     power_law: PowerLaw::Linear,
//!     responsivity_a_per_w: 0.4,
//!     noise: NoiseBudget {
//!         background_shot_a2_per_hz: 0.0,
//!         thermal_a2_per_hz: 0.0,
//!         preamplifier_a2_per_hz: 0.0,
//!         variance_a2: Some(4e-15),
//!     },
//!     bandwidth_hz: 20e6,
//! };
//! let sinr = budget.sinr(1e-6);
//! assert!((sinr / 80.0 - 1.0).abs() < 1e-12, "0.4^2 * 2 * (1e-6)^2 / 4e-15");
//! assert!(budget.rate_bps(sinr, 5) > 20e6 && ber_ook(sinr) < 1e-15);
//! ```

use crate::domain::{not_negative, positive};
use crate::error::ChannelError;
use std::f64::consts::{E, FRAC_1_SQRT_2, PI};

/// The dependence of eq. (6) on the transmitted power.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PowerLaw {
    /// R0^2 P H^2: as printed.
    Linear,
    /// (R0 P H)^2: the squared photocurrent.
    Squared,
}

/// Noise of one detector: the terms as spectral densities.
///
/// The paper names the terms but gives no values; docs/physics.md has the source of each default.
#[derive(Clone, Debug, PartialEq)]
pub struct NoiseBudget {
    /// Shot noise of the background light in A2/Hz; see [`background_shot_density`].
    pub background_shot_a2_per_hz: f64,
    /// Thermal noise in A2/Hz; see [`ThermalNoise`].
    pub thermal_a2_per_hz: f64,
    /// Preamplifier noise in A2/Hz: the square of the input noise current density.
    pub preamplifier_a2_per_hz: f64,
    /// Noise variance in A2; replaces the sum of the terms.
    pub variance_a2: Option<f64>,
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

/// Charge of the electron in C (exact by definition of the SI).
const ELEMENTARY_CHARGE_C: f64 = 1.602_176_634e-19;
/// Boltzmann's constant in J/K (exact by definition of the SI).
const BOLTZMANN_J_PER_K: f64 = 1.380_649e-23;
/// Personick's noise-bandwidth integral I2 for a rectangular pulse.
const PERSONICK_I2: f64 = 0.562;
/// Personick's noise-bandwidth integral I3 for a rectangular pulse.
const PERSONICK_I3: f64 = 0.0868;

/// Spectral density of the shot noise of a background photocurrent: S = 2 q I_bg I2.
///
/// Source: Komine and Nakagawa, IEEE Trans. Consumer Electronics 50(1), 2004. They use 5.1 mA per
/// cm2 of detector in direct sunlight and 0.74 mA in indirect sunlight: 1.02 mA and 0.148 mA for 20
/// mm2.
/// Units: current in A, density in A2/Hz.
pub fn background_shot_density(background_current_a: f64) -> f64 {
    2.0 * ELEMENTARY_CHARGE_C * background_current_a * PERSONICK_I2
}

/// Parameters of the thermal noise of a detector with an FET preamplifier.
///
/// [`Default`] has the values of Komine and Nakagawa (2004), for a detector of 20 mm2.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermalNoise {
    /// Absolute temperature in K.
    pub temperature_k: f64,
    /// Open-loop voltage gain G.
    pub open_loop_gain: f64,
    /// Capacitance of the detector in F/m2.
    pub capacitance_f_per_m2: f64,
    /// Area of the detector in m2.
    pub detector_area_m2: f64,
    /// Channel noise factor of the FET.
    pub channel_noise_factor: f64,
    /// Transconductance of the FET in S.
    pub transconductance_s: f64,
}

impl Default for ThermalNoise {
    fn default() -> Self {
        Self {
            temperature_k: 295.0,
            open_loop_gain: 10.0,
            capacitance_f_per_m2: 112e-8,
            detector_area_m2: 20e-6,
            channel_noise_factor: 1.5,
            transconductance_s: 30e-3,
        }
    }
}

impl ThermalNoise {
    /// Mean spectral density over a bandwidth.
    ///
    /// S = (8 pi k T / G) eta A I2 B + (16 pi^2 k T Gamma / g_m) eta^2 A^2 I3 B^2.
    ///
    /// Source: Komine and Nakagawa (2004), equation of the thermal variance, divided by B.
    /// Units: bandwidth in Hz, density in A2/Hz.
    pub fn density_over(&self, bandwidth_hz: f64) -> f64 {
        let thermal_energy = BOLTZMANN_J_PER_K * self.temperature_k;
        let capacitance = self.capacitance_f_per_m2 * self.detector_area_m2;
        let feedback = 8.0 * PI * thermal_energy / self.open_loop_gain * capacitance * PERSONICK_I2;
        let channel = 16.0 * PI * PI * thermal_energy * self.channel_noise_factor / self.transconductance_s
            * capacitance
            * capacitance
            * PERSONICK_I3;
        feedback * bandwidth_hz + channel * bandwidth_hz * bandwidth_hz
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
/// 1 if every value is zero or the list is empty, since all users then have the same.
///
/// Source: Jain, Chiu and Hawe, DEC Research Report TR-301, 1984. Units: dimensionless.
pub fn jain(values: &[f64]) -> f64 {
    let sum: f64 = values.iter().sum();
    let squares: f64 = values.iter().map(|value| value * value).sum();
    if squares == 0.0 { 1.0 } else { sum * sum / (values.len() as f64 * squares) }
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
