//! Bounds on the figures of a section, and whether they are met.

use anyhow::{Context, Result, ensure};
use serde::Deserialize;
use serde_json::Value;

use super::table::{Row, nearest};

/// A bound that every named row of a section must meet.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bound {
    /// What is promised, in words.
    pub what: String,
    /// JSON pointer of the rows; without it, those of the section's first table.
    pub rows: Option<String>,
    /// The name of the row that it concerns; without it, all rows.
    pub row: Option<String>,
    /// JSON pointer of the figure within a row.
    pub at: String,
    /// JSON pointer of the figure that it is a share of.
    pub share_of: Option<String>,
    /// The name of the row from whose figure it is subtracted.
    pub below: Option<String>,
    /// The lower limit.
    pub at_least: Option<f64>,
    /// The upper limit.
    pub at_most: Option<f64>,
}

/// How a bound came out.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// The figure that is nearest to the limit, or farthest beyond it.
    pub worst: f64,
    /// Whether every row is within the limit.
    pub met: bool,
    /// Whether the 95 % interval of that figure contains the limit.
    pub open: bool,
}

/// Ends a verdict whose interval contains the limit.
pub const OPEN: &str = "open within the interval";

impl Verdict {
    /// The verdict in words.
    pub fn words(&self) -> String {
        let met = if self.met { "met" } else { "not met" };
        if self.open { format!("{met}, {OPEN}") } else { met.to_owned() }
    }
}

impl Bound {
    /// Refuses a bound without one limit.
    pub fn check(&self) -> Result<()> {
        let limits = [self.at_least, self.at_most].iter().flatten().count();
        ensure!(limits == 1, "bound \"{}\": expected either at_least or at_most", self.what);
        Ok(())
    }

    /// Judges the rows of a section.
    ///
    /// # Errors
    /// No row or no figure that the bound concerns.
    pub fn judge(&self, rows: &[Row]) -> Result<Verdict> {
        let missing = |what: &str, at: &str| format!("no {what} {at} for the bound: {}", self.what);
        let figure = |row: &Value, at: &str| {
            let value = row.pointer(at).and_then(Value::as_f64);
            value.with_context(|| format!("{}; {}", missing("figure at", at), nearest(std::iter::once(row), at)))
        };
        let half_width = |row: &Value| {
            // That of a quotient, or of a difference between two rows, does not follow from theirs.
            let is_own = self.share_of.is_none() && self.below.is_none();
            let at = self.at.strip_suffix("/mean").filter(|_| is_own)?;
            row.pointer(&format!("{at}/ci95"))?.as_f64()
        };
        let of_row = |row: &Value| -> Result<f64> {
            let mut value = figure(row, &self.at)?;
            if let Some(of) = &self.share_of {
                value /= figure(row, of)?;
            }
            if let Some(name) = &self.below {
                let other = rows.iter().find(|(other, _)| other == name);
                value = figure(&other.with_context(|| missing("row", name))?.1, &self.at)? - value;
            }
            Ok(value)
        };
        let concerned = rows.iter().filter(|(name, _)| self.row.as_ref().is_none_or(|row| row == name));
        let found = concerned.map(|(_, row)| of_row(row).map(|figure| (figure, half_width(row))));
        let found = found.collect::<Result<Vec<(f64, Option<f64>)>>>()?;
        ensure!(!found.is_empty(), "{}", missing("row", self.row.as_deref().unwrap_or("of any name")));
        let figures = found.iter().map(|(figure, _)| *figure);
        let (worst, met, limit) = match (self.at_least, self.at_most) {
            (Some(limit), _) => {
                let least = figures.fold(f64::INFINITY, f64::min);
                (least, least >= limit, Some(limit))
            }
            (None, limit) => {
                let most = figures.fold(f64::NEG_INFINITY, f64::max);
                (most, limit.is_some_and(|limit| most <= limit), limit)
            }
        };
        let half = found.iter().find(|(figure, _)| *figure == worst).and_then(|(_, half)| *half);
        let open = limit.zip(half).is_some_and(|(limit, half)| (worst - limit).abs() <= half);
        Ok(Verdict { worst, met, open })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn judge(bound: &str) -> Result<Verdict> {
        let row =
            |name: &str, met: f64, late: f64| (name.to_owned(), json!({ "met": met, "late": late, "count": 1000 }));
        let rows = [row("(oracle)", 0.9, 0.0), row("greedy", 0.88, 2.0), row("flat", 0.4, 0.0), row("flat", 0.5, 1.0)];
        let bound: Bound = toml::from_str(&format!("what = \"a test\"\n{bound}")).expect("a bound");
        bound.check().and_then(|()| bound.judge(&rows))
    }

    #[test]
    fn the_worst_row_decides() {
        for (bound, worst, met) in [
            ("row = \"flat\"\nat = \"/met\"\nat_least = 0.45", 0.4, false),
            ("row = \"flat\"\nat = \"/met\"\nat_least = 0.4", 0.4, true),
            ("row = \"flat\"\nat = \"/met\"\nat_most = 0.5", 0.5, true),
            ("at = \"/late\"\nat_most = 1", 2.0, false),
            ("row = \"greedy\"\nat = \"/late\"\nshare_of = \"/count\"\nat_most = 0.001", 0.002, false),
        ] {
            assert_eq!(judge(bound).unwrap(), Verdict { worst, met, open: false }, "{bound}");
        }
        let below = judge("row = \"greedy\"\nat = \"/met\"\nbelow = \"(oracle)\"\nat_most = 0.03").unwrap();
        assert!((below.worst - 0.02).abs() < 1e-12 && below.met);
    }

    #[test]
    fn a_limit_within_the_interval_of_the_figure_is_open() {
        let row =
            json!({ "qos": { "mean": 0.877, "ci95": 0.017 }, "alone": { "mean": 0.877, "ci95": null }, "count": 1 });
        let rows = [("greedy".to_owned(), row), ("flat".to_owned(), json!({ "qos": { "mean": 0.5, "ci95": 0.1 } }))];
        for (bound, expected) in [
            ("at = \"/qos/mean\"\nat_least = 0.878", "not met, open within the interval"),
            ("at = \"/qos/mean\"\nat_least = 0.87", "met, open within the interval"),
            ("at = \"/qos/mean\"\nat_most = 0.88", "met, open within the interval"),
            ("at = \"/qos/mean\"\nat_least = 0.85", "met"),
            ("at = \"/qos/mean\"\nat_least = 0.9", "not met"),
            ("at = \"/qos/ci95\"\nat_most = 0.01", "not met"),
            ("at = \"/alone/mean\"\nat_least = 0.878", "not met"),
            ("at = \"/qos/mean\"\nshare_of = \"/count\"\nat_least = 0.878", "not met"),
            ("at = \"/qos/mean\"\nbelow = \"flat\"\nat_most = -0.38", "not met"),
        ] {
            let bound: Bound =
                toml::from_str(&format!("what = \"a test\"\nrow = \"greedy\"\n{bound}")).expect("a bound");
            assert_eq!(bound.judge(&rows).expect("a verdict").words(), expected, "{bound:?}");
        }
    }

    #[test]
    fn a_bound_on_nothing_or_without_one_limit_is_an_error() {
        for bound in [
            "row = \"nearest\"\nat = \"/met\"\nat_least = 0",
            "row = \"flat\"\nat = \"/absent\"\nat_least = 0",
            "at = \"/met\"",
            "at = \"/met\"\nat_least = 0\nat_most = 1",
        ] {
            assert!(judge(bound).is_err(), "{bound}");
        }
        let refused = judge("row = \"flat\"\nat = \"/mett\"\nat_least = 0").expect_err("no such figure").to_string();
        assert_eq!(refused, "no figure at /mett for the bound: a test; a row has count, late, met");
    }
}
