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
        let figures = concerned.map(|(_, row)| of_row(row)).collect::<Result<Vec<f64>>>()?;
        ensure!(!figures.is_empty(), "{}", missing("row", self.row.as_deref().unwrap_or("of any name")));
        Ok(match (self.at_least, self.at_most) {
            (Some(limit), _) => {
                let least = figures.iter().copied().fold(f64::INFINITY, f64::min);
                Verdict { worst: least, met: least >= limit }
            }
            (None, limit) => {
                let most = figures.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                Verdict { worst: most, met: limit.is_some_and(|limit| most <= limit) }
            }
        })
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
            assert_eq!(judge(bound).unwrap(), Verdict { worst, met }, "{bound}");
        }
        let below = judge("row = \"greedy\"\nat = \"/met\"\nbelow = \"(oracle)\"\nat_most = 0.03").unwrap();
        assert!((below.worst - 0.02).abs() < 1e-12 && below.met);
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
