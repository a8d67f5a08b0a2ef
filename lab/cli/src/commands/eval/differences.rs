//! The figures of a policy minus those of the first one, for tables, files and plots.

use heliostat_learn::comparison::{Report, Row, Spread};

/// A paired difference.
pub struct Difference {
    /// Its name in JSON and in CSV files.
    pub key: &'static str,
    /// The figure with its unit, in titles.
    pub figure: &'static str,
    /// The short heading of a column.
    pub heading: &'static str,
    /// Decimal digits.
    pub digits: usize,
    /// The difference of a row; `None` for the oracle and the first policy.
    pub of: fn(&Row) -> Option<Spread>,
}

const DIFFERENCES: [Difference; 4] = [
    Difference {
        key: "difference_mbps",
        figure: "sum rate in Mbit/s",
        heading: "Mbit/s",
        digits: 1,
        of: |row| row.difference_mbps,
    },
    Difference {
        key: "difference_ratio",
        figure: "ratio to the oracle",
        heading: "ratio",
        digits: 3,
        of: |row| row.difference_ratio,
    },
    Difference {
        key: "difference_qos_met",
        figure: "QoS met",
        heading: "QoS met",
        digits: 3,
        of: |row| row.difference_qos_met,
    },
    Difference {
        key: "difference_outage_time",
        figure: "outage, share of the users' time",
        heading: "outage",
        digits: 3,
        of: |row| row.difference_outage_time,
    },
];

impl Difference {
    /// The differences that a comparison has: none for a single policy, and outage in closed loop only.
    pub fn all(report: &Report) -> impl Iterator<Item = Self> {
        Self::of_any(std::slice::from_ref(report))
    }

    /// The policy that a sweep subtracts: the first one of the first point with a difference. The points may
    /// have different policies.
    pub fn reference(reports: &[Report]) -> Option<&str> {
        let report = reports.iter().find(|report| Self::all(report).next().is_some())?;
        report.policies.first().map(|(name, _)| name.as_str())
    }

    /// The difference of a row from the reference; `None` also at a point that subtracts another policy.
    pub fn to(&self, reference: Option<&str>, report: &Report, row: &Row) -> Option<Spread> {
        let first = report.policies.first().map(|(name, _)| name.as_str());
        (self.of)(row).filter(|_| first == reference)
    }

    /// The differences that at least one of the comparisons has.
    pub fn of_any(reports: &[Report]) -> impl Iterator<Item = Self> {
        let has = |difference: &Self| {
            let mut rows = reports.iter().flat_map(|report| &report.policies);
            rows.any(|(_, row)| (difference.of)(row).is_some())
        };
        DIFFERENCES.into_iter().filter(has)
    }
}
