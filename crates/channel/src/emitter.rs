//! The LED panels on the ceiling.
//!
//! A panel faces straight down and radiates with a generalised Lambertian pattern. A panel of
//! finite size is replaced by equal points at the centres of a square grid of cells. This is the
//! midpoint rule: it is of second order and symmetric, and no point lies on the edge of the panel.
//!
//! ```
//! use heliostat_channel::{Led, geometry::Vec3};
//!
//! let led = Led {
//!     position: Vec3::new(0.0, 0.0, 3.0),
//!     side_m: 0.1,
//!     points_per_side: 5,
//!     half_power_semi_angle: 60.0_f64.to_radians(),
//! };
//! assert_eq!(led.lambertian_order(), 1.0);
//! assert_eq!(led.points().len(), 25);
//! ```

use crate::domain::{finite, not_negative, require};
use crate::error::ChannelError;
use crate::geometry::Vec3;

/// Largest number of points along the side of a panel.
pub const POINTS_PER_SIDE_MAX: usize = 64;

/// An LED: a square panel that faces down, and an access point of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct Led {
    /// Centre of the panel in m.
    pub position: Vec3,
    /// Side of the square in m, parallel to the room's axes; 0 is a point source.
    pub side_m: f64,
    /// Number of points along each side over which the panel is averaged; ignored when `side_m` is
    /// 0.
    pub points_per_side: usize,
    /// Angle from the axis at which the radiant intensity is half of its maximum, in radians,
    /// within (0, pi/2).
    pub half_power_semi_angle: f64,
}

impl Led {
    /// Order n of the Lambertian pattern cos^n(irradiance).
    ///
    /// n = -ln 2 / ln cos(half-power semi-angle), for a semi-angle within (0, pi/2). 60 degrees is
    /// order 1; the rounding of that angle's cosine is removed, so that the order is exactly 1.
    ///
    /// Source: paper, below eq. (1).
    /// Units: dimensionless.
    pub fn lambertian_order(&self) -> f64 {
        let order = -std::f64::consts::LN_2 / self.half_power_semi_angle.cos().ln();
        if (order - 1.0).abs() < 1e-12 { 1.0 } else { order }
    }

    /// The points that represent the panel; each carries an equal share of the power.
    ///
    /// Shape: points_per_side^2, or 1 for a point source. Units: m.
    pub fn points(&self) -> Vec<Vec3> {
        if self.side_m == 0.0 {
            return vec![self.position];
        }
        let cell = self.side_m / self.points_per_side as f64;
        let offset = |index: usize| (index as f64 + 0.5) * cell - 0.5 * self.side_m;
        let row =
            |iy: usize| (0..self.points_per_side).map(move |ix| self.position + Vec3::new(offset(ix), offset(iy), 0.0));
        (0..self.points_per_side).flat_map(row).collect()
    }

    /// Refuses a value outside its domain.
    pub(crate) fn check(&self) -> Result<(), ChannelError> {
        for coordinate in self.position.iter() {
            finite("coordinate of an LED in m", *coordinate)?;
        }
        not_negative("side of an LED panel in m", self.side_m)?;
        let angle = self.half_power_semi_angle;
        require(
            angle > 0.0 && angle < std::f64::consts::FRAC_PI_2,
            "half-power semi-angle of an LED in rad",
            angle,
            "a number above 0 and below pi/2",
        )?;
        if self.points_per_side == 0 || self.points_per_side > POINTS_PER_SIDE_MAX {
            return Err(ChannelError::Count {
                things: "points along the side of an LED panel",
                count: self.points_per_side,
                expected: "1 to 64",
            });
        }
        Ok(())
    }
}

/// cos^n(irradiance) for a cosine that is not negative.
#[inline]
pub(crate) fn lambertian(cosine: f64, order: f64) -> f64 {
    if order == 1.0 { cosine } else { cosine.powf(order) }
}
