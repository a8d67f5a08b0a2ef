//! Tables over several sections.

use anyhow::{Context, Result};
use heliostat_environment::score::Figure;
use heliostat_learn::comparison::{Spread, bounded, paired, paired_with_mean};
use serde_json::{Map, Value, json};

use super::archive::{Archive, Finished};
use super::definition::{Definition, Lines, Section, Summary};
use super::table::{Column, Form, Row, crosses_note, markdown, near_best_note, rows};
use crate::commands::eval::ORACLE;

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
    let table = markdown(&rows, columns, Some(""));
    let notes = [crosses_note(&table), near_best_note(&table)].into_iter().flatten();
    let notes: String = notes.map(|note| format!("{note}\n\n")).collect();
    Ok(format!("## {}\n\n{}\n\n{notes}{table}\n", summary.title, summary.about))
}

/// The figures of a section minus those of its base, paired by episode. Where the episodes of the two are not the
/// same, or not kept, the interval treats the two as independent, and the name of the row says so.
fn change(section: &Section, found: &Finished, (base, other): (&Section, &Finished), columns: &[Column]) -> Row {
    let mut row = json!({});
    let mut is_paired = true;
    for Column { at, .. } in columns {
        let in_episodes = by_episode(&found.output, &other.output, at);
        is_paired &= in_episodes.is_some();
        let difference = in_episodes.unwrap_or_else(|| independent(&found.output, &other.output, at));
        put(&mut row, at, json!(difference));
    }
    let how = if is_paired { "" } else { " (independent)" };
    (format!("{}, compared with {}{how}", section.title, base.title), row)
}

/// The name of the figure at a JSON pointer.
fn figure(at: &str) -> &str {
    at.rsplit('/').next().unwrap_or(at)
}

/// A figure of one output minus that of another one, paired by episode; `None` where their episodes are not the
/// same, or not kept.
fn by_episode(own: &Value, other: &Value, at: &str) -> Option<Spread> {
    let rooms = |output: &Value| ["seed", "room_seed", "states"].map(|name| output["each"][name].clone());
    if rooms(own) != rooms(other) {
        return None;
    }
    let values = |output: &Value| of_actors(output.pointer(&format!("/each{at}"))?);
    paired(figure(at), &values(own)?, &values(other)?, &states(own)?)
}

/// A figure in each episode, one list for each actor; NaN is a missing value.
fn of_actors(runs: &Value) -> Option<Vec<Vec<f64>>> {
    let of_run = |run: &Value| -> Option<Vec<f64>> {
        Some(run.as_array()?.iter().map(|value| value.as_f64().unwrap_or(f64::NAN)).collect())
    };
    runs.as_array()?.iter().map(of_run).collect()
}

/// The numbers of states of the episodes of an output.
fn states(output: &Value) -> Option<Vec<usize>> {
    let states = output["each"]["states"].as_array()?.iter();
    Some(states.map(|states| states.as_u64().unwrap_or(0) as usize).collect())
}

/// The ratio of a policy minus that of another one in the same episodes; `None` where an output keeps no episodes, or
/// has not both policies.
fn ratio_above(output: &Value, policy: &str, other: &str) -> Option<Spread> {
    let values = |policy: &str| of_actors(&output["each"]["policies"][policy]["ratio_to_oracle"]);
    paired_with_mean(&values(policy)?, &values(other)?, &states(output)?)
}

/// The same difference with an interval that treats the two as independent.
fn independent(own: &Value, other: &Value, at: &str) -> Spread {
    let [own, other] = [own, other].map(|output| output.pointer(at).unwrap_or(&Value::Null));
    let part = |of: &Value, name: &str| of[name].as_f64().unwrap_or(f64::NAN);
    let mean = part(own, "mean") - part(other, "mean");
    let ci95 = part(own, "ci95").hypot(part(other, "ci95"));
    bounded(figure(at), Spread { mean, ci95, ..Spread::MISSING })
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
    // The oracle, and a policy that knows the true room, have no time of a decision. The marks leave them out.
    let is_marked = |(name, found): &(String, Vec<Value>)| {
        found.iter().any(|row| !row["decision_us"].is_null()).then(|| name.clone())
    };
    let marked: Vec<String> = by_name.iter().filter_map(is_marked).collect();
    let first = columns.iter().find(|column| matches!(column.form, Form::Interval(_)));
    let mut rows: Vec<Row> = by_name.into_iter().map(|(name, found)| (name, mean(&found, columns))).collect();
    let key =
        |row: &Value| first.and_then(|column| row.pointer(&column.at)?["mean"].as_f64()).unwrap_or(f64::NEG_INFINITY);
    rows.sort_by(|(name, one), (other_name, other)| {
        let is_oracle = (*other_name == ORACLE).cmp(&(*name == ORACLE));
        let count = other["sections"].as_u64().cmp(&one["sections"].as_u64());
        is_oracle.then(count).then(key(other).total_cmp(&key(one)))
    });
    let outputs: Vec<&Value> = sections.iter().map(|(_, finished)| &finished.output).collect();
    subtract_best(&mut rows, &marked, &outputs);
    Ok(rows)
}

/// Sets the difference of each of these policies to the one with the largest mean ratio among those with most sections:
/// the mean of the paired differences over the sections that keep the episodes of both, with the mean half width.
fn subtract_best(rows: &mut [Row], policies: &[String], outputs: &[&Value]) {
    let place = |(name, row): &Row| {
        let ratio = row["ratio_to_oracle"]["mean"].as_f64().filter(|_| policies.contains(name))?;
        Some((row["sections"].as_u64(), ratio, name.clone()))
    };
    let places = rows.iter().rev().filter_map(place);
    // Of equal ratios the first one is the best.
    let best = places.max_by(|one, other| one.0.cmp(&other.0).then(one.1.total_cmp(&other.1)));
    let Some((_, _, best)) = best else { return };
    for (name, row) in rows.iter_mut().filter(|(name, _)| *name != best && policies.contains(name)) {
        let found: Vec<Spread> = outputs.iter().filter_map(|output| ratio_above(output, name, &best)).collect();
        if found.is_empty() {
            continue;
        }
        let mean = |part: fn(&Spread) -> f64| found.iter().map(part).sum::<f64>() / found.len() as f64;
        row["difference_to_best"] = json!({ "mean": mean(|one| one.mean), "ci95": mean(|one| one.ci95) });
    }
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
                let mean = estimates.iter().map(|(mean, _)| mean).sum::<f64>() / count;
                // An upper bound of that of the mean.
                let ci95 = widths.map_or(f64::NAN, |widths| widths.iter().sum::<f64>() / count);
                let over_sections = within_bounds(figure(&column.at), Spread { mean, ci95, ..Spread::MISSING });
                if estimates.is_empty() { Value::Null } else { json!(over_sections) }
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

/// An estimate of the figure or difference of this name, with the bounds that it has by its definition.
fn within_bounds(name: &str, estimate: Spread) -> Spread {
    match name.strip_prefix("difference_") {
        Some(of) => bounded(of, estimate),
        None => Figure::named(name).map_or(estimate, |figure| figure.bounded(estimate)),
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    const AT: &str = "/policies/greedy+filter/qos_met";

    /// The output of a comparison of two episodes with these shares.
    fn output(shares: [Option<f64>; 2], rooms: [u64; 2]) -> Value {
        let figures = json!({ "greedy+filter": { "qos_met": [shares] } });
        json!({
            "policies": { "greedy+filter": { "qos_met": { "mean": 0.5, "ci95": 0.3 } } },
            "each": { "seed": [1, 2], "room_seed": rooms, "states": [20, 20], "policies": figures },
        })
    }

    #[test]
    fn sections_of_the_same_episodes_are_paired_and_others_are_not() {
        let base = output([Some(0.2), Some(0.6)], [7, 8]);
        let same = by_episode(&output([Some(0.3), Some(0.7)], [7, 8]), &base, AT).expect("the same rooms");
        assert!((same.mean - 0.1).abs() < 1e-12 && same.ci95 < 1e-12, "{same:?}");
        let gap = by_episode(&output([Some(0.3), None], [7, 8]), &base, AT).expect("one episode has both");
        assert!((gap.mean - 0.1).abs() < 1e-12 && gap.ci95.is_nan(), "{gap:?}");
        assert_eq!(by_episode(&output([Some(0.3), Some(0.7)], [7, 9]), &base, AT), None);
        let mut not_kept = base.clone();
        not_kept["each"] = Value::Null;
        assert_eq!(by_episode(&not_kept, &not_kept, AT), None);
        assert_eq!(by_episode(&base, &base, "/beliefs/filter/coverage_95"), None);
    }

    #[test]
    fn a_mean_over_sections_whose_interval_reaches_beyond_its_figure_is_marked() {
        let names = ["ratio_to_oracle", "qos_met", "difference_qos_met", "sum_rate_mbps"];
        let column = |name: &str| Column::try_from(format!("{name} | /{name} | ±1")).expect("a column");
        let columns = names.map(column);
        let table = |halves: &[f64]| {
            let estimate = |half: f64| json!({ "mean": 0.5, "ci95": half });
            let row =
                |half: &f64| names.iter().map(|name| ((*name).to_owned(), estimate(*half))).collect::<Map<_, _>>();
            let found: Vec<Value> = halves.iter().map(|half| Value::Object(row(half))).collect();
            markdown(&[("flat".to_owned(), mean(&found, &columns))], &columns, Some(""))
        };
        let (wide, narrow) = (table(&[5.0]), table(&[0.6, 0.2]));
        assert!(wide.ends_with(&format!("| flat |{}\n", " 0.5 ± 5.0\\* |".repeat(4))), "{wide}");
        assert!(narrow.ends_with(&format!("| flat |{}\n", " 0.5 ± 0.4 |".repeat(4))), "one section crosses: {narrow}");
    }

    #[test]
    fn a_policy_that_the_sections_do_not_tell_apart_from_the_best_is_marked() {
        let of = |ratios: [[f64; 2]; 3]| {
            let policies: Map<_, _> = ["greedy", "ddpg", "flat"]
                .iter()
                .zip(ratios)
                .map(|(name, ratios)| ((*name).to_owned(), json!({ "ratio_to_oracle": [ratios] })))
                .collect();
            json!({ "each": { "states": [20, 20], "policies": policies } })
        };
        let outputs = [of([[0.9, 0.8], [0.9, 0.7], [0.5, 0.4]]), of([[0.8, 0.8], [0.9, 0.7], [0.4, 0.4]])];
        // One section is of a command whose output keeps no episodes.
        let other = json!({});
        let outputs = [&outputs[0], &outputs[1], &other];
        let row = |ratio: f64| json!({ "sections": 3, "ratio_to_oracle": { "mean": ratio } });
        let names = [(ORACLE, 1.0), ("greedy", 0.85), ("ddpg", 0.8), ("flat", 0.4)];
        let mut rows: Vec<Row> = names.map(|(name, ratio)| (name.to_owned(), row(ratio))).into();
        subtract_best(&mut rows, &["greedy", "ddpg", "flat"].map(String::from), &outputs);
        let column = Column::try_from("ratio | /ratio_to_oracle/mean | .2".to_owned()).expect("a column");
        let table = markdown(&rows, &[column], Some(""));
        let expected = "| (oracle) | 1.00 |\n| greedy | 0.85 |\n| ddpg \\~ | 0.80 |\n| flat | 0.40 |\n";
        assert!(table.ends_with(expected), "{table}");
        let mean = rows[2].1["difference_to_best"]["mean"].as_f64().expect("a difference");
        assert!((mean + 0.025).abs() < 1e-12, "{mean}");
    }

    #[test]
    fn an_independent_difference_adds_the_variances_and_has_the_bounds_of_a_share() {
        let of = |mean: f64, ci95: f64| json!({ "qos_met": { "mean": mean, "ci95": ci95 } });
        let found = independent(&of(0.9, 0.3), &of(0.4, 0.4), "/qos_met");
        assert!((found.mean - 0.5).abs() < 1e-12 && (found.ci95 - 0.5).abs() < 1e-12, "{found:?}");
        assert!(!found.crosses_bound && independent(&of(0.9, 0.6), &of(0.1, 0.6), "/qos_met").crosses_bound);
        assert!(independent(&of(0.9, 0.3), &json!({}), "/qos_met").mean.is_nan());
    }
}
