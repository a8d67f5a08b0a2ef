//! A results page in Markdown, made from the finished sections and nothing else.

use std::fmt::Write;

use anyhow::{Context, Result};
use serde_json::Value;

use super::archive::{Archive, Finished};
use super::pages::{Page, Section, Training, trainings};
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
        writeln!(text, "**A quick run: it shows that every command works. Its figures mean little.**\n")?;
    }
    let sections = page.sections.iter().map(|section| (section, archive.find(section.name)));
    let (mut body, mut bounds, mut missing) = (String::new(), Vec::new(), Vec::new());
    for (section, finished) in sections {
        match finished {
            Some(finished) => {
                write_section((page, section), finished, &mut body, &mut bounds)
                    .with_context(|| format!("in section {}", section.name))?;
            }
            None => missing.push(section.name),
        }
    }
    if !bounds.is_empty() {
        text.push_str("## Bounds\n\n\"Found\" is the figure nearest to the limit, or farthest beyond it.\n\n");
        bounds.insert(0, ["section", "bound", "found", "verdict"].map(String::from).to_vec());
        writeln!(text, "{}", grid(&bounds))?;
    }
    text.push_str(&body);
    if !missing.is_empty() {
        writeln!(text, "## Not finished\n\n{}", missing.join(", "))?;
    }
    Ok(text.trim_end().to_owned() + "\n")
}

fn write_section(
    (page, section): (&Page, &Section),
    finished: &Finished,
    text: &mut String,
    bounds: &mut Vec<Vec<String>>,
) -> Result<()> {
    let Finished { arguments, made, commit, machine, seconds, output, .. } = finished;
    writeln!(text, "## {}\n\n{}\n", section.title, section.about)?;
    let before = trainings(page, arguments).into_iter().map(Training::arguments);
    let commands: Vec<String> =
        before.chain([arguments.clone()]).map(|arguments| format!("heliostat {}\n", arguments.join(" "))).collect();
    writeln!(text, "```\n{}```\n", commands.concat())?;
    writeln!(text, "{}{made}, commit {commit}, {machine}, {seconds:.0} s.\n", states(output))?;
    writeln!(text, "{}", section.layout.markdown(output, arguments, section.columns)?)?;
    let rows = section.layout.rows(output, arguments)?;
    for bound in section.bounds {
        let verdict = bound.judge(&rows)?;
        let met = if verdict.met { "met" } else { "not met" };
        bounds.push(vec![section.title.into(), bound.what.into(), significant(verdict.worst), met.into()]);
    }
    Ok(())
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
            seconds: 3.2,
            output: json!({ "rows": [{ "p50": 2.31 }] }),
        });
        let text = markdown(&PAGE, &archive).unwrap();
        for expected in [
            "Written by `heliostat results example --quick`",
            "| The loop | p50 at most 2 | 2.31 | not met |",
            "heliostat bench loop --seconds 1\n",
            "2026-11-22T12:00:00Z, commit abc, 2 cores, 3 s.",
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
