//! The summary of the page `combinations`: three matrices of mobility and orientation by mismatch.

use std::fmt::Write;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use super::super::super::archive::{Archive, Finished};
use super::super::super::table::{Form, cell, grid};
use super::super::page::Section;

/// The values of `mismatch.level` in the order of the sections, and of the columns.
pub(super) const MISMATCHES: [&str; 3] = ["none", "typical", "rough"];

const POLICIES: [&str; 2] = ["greedy", "fixed-point"];
const FIGURE: Form = Form::Interval(3);

/// What a matrix shows of a finished section.
type Cell = fn(&Finished) -> Result<String>;

const MATRICES: [(&str, &str, Cell); 3] = [
    (
        "Ratio (minimum rates met)",
        "The highest ratio to the oracle of both policies with the filter's belief. In parentheses: the share of minimum \
         rates that this policy meets.",
        best,
    ),
    (
        "What the filter adds",
        "The ratio of `greedy` with the filter minus that with constant velocity, paired state by state.",
        |section| {
            // Differences in the output are to the first row, `greedy` with the filter.
            let lost = difference(section, "greedy+constant-velocity")?;
            let mean = lost["mean"].as_f64().context("expected a mean")?;
            Ok(cell(&json!({ "mean": -mean, "ci95": lost["ci95"] }), FIGURE))
        },
    ),
    (
        "What reports and belief lose",
        "The ratio of `greedy` that knows the true room in the middle of the command's time in force (`true-future`), minus \
         that with the filter, paired state by state.",
        |section| Ok(cell(difference(section, "greedy+true-future")?, FIGURE)),
    ),
];

/// The matrices in Markdown; nothing without a finished section.
///
/// # Errors
/// A finished section whose JSON object lacks a policy or a belief.
pub fn write(sections: &[Section], archive: &Archive) -> Result<String> {
    if !sections.iter().any(|section| archive.find(section.name).is_some()) {
        return Ok(String::new());
    }
    let mut text =
        String::from("## Summary\n\nColumns: `mismatch.level`. A dash stands for a section that has not finished.\n\n");
    for (title, about, of_section) in MATRICES {
        let mut lines = vec![["mobility, receivers"].iter().chain(&MISMATCHES).map(ToString::to_string).collect()];
        for row in sections.chunks(MISMATCHES.len()) {
            let mut line = vec![row[0].title.to_owned()];
            for section in row {
                let figure = archive.find(section.name).map_or(Ok("-".into()), of_section);
                line.push(figure.with_context(|| format!("in section {}", section.name))?);
            }
            lines.push(line);
        }
        writeln!(text, "### {title}\n\n{about}\n\n{}", grid(&lines))?;
    }
    Ok(text)
}

/// The row of a policy with a belief.
fn row<'a>(section: &'a Finished, name: &str) -> Result<&'a Value> {
    section.output["policies"].get(name).with_context(|| format!("expected the policy {name}"))
}

/// The difference of a row's ratio to that of `greedy` with the filter.
fn difference<'a>(section: &'a Finished, name: &str) -> Result<&'a Value> {
    row(section, name)?.get("difference_ratio").with_context(|| format!("expected a difference of {name}"))
}

/// The figures of the policy with the highest ratio.
fn best(section: &Finished) -> Result<String> {
    let rows = POLICIES.map(|policy| row(section, &format!("{policy}+filter")));
    let mut best: Option<(f64, &Value)> = None;
    for row in rows {
        let row = row?;
        let ratio = row["ratio_to_oracle"]["mean"].as_f64().context("expected a ratio")?;
        if best.is_none_or(|(highest, _)| ratio > highest) {
            best = Some((ratio, row));
        }
    }
    let (_, row) = best.context("expected a policy")?;
    Ok(format!("{} ({})", cell(&row["ratio_to_oracle"], FIGURE), cell(&row["qos_met"], FIGURE)))
}

#[cfg(test)]
mod tests {
    use super::super::PAGE;
    use super::*;

    #[test]
    fn a_row_of_a_matrix_holds_the_sections_that_differ_by_the_mismatch_alone() {
        assert_eq!(PAGE.sections.len(), 7 * 2 * MISMATCHES.len());
        for row in PAGE.sections.chunks(MISMATCHES.len()) {
            for (section, mismatch) in row.iter().zip(MISMATCHES) {
                let (name, set) = match mismatch {
                    "none" => (String::new(), String::new()),
                    level => (format!("-{level}"), format!(" --set mismatch.level={level}")),
                };
                assert_eq!(section.name, format!("{}{name}", row[0].name));
                assert_eq!(section.command, format!("{}{set}", row[0].command));
                assert!(section.title.starts_with(row[0].title), "{}", section.title);
            }
        }
        for pair in PAGE.sections.chunks(2 * MISMATCHES.len()) {
            let [upright, orientation] = [&pair[0], &pair[MISMATCHES.len()]];
            assert_eq!(orientation.command, format!("{} --set users.orientation={{}}", upright.command));
            assert_eq!(orientation.title.strip_suffix("orientation"), upright.title.strip_suffix("upright"));
        }
    }

    fn finished(section: &str) -> Finished {
        let spread = |mean: f64| json!({ "mean": mean, "ci95": 0.004 });
        let row = |ratio: f64, difference: f64| json!({ "ratio_to_oracle": spread(ratio), "qos_met": spread(ratio / 2.0), "difference_ratio": spread(difference) });
        let output = json!({
            "policies": {
                "greedy+filter": { "ratio_to_oracle": spread(0.9), "qos_met": spread(0.45) },
                "greedy+constant-velocity": row(0.7, -0.2),
                "greedy+true-future": row(0.98, 0.08),
                "fixed-point+filter": row(0.92, 0.02),
            },
        });
        Finished {
            section: section.into(),
            arguments: Vec::new(),
            made: String::new(),
            commit: String::new(),
            machine: String::new(),
            load: None,
            seconds: 1.0,
            output,
        }
    }

    #[test]
    fn each_matrix_has_its_figure_in_the_row_of_the_room_and_the_column_of_the_mismatch() {
        let mut archive = Archive::new("combinations", false);
        assert_eq!(write(PAGE.sections, &archive).unwrap(), "");
        archive.put(finished("seated-orientation-rough"));
        let text = write(PAGE.sections, &archive).unwrap();
        let line = |figure: &str| format!("\n| Seated, orientation | - | - | {figure} |\n");
        let expected = ["0.920 ± 0.004 (0.460 ± 0.004)", "0.200 ± 0.004", "0.080 ± 0.004"];
        let mut rest = text.as_str();
        for figure in expected {
            rest = rest.split_once(&line(figure)).unwrap_or_else(|| panic!("{figure} is missing in:\n{text}")).1;
        }
    }

    #[test]
    fn a_section_without_a_policy_is_refused() {
        let mut archive = Archive::new("combinations", false);
        archive.put(Finished { output: json!({ "policies": {} }), ..finished("seated") });
        let error = format!("{:#}", write(PAGE.sections, &archive).unwrap_err());
        assert_eq!(error, "in section seated: expected the policy greedy+filter");
    }
}
