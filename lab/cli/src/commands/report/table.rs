//! Tables in Markdown from the JSON objects of commands.

use anyhow::{Context, Result, ensure};
use heliostat_learn::comparison::Spread;
use serde::Deserialize;
use serde_json::Value;

use crate::commands::eval::{CROSSES_NOTE, NEAR_BEST, NEAR_BEST_NOTE, ORACLE};

/// Marks an interval that reaches beyond the bounds of its figure, in Markdown.
const CROSSES: &str = "\\*";
/// JSON pointer of the policies of `eval`, whose order is that of the command.
const POLICIES: &str = "/policies";
/// JSON pointer of the comparisons of `eval --sweep`.
const SWEEP: &str = "/reports";

/// One row by its name: the policy, the belief or the room, or nothing where rows have no names.
pub type Row = (String, Value);

/// One column: `TITLE | JSON POINTER | FORM` in a file, with ` | optional` for a figure that rows may lack.
#[derive(Clone, Debug, Deserialize)]
#[serde(try_from = "String")]
pub struct Column {
    /// Its heading.
    pub title: String,
    /// JSON pointer of its figure within a row.
    pub at: String,
    /// How the figure is written.
    pub form: Form,
    /// Whether a table may have no such figure at all.
    pub is_optional: bool,
}

/// How a figure is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// `text`: as it stands.
    Text,
    /// `.N`: a number with N digits after the point.
    Number(usize),
    /// `±N`: `mean` and `ci95` of an object with N digits after the point.
    Interval(usize),
}

impl TryFrom<String> for Column {
    type Error = anyhow::Error;

    fn try_from(text: String) -> Result<Self> {
        let expected = || {
            format!(
                "column \"{text}\": expected TITLE | /POINTER | FORM, where FORM is text, .N or ±N, \
                 with \" | optional\" behind it for a figure that rows may lack"
            )
        };
        let parts: Vec<&str> = text.split(" | ").collect();
        let ([title, at, form] | [title, at, form, "optional"]) = parts[..] else { anyhow::bail!(expected()) };
        ensure!(at.starts_with('/'), expected());
        let form = match (form, form.strip_prefix('.'), form.strip_prefix('±')) {
            ("text", ..) => Form::Text,
            (_, Some(digits), _) => Form::Number(digits.parse().with_context(expected)?),
            (_, _, Some(digits)) => Form::Interval(digits.parse().with_context(expected)?),
            _ => anyhow::bail!(expected()),
        };
        Ok(Self { title: title.into(), at: at.into(), form, is_optional: parts.len() > 3 })
    }
}

impl Form {
    /// Whether a value can be written in this form; null is a figure that this row lacks.
    fn fits(self, value: &Value) -> bool {
        let number = |value: &Value| value.is_null() || value.is_number();
        match self {
            Self::Text => true,
            Self::Number(_) => number(value),
            Self::Interval(_) => value.is_null() || value.get("mean").is_some_and(number),
        }
    }
}

/// Refuses rows that `eval` cannot print with these arguments.
///
/// # Errors
/// Rows outside the comparisons of a sweep, or of a sweep that the command does not have.
pub fn check_rows(pointer: &str, arguments: &[String]) -> Result<()> {
    if arguments.get(1).is_none_or(|command| command != "eval") {
        return Ok(());
    }
    let of_sweep = pointer == SWEEP || pointer.starts_with(&format!("{SWEEP}/"));
    match arguments.iter().any(|word| word == "--sweep" || word.starts_with("--sweep=")) {
        true => ensure!(
            of_sweep,
            "rows = \"{pointer}\": expected {SWEEP}, where --sweep has a row for each value and policy"
        ),
        false => ensure!(!of_sweep, "rows = \"{pointer}\": expected {POLICIES}, since the command has no --sweep"),
    }
    Ok(())
}

/// The rows at a JSON pointer: those of an array, of an object by name, or of a sweep.
///
/// # Errors
/// The JSON object of another command.
pub fn rows(output: &Value, pointer: &str, arguments: &[String]) -> Result<Vec<Row>> {
    let found = output.pointer(pointer).with_context(|| {
        let names = output.as_object().into_iter().flat_map(|object| object.keys());
        let names: Vec<String> = names.map(|name| format!("/{name}")).collect();
        format!("the output has nothing at {pointer}; it has {}", names.join(", "))
    })?;
    match found {
        Value::Array(reports) if pointer == SWEEP => {
            let swept = |report: &Value| {
                let rows = rows(&report["report"], POLICIES, arguments)?;
                let values = texts(report["values"].as_array().map_or(&[][..], Vec::as_slice));
                Ok(rows.into_iter().map(move |(name, row)| (format!("{values}: {name}"), row)))
            };
            Ok(reports.iter().map(swept).collect::<Result<Vec<_>>>()?.into_iter().flatten().collect())
        }
        Value::Array(rows) => {
            let name = |row: &Value| row["policy"].as_str().or(row["room"].as_str()).unwrap_or_default().to_owned();
            Ok(rows.iter().map(|row| (name(row), row.clone())).collect())
        }
        Value::Object(named) => {
            let mut rows: Vec<Row> = named.iter().map(|(name, row)| (name.clone(), row.clone())).collect();
            rows.sort_by_key(|(name, _)| rank(name, arguments));
            if pointer == POLICIES {
                rows.insert(0, (ORACLE.into(), output["oracle"].clone()));
            }
            Ok(rows)
        }
        _ => anyhow::bail!("the output has neither an array nor an object at {pointer}"),
    }
}

/// The keys of a sweep or their values in one text.
pub fn texts(values: &[Value]) -> String {
    values.iter().map(|value| cell(value, Form::Text)).collect::<Vec<_>>().join(", ")
}

/// Refuses columns whose figure no row of a table has, unless they are optional.
///
/// # Errors
/// Each such column, with what the rows have in place of its figure.
pub fn check_columns(rows: &[Row], columns: &[Column]) -> Result<()> {
    let lacks = |column: &&Column| {
        let has = |(_, row): &Row| row.pointer(&column.at).is_some_and(|value| column.form.fits(value));
        !column.is_optional && !rows.is_empty() && !rows.iter().any(has)
    };
    let missing = columns.iter().filter(lacks).map(|Column { title, at, .. }| {
        format!(
            "column \"{title}\": no row has such a figure at {at}: {}",
            nearest(rows.iter().map(|(_, row)| row), at)
        )
    });
    let missing: Vec<String> = missing.collect();
    ensure!(
        missing.is_empty(),
        "{}; correct the pointer or the form, or end the column with \" | optional\" if its figure may be absent",
        missing.join("; ")
    );
    Ok(())
}

/// What the row that agrees most with a JSON pointer has at the last part of the pointer that exists.
pub fn nearest<'a>(rows: impl Iterator<Item = &'a Value>, pointer: &'a str) -> String {
    let last_existing = |row: &'a Value| {
        let shorter = pointer.rmatch_indices('/').map(|(end, _)| &pointer[..end]);
        let mut parts = std::iter::once(pointer).chain(shorter);
        parts.find_map(|part| Some((part, row.pointer(part)?))).unwrap_or(("", row))
    };
    let Some((part, value)) = rows.map(last_existing).max_by_key(|(part, _)| part.len()) else {
        return "there are no rows".into();
    };
    let place = if part.is_empty() { "a row" } else { part };
    match value {
        Value::Object(object) if !object.is_empty() => {
            format!("{place} has {}", object.keys().map(String::as_str).collect::<Vec<_>>().join(", "))
        }
        Value::Array(values) => format!("{place} is an array of length {}", values.len()),
        other => format!("{place} is {other}"),
    }
}

/// The place of a row: a variant of a policy follows the policy whose name it begins with, in the order
/// of the command, first those of the beliefs.
fn rank(name: &str, arguments: &[String]) -> (usize, usize, usize) {
    let listed = |flag: &str| {
        let names = arguments.iter().skip_while(|word| *word != flag).nth(1);
        names.map_or(Vec::new(), |names| names.split(',').collect::<Vec<_>>())
    };
    let (policies, beliefs) = (listed("--policies"), listed("--beliefs"));
    let policy = policies.iter().enumerate().filter(|(_, policy)| name.starts_with(**policy));
    let policy = policy.max_by_key(|(_, policy)| policy.len()).map_or(policies.len(), |(index, _)| index);
    let belief = beliefs.iter().position(|belief| name == *belief || name.ends_with(&format!("+{belief}")));
    (policy, belief.unwrap_or(beliefs.len()), name.len())
}

/// A table in Markdown; with a heading for the names of the rows, these are the first column.
pub fn markdown(rows: &[Row], columns: &[Column], heading: Option<&str>) -> String {
    let titles = columns.iter().map(|column| column.title.clone());
    let first = |name: &str| heading.map(|_| name.to_owned());
    let mark = |row: &Value| if is_near_best(row) { format!(" \\{NEAR_BEST}") } else { String::new() };
    let mut lines = vec![first(heading.unwrap_or_default()).into_iter().chain(titles).collect::<Vec<_>>()];
    for (name, row) in rows {
        let cells = columns.iter().map(|column| cell(row.pointer(&column.at).unwrap_or(&Value::Null), column.form));
        lines.push(first(&(name.clone() + &mark(row))).into_iter().chain(cells).collect());
    }
    grid(&lines)
}

/// What a marked interval of these tables means, if there is one.
pub fn crosses_note(tables: &str) -> Option<String> {
    tables.contains(CROSSES).then(|| format!("{CROSSES}: {CROSSES_NOTE}."))
}

/// Whether a row of `eval` is that of a policy which is not told apart from the best one.
fn is_near_best(row: &Value) -> bool {
    let part = |name: &str| row["difference_to_best"][name].as_f64();
    let difference = |mean: f64| Spread { mean, ci95: part("ci95").unwrap_or(f64::NAN), ..Spread::MISSING };
    part("mean").is_some_and(|mean| difference(mean).includes_zero())
}

/// What a marked name of these tables means, if there is one.
pub fn near_best_note(tables: &str) -> Option<String> {
    let mark = format!("\\{NEAR_BEST}");
    tables.contains(&mark).then(|| format!("{mark}: {NEAR_BEST_NOTE}."))
}

/// A figure as text; a dash where it does not exist.
fn cell(value: &Value, form: Form) -> String {
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
            Some(half) if value["crosses_bound"] == true => format!("{mean} ± {half}{CROSSES}"),
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

    fn columns(columns: &[&str]) -> Vec<Column> {
        columns.iter().map(|text| Column::try_from((*text).to_owned()).expect("a column")).collect()
    }

    fn arguments(text: &str) -> Vec<String> {
        text.split(' ').map(String::from).collect()
    }

    fn report(ratio: f64) -> Value {
        let row = |ratio: f64| json!({ "ratio": { "mean": ratio, "ci95": 0.01 }, "us": { "p50": 7.4 } });
        let policies = json!({ "flat": row(ratio / 2.0), "greedy": row(ratio), "greedy-unaware": row(ratio) });
        json!({ "oracle": { "ratio": { "mean": 1.0, "ci95": null } }, "policies": policies })
    }

    #[test]
    fn policies_come_in_the_order_of_the_command_each_before_its_variants() {
        let rows = rows(&report(0.9), POLICIES, &arguments("eval --policies greedy,flat")).unwrap();
        let expected = "|  | ratio | p50 |\n| --- | --- | --- |\n| (oracle) | 1.00 | - |\n| greedy | 0.90 ± 0.01 | 7 |\n\
                        | greedy-unaware | 0.90 ± 0.01 | 7 |\n| flat | 0.45 ± 0.01 | 7 |\n";
        assert_eq!(markdown(&rows, &columns(&["ratio | /ratio | ±2", "p50 | /us/p50 | .0"]), Some("")), expected);
    }

    #[test]
    fn beliefs_and_the_policies_on_them_come_in_the_order_of_the_command() {
        let output = json!({
            "oracle": {}, "beliefs": { "filter": {}, "none": {}, "constant-velocity": {} },
            "policies": { "flat": {}, "greedy+filter": {}, "greedy+none": {}, "greedy+true": {}, "greedy+constant-velocity": {} },
        });
        let words = arguments("eval --beliefs filter,constant-velocity,none --policies greedy,flat");
        let names = |pointer: &str| -> Vec<String> {
            rows(&output, pointer, &words).unwrap().into_iter().map(|(name, _)| name).collect()
        };
        assert_eq!(names("/beliefs"), ["filter", "constant-velocity", "none"]);
        let of_greedy = ["filter", "constant-velocity", "none", "true"].map(|belief| format!("greedy+{belief}"));
        assert_eq!(names(POLICIES), [&[ORACLE.to_owned()], &of_greedy[..], &["flat".to_owned()]].concat());
    }

    #[test]
    fn a_sweep_has_a_row_for_each_value_and_policy() {
        let swept = |value: &str| json!({ "values": [value], "report": report(0.8) });
        let output = json!({ "keys": ["users.count"], "reports": [swept("1"), swept("2")] });
        let rows = rows(&output, SWEEP, &arguments("eval --policies greedy,flat")).unwrap();
        assert_eq!((rows.len(), rows[0].0.as_str(), rows[5].0.as_str()), (8, "1: (oracle)", "2: greedy"));
    }

    #[test]
    fn rows_that_a_sweep_or_a_command_without_one_does_not_have_are_refused() {
        let check =
            |pointer: &str, text: &str| check_rows(pointer, &arguments(text)).map_err(|error| error.to_string());
        let swept = "heliostat-lab eval --sweep users.count=1,2";
        let refused = check("/policies", swept).expect_err("no such rows");
        assert!(refused.starts_with("rows = \"/policies\": expected /reports"), "{refused}");
        let refused = check(SWEEP, "heliostat-lab eval --states 3").expect_err("no sweep");
        assert!(refused.starts_with("rows = \"/reports\": expected /policies"), "{refused}");
        for (pointer, text) in [
            (SWEEP, swept),
            ("/reports/0/report/beliefs", "heliostat-lab eval --sweep=users.count=1,2"),
            ("/beliefs", "heliostat-lab eval"),
            ("/rows", "heliostat bench loop"),
        ] {
            assert_eq!(check(pointer, text), Ok(()), "{pointer} of {text}");
        }
        let missing = rows(&json!({ "keys": ["users.count"], "reports": [] }), POLICIES, &[]).expect_err("no policies");
        assert_eq!(missing.to_string(), "the output has nothing at /policies; it has /keys, /reports");
    }

    #[test]
    fn an_interval_beyond_the_bounds_of_its_figure_is_marked() {
        let of = |crosses: bool| json!({ "mean": 0.01, "ci95": 0.02, "crosses_bound": crosses });
        assert_eq!(
            [true, false].map(|crosses| cell(&of(crosses), Form::Interval(2))),
            ["0.01 ± 0.02\\*", "0.01 ± 0.02"]
        );
    }

    #[test]
    fn the_name_of_a_policy_that_is_not_told_apart_from_the_best_is_marked() {
        let of = |difference: Value| json!({ "us": 1.0, "difference_to_best": difference });
        let rows = [
            ("greedy", json!({ "us": 1.0 })),
            ("ddpg", of(json!({ "mean": -0.01, "ci95": 0.02 }))),
            ("flat", of(json!({ "mean": -0.1, "ci95": 0.02 }))),
            ("hold", of(json!({ "mean": -0.1, "ci95": null }))),
        ];
        let rows = rows.map(|(name, row)| (name.to_owned(), row));
        let table = markdown(&rows, &columns(&["us | /us | .0"]), Some(""));
        let expected = "| greedy | 1 |\n| ddpg \\~ | 1 |\n| flat | 1 |\n| hold | 1 |\n";
        assert!(table.ends_with(expected), "{table}");
        assert!(near_best_note(&table).is_some_and(|note| note.starts_with("\\~: not distinguishable from the best")));
        assert_eq!(near_best_note("| greedy | 1 |"), None);
    }

    #[test]
    fn text_has_no_needless_decimal_and_a_missing_figure_is_a_dash() {
        for (value, expected) in [(json!(100.0), "100"), (json!(0.5), "0.5"), (json!(true), "true"), (Value::Null, "-")]
        {
            assert_eq!(cell(&value, Form::Text), expected);
        }
    }

    #[test]
    fn a_column_whose_figure_no_row_has_is_refused_with_the_keys_that_exist() {
        let rows = rows(&report(0.9), POLICIES, &[]).unwrap();
        let check = |column: &str| check_columns(&rows, &columns(&[column])).map_err(|error| error.to_string());
        for (column, expected) in [
            ("p50 | /us/p5O | .0", "column \"p50\": no row has such a figure at /us/p5O: /us has p50;"),
            ("p50 | /su/p50 | .0", "column \"p50\": no row has such a figure at /su/p50: a row has ratio, us;"),
            ("p50 | /us/p50/mean | .0", "/us/p50 is 7.4;"),
            ("ratio | /ratio | .2", "column \"ratio\": no row has such a figure at /ratio: /ratio has ci95, mean;"),
            ("p50 | /us | ±0", "/us has p50;"),
        ] {
            let refused = check(column).expect_err(column);
            assert!(refused.contains(expected), "{column}: {refused}");
        }
        // The oracle has no time, and its interval has no width.
        for column in
            ["p50 | /us/p50 | .0", "ratio | /ratio | ±2", "width | /ratio/ci95 | .2", "x | /x | .0 | optional"]
        {
            assert_eq!(check(column), Ok(()), "{column}");
        }
        let missing = [(String::new(), json!({ "hz": null, "blocked": { "mean": null } }))];
        check_columns(&missing, &columns(&["rate | /hz | .0", "blocked | /blocked | ±1"])).expect("null is a figure");
        check_columns(&[], &columns(&["p50 | /p50 | .0"])).expect("a table without rows");
    }

    #[test]
    fn other_columns_and_the_output_of_another_command_are_refused() {
        for text in
            ["ratio", "ratio | ratio | .2", "ratio | /ratio | 2", "ratio | /ratio | .x", "ratio | /ratio | .2 | often"]
        {
            let error = Column::try_from(text.to_owned()).unwrap_err().to_string();
            assert!(error.contains("expected TITLE | /POINTER | FORM"), "{error}");
        }
        assert!(rows(&json!({ "rows": 1 }), "/rows", &[]).is_err() && rows(&json!({}), POLICIES, &[]).is_err());
    }
}
