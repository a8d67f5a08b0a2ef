//! A results page in Markdown, made from the finished sections and nothing else.

use std::fmt::Write;

use anyhow::{Context, Result};
use heliostat_reproduce::command::quoted;
use serde_json::Value;

use super::archive::{Archive, Finished};
use super::pages::{Page, Section};
use super::table::grid;

/// The page; it lists unfinished sections at the end.
///
/// # Errors
/// A finished section whose JSON object is not that of its command.
pub fn markdown(page: &Page, archive: &Archive) -> Result<String> {
    let mut text = format!("# {}\n\n", page.title);
    let quick = if archive.quick { " --quick" } else { "" };
    writeln!(text, "Written by `heliostat results {}{quick}`; do not edit. {}\n", page.name, page.about)?;
    if archive.quick {
        text.push_str(QUICK);
    }
    let Body { sections, bounds } = body(page.sections, archive)?;
    if !bounds.is_empty() {
        text.push_str("## Bounds\n\n\"Found\" is the figure nearest to the limit, or farthest beyond it.\n\n");
        writeln!(text, "{bounds}")?;
    }
    if let Some(summary) = page.summary {
        text.push_str(&summary(page.sections, archive).context("in the summary")?);
    }
    text.push_str(&sections);
    Ok(text.trim_end().to_owned() + "\n")
}

/// The parts of a page that its sections write.
pub struct Body {
    /// The finished sections, and the names of the unfinished ones.
    pub sections: String,
    /// The table of bounds; empty without one.
    pub bounds: String,
}

/// The sections of a page.
///
/// # Errors
/// As [`markdown`].
pub fn body(sections: &[Section], archive: &Archive) -> Result<Body> {
    let (mut text, mut bounds, mut missing) = (String::new(), Vec::new(), Vec::new());
    for section in sections {
        match archive.find(section.name) {
            Some(finished) => {
                write_section(section, finished, &mut text, &mut bounds)
                    .with_context(|| format!("in section {}", section.name))?;
            }
            None => missing.push(section.name),
        }
    }
    if !missing.is_empty() {
        writeln!(text, "## Not finished\n\n{}", missing.join(", "))?;
    }
    if !bounds.is_empty() {
        bounds.insert(0, ["section", "bound", "found", "verdict"].map(String::from).to_vec());
    }
    Ok(Body { sections: text, bounds: if bounds.is_empty() { String::new() } else { grid(&bounds) } })
}

/// The note at the head of a page of a quick run.
pub const QUICK: &str = "**A quick run: it shows that every command works. Its figures mean little.**\n\n";

fn write_section(
    section: &Section,
    finished: &Finished,
    text: &mut String,
    bounds: &mut Vec<Vec<String>>,
) -> Result<()> {
    let Finished { arguments, made, commit, machine, load, seconds, output, .. } = finished;
    let load = load.map_or(String::new(), |load| format!(", load {load:.1}"));
    writeln!(text, "## {}\n\n{}\n", section.title, section.about)?;
    writeln!(text, "```\n{}\n```\n", command(arguments))?;
    writeln!(text, "{}{made}, commit {commit}, {machine}{load}, {seconds:.0} s.\n", states(output))?;
    writeln!(text, "{}", section.layout.markdown(output, arguments, section.columns)?)?;
    let rows = section.layout.rows(output, arguments)?;
    for bound in section.bounds {
        let verdict = bound.judge(&rows)?;
        let met = if verdict.met { "met" } else { "not met" };
        bounds.push(vec![section.title.into(), bound.what.into(), significant(verdict.worst), met.into()]);
    }
    Ok(())
}

/// The command line of a section, for a shell.
pub fn command(arguments: &[String]) -> String {
    let words = arguments.iter().map(|word| quoted(word));
    ["heliostat".to_owned()].into_iter().chain(words).collect::<Vec<_>>().join(" ")
}

/// The states and seeds behind the figures of `eval` and `calibrate`.
fn states(output: &Value) -> String {
    let report = output.pointer("/reports/0/report").unwrap_or(output);
    let number = |name: &str| report[name].as_u64();
    match (number("states"), number("seeds"), number("seed")) {
        (Some(states), Some(seeds), Some(seed)) => format!("States per seed: {states}. Seeds: {seeds}, from {seed}. "),
        _ => String::new(),
    }
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

    use super::super::bound::{Bound, Limit};
    use super::super::table::{Column, Form, Layout};
    use super::*;

    static PAGE: Page = Page {
        name: "example",
        title: "An example",
        about: "Times in us.",
        summary: Some(|sections, archive| {
            Ok(format!("## Summary\n\n{} of {}.\n\n", archive.sections.len(), sections.len()))
        }),
        sections: &[section("first"), section("second")],
    };

    const fn section(name: &'static str) -> Section {
        Section {
            name,
            title: "The loop",
            about: "What is measured.",
            command: "bench loop",
            full: "",
            quick: "--seconds 1",
            layout: Layout::Rows,
            columns: &[Column { title: "p50", at: "/p50", form: Form::Number(1) }],
            bounds: &[Bound { what: "p50 at most 2", policy: "", at: "/p50", limit: Limit::AtMost(2.0) }],
        }
    }

    #[test]
    fn a_page_holds_command_origin_table_verdict_and_what_is_missing() {
        let mut archive = Archive::new("example", true);
        archive.put(Finished {
            section: "first".into(),
            arguments: PAGE.sections[0].arguments(true),
            made: "2026-11-22T12:00:00Z".into(),
            commit: "abc".into(),
            machine: "2 cores".into(),
            load: Some(1.25),
            seconds: 3.2,
            output: json!({ "rows": [{ "p50": 2.31 }] }),
        });
        let text = markdown(&PAGE, &archive).unwrap();
        for expected in [
            "Written by `heliostat results example --quick`",
            "| The loop | p50 at most 2 | 2.31 | not met |\n\n## Summary\n\n1 of 2.\n\n## The loop\n",
            "heliostat bench loop --seconds 1\n",
            "2026-11-22T12:00:00Z, commit abc, 2 cores, load 1.2, 3 s.",
            "| p50 |\n| --- |\n| 2.3 |\n",
            "## Not finished\n\nsecond\n",
        ] {
            assert!(text.contains(expected), "{expected} is missing in:\n{text}");
        }
    }

    #[test]
    fn figures_of_verdicts_have_four_digits() {
        let cases = [
            (0.0, "0"),
            (-1e-17, "0"),
            (1.23456, "1.235"),
            (0.00087654, "0.0008765"),
            (672.4, "672.4"),
            (12345.6, "12346"),
        ];
        for (value, expected) in cases {
            assert_eq!(significant(value), expected);
        }
    }
}
