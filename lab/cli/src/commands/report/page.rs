//! A report in Markdown, made from the finished sections and nothing else.

use std::fmt::Write;

use anyhow::{Context, Result};
use heliostat_files::shell_word;
use heliostat_learn::comparison::EPISODES_MIN;
use serde_json::Value;

use crate::commands::eval::{ABOVE_ONE, exceeds_one};

use super::archive::{Archive, Finished};
use super::bound::OPEN;
use super::definition::{Definition, Section};
use super::summary;
use super::table::{check_columns, crosses_note, grid, markdown, near_best_note, rows, texts};

/// A page, and why it does not show all that is finished.
pub struct Page {
    /// In Markdown.
    pub text: String,
    /// One for each section or summary that is not shown completely.
    pub problems: Vec<String>,
}

/// The page; it lists unfinished sections at the end. A section whose JSON object is not that of its tables
/// or bounds has the reason in their place.
///
/// # Errors
/// None of the report: text that cannot be formatted.
pub fn write(definition: &Definition, archive: &Archive) -> Result<Page> {
    let (mut sections, mut bounds, mut missing) = (String::new(), Vec::new(), Vec::new());
    let mut problems = Vec::new();
    for section in &definition.sections {
        let Some(finished) = archive.find(&section.name) else {
            missing.push(section.name.as_str());
            continue;
        };
        let shown = write_section(definition, section, finished, &mut sections)
            .and_then(|()| judge(section, finished, &mut bounds))
            .and_then(|()| check(definition, section, finished));
        if let Err(error) = shown {
            writeln!(sections, "Not shown: {error:#}.\n")?;
            problems.push(format!("in section {}: {error:#}", section.name));
        }
    }
    let mut text = format!("# {}\n\n{}\n\n", definition.title, definition.about);
    if archive.quick {
        text.push_str("**A quick run: it shows that every command works. Its figures mean little.**\n\n");
    }
    if !bounds.is_empty() {
        bounds.insert(0, ["section", "bound", "found", "verdict"].map(String::from).to_vec());
        text.push_str("## Bounds\n\n\"Found\" is the figure nearest to the limit, or farthest beyond it.");
        if bounds.iter().flatten().any(|cell| cell.ends_with(OPEN)) {
            write!(text, " Where a verdict is \"{OPEN}\", the 95 % interval of that figure contains the limit.")?;
        }
        text.push_str("\n\n");
        writeln!(text, "{}", grid(&bounds))?;
    }
    for one in &definition.summary {
        match summary::write(one, definition, archive) {
            Ok(table) => text.push_str(&table),
            Err(error) => problems.push(format!("in {}: {error:#}", one.title)),
        }
    }
    text.push_str(&sections);
    if !missing.is_empty() {
        writeln!(text, "## Not finished\n\n{}", missing.join(", "))?;
    }
    Ok(Page { text: text.trim_end().to_owned() + "\n", problems })
}

fn write_section(definition: &Definition, section: &Section, finished: &Finished, text: &mut String) -> Result<()> {
    let Finished { arguments, made, commit, machine, load, seconds, output, .. } = finished;
    let load = load.map_or(String::new(), |load| format!(", load {load:.1}"));
    writeln!(text, "## {}\n\n{}\n\n```\n{}\n```\n", section.title, section.about, command(arguments))?;
    writeln!(text, "{}{made}, commit {commit}, {machine}{load}, {seconds:.0} s.\n", states(output))?;
    let mut tables = String::new();
    for table in &section.tables {
        let rows = rows(output, &table.rows, arguments)?;
        let heading = heading(output, &table.rows);
        writeln!(tables, "{}", markdown(&rows, definition.columns(&table.columns)?, heading.as_deref()))?;
    }
    for note in notes(output, &tables) {
        writeln!(text, "{note}\n")?;
    }
    text.push_str(&tables);
    if has_ratio_above_one(output) {
        writeln!(text, "Note that {ABOVE_ONE}.\n")?;
    }
    Ok(())
}

fn judge(section: &Section, finished: &Finished, bounds: &mut Vec<Vec<String>>) -> Result<()> {
    for bound in &section.bounds {
        let pointer = bound.rows.as_ref().or(section.tables.first().map(|table| &table.rows)).context("no rows")?;
        let verdict = bound.judge(&rows(&finished.output, pointer, &finished.arguments)?)?;
        bounds.push(vec![section.title.clone(), bound.what.clone(), significant(verdict.worst), verdict.words()]);
    }
    Ok(())
}

/// Refuses columns whose figure no row of their table has.
fn check(definition: &Definition, section: &Section, finished: &Finished) -> Result<()> {
    section.tables.iter().try_for_each(|table| {
        check_columns(&rows(&finished.output, &table.rows, &finished.arguments)?, definition.columns(&table.columns)?)
    })
}

/// A command line for a shell.
pub fn command(arguments: &[String]) -> String {
    arguments.iter().map(|word| shell_word(word)).collect::<Vec<_>>().join(" ")
}

/// The states and seeds behind the figures of `eval` and `calibrate`.
fn states(output: &Value) -> String {
    let report = output.pointer("/reports/0/report").unwrap_or(output);
    let number = |name: &str| report[name].as_u64();
    match (number("states"), number("seeds"), number("seed")) {
        (Some(states), Some(seeds), Some(seed)) => {
            let episodes = number("episodes").map_or(String::new(), |episodes| {
                let few = if episodes < EPISODES_MIN as u64 { ", too few for its intervals" } else { "" };
                format!("Episodes: {episodes}{few}. ")
            });
            format!("States per seed: {states}. Seeds: {seeds}, from {seed}. {episodes}")
        }
        _ => String::new(),
    }
}

/// The heading of the names of rows, as [`rows`] makes them; `None` where they have no names.
fn heading(output: &Value, pointer: &str) -> Option<String> {
    match (output["keys"].as_array(), output.pointer(pointer)) {
        (Some(keys), _) => Some(format!("{}: policy", texts(keys))),
        (None, Some(Value::Array(_))) => None,
        (None, _) => Some(String::new()),
    }
}

/// Whether a policy has a larger sum rate than the oracle, in the digits of a table.
fn has_ratio_above_one(output: &Value) -> bool {
    let rows = of_points(output).into_iter().filter_map(|report| report["policies"].as_object());
    let mut ratios = rows.flat_map(|policies| policies.values()).map(|row| &row["ratio_to_oracle"]["mean"]);
    ratios.any(|ratio| ratio.as_f64().is_some_and(exceeds_one))
}

/// The reports of a sweep, or the output itself.
fn of_points(output: &Value) -> Vec<&Value> {
    let reports = output["reports"].as_array().map(|reports| reports.iter().map(|report| &report["report"]).collect());
    reports.unwrap_or_else(|| vec![output])
}

/// The methods whose conditions the rooms do not meet, and what the marks of the tables mean.
fn notes(output: &Value, tables: &str) -> Vec<String> {
    let mut notes: Vec<String> = Vec::new();
    for condition in of_points(output).into_iter().filter_map(|report| report["conditions"].as_array()).flatten() {
        let part = |name: &str| condition[name].as_str().unwrap_or_default();
        let note =
            format!("Condition: {} does not apply: {}: {}.", part("method"), part("because"), part("consequence"));
        if !notes.contains(&note) {
            notes.push(note);
        }
    }
    notes.extend(crosses_note(tables));
    notes.extend(near_best_note(tables));
    notes
}

/// Four significant digits.
fn significant(value: f64) -> String {
    if value.abs() < 1e-9 {
        return "0".into();
    }
    let digits = (3 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const REPORT: &str = r#"
        name = "example"
        title = "An example"
        about = "Times in us."
        columns.time = ["p50 | /p50 | .1"]
        columns.change = ["ratio, difference | /policies/greedy/ratio | ±2"]
        columns.mean = ["sections | /sections | text | optional", "ratio | /ratio | ±2", "largest p99 | /us/p99 | .0"]
        [[summary]]
        title = "Changes"
        about = "Differences."
        of = "changes"
        columns = "change"
        [[summary]]
        title = "Standings"
        about = "Means."
        of = "rows"
        columns = "mean"
        [[section]]
        name = "first"
        title = "The loop"
        about = "What is measured."
        command = "heliostat bench loop"
        quick = "--seconds 1"
        tables = [{ rows = "/rows", columns = "time" }]
        bound = [{ what = "p50 at most 2", at = "/p50", at_most = 2.0 }]
        [[section]]
        name = "plain"
        title = "Plain"
        about = "A room."
        command = "heliostat-lab eval --policies greedy"
        tables = [{ rows = "/policies", columns = "mean" }]
        [[section]]
        name = "rough"
        title = "Rough"
        about = "A room."
        command = "heliostat-lab eval --policies greedy"
        base = "plain"
        tables = [{ rows = "/policies", columns = "mean" }]
        [[section]]
        name = "last"
        title = "Last"
        about = "Not run."
        command = "heliostat bench decide"
        tables = [{ rows = "/rows", columns = "time" }]
    "#;

    fn finished(section: &str, output: Value) -> Finished {
        Finished {
            section: section.into(),
            arguments: ["heliostat", "bench", "loop", "--seconds", "1"].map(String::from).into(),
            made: "2026-11-22T12:00:00Z".into(),
            commit: "abc".into(),
            machine: "2 cores".into(),
            load: Some(1.25),
            seconds: 3.2,
            output,
        }
    }

    #[test]
    fn a_page_holds_command_origin_tables_verdicts_and_what_is_missing() {
        let room = |ratio: f64, p99: f64| {
            let row = |ratio: f64| json!({ "ratio": { "mean": ratio, "ci95": 0.03 }, "us": { "p99": p99 } });
            json!({ "oracle": row(1.0), "policies": { "greedy": row(ratio) } })
        };
        let mut archive = Archive::new("example", true);
        archive.put(finished("first", json!({ "rows": [{ "p50": 2.31 }] })));
        archive.put(finished("rough", room(0.5, 7.0)));
        archive.put(finished("plain", room(0.9, 3.0)));
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("example.toml");
        std::fs::write(&file, REPORT).unwrap();
        let definition = Definition::read(&file, &[]).unwrap();
        let Page { text, problems } = write(&definition, &archive).unwrap();
        assert!(problems.is_empty(), "{problems:?}");
        for expected in [
            "# An example\n\nTimes in us.\n\n**A quick run",
            "| The loop | p50 at most 2 | 2.31 | not met |\n\n## Changes\n\nDifferences.\n",
            "|  | ratio, difference |\n| --- | --- |\n| Rough, compared with Plain (independent) | -0.40 ± 0.04 |\n",
            "| (oracle) | 2 | 1.00 ± 0.03 | 7 |\n| greedy | 2 | 0.70 ± 0.03 | 7 |\n",
            "## The loop\n\nWhat is measured.\n\n```\nheliostat bench loop --seconds 1\n```\n",
            "2026-11-22T12:00:00Z, commit abc, 2 cores, load 1.2, 3 s.\n\n| p50 |\n| --- |\n| 2.3 |\n",
            "## Not finished\n\nlast\n",
        ] {
            assert!(text.contains(expected), "{expected} is missing in:\n{text}");
        }
    }

    #[test]
    fn a_section_that_cannot_be_shown_leaves_the_others_on_the_page() {
        let mut archive = Archive::new("example", false);
        archive.put(finished("first", json!({ "keys": ["users.count"], "reports": [] })));
        archive.put(finished("last", json!({ "rows": [{ "p50": 1.5 }] })));
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("example.toml");
        std::fs::write(&file, REPORT).unwrap();
        let Page { text, problems } = write(&Definition::read(&file, &[]).unwrap(), &archive).unwrap();
        let reason = "the output has nothing at /rows; it has /keys, /reports";
        assert_eq!(problems, [format!("in section first: {reason}")]);
        assert!(text.contains(&format!("Not shown: {reason}.\n\n## Last")), "{text}");
        assert!(text.contains("| p50 |\n| --- |\n| 1.5 |\n"), "{text}");
    }

    #[test]
    fn a_column_that_no_row_has_is_a_problem_of_its_section_beside_the_other_columns() {
        let mut archive = Archive::new("example", false);
        archive.put(finished("first", json!({ "rows": [{ "p50": 1.5, "p99": 2.5 }] })));
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("example.toml");
        let columns = r#"time = ["p50 | /p50 | .1", "p99 | /p9 | .1"]"#;
        std::fs::write(&file, REPORT.replace(r#"time = ["p50 | /p50 | .1"]"#, columns)).unwrap();
        let Page { text, problems } = write(&Definition::read(&file, &[]).unwrap(), &archive).unwrap();
        let [problem] = &problems[..] else { panic!("{problems:?}") };
        let reason = "column \"p99\": no row has such a figure at /p9: a row has p50, p99; correct the pointer";
        assert!(problem.starts_with(&format!("in section first: {reason}")), "{problem}");
        assert!(text.contains("| 1.5 | - |\n\nNot shown: column \"p99\""), "{text}");
        assert!(text.contains("| The loop | p50 at most 2 | 1.5 | met |"), "{text}");
    }

    #[test]
    fn a_page_explains_a_verdict_that_is_open_within_the_interval() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("example.toml");
        let report =
            REPORT.replace("p50 | /p50 | .1", "p50 | /p50 | ±1").replace("at = \"/p50\"", "at = \"/p50/mean\"");
        std::fs::write(&file, report).unwrap();
        let definition = Definition::read(&file, &[]).unwrap();
        let page = |ci95: f64| {
            let mut archive = Archive::new("example", false);
            archive.put(finished("first", json!({ "rows": [{ "p50": { "mean": 2.31, "ci95": ci95 } }] })));
            write(&definition, &archive).unwrap().text
        };
        let (wide, narrow) = (page(0.4), page(0.2));
        for part in
            ["| 2.31 | not met, open within the interval |", "the 95 % interval of that figure contains the limit."]
        {
            assert!(wide.contains(part) && !narrow.contains(part), "{part}: {wide}");
        }
        assert!(narrow.contains("farthest beyond it.\n\n| section") && narrow.contains("| not met |"), "{narrow}");
    }

    #[test]
    fn episodes_conditions_and_marked_intervals_are_stated_once() {
        let condition = json!({ "method": "the filter", "because": "no gains", "consequence": "no headings" });
        let report = json!({
            "states": 40, "seeds": 2, "seed": 1, "episodes": 4, "conditions": [condition],
            "oracle": { "ratio": { "mean": 0.0, "ci95": 0.1, "crosses_bound": true } },
        });
        let swept = json!({ "reports": [{ "report": report }, { "report": report }] });
        assert_eq!(states(&swept), "States per seed: 40. Seeds: 2, from 1. Episodes: 4, too few for its intervals. ");
        let found = notes(&swept, "| 0.00 ± 0.10\\* |");
        assert_eq!(found.len(), 2, "{found:?}");
        assert_eq!(found[0], "Condition: the filter does not apply: no gains: no headings.");
        assert!(found[1].contains("beyond what the figure can be"), "{found:?}");
        assert_eq!(notes(&swept, "| 0.00 |").len(), 1, "no table has a mark");
        assert!(notes(&json!({ "rows": [] }), "").is_empty());
    }

    #[test]
    fn a_sweep_has_its_keys_as_heading_and_a_ratio_above_one_is_explained() {
        let swept = |ratio: f64| {
            let policies = json!({ "flat": { "ratio_to_oracle": { "mean": ratio } } });
            json!({ "keys": ["users.count", "led.power_w"], "reports": [{ "report": { "policies": policies } }] })
        };
        assert_eq!(heading(&swept(1.0), "/reports").as_deref(), Some("users.count, led.power_w: policy"));
        assert_eq!(heading(&json!({ "rows": [] }), "/rows"), None);
        assert_eq!(heading(&json!({ "policies": {} }), "/policies").as_deref(), Some(""));
        assert!(has_ratio_above_one(&swept(1.001)) && !has_ratio_above_one(&swept(1.0)));
        assert!(has_ratio_above_one(&swept(1.001)["reports"][0]["report"]));
    }

    #[test]
    fn figures_of_verdicts_have_four_digits() {
        for (value, expected) in [
            (0.0, "0"),
            (-1e-17, "0"),
            (1.23456, "1.235"),
            (0.00087654, "0.0008765"),
            (672.4, "672.4"),
            (12345.6, "12346"),
        ] {
            assert_eq!(significant(value), expected);
        }
    }
}
