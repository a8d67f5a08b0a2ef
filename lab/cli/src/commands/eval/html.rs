//! A comparison as one HTML file: tables, and plots as SVG elements. The file refers to no other one.

mod plots;

use std::fmt::Write;
use std::path::Path;

use anyhow::Result;
use heliostat_files::shell_word;
use heliostat_learn::comparison::{Loop, Report, Row, Spread};
use heliostat_reproduce::draw::style::short_number;
use heliostat_reproduce::machine;
use heliostat_scenario::Scenario;
use heliostat_service::counted::counted;
use heliostat_service::printable::{printable, printable_lines};

use super::cells::{ber, difference, interval, number, rows};
use super::differences::{Difference, marked_name};
use super::notes::{note_on_times, notes_on_episodes};
use super::origin;
use super::output::{BELIEF_NOTE, BLOCKED, belief_columns, blocked_states, users};
use super::point_tables;
use super::sweep::{Grid, Sweep};
use super::{ABOVE_ONE, NEAR_BEST, NEAR_BEST_NOTE};
use heliostat_service::whole_file;

/// Writes the report of a comparison, or of one comparison for each value of a sweep.
///
/// # Errors
/// A plot that cannot be drawn, or a file that cannot be written.
pub fn write(file: &Path, scenario: &Scenario, grid: Option<&Grid>, reports: &[Report]) -> Result<()> {
    let page = page(&command(), scenario, grid, reports)?;
    whole_file::write(file, page.as_bytes())
}

/// The command line of this process.
fn command() -> String {
    let arguments = std::env::args_os().skip(1);
    let words = arguments.map(|word| shell_word(&word.to_string_lossy()));
    [heliostat::programs::LAB.to_owned()].into_iter().chain(words).collect::<Vec<_>>().join(" ")
}

/// Text from a file or a flag, for the page.
fn text(text: &str) -> String {
    escape(&printable(text))
}

fn page(command: &str, scenario: &Scenario, grid: Option<&Grid>, reports: &[Report]) -> Result<String> {
    let first = &reports[0];
    let title = format!("Policies in {}", text(&first.scenario));
    let mut page = String::new();
    writeln!(
        page,
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width\">\n\
         <title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>"
    )?;
    write_origin(&mut page, command, grid, reports)?;
    let mut notes = notes_on_episodes(reports, None);
    // The tables over the points have intervals of their own.
    for note in grid.map_or_else(Vec::new, |grid| notes_on_episodes(reports, Some(grid))) {
        if !notes.contains(&note) {
            notes.push(note);
        }
    }
    for note in notes {
        writeln!(page, "<p class=\"note\">{}</p>", text(&note))?;
    }
    if let Some(grid) = grid {
        let keys = grid.keys().collect::<Vec<_>>().join(" and ");
        writeln!(page, "<h2>Over {}</h2>\n<div class=\"plots\">{}</div>", text(&keys), plots::over(grid, reports)?)?;
        write_points(&mut page, grid, reports)?;
    }
    for (index, report) in reports.iter().enumerate() {
        if let Some(grid) = grid {
            writeln!(page, "<h2>{}</h2>", text(&grid.name(&grid.points()[index])))?;
            write_meta(&mut page, &of_configuration(report))?;
        }
        write_table(&mut page, report)?;
        write_beliefs(&mut page, report)?;
        writeln!(page, "<div class=\"plots\">{}</div>", plots::by_policy(report)?)?;
    }
    write_notes(&mut page, first)?;
    let effective = escape(&printable_lines(&scenario.to_toml()));
    let which = if grid.is_some() { " of the first value" } else { "" };
    writeln!(
        page,
        "<h2>Scenario</h2>\n<details><summary>The effective scenario{which}</summary><pre>{effective}</pre></details>"
    )?;
    writeln!(page, "</body>\n</html>")?;
    Ok(page)
}

fn write_origin(page: &mut String, command: &str, grid: Option<&Grid>, reports: &[Report]) -> std::fmt::Result {
    let first = &reports[0];
    let mode = match first.mode {
        Loop::Static => "static: exact states, mirrors that turn at once",
        Loop::ClosedLoop => "closed loop: reports, delays, noise and mirrors of the scenario",
    };
    writeln!(page, "<p>Command: <code>{}</code></p>", text(command))?;
    let mut rows = vec![("scenario", first.scenario.clone()), ("comparison", mode.to_owned())];
    match grid {
        None => rows.extend(of_configuration(first)),
        Some(grid) => {
            let of = |sweep: &Sweep| format!("{} = {}", sweep.key(), sweep.values().join(", "));
            rows.push(("sweep", grid.sweeps().iter().map(of).collect::<Vec<_>>().join("; ")));
        }
    }
    rows.extend([
        ("made", machine::now()),
        ("program", format!("{}, commit {}", origin::program(), machine::COMMIT)),
        ("machine", machine::hardware()),
    ]);
    for condition in reports.iter().flat_map(|report| &report.conditions) {
        let row = ("condition", condition.to_string());
        if !rows.contains(&row) {
            rows.push(row);
        }
    }
    write_meta(page, &rows)
}

/// What belongs to one configuration: each point of a sweep has its own.
fn of_configuration(report: &Report) -> [(&'static str, String); 5] {
    let last_seed = report.seed.wrapping_add(report.seeds as u64 - 1);
    [
        ("configuration", report.configuration.clone()),
        ("users", users(report)),
        ("seeds", format!("{} to {last_seed}: {} for each", report.seed, counted(report.states, "state"))),
        ("episodes", format!("{}; intervals come from them", counted(report.episodes, report.group()))),
        ("blocked", blocked_states(report)),
    ]
}

fn write_meta(page: &mut String, rows: &[(&str, String)]) -> std::fmt::Result {
    writeln!(page, "<table class=\"meta\">")?;
    for (name, value) in rows {
        writeln!(page, "<tr><th>{name}</th><td>{}</td></tr>", text(value))?;
    }
    writeln!(page, "</table>")
}

/// A column of the table: its heading, and the text of a row's cell.
type Column = (String, Box<dyn Fn(&Row) -> String>);

fn columns(report: &Report) -> Vec<Column> {
    let spread = |heading: &str, digits: usize, value: fn(&Row) -> Spread| -> Column {
        (heading.into(), Box::new(move |row| interval(value(row), digits)))
    };
    let mut columns = vec![spread("sum rate (Mbit/s)", 1, |row| row.sum_rate_mbps)];
    if let Some((first, _)) = report.policies.first() {
        columns.extend(Difference::all(report).map(|one| -> Column {
            let heading = format!("difference to {first} ({})", one.heading);
            (heading, Box::new(move |row: &Row| difference((one.of)(row), &one)))
        }));
    }
    columns.extend([
        spread("ratio to the oracle", 3, |row| row.ratio_to_oracle),
        ("ratio, p5".into(), Box::new(|row| number(row.ratio_to_oracle.p5, 3))),
        spread("QoS met", 3, |row| row.qos_met),
        spread("Jain", 3, |row| row.jain),
        spread("blocked (Mbit/s)", 2, |row| row.blocked_rate_mbps),
        ("BER".into(), Box::new(|row| ber(row.ber))),
    ]);
    if report.oracle.outage_time.is_some() {
        let outage = |row: &Row| row.outage_time.map_or("-".into(), |outage| interval(outage, 3));
        columns.push(("outage (share of time)".into(), Box::new(outage)));
    }
    let time = |value: Option<f64>| value.map_or("-".into(), short_number);
    columns.push(("decision time p50 (us)".into(), Box::new(move |row| time(row.decision_us.map(|times| times.p50)))));
    columns.push(("p99 (us)".into(), Box::new(move |row| time(row.decision_us.map(|times| times.p99)))));
    columns.push(("trained".into(), Box::new(|row| row.training_seeds.map_or("-".into(), |seeds| seeds.to_string()))));
    columns
}

fn write_table(page: &mut String, report: &Report) -> std::fmt::Result {
    let columns = columns(report);
    let headings = columns.iter().map(|(heading, _)| format!("<th>{}</th>", text(heading))).collect::<String>();
    writeln!(page, "<div class=\"wide\"><table class=\"figures\">\n<tr><th>policy</th>{headings}</tr>")?;
    for (name, row) in rows(report) {
        let cells = columns.iter().map(|(_, cell)| format!("<td>{}</td>", cell(row))).collect::<String>();
        writeln!(page, "<tr><th>{}</th>{cells}</tr>", text(&marked_name(name, row)))?;
    }
    writeln!(page, "</table></div>")
}

/// The tables over the points of a sweep.
fn write_points(page: &mut String, grid: &Grid, reports: &[Report]) -> std::fmt::Result {
    for table in point_tables::tables(grid, reports) {
        let names = grid.keys().chain(table.names.iter().copied());
        let headings = names.map(|name| format!("<th>{}</th>", text(name))).collect::<String>();
        let title = text(&table.title);
        writeln!(page, "<h3>{title}</h3>\n<div class=\"wide\"><table class=\"figures\">\n<tr>{headings}</tr>")?;
        for (point, line) in grid.points().iter().zip(&table.lines) {
            let keys = point.iter().map(|value| format!("<th>{}</th>", text(value))).collect::<String>();
            let cells = line.iter().map(|cell| format!("<td>{}</td>", escape(cell))).collect::<String>();
            writeln!(page, "<tr>{keys}{cells}</tr>")?;
        }
        writeln!(page, "</table></div>")?;
    }
    Ok(())
}

fn write_beliefs(page: &mut String, report: &Report) -> std::fmt::Result {
    if report.beliefs.is_empty() {
        return Ok(());
    }
    let columns = belief_columns();
    let headings = columns.iter().map(|(heading, _)| format!("<th>{}</th>", text(heading))).collect::<String>();
    writeln!(page, "<div class=\"wide\"><table class=\"figures\">\n<tr><th>belief</th>{headings}</tr>")?;
    for (name, quality) in &report.beliefs {
        let cells = columns.iter().map(|(_, cell)| format!("<td>{}</td>", cell(quality))).collect::<String>();
        writeln!(page, "<tr><th>{}</th>{cells}</tr>", text(name))?;
    }
    writeln!(page, "</table></div>")
}

fn write_notes(page: &mut String, report: &Report) -> std::fmt::Result {
    writeln!(page, "<h2>How to read this</h2>\n<ul>")?;
    let blocked = format!("Blocked: {BLOCKED}.");
    let near_best = format!("{NEAR_BEST}: {NEAR_BEST_NOTE}.");
    let ratio = format!(
        "Ratio: to the sum rate of the oracle with minimum rates, state by state; p5: its 5th percentile over the states. \
         Note that {ABOVE_ONE}."
    );
    for note in [
        "±: half the width of the 95 % confidence interval of the mean, by Student's t. A single state has no interval.",
        "Difference: the figure minus that of the first policy, state by state. Its interval is narrower than that of two means, because \
         both policies meet the same states. An interval that does not contain 0 is a difference beyond the variation of the states.",
        near_best.as_str(),
        ratio.as_str(),
        "QoS met: minimum rates met, the share of the users whose minimum rate is met. Jain: Jain's fairness index of the rates. BER: with on-off keying.",
        blocked.as_str(),
        "Trained: number of training seeds; the interval includes their spread.",
    ] {
        writeln!(page, "<li>{}</li>", escape(note))?;
    }
    if report.policies.iter().any(|(_, row)| row.decision_us.is_some()) {
        let of = match report.mode {
            Loop::Static => "the policy alone, encoding included",
            Loop::ClosedLoop => "belief, observation and policy",
        };
        writeln!(page, "<li>Decision time: of {of}, on this machine.</li>")?;
    }
    if let Some(note) = note_on_times(report) {
        writeln!(page, "<li>{}</li>", escape(&note))?;
    }
    if !report.beliefs.is_empty() {
        writeln!(page, "<li>Belief, against the truth at the predicted instant: {}.</li>", escape(BELIEF_NOTE))?;
    }
    writeln!(page, "</ul>")
}

/// A text for an element or an attribute of the page.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

const STYLE: &str = "
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 1280px; padding: 0 1.5rem; color: #222; }
h1 { font-size: 1.7rem; } h2 { margin-top: 2.5rem; border-bottom: 1px solid #ccc; } h3 { font-size: 1rem; margin-bottom: 0.3rem; }
table { border-collapse: collapse; font-size: 0.9rem; } td, th { text-align: left; vertical-align: top; padding: 0.3rem 0.7rem; }
.note { background: #fff4d6; border-left: 4px solid #e0a800; padding: 0.4rem 0.8rem; }
.meta th { color: #666; font-weight: normal; } code { background: #f2f2f2; padding: 0 0.25em; border-radius: 3px; }
.wide { overflow-x: auto; } .figures td, .figures th { border-bottom: 1px solid #ddd; white-space: nowrap; } .figures td { text-align: right; }
.figures tr:first-child th { white-space: normal; vertical-align: bottom; }
.plots { display: flex; flex-wrap: wrap; align-items: flex-start; gap: 1rem; margin: 1.5rem 0; } .plots svg { max-width: 100%; height: auto; }
pre { overflow-x: auto; }
";

#[cfg(test)]
mod tests {
    use heliostat_learn::comparison::{Progress, Settings, compare};

    use super::*;

    fn report_of(policies: &[&str]) -> (Scenario, Report) {
        let room = ["mirrors.rows=2", "mirrors.columns=3", "users.count=2", "name=\"<b>lab</b>\""];
        let scenario = Scenario::from_toml_with("", &room).expect("a scenario");
        let actor = heliostat_models::ActorSource::Shipped;
        let settings = Settings::of_names(scenario.clone(), policies, &actor, (Loop::Static, 3)).expect("policies");
        let settings = Settings { seeds: 2, training_seed: None, ..settings };
        let report = compare(&settings, &Progress::shown().expect("a bar")).expect("a report");
        (scenario, report)
    }

    #[test]
    fn text_from_flags_and_files_cannot_become_elements_of_the_page() {
        let (scenario, mut report) = report_of(&["flat", "nearest"]);
        for (name, _) in &mut report.policies {
            *name = format!("<script>{name}</script>&\u{1b}[2J.onnx");
        }
        let sweeps = ["name=<i>a</i>,<i>b</i>".parse::<Sweep>().expect("a sweep")];
        let grid = Grid::new(&sweeps).expect("a key").expect("a sweep");
        let reports = [report.clone(), report];
        let page = page("heliostat-lab eval '<u>'", &scenario, Some(&grid), &reports).expect("a page");
        for element in ["<script", "<b>lab", "<i>", "<u>", "\u{1b}"] {
            assert!(!page.contains(element), "{element} in\n{page}");
        }
        assert!(page.contains("&lt;script&gt;flat&lt;/script&gt;&amp;\\u001b[2J.onnx"), "{page}");
    }

    #[test]
    fn each_point_of_a_sweep_names_its_own_configuration_and_the_head_names_none() {
        let (scenario, first) = report_of(&["flat", "nearest"]);
        let second = Report { configuration: "of the second point".into(), users: 7, ..first.clone() };
        let sweeps = ["users.count=2,7".parse::<Sweep>().expect("a sweep")];
        let grid = Grid::new(&sweeps).expect("a key").expect("a sweep");
        let page = page("heliostat-lab eval", &scenario, Some(&grid), &[first.clone(), second]).expect("a page");
        let parts: Vec<&str> = page.split("<h2>users.count = ").collect();
        assert_eq!(parts.len(), 3, "{page}");
        assert!(!parts[0].contains(&first.configuration) && !parts[0].contains("<th>users</th>"), "{page}");
        assert!(parts[1].contains(&first.configuration) && parts[1].contains("<td>2 users</td>"), "{page}");
        assert!(parts[2].contains("<td>of the second point</td>") && parts[2].contains("<td>7 users</td>"), "{page}");
        assert!(page.contains("a ratio can exceed 1"), "{page}");
    }
}
