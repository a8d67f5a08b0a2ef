//! The tables over the points of a sweep, for the terminal and for the report.

use heliostat_learn::comparison::{Report, Row, Spread};

use super::ORACLE;
use super::cells::{difference, interval, of_policy, rows};
use super::differences::{Difference, marked_name};
use super::output::states_and_seeds;
use super::sweep::Grid;

/// One figure of the oracle and of each policy at each point.
pub struct PointTable<'a> {
    /// The figure with its unit.
    pub title: String,
    /// The columns: the oracle, and each policy of any point.
    pub names: Vec<&'a str>,
    /// The cells of each point. A point without a policy has a dash.
    pub lines: Vec<Vec<String>>,
}

impl<'a> PointTable<'a> {
    /// A table in which `cell` returns the text of a row at a point.
    fn new(title: String, reports: &'a [Report], cell: impl Fn(usize, &str, &Row) -> String) -> Self {
        let mut names: Vec<&str> = Vec::new();
        for (name, _) in reports.iter().flat_map(rows) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        let of_point = |(index, report): (usize, &Report)| {
            let text = |name: &&str| {
                let row = rows(report).find(|(of, _)| of == name);
                row.map_or("-".into(), |(_, row)| cell(index, name, row))
            };
            names.iter().map(text).collect::<Vec<String>>()
        };
        let lines = reports.iter().enumerate().map(of_point).collect();
        Self { title, names, lines }
    }
}

/// The ratio and minimum rates met of every policy, the sum rates, in closed loop the time in outage, and the paired
/// differences.
pub fn tables<'a>(grid: &Grid, reports: &'a [Report]) -> Vec<PointTable<'a>> {
    let Some(first) = reports.first() else { return Vec::new() };
    let states = states_and_seeds(first);
    let is_shared = reports.iter().all(|report| states_and_seeds(report) == states);
    let place = if is_shared { "" } else { " at the first point" };
    let title = format!("ratio to the oracle with minimum rates, and share of minimum rates met; {states}{place}");
    let mut tables = vec![
        PointTable::new(title, reports, |_, name, row| match name {
            ORACLE => interval(row.qos_met, 3),
            _ => marked_name(&format!("{} {}", interval(row.ratio_to_oracle, 3), interval(row.qos_met, 3)), row),
        }),
        PointTable::new("sum rate in Mbit/s".into(), reports, |_, _, row| interval(row.sum_rate_mbps, 1)),
    ];
    if first.oracle.outage_time.is_some() {
        let title = "outage: share of the users' time below the minimum rate".into();
        let outage = |row: &Row| interval(row.outage_time.unwrap_or(Spread::MISSING), 3);
        tables.push(PointTable::new(title, reports, |_, _, row| outage(row)));
    }
    let reference = Difference::reference(reports);
    for one in Difference::of_any(reports) {
        let title = format!("difference to {}, paired: {}", reference.unwrap_or_default(), one.figure);
        tables.push(PointTable::new(title, reports, |index, _, row| {
            difference(one.to(reference, &reports[index], row), &one)
        }));
    }
    // The points have paired differences from their bases where they have the same rooms.
    for bases in &grid.bases() {
        for one in Difference::of_points(reports, bases) {
            let title = format!("difference to {}, paired by episode: {}", bases.name, one.figure);
            tables.push(PointTable::new(title, reports, |index, name, _| {
                difference(one.to_base(reports, bases, index, of_policy(name)), &one)
            }));
        }
    }
    tables
}
