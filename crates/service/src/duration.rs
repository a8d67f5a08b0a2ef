//! Durations on the command line: one rule for every flag that takes seconds.

use std::time::Duration;

use thiserror::Error;

/// Shortest duration that a flag accepts, in s.
pub const MIN_S: f64 = 0.01;
/// Longest duration that a flag accepts, in s; some 116 days.
pub const MAX_S: f64 = 1e7;

/// A text that is no duration, or one out of range.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "invalid duration \"{0}\": expected seconds between {MIN_S} and {MAX_S}, for example 2.5, 2.5s, 500ms or 10min"
)]
pub struct DurationError(String);

/// Units that may follow the number, and their length in s. `s` is last: it ends `ms` too.
const UNITS: [(&str, f64); 4] = [("ms", 1e-3), ("min", 60.0), ("h", 3600.0), ("s", 1.0)];

/// Reads a number of seconds between [`MIN_S`] and [`MAX_S`], or of another unit that follows it: `ms`,
/// `s`, `min` or `h`. For `value_parser` of a flag.
///
/// ```
/// use heliostat_service::duration::seconds;
/// use std::time::Duration;
///
/// assert_eq!(seconds("2.5"), Ok(Duration::from_millis(2500)));
/// assert_eq!(seconds("3s"), Ok(Duration::from_secs(3)));
/// let error = seconds("x").unwrap_err().to_string();
/// assert_eq!(error, "invalid duration \"x\": expected seconds between 0.01 and 10000000, for example 2.5, 2.5s, 500ms or 10min");
/// ```
///
/// # Errors
/// [`DurationError`] for anything else.
pub fn seconds(text: &str) -> Result<Duration, DurationError> {
    let with_unit = UNITS.iter().find_map(|(unit, length_s)| Some((text.strip_suffix(unit)?, *length_s)));
    let (number, length_s) = with_unit.unwrap_or((text, 1.0));
    let value = number.parse().ok().map(|number: f64| number * length_s);
    let value = value.filter(|value| (MIN_S..=MAX_S).contains(value));
    value.map(Duration::from_secs_f64).ok_or_else(|| DurationError(text.to_owned()))
}

/// A duration for a message, in seconds: with three decimals at most below 1 s, and with one at most from there on.
///
/// ```
/// use heliostat_service::duration::in_seconds;
/// use std::time::Duration;
///
/// assert_eq!(in_seconds(Duration::from_nanos(3_485_468_733)), "3.5 s");
/// assert_eq!(in_seconds(Duration::from_secs(5)), "5 s");
/// assert_eq!(in_seconds(Duration::from_millis(250)), "0.25 s");
/// ```
pub fn in_seconds(duration: Duration) -> String {
    let steps_per_s = if duration < Duration::from_secs(1) { 1e3 } else { 10.0 };
    format!("{} s", (duration.as_secs_f64() * steps_per_s).round() / steps_per_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_seconds_in_range_are_durations() {
        assert_eq!(seconds("0.01"), Ok(Duration::from_millis(10)));
        assert_eq!(seconds("1e7"), Ok(Duration::from_secs(10_000_000)));
        for (text, expected_ms) in [("3s", 3000), ("500ms", 500), ("2min", 120_000), ("1.5h", 5_400_000)] {
            assert_eq!(seconds(text), Ok(Duration::from_millis(expected_ms)), "{text}");
        }
        for wrong in [
            "", "x", "-1", "0", "0.009", "10000001", "nan", "inf", "-inf", "1 s", "1,5", "s", "ms", "5ms", "3000h",
            "3m", "1d", "-3s", "infs",
        ] {
            assert_eq!(seconds(wrong), Err(DurationError(wrong.to_owned())));
        }
    }
}
