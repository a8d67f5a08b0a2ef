//! Checks of numbers against their domain: one implementation for all parts of a model.
//!
//! A value that is not a number is outside every domain.
//!
//! ```
//! use heliostat_channel::domain;
//!
//! assert_eq!(domain::positive("optical power in W", 2.0), Ok(2.0));
//! let error = domain::positive("optical power in W", -1.0).unwrap_err();
//! assert_eq!(error.to_string(), "optical power in W is -1: expected a finite number above 0");
//! assert!(domain::finite("gain", f64::NAN).is_err());
//! ```

use crate::error::ChannelError;

/// Accepts a finite number.
///
/// # Errors
/// [`ChannelError::OutOfRange`] for any other value; `quantity` names it, with its unit.
pub fn finite(quantity: &'static str, value: f64) -> Result<f64, ChannelError> {
    require(value.is_finite(), quantity, value, "a finite number")
}

/// Accepts a finite number above 0.
///
/// # Errors
/// [`ChannelError::OutOfRange`] for any other value; `quantity` names it, with its unit.
pub fn positive(quantity: &'static str, value: f64) -> Result<f64, ChannelError> {
    require(value.is_finite() && value > 0.0, quantity, value, "a finite number above 0")
}

/// Accepts a finite number of at least 0.
///
/// # Errors
/// [`ChannelError::OutOfRange`] for any other value; `quantity` names it, with its unit.
pub fn not_negative(quantity: &'static str, value: f64) -> Result<f64, ChannelError> {
    require(value.is_finite() && value >= 0.0, quantity, value, "a finite number of at least 0")
}

/// Accepts the value when the condition holds; the condition must be false for a value that is not
/// a number.
pub(crate) fn require(
    holds: bool,
    quantity: &'static str,
    value: f64,
    expected: &'static str,
) -> Result<f64, ChannelError> {
    if holds { Ok(value) } else { Err(ChannelError::OutOfRange { quantity, value, expected }) }
}
