//! The rows of a comparison, and the text of each figure.

use heliostat_learn::comparison::{Report, Row, Spread};

use super::ORACLE;
use super::differences::Difference;

/// The oracle's row, then those of the policies.
pub fn rows(report: &Report) -> impl Iterator<Item = (&str, &Row)> {
    let policies = report.policies.iter().map(|(name, row)| (name.as_str(), row));
    std::iter::once((ORACLE, &report.oracle)).chain(policies)
}

/// The policy of a row; `None` for the oracle.
pub fn of_policy(name: &str) -> Option<&str> {
    (name != ORACLE).then_some(name)
}

/// The text of a difference, or a dash where there is none.
pub fn difference(found: Option<Spread>, one: &Difference) -> String {
    found.map_or("-".into(), |spread| signed(spread, one.digits))
}

/// Marks an interval that reaches beyond the bounds of its quantity.
pub const CROSSES: &str = "*";

/// The mark of an interval, or nothing.
pub fn mark(spread: Spread) -> &'static str {
    if spread.crosses_bound { CROSSES } else { "" }
}

pub fn ber(spread: Spread) -> String {
    match (spread.mean.is_nan(), spread.ci95.is_nan()) {
        (true, _) => "-".into(),
        (false, true) => format!("{:.2e}", spread.mean),
        (false, false) => format!("{:.2e} ±{:.1e}{}", spread.mean, spread.ci95, mark(spread)),
    }
}

/// A mean with half the width of its interval, or without it where it is missing.
pub fn interval(spread: Spread, digits: usize) -> String {
    if spread.ci95.is_nan() {
        return number(spread.mean, digits);
    }
    format!("{:.digits$} ±{:.digits$}{}", spread.mean, spread.ci95, mark(spread))
}

/// A difference with its sign, and half the width of its interval.
fn signed(spread: Spread, digits: usize) -> String {
    format!("{}{}", if spread.mean >= 0.0 { "+" } else { "" }, interval(spread, digits))
}

/// A number, or a dash for NaN.
pub fn number(value: f64, digits: usize) -> String {
    if value.is_nan() { "-".into() } else { format!("{value:.digits$}") }
}
