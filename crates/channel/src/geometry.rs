//! Points and directions in the room, and what can be wrong with them.
//!
//! The room's frame has its origin at the centre of the floor; z points up. Lengths are in m.
//!
//! ```
//! use heliostat_channel::geometry::{self, GeometryError, Vec3};
//!
//! let detector = Vec3::new(1.0, -0.5, 0.85);
//! assert_eq!(geometry::finite_point("the position of a detector", &detector), Ok(()));
//!
//! let unknown = Vec3::new(f64::NAN, 0.0, 0.85);
//! let error = geometry::finite_point("the position of a detector", &unknown).unwrap_err();
//! assert_eq!(error, GeometryError::NotFinite { what: "the position of a detector" });
//! ```

use thiserror::Error;

/// A point in m, or a dimensionless direction, in three dimensions.
pub type Vec3 = nalgebra::Vector3<f64>;

/// Why a gain cannot be computed between two points.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum GeometryError {
    /// Two ends of a path share a point.
    #[error("{what} share a point: expected two points with a distance above 0 m")]
    Coincident {
        /// The two ends.
        what: &'static str,
    },
    /// A coordinate that is infinite or not a number.
    #[error("{what} is not finite: expected three finite coordinates in m")]
    NotFinite {
        /// The point or direction.
        what: &'static str,
    },
    /// A vector or quaternion whose length is not 1.
    #[error("{what} does not have length 1: expected finite components with a sum of squares of 1")]
    NotUnit {
        /// The vector or quaternion.
        what: &'static str,
    },
}

/// Accepts a point whose three coordinates are finite.
///
/// # Errors
/// [`GeometryError::NotFinite`] for any other point; `what` names it in the message.
pub fn finite_point(what: &'static str, point: &Vec3) -> Result<(), GeometryError> {
    if point.iter().all(|coordinate| coordinate.is_finite()) { Ok(()) } else { Err(GeometryError::NotFinite { what }) }
}
