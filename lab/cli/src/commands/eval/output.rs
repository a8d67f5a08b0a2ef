//! A comparison as tables.

use std::io;

use heliostat_environment::episodes::{INSTANTS, sampled_s};
use heliostat_learn::comparison::{BeliefQuality, Loop, Report, Row};
use heliostat_service::counted::counted;
use heliostat_service::outln;

use super::cells::{ber, difference, interval, number, rows};
use super::differences::{Difference, marked_name};
use super::notes::{note_on_times, notes_on_episodes};
use super::point_tables::{self, PointTable};
use super::sweep::{Grid, Sweep};
use super::{ABOVE_ONE, NEAR_BEST, NEAR_BEST_NOTE, exceeds_one};

/// The means of a comparison as bits, to find whether two are equal.
pub fn figures(report: &Report) -> Vec<u64> {
    let of_row = |(_, row): (&str, &Row)| {
        let means = [row.sum_rate_mbps, row.qos_met, row.jain, row.blocked_rate_mbps, row.ber];
        means.into_iter().chain(row.outage_time)
    };
    let of_belief = |(_, quality): &(String, BeliefQuality)| [quality.place_error_cm, quality.coverage_95];
    let spreads = rows(report).flat_map(of_row).chain(report.beliefs.iter().flat_map(of_belief));
    spreads.map(|spread| spread.mean.to_bits()).collect()
}

/// Width of the column of names.
fn name_width(report: &Report) -> usize {
    rows(report).map(|(name, row)| marked_name(name, row).len()).max().unwrap_or(0).max(22)
}

/// The number of users, and of those that never have a direct path.
pub(super) fn users(report: &Report) -> String {
    let users = counted(report.users, "user");
    if report.blocked == 0 { users } else { format!("{users}, {} of them never with a direct path", report.blocked) }
}

/// Prints a comparison: its conditions, then its tables.
pub fn print_table(report: &Report) -> io::Result<()> {
    let loop_name = if report.mode == Loop::ClosedLoop { "closed loop" } else { "static" };
    print_conditions(std::slice::from_ref(report))?;
    outln!("{}, {loop_name}: {}; {}", report.scenario, users(report), states_and_seeds(report))?;
    let width = name_width(report);
    outln!(
        "{:<width$} {:>7} {:>13} {:>13} {:>6} {:>12} {:>12} {:>13} {:>18} {:>8} {:>8}",
        "",
        "trained",
        "Mbit/s",
        "ratio",
        "p5",
        "QoS met",
        "Jain",
        "blocked",
        "BER",
        "p50 (us)",
        "p99 (us)"
    )?;
    for (name, row) in rows(report) {
        let (rate, ratio) = (row.sum_rate_mbps, row.ratio_to_oracle);
        let time = |time: Option<f64>| time.map_or("-".into(), |time| format!("{time:.0}"));
        outln!(
            "{:<width$} {:>7} {:>13} {:>13} {:>6} {:>12} {:>12} {:>13} {:>18} {:>8} {:>8}",
            marked_name(name, row),
            row.training_seeds.map_or("-".into(), |seeds| seeds.to_string()),
            interval(rate, 1),
            interval(ratio, 3),
            number(ratio.p5, 3),
            interval(row.qos_met, 3),
            interval(row.jain, 3),
            interval(row.blocked_rate_mbps, 2),
            ber(row.ber),
            time(row.decision_us.map(|times| times.p50)),
            time(row.decision_us.map(|times| times.p99)),
        )?;
    }
    note_on_episodes(std::slice::from_ref(report), None)?;
    outln!("trained: number of training seeds of a learned policy; the interval includes their spread")?;
    outln!(
        "±: half the width of the 95 % confidence interval of the mean; ratio: to the sum rate of the oracle with minimum rates; p5: its 5th percentile"
    )?;
    note_on_times(report).iter().try_for_each(|note| outln!("{note}"))?;
    note_on_near_best(std::slice::from_ref(report))?;
    note_on_ratios(std::slice::from_ref(report))?;
    outln!("blocked: {BLOCKED}: {}", blocked_states(report))?;
    print_differences(report)?;
    print_outages(report)?;
    print_beliefs(None, std::slice::from_ref(report))
}

/// Prints each condition of the rooms once, before the figures that it concerns.
fn print_conditions(reports: &[Report]) -> io::Result<()> {
    let mut known = Vec::new();
    for condition in reports.iter().flat_map(|report| &report.conditions) {
        if !known.contains(&condition) {
            outln!("condition: {condition}")?;
            known.push(condition);
        }
    }
    Ok(())
}

/// Prints number and lengths of the outages in closed loop.
fn print_outages(report: &Report) -> io::Result<()> {
    let mut rows = rows(report).filter_map(|(name, row)| Some((name, row.outages?, row.outage_time?))).peekable();
    if rows.peek().is_none() {
        return Ok(());
    }
    outln!(
        "\noutages: times in which a user is below the minimum rate, sampled every 20 ms; each ends with its episode of {} s",
        sampled_s(report.states.min(INSTANTS))
    )?;
    let width = name_width(report);
    outln!(
        "{:<width$} {:>18} {:>15} {:>19} {:>15}",
        "",
        "per user minute",
        "median (s)",
        "95th percentile (s)",
        "share of time"
    )?;
    for (name, outages, share) in rows {
        outln!(
            "{name:<width$} {:>18} {:>15} {:>19} {:>15}",
            number(outages.per_user_minute, 2),
            number(outages.p50_s, 2),
            number(outages.p95_s, 2),
            interval(share, 3)
        )?;
    }
    outln!("share of time: mean share of users below the minimum rate, at the states of the table above")
}

/// Prints the paired differences of the oracle and the policies from the first one, if there are several.
fn print_differences(report: &Report) -> io::Result<()> {
    let differences: Vec<Difference> = Difference::all(report).collect();
    let Some((first, _)) = report.policies.first() else { return Ok(()) };
    if differences.is_empty() {
        return Ok(());
    }
    outln!("\ndifference to {first}, paired state by state")?;
    let width = name_width(report);
    let headings: Vec<String> = differences.iter().map(|one| format!("{:>15}", one.heading)).collect();
    outln!("{:<width$} {}", "", headings.join(" "))?;
    for (name, row) in rows(report).filter(|(name, _)| name != first) {
        let cells: Vec<String> =
            differences.iter().map(|one| format!("{:>15}", difference((one.of)(row), one))).collect();
        outln!("{name:<width$} {}", cells.join(" "))?;
    }
    Ok(())
}

/// Prints the quality of each belief about the users, at each point of a sweep if there is one.
fn print_beliefs(grid: Option<&Grid>, reports: &[Report]) -> io::Result<()> {
    if reports.iter().all(|report| report.beliefs.is_empty()) {
        return Ok(());
    }
    let width = reports.iter().map(name_width).max().unwrap_or(0);
    let print = |keys: Option<String>, name: &str, cells: [String; 6]| {
        let keys = keys.map(|keys| keys + " ").unwrap_or_default();
        let cells = cells.map(|cell| format!("{cell:>18}"));
        outln!("{keys}{name:<width$} {}", cells.join(" "))
    };
    let columns = belief_columns();
    outln!("\nbelief about the users, against the truth at the predicted instant")?;
    print(grid.map(|grid| key_cells(grid, grid.keys())), "", columns.map(|(heading, _)| heading.to_owned()))?;
    for (index, report) in reports.iter().enumerate() {
        for (name, quality) in &report.beliefs {
            let keys = grid.map(|grid| key_cells(grid, grid.points()[index].iter().copied()));
            print(keys, name, columns.map(|(_, cell)| cell(quality)))?;
        }
    }
    outln!("{BELIEF_NOTE}")
}

/// How to read the columns of [`belief_columns`].
pub(super) const BELIEF_NOTE: &str = "place: distance on the floor; heading: of users who walk, and of users who stand \
     (below 0.05 m/s); in 50 %, in 95 %: share of true places within the ellipse that should contain this share";

/// A column about beliefs: its heading, and the text of a cell.
type BeliefColumn = (&'static str, fn(&BeliefQuality) -> String);

/// The columns about beliefs.
pub(super) fn belief_columns() -> [BeliefColumn; 6] {
    [
        ("place, median (cm)", |quality| number(quality.place_error_median_cm, 1)),
        ("place, mean (cm)", |quality| interval(quality.place_error_cm, 1)),
        ("walking (deg)", |quality| interval(quality.heading_error_walking_deg, 1)),
        ("standing (deg)", |quality| interval(quality.heading_error_standing_deg, 1)),
        ("in 50 %", |quality| interval(quality.coverage_50, 3)),
        ("in 95 %", |quality| interval(quality.coverage_95, 3)),
    ]
}

/// Prints the conditions, the tables over the points, and in closed loop the quality of the beliefs.
pub fn print_sweep(grid: &Grid, reports: &[Report]) -> io::Result<()> {
    print_conditions(reports)?;
    for (index, table) in point_tables::tables(grid, reports).iter().enumerate() {
        outln!("{}", table.title)?;
        print_points(grid, table)?;
        // The marks are in the table of ratios, which is the first one.
        if index == 0 {
            note_on_near_best(reports)?;
        }
    }
    note_on_episodes(reports, Some(grid))?;
    note_on_ratios(reports)?;
    print_beliefs(Some(grid), reports)
}

/// Prints a table with one line for each point.
fn print_points(grid: &Grid, table: &PointTable) -> io::Result<()> {
    let width = |(column, name): (usize, &&str)| {
        let cells = table.lines.iter().map(|line| line[column].chars().count());
        cells.chain([name.chars().count()]).max().unwrap_or(0)
    };
    let widths: Vec<usize> = table.names.iter().enumerate().map(width).collect();
    outln!("{} {}", key_cells(grid, grid.keys()), aligned(&table.names, &widths))?;
    for (point, line) in grid.points().iter().zip(&table.lines) {
        outln!("{} {}", key_cells(grid, point.iter().copied()), aligned(line, &widths))?;
    }
    Ok(())
}

/// Cells in one line, each at the right of its column.
fn aligned(cells: &[impl AsRef<str>], widths: &[usize]) -> String {
    let cells = cells.iter().zip(widths).map(|(cell, &width)| format!("{:>width$}", cell.as_ref()));
    cells.collect::<Vec<_>>().join(" ")
}

/// The columns of the keys of a sweep, with these texts.
fn key_cells<'a>(grid: &Grid, texts: impl Iterator<Item = &'a str>) -> String {
    let cells = grid.sweeps().iter().zip(texts).map(|(sweep, text)| format!("{text:>0$}", key_width(sweep)));
    cells.collect::<Vec<_>>().join(" ")
}

/// Width of the column of a key.
fn key_width(sweep: &Sweep) -> usize {
    let values = sweep.values().iter().map(|value| value.chars().count());
    values.chain([sweep.key().chars().count()]).max().unwrap_or(0)
}

/// How many states a comparison has, and of which seeds.
pub(super) fn states_and_seeds(report: &Report) -> String {
    let states = counted(report.states, "state");
    let states = match report.seeds {
        1 => format!("{states} of the seed {}", report.seed),
        seeds => format!("{states} for each of {seeds} seeds from {}", report.seed),
    };
    // Each state of a static comparison is a room of its own.
    if report.mode == Loop::Static { states } else { episodes_and_seeds(report) }
}

fn episodes_and_seeds(report: &Report) -> String {
    let of_seed = report.episodes / report.seeds;
    let of_seeds = match report.seeds {
        1 => format!(" of the seed {}", report.seed),
        seeds => format!(": {of_seed} for each of {seeds} seeds from {}", report.seed),
    };
    // The last episode of a seed may be shorter.
    let states = if of_seed == 1 || report.states == of_seed * INSTANTS {
        let each = report.states.min(INSTANTS);
        format!("{} each within {} s", counted(each, "state"), sampled_s(each))
    } else {
        format!("{} of each seed, {INSTANTS} within {} s", counted(report.states, "state"), sampled_s(INSTANTS))
    };
    format!("{}{of_seeds}, {states}", counted(report.episodes, "episode"))
}

/// What the column `blocked` is.
pub(super) const BLOCKED: &str = "mean rate of a user without direct path in Mbit/s, over the states with such a user";

/// From how many episodes the column `blocked` comes.
pub(super) fn blocked_states(report: &Report) -> String {
    match (report.blocked_episodes(), report.group()) {
        (0, group) => format!("no {group} has such a user"),
        (some, group) => format!("from {some} of {}", counted(report.episodes, group)),
    }
}

/// Prints what the mark of a policy means, if one has it.
fn note_on_near_best(reports: &[Report]) -> io::Result<()> {
    let mut rows = reports.iter().flat_map(|report| &report.policies);
    if rows.any(|(_, row)| row.is_near_best()) { outln!("{NEAR_BEST}: {NEAR_BEST_NOTE}") } else { Ok(()) }
}

/// Prints why a ratio exceeds 1, if one does.
fn note_on_ratios(reports: &[Report]) -> io::Result<()> {
    let mut rows = reports.iter().flat_map(|report| &report.policies);
    if rows.any(|(_, row)| exceeds_one(row.ratio_to_oracle.mean)) { outln!("{ABOVE_ONE}") } else { Ok(()) }
}

fn note_on_episodes(reports: &[Report], sweep: Option<&Grid>) -> io::Result<()> {
    notes_on_episodes(reports, sweep).iter().try_for_each(|note| outln!("{note}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_of_a_sweep_is_as_wide_as_its_key_and_its_values() {
        for (sweep, width) in [("users.count=1..3", 11), ("led.positions_m=[[0,0,3]],[[1,0,3],[-1,0,3]]", 18)] {
            assert_eq!(key_width(&sweep.parse().expect("a sweep")), width);
        }
    }
}
