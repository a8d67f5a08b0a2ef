//! The summary of the page `rooms`: one line for each room, and what each change of `hall` costs.

use std::fmt::Write;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use super::super::super::archive::{Archive, Finished};
use super::super::super::table::{Column, Form, Layout};
use super::super::page::Section;

/// The model-based policies of every section; the first is the one that differences refer to.
const MODEL_BASED: [&str; 2] = ["greedy", "fixed-point"];

const ROOMS: [Column; 8] = [
    Column { title: "section", at: "/section", form: Form::Text },
    Column { title: "best with filter", at: "/best", form: Form::Text },
    Column { title: "ratio", at: "/filter/ratio_to_oracle", form: Form::Interval(3) },
    Column { title: "ratio with constant velocity", at: "/constant_velocity/ratio_to_oracle", form: Form::Interval(3) },
    Column { title: "filter - constant velocity, `greedy`", at: "/won", form: Form::Interval(3) },
    Column { title: "QoS met", at: "/filter/qos_met", form: Form::Interval(3) },
    Column { title: "outage time", at: "/filter/outage_time", form: Form::Interval(3) },
    Column { title: "within 95 % ellipse", at: "/coverage", form: Form::Interval(3) },
];

const COSTS: [Column; 5] = [
    Column { title: "section", at: "/section", form: Form::Text },
    Column { title: "compared with", at: "/base", form: Form::Text },
    Column { title: "filter: ratio, difference", at: "/filter_ratio", form: Form::Interval(3) },
    Column { title: "filter: QoS met, difference", at: "/filter_qos", form: Form::Interval(3) },
    Column { title: "constant velocity: ratio, difference", at: "/velocity_ratio", form: Form::Interval(3) },
];

/// Sections that change one thing, and the section without that change.
const CHANGES: [(&str, &str); 16] = [
    ("orientation", "plain"),
    ("orientation-assumed", "plain"),
    ("orientation-reported", "plain"),
    ("orientation-social-force", "social-force"),
    ("orientation-seated", "seated"),
    ("orientation-seated-reported", "seated"),
    ("typical", "plain"),
    ("rough", "plain"),
    ("rough-bodies", "plain"),
    ("rough-tilt", "plain"),
    ("rough-mirrors", "plain"),
    ("rough-led", "plain"),
    ("rough-receiver", "plain"),
    ("rough-floor", "plain"),
    ("rough-tracker", "plain"),
    ("all", "plain"),
];

/// The two tables in Markdown; nothing without a finished section.
///
/// # Errors
/// A finished section whose JSON object lacks a policy or a belief.
pub fn write(sections: &[Section], archive: &Archive) -> Result<String> {
    let find = |name: &str| {
        let section = sections.iter().find(|section| section.name == name)?;
        Some((section.title, archive.find(name)?))
    };
    let rooms = sections.iter().filter_map(|section| find(section.name));
    let rooms = rooms.map(|one| room(one).with_context(|| format!("in section {}", one.1.section)));
    let rooms: Vec<Value> = rooms.collect::<Result<_>>()?;
    if rooms.is_empty() {
        return Ok(String::new());
    }
    let rooms = json!({ "rows": rooms });
    let mut text = String::new();
    writeln!(
        text,
        "## Summary\n\nThe model-based policy with the highest ratio on the filter's belief, and the same policy with constant velocity. \
         The difference is that of `greedy`, paired state by state. Outage time is the share of the users' time below the minimum rate. \
         The last column is the share of true places within the filter's 95 % ellipse.\n\n{}",
        Layout::Rows.markdown(&rooms, &[], &ROOMS)?
    )?;
    let costs = CHANGES.iter().filter_map(|(changed, base)| find(changed).zip(find(base)));
    let costs: Vec<Value> = costs.map(|(changed, base)| cost(changed, base)).collect::<Result<_>>()?;
    if !costs.is_empty() {
        writeln!(
            text,
            "## Costs of orientation and mismatch\n\nFigures of `greedy` in one section minus those in another. The ratio is to the oracle \
             of each room. The interval treats the two rooms as independent.\n\n{}",
            Layout::Rows.markdown(&json!({ "rows": costs }), &[], &COSTS)?
        )?;
    }
    Ok(text)
}

/// A policy's row of a section.
fn row<'a>(finished: &'a Finished, policy: &str, belief: &str) -> Result<&'a Value> {
    let name = format!("{policy}+{belief}");
    finished.output["policies"].get(&name).with_context(|| format!("expected the policy {name}"))
}

/// A line of the first table.
fn room((title, finished): (&str, &Finished)) -> Result<Value> {
    let mut best = (MODEL_BASED[0], row(finished, MODEL_BASED[0], "filter")?);
    let ratio = |row: &Value| row["ratio_to_oracle"]["mean"].as_f64();
    for policy in &MODEL_BASED[1..] {
        let other = row(finished, policy, "filter")?;
        if ratio(other) > ratio(best.1) {
            best = (policy, other);
        }
    }
    // The first policy of the command is `greedy` with the filter, to which its difference refers.
    let lost = &row(finished, MODEL_BASED[0], "constant-velocity")?["difference_ratio"];
    let won = lost["mean"].as_f64().context("expected a difference to greedy+filter")?;
    Ok(json!({
        "section": title, "best": best.0, "filter": best.1,
        "constant_velocity": row(finished, best.0, "constant-velocity")?,
        "won": { "mean": -won, "ci95": lost["ci95"] },
        "coverage": finished.output["beliefs"]["filter"]["coverage_95"],
    }))
}

/// A line of the second table.
fn cost((title, changed): (&str, &Finished), (base_title, base): (&str, &Finished)) -> Result<Value> {
    let difference = |belief: &str, figure: &str| -> Result<Value> {
        let [changed, base] = [changed, base].map(|finished| row(finished, MODEL_BASED[0], belief));
        let [changed, base] = [&changed?[figure], &base?[figure]];
        let number = |value: &Value| value.as_f64().with_context(|| format!("expected a figure {figure}"));
        // A single episode has no interval.
        let interval = changed["ci95"].as_f64().zip(base["ci95"].as_f64()).map(|(one, other)| one.hypot(other));
        Ok(json!({ "mean": number(&changed["mean"])? - number(&base["mean"])?, "ci95": interval }))
    };
    Ok(json!({
        "section": title, "base": base_title,
        "filter_ratio": difference("filter", "ratio_to_oracle")?,
        "filter_qos": difference("filter", "qos_met")?,
        "velocity_ratio": difference("constant-velocity", "ratio_to_oracle")?,
    }))
}

#[cfg(test)]
mod tests {
    use super::super::PAGE;
    use super::*;

    #[test]
    fn changes_name_sections_of_the_page() {
        for name in CHANGES.iter().flat_map(|(changed, base)| [changed, base]) {
            assert!(PAGE.sections.iter().any(|section| section.name == *name), "{name}");
        }
    }

    fn finished(section: &str, greedy: f64, fixed_point: f64) -> Finished {
        let spread = |mean: f64| json!({ "mean": mean, "ci95": 0.003 });
        let row = |ratio: f64| json!({ "ratio_to_oracle": spread(ratio), "qos_met": spread(ratio / 2.0), "outage_time": spread(0.2) });
        let mut slow = row(0.7);
        slow["difference_ratio"] = json!({ "mean": -0.2, "ci95": 0.01 });
        let output = json!({
            "policies": {
                "greedy+filter": row(greedy), "greedy+constant-velocity": slow,
                "fixed-point+filter": row(fixed_point), "fixed-point+constant-velocity": row(0.6),
            },
            "beliefs": { "filter": { "coverage_95": spread(0.94) } },
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
    fn the_best_policy_stands_for_a_room_and_a_change_is_compared_with_the_room_without_it() {
        let mut archive = Archive::new("rooms", false);
        archive.put(finished("plain", 0.9, 0.8));
        archive.put(finished("rough", 0.75, 0.8));
        let text = write(PAGE.sections, &archive).unwrap();
        for expected in [
            "\n| hall | greedy | 0.900 ± 0.003 | 0.700 ± 0.003 | 0.200 ± 0.010 | 0.450 ± 0.003 | 0.200 ± 0.003 | 0.940 ± 0.003 |\n",
            "\n| Mismatch: rough | fixed-point | 0.800 ± 0.003 | 0.600 ± 0.003 | 0.200 ± 0.010 | 0.400 ± 0.003 | 0.200 ± 0.003 | 0.940 ± 0.003 |\n",
            "\n| Mismatch: rough | hall | -0.150 ± 0.004 | -0.075 ± 0.004 | 0.000 ± 0.004 |\n",
        ] {
            assert!(text.contains(expected), "{expected} is missing in:\n{text}");
        }
    }

    #[test]
    fn a_section_without_a_policy_is_refused() {
        let mut archive = Archive::new("rooms", false);
        archive.put(Finished { output: json!({ "policies": {} }), ..finished("plain", 0.9, 0.8) });
        let error = format!("{:#}", write(PAGE.sections, &archive).unwrap_err());
        assert_eq!(error, "in section plain: expected the policy greedy+filter");
        assert_eq!(write(PAGE.sections, &Archive::new("rooms", false)).unwrap(), "");
    }
}
