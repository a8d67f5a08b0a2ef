//! Tables over several sections.

use anyhow::{Context, Result};
use serde_json::{Map, Value, json};

use super::archive::{Archive, Finished};
use super::definition::{Definition, Lines, Section, Summary};
use super::table::{Column, Form, ORACLE, Row, markdown, rows};

/// The table in Markdown; empty without a finished section that it concerns.
///
/// # Errors
/// A finished section whose JSON object is not that of its command.
pub fn write(summary: &Summary, definition: &Definition, archive: &Archive) -> Result<String> {
    let columns = definition.columns(&summary.columns)?;
    let finished = |name: &str| archive.find(name);
    let sections = definition.sections.iter().filter_map(|section| Some((section, finished(&section.name)?)));
    let rows = match summary.of {
        Lines::Sections => sections.map(|(section, found)| (section.title.clone(), found.output.clone())).collect(),
        Lines::Changes => {
            let base =
                |section: &Section| definition.sections.iter().find(|one| Some(&one.name) == section.base.as_ref());
            let changed = sections.filter_map(|(section, found)| {
                let base = base(section)?;
                Some(change(section, found, (base, finished(&base.name)?), columns))
            });
            changed.collect()
        }
        Lines::Rows => means(&sections.collect::<Vec<_>>(), columns)?,
    };
    if rows.is_empty() {
        return Ok(String::new());
    }
    Ok(format!("## {}\n\n{}\n\n{}\n", summary.title, summary.about, markdown(&rows, columns, Some(""))))
}

/// The figures of a section minus those of its base. The interval treats the two as independent.
fn change(section: &Section, found: &Finished, (base, other): (&Section, &Finished), columns: &[Column]) -> Row {
    let mut row = json!({});
    for column in columns {
        let [one, other] = [found, other].map(|finished| finished.output.pointer(&column.at).unwrap_or(&Value::Null));
        let part = |name: &str| one[name].as_f64().zip(other[name].as_f64());
        let mean = part("mean").map(|(one, other)| one - other);
        let difference = json!({ "mean": mean, "ci95": part("ci95").map(|(one, other)| one.hypot(other)) });
        put(&mut row, &column.at, difference);
    }
    (format!("{}, compared with {}", section.title, base.title), row)
}

/// A row for each name in the first tables of sections: the means of intervals over the sections that have
/// the name, the largest of other numbers, and `/sections`, the number of these sections. The oracle
/// comes first, then the names with most sections, then those with the largest first interval.
fn means(sections: &[(&Section, &Finished)], columns: &[Column]) -> Result<Vec<Row>> {
    let mut by_name: Vec<(String, Vec<Value>)> = Vec::new();
    for (section, finished) in sections {
        let table = section.tables.first().context("a section has a table")?;
        // Rows without names, such as those of a benchmark, have no mean over sections.
        if finished.output.pointer(&table.rows).is_none_or(Value::is_array) {
            continue;
        }
        for (name, row) in rows(&finished.output, &table.rows, &finished.arguments)? {
            match by_name.iter_mut().find(|(known, _)| *known == name) {
                Some((_, found)) => found.push(row),
                None => by_name.push((name, vec![row])),
            }
        }
    }
    let first = columns.iter().find(|column| matches!(column.form, Form::Interval(_)));
    let mut rows: Vec<Row> = by_name.into_iter().map(|(name, found)| (name, mean(&found, columns))).collect();
    let key =
        |row: &Value| first.and_then(|column| row.pointer(&column.at)?["mean"].as_f64()).unwrap_or(f64::NEG_INFINITY);
    rows.sort_by(|(name, one), (other_name, other)| {
        let is_oracle = (*other_name == ORACLE).cmp(&(*name == ORACLE));
        let count = other["sections"].as_u64().cmp(&one["sections"].as_u64());
        is_oracle.then(count).then(key(other).total_cmp(&key(one)))
    });
    Ok(rows)
}

fn mean(found: &[Value], columns: &[Column]) -> Value {
    let mut row = json!({});
    for column in columns {
        let values: Vec<&Value> = found.iter().filter_map(|row| row.pointer(&column.at)).collect();
        let value = match column.form {
            Form::Interval(_) => {
                let estimates =
                    values.iter().filter_map(|value| Some((value["mean"].as_f64()?, value["ci95"].as_f64())));
                let estimates: Vec<(f64, Option<f64>)> = estimates.collect();
                let count = estimates.len() as f64;
                let widths: Option<Vec<f64>> = estimates.iter().map(|(_, width)| *width).collect();
                match estimates.is_empty() {
                    true => Value::Null,
                    false => json!({
                        "mean": estimates.iter().map(|(mean, _)| mean).sum::<f64>() / count,
                        // An upper bound of that of the mean.
                        "ci95": widths.map(|widths| widths.iter().sum::<f64>() / count),
                    }),
                }
            }
            Form::Number(_) | Form::Text => {
                json!(values.iter().filter_map(|value| value.as_f64()).max_by(f64::total_cmp))
            }
        };
        put(&mut row, &column.at, value);
    }
    row["sections"] = json!(found.len());
    row
}

/// Sets the value at a JSON pointer; objects on the way are made.
fn put(object: &mut Value, pointer: &str, value: Value) {
    let mut place = object;
    for name in pointer.split('/').skip(1) {
        if !place.is_object() {
            *place = Value::Object(Map::new());
        }
        place = &mut place[name];
    }
    *place = value;
}
