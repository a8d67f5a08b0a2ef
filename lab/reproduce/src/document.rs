//! A report as text and tables in Markdown, which is also docs/results/reproduction.md.

use std::fmt::Write;

use anyhow::Result;

use crate::figure::{Figure, Panel, Point, Series};
use crate::figures::{inference, sum_rate_iterations};
use crate::report::{Report, duration_text};

/// Rows of a table for a long curve.
const ROWS: usize = 7;

/// A report without the data that the document omits: floors, parts, commands of figures, most
/// points of long curves, and digits after the fourth.
pub fn reduced(report: &Report) -> Report {
    let mut report = Report { parts: Vec::new(), ..report.clone() };
    report.meta.cpu_s = rounded(report.meta.cpu_s);
    for source in &mut report.sources {
        source.cpu_s = rounded(source.cpu_s);
    }
    for figure in &mut report.figures {
        figure.command.clear();
        for panel in &mut figure.panels {
            // The objects of a floor are omitted with it.
            if panel.floor.take().is_some() {
                panel.series.clear();
            }
        }
        let drawn = figure.panels.iter_mut().flat_map(|panel| &mut panel.series);
        for series in drawn.chain(&mut figure.ratios) {
            thin(series);
            for point in &mut series.points {
                (point.x, point.y) = (rounded(point.x), rounded(point.y));
                point.ci95 = point.ci95.map(rounded);
                point.x_ci95 = point.x_ci95.map(rounded);
            }
        }
    }
    report
}

/// Keeps at most [`ROWS`] points at even steps, including the first and the last.
fn thin(series: &mut Series) {
    let last = series.points.len().saturating_sub(1);
    if last < ROWS {
        return;
    }
    let kept: Vec<usize> = (0..ROWS).map(|row| row * last / (ROWS - 1)).collect();
    let mut index = 0;
    series.points.retain(|_| {
        index += 1;
        kept.contains(&(index - 1))
    });
}

fn rounded(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

/// The report as JSON, beside the document.
///
/// # Errors
/// None expected: every number in a report is finite.
pub fn json(report: &Report) -> Result<String> {
    Ok(serde_json::to_string_pretty(report)? + "\n")
}

/// The document; with `pictures` it shows the SVG files in its folder.
pub fn markdown(report: &Report, pictures: bool) -> String {
    let mut text = String::new();
    write(report, pictures, &mut text).expect("writing into a string does not fail");
    text
}

fn write(report: &Report, pictures: bool, text: &mut String) -> std::fmt::Result {
    let meta = &report.meta;
    writeln!(text, "# Reproduction of the paper's figures\n")?;
    writeln!(
        text,
        "Made by the command below; do not edit. docs/physics.md explains the interpretation of the paper. The command also writes the plots as SVG.\n"
    )?;
    writeln!(text, "```\n{} --write-docs docs/results\n```\n", meta.command)?;
    let commits = meta.commits.join(", ");
    writeln!(text, "| | |\n| --- | --- |")?;
    writeln!(text, "| made | {}, {} run, heliostat {}, commit {} |", meta.made, meta.effort, meta.version, commits)?;
    writeln!(
        text,
        "| seeds | {} from {} without training; {} for training ({} episodes) and timing |",
        meta.seeds, meta.first_seed, meta.training_seeds, meta.episodes
    )?;
    writeln!(text, "| machine | {} |", meta.machine)?;
    writeln!(text, "| computing time | {} of one core, over all parts |\n", duration_text(meta.cpu_s))?;
    write_claims(report, text)?;
    let mut last: Option<&Figure> = None;
    for figure in &report.figures {
        if last.is_none_or(|last| last.id != figure.id) {
            writeln!(text, "## {}\n", figure.title)?;
        }
        writeln!(text, "### {}: {}\n", figure.id, figure.room)?;
        if pictures {
            writeln!(text, "![{} in {}]({}.svg)\n", figure.title, figure.room, figure.stem())?;
        }
        // Lines that the previous room has already are omitted.
        let is_repeated = |line: &&String| last.is_some_and(|last| last.id == figure.id && last.caption.contains(line));
        let lines: Vec<&String> = figure.caption.iter().filter(|line| !is_repeated(line)).collect();
        for line in &lines {
            writeln!(text, "- {line}")?;
        }
        if !lines.is_empty() {
            writeln!(text)?;
        }
        write_figure(figure, text)?;
        last = Some(figure);
    }
    if !report.left_out.is_empty() {
        writeln!(text, "## Missing\n")?;
        for left_out in &report.left_out {
            writeln!(text, "- {} in room {}: {}.", left_out.figure, left_out.room, left_out.why)?;
        }
        writeln!(text)?;
    }
    write_sources(report, text)
}

fn write_claims(report: &Report, text: &mut String) -> std::fmt::Result {
    writeln!(text, "## Statements of the paper and findings\n")?;
    writeln!(
        text,
        "| statement | paper | room | here | verdict | calibrated to the paper |\n| --- | --- | --- | --- | --- | --- |"
    )?;
    for claim in &report.claims {
        for (index, finding) in claim.findings.iter().enumerate() {
            let (statement, paper) =
                if index == 0 { (claim.statement.as_str(), claim.paper.as_str()) } else { ("", "") };
            let (room, ours, verdict) = (&finding.room, &finding.ours, finding.verdict.words());
            writeln!(
                text,
                "| {statement} | {paper} | {room} | {ours} | **{verdict}**: {} | {} |",
                finding.why, finding.calibrated
            )?;
        }
    }
    writeln!(text)
}

fn write_figure(figure: &Figure, text: &mut String) -> std::fmt::Result {
    for panel in &figure.panels {
        if panel.series.is_empty() {
            writeln!(text, "- {}", panel.title)?;
        } else if figure.id == inference::ID {
            write_times(panel, text)?;
        } else {
            write_panel(figure, panel, text)?;
        }
    }
    writeln!(text)
}

fn write_panel(figure: &Figure, panel: &Panel, text: &mut String) -> std::fmt::Result {
    // A constant line has two points only; the longest curve determines the rows.
    let Some(longest) = panel.series.iter().max_by_key(|series| series.points.len()) else { return Ok(()) };
    let names: Vec<&str> = panel.series.iter().map(|series| series.name.as_str()).collect();
    writeln!(text, "**{}**: {} against {}\n", panel.title, figure.y.label, figure.x.label)?;
    writeln!(text, "| {} | {} |\n|{}", figure.x.label, names.join(" | "), " --- |".repeat(names.len() + 1))?;
    for place in &longest.points {
        let cell = |series: &Series| {
            let constant = figure.id == sum_rate_iterations::ID && series.points.len() == 2;
            let point = series.at(place.x).or(series.points.first().filter(|_| constant));
            point.map_or("-".into(), |point| number(point.y, point.ci95))
        };
        let cells: Vec<String> = panel.series.iter().map(cell).collect();
        writeln!(text, "| {} | {} |", short(place.x), cells.join(" | "))?;
    }
    writeln!(text)
}

fn write_times(panel: &Panel, text: &mut String) -> std::fmt::Result {
    writeln!(
        text,
        "**{}**\n\n| | median (us) | 99th percentile (us) | sum rate over the oracle's |\n| --- | --- | --- | --- |",
        panel.title
    )?;
    for series in &panel.series {
        if let [median, tail] = series.points[..] {
            writeln!(
                text,
                "| {} | {} | {} | {} |",
                series.name,
                time(median),
                time(tail),
                number(median.y, median.ci95)
            )?;
        }
    }
    writeln!(text)
}

fn write_sources(report: &Report, text: &mut String) -> std::fmt::Result {
    writeln!(text, "## Origin of the figures\n")?;
    writeln!(
        text,
        "| figure | room | parts | commit | from | to | computing time |\n| --- | --- | --- | --- | --- | --- | --- |"
    )?;
    for source in &report.sources {
        writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} | {} |",
            source.figure,
            source.room,
            source.parts,
            source.commits.join(", "),
            source.first,
            source.last,
            duration_text(source.cpu_s)
        )?;
    }
    Ok(())
}

/// A mean with its interval; tiny values as powers of ten.
fn number(value: f64, ci95: Option<f64>) -> String {
    if value != 0.0 && value.abs() < 1e-12 {
        return "under 1e-12".into();
    }
    if value != 0.0 && value.abs() < 1e-2 {
        return format!("{value:.1e}");
    }
    let digits = if value.abs() >= 100.0 {
        1
    } else if value.abs() >= 1.0 {
        2
    } else {
        3
    };
    let mean = format!("{value:.digits$}");
    ci95.map_or(mean.clone(), |ci95| format!("{mean} ± {ci95:.digits$}"))
}

/// A time with its interval, in digits of the same place.
fn time(point: Point) -> String {
    let digits = if point.x >= 10.0 { 0 } else { 2 };
    point.x_ci95.map_or(short(point.x), |ci95| format!("{:.digits$} ± {ci95:.digits$}", point.x))
}

fn short(value: f64) -> String {
    if value.abs() >= 10.0 { format!("{value:.0}") } else { format!("{value}") }
}
