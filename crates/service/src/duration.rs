//! Durations on the command line: one rule for every flag that takes seconds.

use std::time::Duration;

use thiserror::Error;

/// Shortest duration that a flag accepts, in s.
pub const MIN_S: f64 = 0.01;
/// Longest duration that a flag accepts, in s; some 116 days.
pub const MAX_S: f64 = 1e7;

/// A text that is no duration, or one out of range.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("invalid duration \"{0}\": expected seconds between {MIN_S} and {MAX_S}, for example 2.5")]
pub struct DurationError(String);

/// Reads a number of seconds between [`MIN_S`] and [`MAX_S`]. For `value_parser` of a flag.
///
/// ```
/// use heliostat_service::duration::seconds;
/// use std::time::Duration;
///
/// assert_eq!(seconds("2.5"), Ok(Duration::from_millis(2500)));
/// let error = seconds("x").unwrap_err().to_string();
/// assert_eq!(error, "invalid duration \"x\": expected seconds between 0.01 and 10000000, for example 2.5");
/// ```
///
/// # Errors
/// [`DurationError`] for anything else.
pub fn seconds(text: &str) -> Result<Duration, DurationError> {
    let value = text.parse().ok().filter(|value| (MIN_S..=MAX_S).contains(value));
    value.map(Duration::from_secs_f64).ok_or_else(|| DurationError(text.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_seconds_in_range_are_durations() {
        assert_eq!(seconds("0.01"), Ok(Duration::from_millis(10)));
        assert_eq!(seconds("1e7"), Ok(Duration::from_secs(10_000_000)));
        for wrong in ["", "x", "-1", "0", "0.009", "10000001", "nan", "inf", "-inf", "1 s", "1,5"] {
            assert_eq!(seconds(wrong), Err(DurationError(wrong.to_owned())));
        }
    }
}
