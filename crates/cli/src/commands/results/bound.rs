//! Bounds on the figures of a section, and whether they are met.

use anyhow::{Context, Result, ensure};
use serde_json::Value;

use super::table::{ORACLE, Row};

/// A bound that every named row of a section must meet.
#[derive(Clone, Copy, Debug)]
pub struct Bound {
    /// What is promised, in words.
    pub what: &'static str,
    /// The policy whose rows it concerns; empty for all rows.
    pub policy: &'static str,
    /// JSON pointer of the figure within a row.
    pub at: &'static str,
    /// The limit.
    pub limit: Limit,
}

/// On which side of a number a figure must lie.
#[derive(Clone, Copy, Debug)]
pub enum Limit {
    /// This much or more.
    AtLeast(f64),
    /// This much or less.
    AtMost(f64),
    /// The share of `of` (a JSON pointer) that the figure may make at most.
    ShareAtMost(f64, &'static str),
    /// The figure of the oracle's row may exceed this one by so much at most.
    BelowOracleAtMost(f64),
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
    /// Judges the rows of a section.
    ///
    /// # Errors
    /// No row or no figure that the bound concerns.
    pub fn judge(&self, rows: &[Row]) -> Result<Verdict> {
        let figure = |row: &Value, at: &str| row.pointer(at).and_then(Value::as_f64);
        let oracle = rows.iter().find(|(name, _)| name == ORACLE).map(|(_, row)| row);
        let of_row = |row: &Value| {
            let value = figure(row, self.at)?;
            match self.limit {
                Limit::AtLeast(_) | Limit::AtMost(_) => Some(value),
                Limit::ShareAtMost(_, of) => Some(value / figure(row, of)?),
                Limit::BelowOracleAtMost(_) => Some(figure(oracle?, self.at)? - value),
            }
        };
        let concerned = rows.iter().filter(|(name, _)| self.policy.is_empty() || name == self.policy);
        let figures: Option<Vec<f64>> = concerned.map(|(_, row)| of_row(row)).collect();
        let figures = figures.with_context(|| format!("no figure at {} for the bound: {}", self.at, self.what))?;
        ensure!(!figures.is_empty(), "no row for the bound: {}", self.what);
        let (least, most) = figures
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| (least.min(*value), most.max(*value)));
        Ok(match self.limit {
            Limit::AtLeast(limit) => Verdict { worst: least, met: least >= limit },
            Limit::AtMost(limit) | Limit::ShareAtMost(limit, _) | Limit::BelowOracleAtMost(limit) => {
                Verdict { worst: most, met: most <= limit }
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn rows() -> Vec<Row> {
        let row =
            |name: &str, met: f64, late: f64| (name.to_owned(), json!({ "met": met, "late": late, "count": 1000 }));
        vec![row("(oracle)", 0.9, 0.0), row("greedy", 0.88, 2.0), row("flat", 0.4, 0.0), row("flat", 0.5, 1.0)]
    }

    fn judge(policy: &'static str, at: &'static str, limit: Limit) -> Result<Verdict> {
        Bound { what: "a test", policy, at, limit }.judge(&rows())
    }

    #[test]
    fn the_worst_row_decides() {
        let cases = [
            ("flat", "/met", Limit::AtLeast(0.45), 0.4, false),
            ("flat", "/met", Limit::AtLeast(0.4), 0.4, true),
            ("flat", "/met", Limit::AtMost(0.5), 0.5, true),
            ("", "/late", Limit::AtMost(1.0), 2.0, false),
            ("greedy", "/late", Limit::ShareAtMost(0.001, "/count"), 0.002, false),
        ];
        for (policy, at, limit, worst, met) in cases {
            assert_eq!(judge(policy, at, limit).unwrap(), Verdict { worst, met }, "{policy} {at} {limit:?}");
        }
        let below = judge("greedy", "/met", Limit::BelowOracleAtMost(0.03)).unwrap();
        assert!((below.worst - 0.02).abs() < 1e-12 && below.met);
    }

    #[test]
    fn a_bound_on_nothing_is_an_error() {
        assert!(judge("nearest", "/met", Limit::AtLeast(0.0)).is_err());
        assert!(judge("flat", "/absent", Limit::AtLeast(0.0)).is_err());
    }
}
