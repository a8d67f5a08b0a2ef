//! What can be wrong with a model or a geometry, with the value that was found and the one that was wanted.

use thiserror::Error;

/// Why a [`ChannelModel`](crate::ChannelModel) or one of its parts cannot be built.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ChannelError {
    /// A number outside its domain.
    #[error("{quantity} is {value}, but must be {wanted}")]
    OutOfRange {
        /// What the number stands for, with its unit.
        quantity: &'static str,
        /// The number that was given.
        value: f64,
        /// The domain, in words.
        wanted: &'static str,
    },
    /// Too few or too many of something.
    #[error("there are {count} {things}, but there must be {wanted}")]
    Count {
        /// What is counted.
        things: &'static str,
        /// How many were given.
        count: usize,
        /// How many are allowed, in words.
        wanted: &'static str,
    },
    /// An LED that the array cannot face.
    #[error("LED {led} is {distance_m} m in front of the mirror wall, but must be more than 0 m")]
    LedBehindWall {
        /// Index of the LED.
        led: usize,
        /// Its distance from the wall's plane, negative behind it, in m.
        distance_m: f64,
    },
}

/// Why a gain cannot be computed between two points.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum GeometryError {
    /// Two ends of a path share a point.
    #[error("{what} share a point, but a path needs a length")]
    Coincident {
        /// The two ends.
        what: &'static str,
    },
    /// A coordinate that is not a number.
    #[error("{what} is not finite")]
    NotFinite {
        /// The point or direction.
        what: &'static str,
    },
    /// A direction without a length.
    #[error("{what} has length {length}, but must have length 1")]
    NotUnit {
        /// The direction.
        what: &'static str,
        /// Its length.
        length: f64,
    },
}

/// Refuses a value that is not finite and positive.
pub(crate) fn positive(quantity: &'static str, value: f64) -> Result<f64, ChannelError> {
    check(value.is_finite() && value > 0.0, quantity, value, "finite and positive")
}

/// Refuses a value that is negative or not finite.
pub(crate) fn not_negative(quantity: &'static str, value: f64) -> Result<f64, ChannelError> {
    check(value.is_finite() && value >= 0.0, quantity, value, "finite and not negative")
}

/// Refuses a value that is not finite.
pub(crate) fn finite(quantity: &'static str, value: f64) -> Result<f64, ChannelError> {
    check(value.is_finite(), quantity, value, "finite")
}

/// Refuses the value unless the condition holds; the condition must be false for a value that is not a number.
pub(crate) fn check(
    holds: bool,
    quantity: &'static str,
    value: f64,
    wanted: &'static str,
) -> Result<f64, ChannelError> {
    if holds { Ok(value) } else { Err(ChannelError::OutOfRange { quantity, value, wanted }) }
}
