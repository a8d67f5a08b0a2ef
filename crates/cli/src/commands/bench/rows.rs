//! The output of the latency benchmarks: rows with a measured distribution beside a reference of
//! the same run.

use std::collections::BTreeMap;
use std::io;
use std::time::Duration;

use hdrhistogram::Histogram;
use heliostat_controller::report::stage_times::{empty_ns, quantiles_us};
use heliostat_proto::Quantiles;
use serde::Serialize;

use heliostat_service::{clock::as_ns, outln};

use super::usage::ReportUsage;

/// A histogram of times.
pub struct Times(Histogram<u64>);

impl Default for Times {
    fn default() -> Self {
        Self::new()
    }
}

impl Times {
    /// An empty histogram with all its memory.
    pub fn new() -> Self {
        Self(empty_ns())
    }

    /// Adds a time.
    pub fn record(&mut self, time: Duration) {
        self.0.saturating_record(as_ns(time).max(1));
    }

    /// Number of times longer than a limit; exact to the histogram's three digits.
    pub fn over(&self, limit: Duration) -> u64 {
        self.0.len() - self.0.count_between(0, limit.as_nanos() as u64)
    }

    /// Number of times.
    pub fn count(&self) -> u64 {
        self.0.len()
    }

    /// Their distribution.
    pub fn distribution(&self) -> Distribution {
        quantiles_us(&self.0).into()
    }
}

/// A distribution of times in us.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Distribution {
    /// The median.
    pub p50: f64,
    p90: f64,
    /// The 99th percentile.
    pub p99: f64,
    p999: f64,
    max: f64,
}

impl From<Quantiles> for Distribution {
    fn from(Quantiles { p50, p90, p99, p999, max, .. }: Quantiles) -> Self {
        Self { p50, p90, p99, p999, max }
    }
}

/// What was varied.
#[derive(Clone, Debug, Serialize)]
pub struct Varied {
    /// Reports a second and room; null if each report follows immediately after the previous
    /// answer.
    pub hz: Option<f64>,
    /// Number of mirrors.
    pub mirrors: usize,
    /// Number of users.
    pub users: usize,
    /// Rooms served by the controllers.
    pub rooms: usize,
    /// Controller processes that share the rooms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub controllers: Option<usize>,
    /// The policy.
    pub policy: String,
    /// The inference engine of a learned policy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub engine: Option<String>,
}

/// One line of a benchmark.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    #[serde(flatten)]
    varied: Varied,
    measured_us: Distribution,
    reference_us: Distribution,
    ratio_p50: f64,
    ratio_p99: f64,
    /// Number of measured times above 0.5 ms.
    over_budget: u64,
    /// Decisions of more than 0.5 ms, by their longest stage.
    over_budget_by: BTreeMap<String, u64>,
    count: u64,
    /// Reports that got no command of their own.
    lost: u64,
    /// Medians of the stages of a decision, in us.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    stages_p50_us: BTreeMap<String, f64>,
    /// For `loop` and `rooms`: the decision within the loop, from the callback to the return of the
    /// put.
    #[serde(skip_serializing_if = "Option::is_none")]
    decision_us: Option<Distribution>,
    /// For `loop` and `rooms`: what one report uses.
    #[serde(skip_serializing_if = "Option::is_none")]
    used_a_report: Option<ReportUsage>,
}

impl Row {
    /// A row; `over_budget_by` holds the decisions of more than 0.5 ms by their longest stage.
    pub fn new(varied: Varied, (measured, over_budget, count): (Distribution, u64, u64), reference: &Times) -> Self {
        let reference = reference.distribution();
        Self {
            varied,
            measured_us: measured,
            reference_us: reference,
            ratio_p50: measured.p50 / reference.p50,
            ratio_p99: measured.p99 / reference.p99,
            over_budget,
            over_budget_by: BTreeMap::new(),
            stages_p50_us: BTreeMap::new(),
            count,
            lost: 0,
            decision_us: None,
            used_a_report: None,
        }
    }

    /// Adds the decisions over budget by stage, and the median of each stage.
    #[must_use]
    pub fn by_stage(mut self, over_budget_by: BTreeMap<String, u64>, stages: &BTreeMap<String, Quantiles>) -> Self {
        self.over_budget_by = over_budget_by;
        self.stages_p50_us = stages.iter().map(|(stage, times)| (stage.clone(), times.p50)).collect();
        self
    }

    /// Adds the figures that only `loop` and `rooms` have.
    #[must_use]
    pub fn across_processes(mut self, lost: u64, decision: Quantiles, used: ReportUsage) -> Self {
        self.lost = lost;
        self.used_a_report = Some(used);
        self.decision_us = Some(decision.into());
        self
    }
}

/// Collects rows; prints each when it is added, or all as one JSON object at the end.
pub struct Table {
    json: bool,
    rows: Vec<Row>,
}

impl Table {
    /// An empty table; prints `title` and the heading unless the output is JSON.
    pub fn new(json: bool, title: &str) -> io::Result<Self> {
        if !json {
            outln!("{title}; times in us")?;
            outln!(
                "{:>7}{:>8}{:>6}{:>6}  {:<13}{:<7}{:>9}{:>9}{:>9}{:>9}{:>9} |{:>9}{:>9} |{:>7}{:>7} |{:>8}{:>8}",
                "hz",
                "mirrors",
                "users",
                "rooms",
                "policy",
                "engine",
                "p50",
                "p90",
                "p99",
                "p99.9",
                "max",
                "ref p50",
                "ref p99",
                "x p50",
                "x p99",
                "count",
                ">500us"
            )?;
        }
        Ok(Self { json, rows: Vec::new() })
    }

    /// Adds a row.
    pub fn add(&mut self, row: Row) -> io::Result<()> {
        if !self.json {
            let Varied { hz, mirrors, users, rooms, policy, engine, .. } = &row.varied;
            let engine = engine.as_deref().unwrap_or("-");
            let hz = hz.map_or("unpaced".to_string(), |hz| hz.to_string());
            let (took, reference) = (&row.measured_us, &row.reference_us);
            let by_stage: String =
                row.over_budget_by.iter().map(|(stage, count)| format!(" {stage} {count}")).collect();
            let stages: String = row.stages_p50_us.iter().map(|(stage, p50)| format!(" {stage} {p50:.0}")).collect();
            let lost = if row.lost > 0 { format!(" lost {}", row.lost) } else { String::new() };
            let decision = row.decision_us.map_or(String::new(), |decision| {
                format!("  (decision p50 {:.0} p99 {:.0})", decision.p50, decision.p99)
            });
            let used = row.used_a_report.map_or(String::new(), |used| {
                let ReportUsage { controller_us, router_us, loopback_bytes } = used;
                format!(
                    "  (a report: controller {controller_us:.0} us, router {router_us:.0} us, {loopback_bytes:.0} B)"
                )
            });
            outln!(
                "{hz:>7}{mirrors:>8}{users:>6}{rooms:>6}  {policy:<13}{engine:<7}{:>9.1}{:>9.1}{:>9.1}{:>9.1}{:>9.1} |{:>9.1}{:>9.1} |{:>7.2}{:>7.2} |{:>8}{:>8}{by_stage}{lost}{decision}{used}  [{}]",
                took.p50,
                took.p90,
                took.p99,
                took.p999,
                took.max,
                reference.p50,
                reference.p99,
                row.ratio_p50,
                row.ratio_p99,
                row.count,
                row.over_budget,
                stages.trim_start(),
            )?;
        }
        self.rows.push(row);
        Ok(())
    }

    /// Prints the JSON object, if the output is JSON.
    pub fn finish(self) -> io::Result<()> {
        if self.json {
            outln!("{}", serde_json::json!({ "rows": self.rows }))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn over_counts_longer_times_only() {
        let mut times = Times::new();
        for us in [100, 499, 501, 3000] {
            times.record(Duration::from_micros(us));
        }
        assert_eq!((times.over(Duration::from_micros(500)), times.count()), (2, 4));
    }

    #[test]
    fn a_row_has_the_documented_json_names() {
        let mut times = Times::new();
        times.record(Duration::from_micros(50));
        let varied = Varied {
            hz: None,
            mirrors: 100,
            users: 5,
            rooms: 1,
            policy: "flat".into(),
            controllers: None,
            engine: None,
        };
        let row = Row::new(varied, (times.distribution(), 0, 1), &times);
        let json = serde_json::to_value(&row).unwrap();
        for name in ["hz", "mirrors", "users", "rooms", "policy", "over_budget", "count", "ratio_p50", "ratio_p99"] {
            assert!(json.get(name).is_some(), "{name}: {json}");
        }
        for part in ["measured_us", "reference_us"] {
            for name in ["p50", "p90", "p99", "p999", "max"] {
                assert!(json[part][name].as_f64() > Some(0.0), "{part}.{name}: {json}");
            }
        }
        assert_eq!(json["ratio_p50"].as_f64(), Some(1.0));
    }
}
