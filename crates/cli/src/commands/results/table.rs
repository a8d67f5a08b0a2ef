//! Tables of results pages, rendered from the JSON objects of `eval`, `calibrate` and `bench`.

use anyhow::{Context, Result};
use serde_json::{Map, Value};

/// Name of the oracle's row.
pub const ORACLE: &str = "(oracle)";
/// JSON pointer of the ratio to the oracle.
const RATIO: &str = "/ratio_to_oracle";

/// How the rows of a table lie in a command's JSON object.
#[derive(Clone, Copy, Debug)]
pub enum Layout {
    /// `heliostat eval`: one row for the oracle and one a policy.
    Policies,
    /// `heliostat eval --closed-loop`: the same, and a second table of the beliefs' own quality.
    PoliciesAndBeliefs,
    /// `heliostat eval --sweep`: one row a value of the swept key, with each column for each policy.
    Sweep,
    /// `heliostat bench` and `heliostat calibrate`: the array `rows`.
    Rows,
    /// `heliostat bench env`: the same, and a second table of the array `moving`, whose rows have the
    /// name `moving`.
    RowsAndMoving,
}

/// One column.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Its heading.
    pub title: &'static str,
    /// JSON pointer of its figure within a row.
    pub at: &'static str,
    /// How the figure is written.
    pub form: Form,
}

/// How a figure is written.
#[derive(Clone, Copy, Debug)]
pub enum Form {
    /// As it stands.
    Text,
    /// A number with so many digits after the point.
    Number(usize),
    /// `mean` and `ci95` of an object, with so many digits after the point.
    Interval(usize),
}

/// The quality of a belief about the users.
const BELIEF: [Column; 6] = [
    Column { title: "place error, median (cm)", at: "/place_error_median_cm", form: Form::Number(1) },
    Column { title: "place error, mean (cm)", at: "/place_error_cm", form: Form::Interval(1) },
    Column { title: "heading error, walking (deg)", at: "/heading_error_walking_deg", form: Form::Interval(1) },
    Column { title: "heading error, standing (deg)", at: "/heading_error_standing_deg", form: Form::Interval(1) },
    Column { title: "within 50 % ellipse", at: "/coverage_50", form: Form::Interval(3) },
    Column { title: "within 95 % ellipse", at: "/coverage_95", form: Form::Interval(3) },
];

/// The speed of a room with moving users, beside that of the same room with simpler ones.
const MOVING: [Column; 5] = [
    Column { title: "users with", at: "/movement", form: Form::Text },
    Column { title: "step (s)", at: "/step_s", form: Form::Text },
    Column { title: "steps/s", at: "/steps_per_s", form: Form::Number(0) },
    Column { title: "random waypoint, upright: steps/s", at: "/reference_steps_per_s", form: Form::Number(0) },
    Column { title: "ratio", at: "/ratio", form: Form::Number(2) },
];

/// One row by its name: the policy, the belief or the room, or nothing where rows have no names.
pub type Row = (String, Value);

impl Layout {
    /// The rows of a JSON object; those of policies and beliefs in the order in which `arguments` name
    /// them.
    ///
    /// # Errors
    /// A JSON object of another command.
    pub fn rows(self, output: &Value, arguments: &[String]) -> Result<Vec<Row>> {
        match self {
            Self::Rows => {
                let rows = output["rows"].as_array().context("expected an array `rows`")?;
                let name = |row: &Value| row["policy"].as_str().or(row["room"].as_str()).unwrap_or_default().to_owned();
                Ok(rows.iter().map(|row| (name(row), row.clone())).collect())
            }
            Self::RowsAndMoving => Ok([Self::Rows.rows(output, arguments)?, moving(output)?].concat()),
            Self::Policies => policies(output, arguments),
            Self::PoliciesAndBeliefs => Ok([policies(output, arguments)?, beliefs(output, arguments)?].concat()),
            Self::Sweep => {
                let reports = output["reports"].as_array().context("expected an array `reports`")?;
                let rows = reports.iter().map(|swept| policies(&swept["report"], arguments));
                Ok(rows.collect::<Result<Vec<_>>>()?.concat())
            }
        }
    }

    /// The table in Markdown.
    ///
    /// # Errors
    /// A JSON object of another command.
    pub fn markdown(self, output: &Value, arguments: &[String], columns: &[Column]) -> Result<String> {
        let mut lines = Vec::new();
        match self {
            Self::Rows => {
                lines.push(columns.iter().map(|column| column.title.to_owned()).collect());
                for (_, row) in self.rows(output, arguments)? {
                    lines.push(cells(&row, columns));
                }
            }
            Self::RowsAndMoving => {
                let moving = moving(output)?.iter().map(|(_, row)| cells(row, &MOVING)).collect::<Vec<_>>();
                let titles = MOVING.iter().map(|column| column.title.to_owned()).collect();
                return Ok(Self::Rows.markdown(output, arguments, columns)?
                    + "\n"
                    + &grid(&[vec![titles], moving].concat()));
            }
            Self::Policies => lines = named_lines(policies(output, arguments)?, columns),
            Self::PoliciesAndBeliefs => {
                let beliefs = grid(&named_lines(beliefs(output, arguments)?, &BELIEF));
                return Ok(grid(&named_lines(policies(output, arguments)?, columns)) + "\n" + &beliefs);
            }
            Self::Sweep => {
                let key = output["sweep"].as_str().context("expected the swept key in `sweep`")?;
                for swept in output["reports"].as_array().context("expected an array `reports`")? {
                    let rows = policies(&swept["report"], arguments)?;
                    // The oracle's ratio to itself is no information.
                    let shown = |name: &str| {
                        let of_oracle = name == ORACLE;
                        columns.iter().filter(|column| !(of_oracle && column.at == RATIO)).copied().collect::<Vec<_>>()
                    };
                    if lines.is_empty() {
                        let titles = rows.iter().flat_map(|(name, _)| {
                            shown(name).into_iter().map(move |column| format!("{name}: {}", column.title))
                        });
                        lines.push([format!("`{key}`")].into_iter().chain(titles).collect());
                    }
                    let value = cell(&swept["value"], Form::Text);
                    let figures = rows.iter().flat_map(|(name, row)| cells(row, &shown(name)));
                    lines.push([value].into_iter().chain(figures).collect::<Vec<_>>());
                }
            }
        }
        Ok(grid(&lines))
    }
}

/// The oracle's row, then those of the policies.
fn policies(report: &Value, arguments: &[String]) -> Result<Vec<Row>> {
    let policies: &Map<String, Value> = report["policies"].as_object().context("expected an object `policies`")?;
    let (named, beliefs) = (listed(arguments, "--policies"), listed(arguments, "--beliefs"));
    // A variant of a policy follows the policy whose name it begins with: first those of the beliefs.
    let rank = |name: &str| {
        let fits = named.iter().enumerate().filter(|(_, policy)| name.starts_with(**policy));
        let best = fits.max_by_key(|(_, policy)| policy.len());
        let belief = beliefs.iter().position(|belief| name.ends_with(&format!("+{belief}")));
        (best.map_or(named.len(), |(index, _)| index), belief.unwrap_or(beliefs.len()), name.len())
    };
    let mut rows: Vec<Row> = policies.iter().map(|(name, row)| (name.clone(), row.clone())).collect();
    rows.sort_by_key(|(name, _)| rank(name));
    rows.insert(0, (ORACLE.into(), report["oracle"].clone()));
    Ok(rows)
}

/// The rows of the beliefs.
fn beliefs(report: &Value, arguments: &[String]) -> Result<Vec<Row>> {
    let beliefs = report["beliefs"].as_object().context("expected an object `beliefs`")?;
    let named = listed(arguments, "--beliefs");
    let mut rows: Vec<Row> = beliefs.iter().map(|(name, row)| (name.clone(), row.clone())).collect();
    rows.sort_by_key(|(name, _)| named.iter().position(|belief| belief == name).unwrap_or(named.len()));
    Ok(rows)
}

/// The rows of the array `moving`.
fn moving(output: &Value) -> Result<Vec<Row>> {
    let rows = output["moving"].as_array().context("expected an array `moving`")?;
    Ok(rows.iter().map(|row| ("moving".to_owned(), row.clone())).collect())
}

/// The names that follow a flag, separated by commas.
fn listed<'a>(arguments: &'a [String], flag: &str) -> Vec<&'a str> {
    let names = arguments.iter().skip_while(|word| *word != flag).nth(1);
    names.map_or(Vec::new(), |names| names.split(',').collect())
}

/// The heading and a line for each row, which begins with the row's name.
fn named_lines(rows: Vec<Row>, columns: &[Column]) -> Vec<Vec<String>> {
    let titles = columns.iter().map(|column| column.title.to_owned());
    let heading = [String::new()].into_iter().chain(titles).collect();
    let lines = rows.into_iter().map(|(name, row)| [name].into_iter().chain(cells(&row, columns)).collect());
    [heading].into_iter().chain(lines).collect()
}

fn cells(row: &Value, columns: &[Column]) -> Vec<String> {
    columns.iter().map(|column| cell(row.pointer(column.at).unwrap_or(&Value::Null), column.form)).collect()
}

/// A figure as text; a dash where it does not exist.
pub fn cell(value: &Value, form: Form) -> String {
    let number = |value: &Value, digits: usize| value.as_f64().map(|number| format!("{number:.digits$}"));
    let text = match form {
        Form::Text => match value {
            Value::Null => None,
            Value::String(text) => Some(text.clone()),
            Value::Number(number) => Some(number.to_string().trim_end_matches(".0").to_owned()),
            other => Some(other.to_string()),
        },
        Form::Number(digits) => number(value, digits),
        Form::Interval(digits) => number(&value["mean"], digits).map(|mean| match number(&value["ci95"], digits) {
            Some(half) => format!("{mean} ± {half}"),
            None => mean,
        }),
    };
    text.unwrap_or_else(|| "-".into())
}

/// A Markdown table; the first line is its heading.
pub fn grid(lines: &[Vec<String>]) -> String {
    let mut text = String::new();
    for (index, line) in lines.iter().enumerate() {
        text.push_str(&format!("| {} |\n", line.join(" | ")));
        if index == 0 {
            text.push_str(&format!("|{}\n", " --- |".repeat(line.len())));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const COLUMNS: [Column; 2] = [
        Column { title: "ratio", at: "/ratio_to_oracle", form: Form::Interval(2) },
        Column { title: "p50", at: "/decision_us/p50", form: Form::Number(0) },
    ];

    fn arguments(text: &str) -> Vec<String> {
        text.split(' ').map(String::from).collect()
    }

    fn report(ratio: f64) -> Value {
        let row =
            |ratio: f64| json!({ "ratio_to_oracle": { "mean": ratio, "ci95": 0.01 }, "decision_us": { "p50": 7.4 } });
        let oracle = json!({ "ratio_to_oracle": { "mean": 1.0, "ci95": null } });
        json!({ "oracle": oracle, "policies": { "flat": row(ratio / 2.0), "greedy": row(ratio), "greedy-unaware": row(ratio) } })
    }

    #[test]
    fn policies_come_in_the_order_of_the_command_each_before_its_variants() {
        let table = Layout::Policies.markdown(&report(0.9), &arguments("eval --policies greedy,flat"), &COLUMNS);
        let expected = "|  | ratio | p50 |\n| --- | --- | --- |\n| (oracle) | 1.00 | - |\n| greedy | 0.90 ± 0.01 | 7 |\n\
                        | greedy-unaware | 0.90 ± 0.01 | 7 |\n| flat | 0.45 ± 0.01 | 7 |\n";
        assert_eq!(table.unwrap(), expected);
    }

    #[test]
    fn rows_with_beliefs_come_in_the_order_of_the_command_and_a_table_of_the_beliefs_follows() {
        let row = |ratio: f64| json!({ "ratio_to_oracle": { "mean": ratio, "ci95": 0.01 } });
        let policies = json!({
            "flat": row(0.3), "greedy+filter": row(0.9), "greedy+none": row(0.7), "greedy+true-present": row(1.0),
            "greedy+constant-velocity": row(0.8)
        });
        let quality = |cm: f64| json!({ "place_error_median_cm": cm, "coverage_95": { "mean": 0.94, "ci95": 0.02 } });
        let beliefs = json!({ "filter": quality(2.5), "constant-velocity": quality(6.0), "none": { "place_error_median_cm": 9.0 } });
        let output = json!({ "oracle": row(1.0), "policies": policies, "beliefs": beliefs });
        let words = arguments("eval --beliefs filter,constant-velocity,none --policies greedy,flat");
        let layout = Layout::PoliciesAndBeliefs;
        let names: Vec<String> = layout.rows(&output, &words).unwrap().into_iter().map(|(name, _)| name).collect();
        let of_greedy =
            ["filter", "constant-velocity", "none", "true-present"].map(|belief| format!("greedy+{belief}"));
        let others = ["flat", "filter", "constant-velocity", "none"].map(String::from);
        let expected = [&["(oracle)".to_owned()], &of_greedy[..], &others].concat();
        assert_eq!(names, expected);
        let text = layout.markdown(&output, &words, &COLUMNS).unwrap();
        let (policies, beliefs) = text.split_once("\n\n").expect("two tables");
        assert_eq!((policies.lines().count(), beliefs.lines().count()), (8, 5), "{text}");
        assert!(beliefs.starts_with("|  | place error, median (cm) |"), "{text}");
        assert!(
            beliefs.contains("\n| filter | 2.5 | - | - | - | - | 0.940 ± 0.020 |\n| constant-velocity | 6.0 |"),
            "{text}"
        );
        assert!(beliefs.ends_with("\n| none | 9.0 | - | - | - | - | - |\n"), "{text}");
        assert!(layout.markdown(&json!({ "oracle": {}, "policies": {} }), &words, &COLUMNS).is_err());
    }

    #[test]
    fn a_table_of_moving_users_follows_the_rows_and_its_rows_have_a_name() {
        let moving = json!([{ "movement": "both", "step_s": 0.1, "steps_per_s": 60.4, "reference_steps_per_s": 100.0, "ratio": 0.604 }]);
        let output = json!({ "rows": [{ "decision_us": { "p50": 7.4 } }], "moving": moving });
        let layout = Layout::RowsAndMoving;
        let names: Vec<String> = layout.rows(&output, &[]).unwrap().into_iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["", "moving"]);
        let text = layout.markdown(&output, &[], &COLUMNS[1..]).unwrap();
        let (rows, moving) = text.split_once("\n\n").expect("two tables");
        assert_eq!(rows, "| p50 |\n| --- |\n| 7 |");
        assert!(moving.ends_with("| --- |\n| both | 0.1 | 60 | 100 | 0.60 |\n"), "{text}");
        assert!(layout.markdown(&json!({ "rows": [] }), &[], &COLUMNS).is_err());
    }

    #[test]
    fn a_sweep_has_a_line_a_value_and_each_column_for_each_policy() {
        let swept = |value: &str| json!({ "value": value, "report": report(0.8) });
        let output = json!({ "sweep": "users.count", "reports": [swept("1"), swept("2")] });
        let table = Layout::Sweep.markdown(&output, &arguments("eval --policies greedy,flat"), &COLUMNS).unwrap();
        let lines: Vec<&str> = table.lines().collect();
        assert_eq!(lines.len(), 4);
        assert!(lines[0].starts_with("| `users.count` | (oracle): p50 | greedy: ratio | greedy: p50 |"), "{table}");
        assert!(lines[3].starts_with("| 2 | - | 0.80 ± 0.01 | 7 |"), "{table}");
    }

    #[test]
    fn text_has_no_needless_decimal_and_a_missing_figure_is_a_dash() {
        let cases = [(json!(100.0), "100"), (json!(0.5), "0.5"), (json!(true), "true"), (Value::Null, "-")];
        for (value, expected) in cases {
            assert_eq!(cell(&value, Form::Text), expected);
        }
    }

    #[test]
    fn the_output_of_another_command_is_refused() {
        for layout in [Layout::Rows, Layout::Policies, Layout::Sweep] {
            assert!(layout.markdown(&json!({}), &[], &COLUMNS).is_err(), "{layout:?}");
        }
    }
}
