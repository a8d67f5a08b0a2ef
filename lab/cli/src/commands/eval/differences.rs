//! The figures of a policy minus those of the first one, or those of a point of a sweep minus those of another
//! point, for tables, files and plots.

use heliostat_learn::comparison::{Report, Row, Spread};
use serde_json::{Map, Value, json};

use super::NEAR_BEST;
use super::sweep::Bases;

/// The differences to the first point of a sweep, in JSON and in CSV files.
pub const TO_FIRST: &str = "difference_to_first";

/// The differences along a key of a sweep, in JSON and in CSV files.
pub const ALONG: &str = "difference_along";

/// A paired difference.
pub struct Difference {
    /// Its name in JSON and in CSV files.
    pub key: &'static str,
    /// The name of its figure in JSON and in CSV files.
    pub of_figure: &'static str,
    /// The figure with its unit, in titles.
    pub figure: &'static str,
    /// The short heading of a column.
    pub heading: &'static str,
    /// Decimal digits.
    pub digits: usize,
    /// The difference of a row; `None` for the first policy.
    pub of: fn(&Row) -> Option<Spread>,
}

const DIFFERENCES: [Difference; 4] = [
    Difference {
        key: "difference_mbps",
        of_figure: "sum_rate_mbps",
        figure: "sum rate in Mbit/s",
        heading: "Mbit/s",
        digits: 1,
        of: |row| row.difference_mbps,
    },
    Difference {
        key: "difference_ratio",
        of_figure: "ratio_to_oracle",
        figure: "ratio to the oracle",
        heading: "ratio",
        digits: 3,
        of: |row| row.difference_ratio,
    },
    Difference {
        key: "difference_qos_met",
        of_figure: "qos_met",
        figure: "minimum rates met",
        heading: "QoS met",
        digits: 3,
        of: |row| row.difference_qos_met,
    },
    Difference {
        key: "difference_outage_time",
        of_figure: "outage_time",
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

    /// The figure at a point of a sweep minus that at its base, of a policy or of the oracle (`None`), paired by
    /// episode; `None` at the base itself, and where the episodes have other rooms.
    pub fn to_base(&self, reports: &[Report], bases: &Bases, index: usize, policy: Option<&str>) -> Option<Spread> {
        let base = *bases.points.get(index)?;
        let (first, own) = (reports.get(base)?, reports.get(index)?);
        (index != base).then(|| own.minus(first, policy, self.of_figure)).flatten()
    }

    /// The name of the difference from such points in CSV files, with the parts of its name in JSON.
    pub fn name_to_base(&self, bases: &Bases) -> String {
        match bases.key {
            None => format!("{TO_FIRST}_{}", self.of_figure),
            Some(key) => format!("{ALONG}_{key}_{}", self.of_figure),
        }
    }

    /// The differences that at least one point of a sweep has from its base.
    pub fn of_points(reports: &[Report], bases: &Bases) -> impl Iterator<Item = Self> {
        let has = move |difference: &Self| {
            (0..reports.len()).any(|index| difference.to_base(reports, bases, index, None).is_some())
        };
        DIFFERENCES.into_iter().filter(has)
    }
}

/// The name of a row, or the text of its cell, with a mark where the policy is not told apart from the best one.
pub fn marked_name(name: &str, row: &Row) -> String {
    if row.is_near_best() { format!("{name} {NEAR_BEST}") } else { name.to_owned() }
}

/// The differences of a point of a sweep from its base as JSON, of the oracle and of each policy that both have;
/// `None` at the base itself, and where the episodes have other rooms.
pub fn to_base(reports: &[Report], bases: &Bases, index: usize) -> Option<Value> {
    let of = |policy: Option<&str>| {
        let difference = |one: Difference| {
            let found = one.to_base(reports, bases, index, policy)?;
            Some((one.of_figure.to_owned(), json!(found)))
        };
        DIFFERENCES.into_iter().filter_map(difference).collect::<Map<_, _>>()
    };
    let oracle = Some(of(None)).filter(|oracle| !oracle.is_empty())?;
    let policies = reports[index].policies.iter().map(|(name, _)| (name.clone(), of(Some(name.as_str()))));
    let policies = policies.filter(|(_, found)| !found.is_empty()).map(|(name, found)| (name, Value::Object(found)));
    Some(json!({ "oracle": oracle, "policies": policies.collect::<Map<_, _>>() }))
}

/// The episodes of a comparison and their figures as JSON: for each figure one list for each actor. In a static
/// comparison an episode is one state.
pub fn in_episodes(report: &Report) -> Value {
    let names = || report.each.first().into_iter().flat_map(|row| &row.figures).map(|(name, _)| *name);
    let of = |policy: Option<&str>| {
        let figures = names().map(|name| (name.to_owned(), json!(report.in_episodes(policy, name))));
        figures.collect::<Map<_, _>>()
    };
    let policies = report.policies.iter().map(|(name, _)| (name.clone(), Value::Object(of(Some(name.as_str())))));
    json!({
        "seed": report.rooms().map(|(room, _)| room.set).collect::<Vec<_>>(),
        "room_seed": report.rooms().map(|(room, _)| room.room).collect::<Vec<_>>(),
        "states": report.rooms().map(|(_, states)| states).collect::<Vec<_>>(),
        "oracle": of(None),
        "policies": policies.collect::<Map<_, _>>(),
    })
}
