//! A comparison as CSV files.

use anyhow::Result;
use heliostat_learn::comparison::{Loop, Report, Row, Spread};
use heliostat_reproduce::machine;

use super::ORACLE;
use super::cells::{of_policy, rows};
use super::differences::Difference;
use super::sweep::{Bases, Grid};

/// Columns that say where a line comes from.
const ORIGIN: [&str; 3] = ["scenario", "configuration", "commit"];

fn origin(report: &Report) -> [String; 3] {
    [report.scenario.clone(), report.configuration.clone(), machine::COMMIT.into()]
}

/// The first columns: the keys of a sweep.
fn keys(grid: Option<&Grid>) -> Vec<String> {
    grid.map(|grid| grid.keys().map(String::from).collect()).unwrap_or_default()
}

/// The values of the keys at a point.
fn values(grid: Option<&Grid>, index: usize) -> Vec<String> {
    grid.map(|grid| grid.points()[index].iter().map(|value| (*value).to_owned()).collect()).unwrap_or_default()
}

/// A number with all its digits, as a power of ten where it is tiny, such as a bit error rate; empty for NaN.
fn cell(value: f64) -> String {
    match value.abs() {
        size if size.is_nan() => String::new(),
        size if size > 0.0 && size < 1e-4 => format!("{value:e}"),
        _ => value.to_string(),
    }
}

/// A line for each policy; in a sweep the first columns are the values of the keys, and each point has its
/// differences from the first one and along each key. The last column has the conditions of the room, separated by
/// ` | `.
pub fn by_policy(grid: Option<&Grid>, reports: &[Report]) -> Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    // The points of a sweep may have different policies, and all lines have the same columns.
    let differences: Vec<Difference> = Difference::of_any(reports).collect();
    let reference = Difference::reference(reports);
    let mut all_rows = reports.iter().flat_map(|report| &report.policies);
    let has_best = all_rows.any(|(_, row)| row.difference_to_best.is_some());
    let bases = grid.map(Grid::bases).unwrap_or_default();
    let of_bases = |bases| Difference::of_points(reports, bases).map(move |one| (bases, one));
    let from_bases: Vec<(&Bases, Difference)> = bases.iter().flat_map(of_bases).collect();
    let spreads = |index: usize, policy: &str, row: &Row| {
        let own = spreads(row).into_iter().map(|(name, spread)| (name, Some(spread)));
        let further = differences.iter().map(|one| (one.key, one.to(reference, &reports[index], row)));
        let to_best = has_best.then_some(("difference_to_best", row.difference_to_best));
        let named = own.chain(further).chain(to_best).map(|(name, spread)| (name.to_owned(), spread));
        let from_bases = from_bases
            .iter()
            .map(|(bases, one)| (one.name_to_base(bases), one.to_base(reports, bases, index, of_policy(policy))));
        let all = named.chain(from_bases).map(|(name, spread)| (name, spread.unwrap_or(Spread::MISSING)));
        all.collect::<Vec<_>>()
    };
    let mut header = keys(grid);
    header.push("policy".into());
    for (name, _) in reports.first().map_or_else(Vec::new, |first| spreads(0, ORACLE, &first.oracle)) {
        header.extend(["mean", "ci95", "p5"].map(|part| format!("{name}_{part}")));
    }
    header.extend(["decision_us_p50", "decision_us_p99", "training_seeds", "episodes"].map(String::from));
    header.extend(ORIGIN.map(String::from));
    header.push("conditions".into());
    writer.write_record(&header)?;
    for (index, report) in reports.iter().enumerate() {
        let conditions = report.conditions.iter().map(ToString::to_string).collect::<Vec<_>>().join(" | ");
        for (name, row) in rows(report) {
            let figures =
                spreads(index, name, row).into_iter().flat_map(|(_, spread)| [spread.mean, spread.ci95, spread.p5]);
            let times = row.decision_us.map_or([f64::NAN; 2], |times| [times.p50, times.p99]);
            let trained = row.training_seeds.map_or(f64::NAN, |seeds| seeds as f64);
            let cells = figures.chain(times).chain([trained, report.episodes as f64]).map(cell);
            let first = values(grid, index).into_iter().chain([name.to_owned()]);
            writer.write_record(first.chain(cells).chain(origin(report)).chain([conditions.clone()]))?;
        }
    }
    Ok(writer.into_inner()?)
}

/// A line for each policy, actor and episode; in a static comparison an episode is one state. In closed loop
/// the last column has the weight of `outages_per_user_minute`.
pub fn by_episode(grid: Option<&Grid>, reports: &[Report]) -> Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let mut header = keys(grid);
    header.extend(["policy", "actor", "seed", "room_seed", "states"].map(String::from));
    let figures = reports.iter().flat_map(|report| &report.each).take(1).flat_map(|row| &row.figures);
    header.extend(figures.map(|(name, _)| (*name).to_owned()));
    header.extend(ORIGIN.map(String::from));
    let has_outages = reports.iter().any(|report| report.mode == Loop::ClosedLoop);
    header.extend(has_outages.then(|| "user_minutes".to_owned()));
    writer.write_record(&header)?;
    for (index, report) in reports.iter().enumerate() {
        for row in &report.each {
            let of = [
                row.policy.clone().unwrap_or_else(|| ORACLE.into()),
                row.actor.map_or(String::new(), |actor| actor.to_string()),
                row.group.set.to_string(),
                row.group.room.to_string(),
                row.states.to_string(),
            ];
            let figures = row.figures.iter().map(|(_, value)| cell(*value));
            let weight = has_outages.then(|| cell(row.user_minutes));
            let cells = values(grid, index).into_iter().chain(of).chain(figures).chain(origin(report)).chain(weight);
            writer.write_record(cells)?;
        }
    }
    Ok(writer.into_inner()?)
}

/// The figures of a row by name, without its differences.
fn spreads(row: &Row) -> Vec<(&'static str, Spread)> {
    let mut spreads = vec![
        ("sum_rate_mbps", row.sum_rate_mbps),
        ("ratio_to_oracle", row.ratio_to_oracle),
        ("qos_met", row.qos_met),
        ("jain", row.jain),
        ("blocked_rate_mbps", row.blocked_rate_mbps),
        ("ber", row.ber),
    ];
    spreads.extend(row.outage_time.map(|outage| ("outage_time", outage)));
    spreads
}

#[cfg(test)]
mod tests {
    use super::cell;

    #[test]
    fn a_tiny_number_is_short_and_keeps_its_digits() {
        let values = [f64::NAN, 0.0, 12.5, 0.25, 1.25e-150, -3e-7];
        assert_eq!(values.map(cell), ["", "0", "12.5", "0.25", "1.25e-150", "-3e-7"]);
    }
}
