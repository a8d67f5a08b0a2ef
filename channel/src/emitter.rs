//! The LED panels on the ceiling: where light starts.
//!
//! A panel faces straight down and radiates with a generalised Lambertian pattern. A panel of finite size is replaced by
//! equal points at the centres of a square grid of cells (the midpoint rule: second order, symmetric, and no point lies
//! on the edge, where half of its cell would be outside the panel).

use crate::Vec3;
use crate::error::{ChannelError, check, finite, not_negative};

/// Most points along the side of a panel.
pub const POINTS_PER_SIDE_MAX: usize = 64;

/// One access point: a square LED panel that faces down.
#[derive(Clone, Debug, PartialEq)]
pub struct Led {
    /// Centre of the panel in m.
    pub position: Vec3,
    /// Side of the square in m, parallel to the room's axes; 0 is a point.
    pub side_m: f64,
    /// The panel is averaged over this many points along each side; 1 where `side_m` is 0.
    pub points_per_side: usize,
    /// Angle from the axis at which the radiant intensity has fallen to one half, in radians.
    pub half_power_semi_angle: f64,
}

impl Led {
    /// Order n of the Lambertian pattern cos^n: n = -ln 2 / ln cos(half-power semi-angle), dimensionless.
    ///
    /// 60 degrees is order 1; the rounding of that angle's cosine is removed, so the order is 1 exactly.
    ///
    /// Source: paper, below eq. (1).
    pub fn lambertian_order(&self) -> f64 {
        let order = -std::f64::consts::LN_2 / self.half_power_semi_angle.cos().ln();
        if (order - 1.0).abs() < 1e-12 { 1.0 } else { order }
    }

    /// The points, in m, that stand for the panel; each carries an equal share of the power. Shape: points_per_side^2,
    /// or 1 for a point LED.
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

    /// Refuses a panel that cannot be.
    pub(crate) fn check(&self) -> Result<(), ChannelError> {
        for coordinate in self.position.iter() {
            finite("coordinate of an LED in m", *coordinate)?;
        }
        not_negative("side of an LED panel in m", self.side_m)?;
        let angle = self.half_power_semi_angle;
        check(
            angle > 0.0 && angle < std::f64::consts::FRAC_PI_2,
            "half-power semi-angle of an LED in rad",
            angle,
            "between 0 and pi/2, both excluded",
        )?;
        if self.points_per_side == 0 || self.points_per_side > POINTS_PER_SIDE_MAX {
            return Err(ChannelError::Count {
                things: "points along the side of an LED panel",
                count: self.points_per_side,
                wanted: "1 to 64",
            });
        }
        Ok(())
    }
}

/// cos^n of an irradiance angle for a cosine that is not negative.
#[inline]
pub(crate) fn lambertian(cosine: f64, order: f64) -> f64 {
    if order == 1.0 { cosine } else { cosine.powf(order) }
}
