//! The users' receivers: one detector or several, each with its direction and field of view.
//!
//! An angle-diversity receiver is a list of branches. Each branch sees its own gain; [`Combining`] makes one figure of
//! them. All three rules are norms of the vector of branch gains, which is why a combined gain can stand in the place of a
//! single detector's gain in the SINR.

use crate::Vec3;
use crate::error::{ChannelError, check, positive};
use crate::trig::Lanes;

/// Most branches of a receiver.
pub const BRANCHES_MAX: usize = 16;

/// One detector of a receiver.
#[derive(Clone, Debug, PartialEq)]
pub struct Branch {
    /// Unit vector that the detector faces, in the room's frame.
    pub normal: Vec3,
    /// Largest incidence angle that is detected, in radians; at most pi/2.
    pub fov_semi_angle: f64,
}

/// How the branches of a receiver become one signal. Each branch has the same noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Combining {
    /// The branch with the highest SINR is used: the largest gain.
    Best,
    /// The photocurrents are added, and so are the noise variances: (sum of gains) / sqrt(branches).
    EqualGain,
    /// The photocurrents are weighted by their gains, so that the SINRs add: sqrt(sum of squared gains).
    MaximalRatio,
}

impl Combining {
    /// The gain of a single detector that would have the combined receiver's SINR. Shape: one gain a branch.
    #[inline]
    pub fn combine(self, gains: &[f64]) -> f64 {
        if let [only] = gains {
            return *only;
        }
        self.finish(gains.iter().fold(0.0, |sum, gain| self.add(sum, *gain)), gains.len())
    }

    /// Takes one more branch into a running value that starts at zero.
    #[inline]
    pub(crate) fn add(self, sum: f64, gain: f64) -> f64 {
        match self {
            Self::Best => sum.max(gain),
            Self::EqualGain => sum + gain,
            Self::MaximalRatio => sum + gain * gain,
        }
    }

    /// Takes one more branch into the running values of a block of mirrors.
    ///
    /// The choice stands outside the loop, where it keeps no compiler from vectorising.
    #[inline(always)]
    pub(crate) fn add_each(self, sums: &mut Lanes, gains: &Lanes) {
        let both = sums.iter_mut().zip(gains);
        match self {
            Self::Best => both.for_each(|(sum, gain)| *sum = Self::Best.add(*sum, *gain)),
            Self::EqualGain => both.for_each(|(sum, gain)| *sum = Self::EqualGain.add(*sum, *gain)),
            Self::MaximalRatio => both.for_each(|(sum, gain)| *sum = Self::MaximalRatio.add(*sum, *gain)),
        }
    }

    /// Makes the combined gains of the running values of a block.
    #[inline(always)]
    pub(crate) fn finish_each(self, sums: &mut Lanes, branches: usize) {
        match self {
            Self::Best => {}
            Self::EqualGain => sums.iter_mut().for_each(|sum| *sum = Self::EqualGain.finish(*sum, branches)),
            Self::MaximalRatio => sums.iter_mut().for_each(|sum| *sum = Self::MaximalRatio.finish(*sum, branches)),
        }
    }

    /// Makes the combined gain of the running value.
    #[inline]
    pub(crate) fn finish(self, sum: f64, branches: usize) -> f64 {
        match self {
            Self::Best => sum,
            Self::EqualGain => sum / (branches as f64).sqrt(),
            Self::MaximalRatio => sum.sqrt(),
        }
    }
}

/// A receiver; every user has the same.
#[derive(Clone, Debug, PartialEq)]
pub struct Receiver {
    /// The detectors.
    pub branches: Vec<Branch>,
    /// Physical area A_r of one detector in m2.
    pub detector_area_m2: f64,
    /// Gain T_s of the optical filter.
    pub filter_gain: f64,
    /// Refractive index of the optical concentrator, where there is one.
    pub concentrator_index: Option<f64>,
    /// How the branches become one signal.
    pub combining: Combining,
}

impl Receiver {
    /// Gain g of a branch's concentrator within its field of view: n^2 / sin^2(psi_c), or 1 without a concentrator.
    ///
    /// It multiplies the direct and the reflected light alike.
    ///
    /// Source: paper, Table I gives the index and the text names psi_c; the formula is that of an ideal non-imaging
    /// concentrator (Kahn and Barry, Proc. IEEE 85(2), 1997, eq. 12).
    pub fn concentrator_gain(&self, branch: &Branch) -> f64 {
        self.concentrator_index.map_or(1.0, |index| (index / branch.fov_semi_angle.sin()).powi(2))
    }

    /// Refuses a receiver that cannot be.
    pub(crate) fn check(&self) -> Result<(), ChannelError> {
        positive("detector area in m2", self.detector_area_m2)?;
        positive("filter gain", self.filter_gain)?;
        if let Some(index) = self.concentrator_index {
            check(index.is_finite() && index >= 1.0, "concentrator index", index, "finite and at least 1")?;
        }
        if self.branches.is_empty() || self.branches.len() > BRANCHES_MAX {
            return Err(ChannelError::Count {
                things: "branches of the receiver",
                count: self.branches.len(),
                wanted: "1 to 16",
            });
        }
        self.branches.iter().try_for_each(Branch::check)
    }
}

impl Branch {
    /// Smallest cosine of an incidence angle that is detected.
    #[inline]
    pub(crate) fn fov_cosine(&self) -> f64 {
        // The cosine of a rounded pi/2 is 6e-17 and not 0; the gain is the same to that much.
        self.fov_semi_angle.cos()
    }

    fn check(&self) -> Result<(), ChannelError> {
        let length = self.normal.norm();
        check((length - 1.0).abs() < 1e-6, "length of a branch's normal", length, "1")?;
        let fov = self.fov_semi_angle;
        check(
            fov > 0.0 && fov <= std::f64::consts::FRAC_PI_2,
            "field of view (semi-angle) in rad",
            fov,
            "above 0 and at most pi/2",
        )?;
        Ok(())
    }
}
