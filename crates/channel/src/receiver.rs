//! The users' receivers: one or several detectors, each with a direction and a field of view.
//!
//! An angle-diversity receiver is a list of branches. Each branch has its own gain, and
//! [`Combining`] reduces the gains to one. All three rules are norms of the vector of branch gains.
//! A combined gain can therefore replace the gain of a single detector in the SINR.
//!
//! ```
//! use heliostat_channel::Combining;
//!
//! let gains = [3e-6, 4e-6];
//! assert_eq!(Combining::Best.combine(&gains), 4e-6);
//! assert!((Combining::MaximalRatio.combine(&gains) - 5e-6).abs() < 1e-18);
//! ```

use serde::{Deserialize, Serialize};

use crate::domain::{positive, require};
use crate::error::ChannelError;
use crate::geometry::Vec3;
use crate::orientation::Orientation;
use crate::trig::Lanes;

/// Largest number of branches of a receiver.
pub const BRANCHES_MAX: usize = heliostat_proto::MAX_BRANCHES;

/// One detector of a receiver.
#[derive(Clone, Debug, PartialEq)]
pub struct Branch {
    /// Unit normal of the detector's surface, in the room's frame, for an upright receiver.
    pub normal: Vec3,
    /// Largest incidence angle that is detected, in radians, within (0, pi/2].
    pub fov_semi_angle: f64,
}

/// How the branches of a receiver are combined; each branch has the same noise variance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Combining {
    /// Selection: H = max H_b, the branch with the highest SINR.
    Best,
    /// Equal gain: H = (sum H_b) / sqrt(branches), since photocurrents and noise variances add.
    EqualGain,
    /// Maximal ratio: H = sqrt(sum H_b^2), since photocurrents are weighted by their gains and the
    /// SINRs add.
    MaximalRatio,
}

impl Combining {
    /// Gain of the single detector that has the same SINR as the combined receiver; see the
    /// variants for the equations.
    ///
    /// Shape of `gains`: B, one per branch. Units: dimensionless.
    #[inline]
    pub fn combine(self, gains: &[f64]) -> f64 {
        if let [only] = gains {
            return *only;
        }
        self.finish(gains.iter().fold(0.0, |sum, gain| self.add(sum, *gain)), gains.len())
    }

    /// Adds one branch to a running value that starts at zero.
    #[inline]
    pub(crate) fn add(self, sum: f64, gain: f64) -> f64 {
        match self {
            Self::Best => sum.max(gain),
            Self::EqualGain => sum + gain,
            Self::MaximalRatio => sum + gain * gain,
        }
    }

    /// Adds one branch to the running values of a block of mirrors.
    ///
    /// The match is outside the loops, so that each loop can be vectorised.
    #[inline(always)]
    pub(crate) fn add_each(self, sums: &mut Lanes, gains: &Lanes) {
        let both = sums.iter_mut().zip(gains);
        match self {
            Self::Best => both.for_each(|(sum, gain)| *sum = Self::Best.add(*sum, *gain)),
            Self::EqualGain => both.for_each(|(sum, gain)| *sum = Self::EqualGain.add(*sum, *gain)),
            Self::MaximalRatio => both.for_each(|(sum, gain)| *sum = Self::MaximalRatio.add(*sum, *gain)),
        }
    }

    /// Converts the running values of a block to combined gains.
    #[inline(always)]
    pub(crate) fn finish_each(self, sums: &mut Lanes, branches: usize) {
        match self {
            Self::Best => {}
            Self::EqualGain => sums.iter_mut().for_each(|sum| *sum = Self::EqualGain.finish(*sum, branches)),
            Self::MaximalRatio => sums.iter_mut().for_each(|sum| *sum = Self::MaximalRatio.finish(*sum, branches)),
        }
    }

    /// Converts a running value to the combined gain.
    #[inline]
    pub(crate) fn finish(self, sum: f64, branches: usize) -> f64 {
        match self {
            Self::Best => sum,
            Self::EqualGain => sum / (branches as f64).sqrt(),
            Self::MaximalRatio => sum.sqrt(),
        }
    }
}

/// A receiver; all users have the same one, each in an [`Orientation`] of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct Receiver {
    /// The branches: at least 1, at most [`BRANCHES_MAX`].
    pub branches: Vec<Branch>,
    /// Physical area A_r of one detector in m2, above 0.
    pub detector_area_m2: f64,
    /// Gain T_s of the optical filter, dimensionless, above 0.
    pub filter_gain: f64,
    /// Refractive index n_c of the optical concentrator, at least 1; `None` without a concentrator.
    pub concentrator_index: Option<f64>,
    /// How the branches are combined.
    pub combining: Combining,
}

impl Receiver {
    /// Gain of a branch's optical concentrator within the field of view.
    ///
    /// g = n_c^2 / sin^2(fov_semi_angle), or 1 without a concentrator. It applies to direct and
    /// reflected light.
    ///
    /// Source: the index is in the paper's Table I; the equation is that of an ideal non-imaging
    /// concentrator (Kahn and Barry, Proc. IEEE 85(2), 1997, eq. 12).
    /// Units: dimensionless.
    pub fn concentrator_gain(&self, branch: &Branch) -> f64 {
        self.concentrator_index.map_or(1.0, |index| (index / branch.fov_semi_angle.sin()).powi(2))
    }

    /// The receiver of a user who holds it like this: the normals of all branches are turned.
    pub fn turned(&self, orientation: &Orientation) -> Self {
        let mut turned = self.clone();
        for branch in &mut turned.branches {
            branch.normal = orientation.turn(&branch.normal);
        }
        turned
    }

    /// Refuses a value outside its domain.
    pub(crate) fn check(&self) -> Result<(), ChannelError> {
        positive("detector area in m2", self.detector_area_m2)?;
        positive("filter gain", self.filter_gain)?;
        if let Some(index) = self.concentrator_index {
            require(index.is_finite() && index >= 1.0, "concentrator index", index, "a finite number of at least 1")?;
        }
        if self.branches.is_empty() || self.branches.len() > BRANCHES_MAX {
            return Err(ChannelError::Count {
                things: "branches of the receiver",
                count: self.branches.len(),
                expected: "1 to 16",
            });
        }
        self.branches.iter().try_for_each(Branch::check)
    }
}

impl Branch {
    /// Smallest incidence cosine that is detected.
    #[inline]
    pub(crate) fn fov_cosine(&self) -> f64 {
        // The cosine of the rounded pi/2 is 6e-17 and not 0, which changes a gain by no more than
        // that.
        self.fov_semi_angle.cos()
    }

    fn check(&self) -> Result<(), ChannelError> {
        let length = self.normal.norm();
        require((length - 1.0).abs() < 1e-6, "length of a branch's normal", length, "1")?;
        let fov = self.fov_semi_angle;
        require(
            fov > 0.0 && fov <= std::f64::consts::FRAC_PI_2,
            "field of view (semi-angle) in rad",
            fov,
            "a number above 0 and at most pi/2",
        )?;
        Ok(())
    }
}
