//! The tasks in one table: the means of each policy over the tasks in which it took part.

use anyhow::Result;
use serde::Serialize;
use serde_json::Value;

use crate::commands::results::archive::Archive;
use crate::commands::results::table::{Column, Form, ORACLE, Row};

use super::tasks::TASKS;

/// What the table shows.
pub const COLUMNS: [Column; 11] = [
    Column { title: "policy", at: "/policy", form: Form::Text },
    Column { title: "tasks", at: "/tasks", form: Form::Text },
    Column { title: "ratio", at: "/ratio", form: Form::Interval(3) },
    Column { title: "ratio, difference", at: "/difference_ratio", form: Form::Interval(3) },
    Column { title: "QoS met", at: "/qos_met", form: Form::Interval(3) },
    Column { title: "QoS met, difference", at: "/difference_qos_met", form: Form::Interval(3) },
    Column { title: "Jain", at: "/jain", form: Form::Interval(3) },
    Column { title: "outage time", at: "/outage_time", form: Form::Interval(3) },
    Column { title: "outage p95 (s)", at: "/outage_p95_s", form: Form::Number(2) },
    Column { title: "decision p50 (us)", at: "/decision_p50_us", form: Form::Number(0) },
    Column { title: "decision p99 (us)", at: "/decision_p99_us", form: Form::Number(0) },
];

/// A mean over tasks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Mean {
    /// The mean.
    pub mean: f64,
    /// An upper bound of half the width of its 95 % interval: the mean of those of the tasks, which
    /// is that of the mean where the tasks are completely correlated. `None` where a task has none.
    pub ci95: Option<f64>,
}

/// One policy over the tasks in which it took part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Standing {
    /// Its name.
    pub policy: String,
    /// Number of these tasks.
    pub tasks: usize,
    /// Ratio to the oracle.
    pub ratio: Option<Mean>,
    /// The ratio minus that of the reference, paired state by state.
    pub difference_ratio: Option<Mean>,
    /// Share of users whose minimum rate is met.
    pub qos_met: Option<Mean>,
    /// This share minus that of the reference, paired state by state.
    pub difference_qos_met: Option<Mean>,
    /// Jain's fairness index of the rates.
    pub jain: Option<Mean>,
    /// Tasks in closed loop: share of the users' time below their minimum rate.
    pub outage_time: Option<Mean>,
    /// 95th percentile of the length of an outage in s, in the task where it is largest.
    pub outage_p95_s: Option<f64>,
    /// Median decision time in us, in the task where it is largest.
    pub decision_p50_us: Option<f64>,
    /// 99th percentile of the decision time in us, in the task where it is largest.
    pub decision_p99_us: Option<f64>,
}

/// The policies of the finished tasks: the oracle, then those with most tasks, the largest ratio first.
///
/// # Errors
/// A finished task whose JSON object is not that of its command.
pub fn standings(archive: &Archive) -> Result<Vec<Standing>> {
    let mut tasks = Vec::new();
    for task in &TASKS {
        if let Some(finished) = archive.find(task.name) {
            tasks.push(task.layout.rows(&finished.output, &finished.arguments)?);
        }
    }
    Ok(ranked(&tasks))
}

fn ranked(tasks: &[Vec<Row>]) -> Vec<Standing> {
    let mut names: Vec<&str> = Vec::new();
    for (name, _) in tasks.iter().flatten() {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    let of_policy =
        |name: &str| tasks.iter().flatten().filter(|(policy, _)| policy == name).map(|(_, row)| row).collect();
    let mut standings: Vec<Standing> = names.into_iter().map(|name| Standing::new(name, of_policy(name))).collect();
    let ratio = |standing: &Standing| standing.ratio.map_or(f64::NEG_INFINITY, |ratio| ratio.mean);
    standings.sort_by(|one, other| {
        let is_oracle = |standing: &Standing| standing.policy == ORACLE;
        let first = is_oracle(other).cmp(&is_oracle(one));
        first.then(other.tasks.cmp(&one.tasks)).then(ratio(other).total_cmp(&ratio(one)))
    });
    standings
}

impl Standing {
    fn new(policy: &str, rows: Vec<&Value>) -> Self {
        let mean = |at: &str| Mean::of(rows.iter().filter_map(|row| row.pointer(at)));
        let largest = |at: &str| {
            let values = rows.iter().filter_map(|row| row.pointer(at)?.as_f64());
            values.max_by(f64::total_cmp)
        };
        Self {
            policy: policy.into(),
            tasks: rows.len(),
            ratio: mean("/ratio_to_oracle"),
            difference_ratio: mean("/difference_ratio"),
            qos_met: mean("/qos_met"),
            difference_qos_met: mean("/difference_qos_met"),
            jain: mean("/jain"),
            outage_time: mean("/outage_time"),
            outage_p95_s: largest("/outages/p95_s"),
            decision_p50_us: largest("/decision_us/p50"),
            decision_p99_us: largest("/decision_us/p99"),
        }
    }
}

impl Mean {
    /// The mean of estimates; `None` without one.
    fn of<'a>(estimates: impl Iterator<Item = &'a Value>) -> Option<Self> {
        let estimates: Vec<(f64, Option<f64>)> =
            estimates.filter_map(|estimate| Some((estimate["mean"].as_f64()?, estimate["ci95"].as_f64()))).collect();
        let count = estimates.len() as f64;
        let widths: Option<Vec<f64>> = estimates.iter().map(|(_, width)| *width).collect();
        (!estimates.is_empty()).then(|| Self {
            mean: estimates.iter().map(|(mean, _)| mean).sum::<f64>() / count,
            ci95: widths.map(|widths| widths.iter().sum::<f64>() / count),
        })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn row(name: &str, ratio: f64, ci95: Option<f64>, p99: f64) -> Row {
        let row = json!({
            "ratio_to_oracle": { "mean": ratio, "ci95": ci95 },
            "qos_met": { "mean": null, "ci95": null },
            "decision_us": { "p50": 1.0, "p99": p99 },
        });
        (name.into(), row)
    }

    #[test]
    fn policies_with_all_tasks_come_first_by_their_mean_ratio() {
        let tasks = [
            vec![
                row("flat", 0.5, Some(0.1), 2.0),
                row("partial", 0.99, Some(0.1), 1.0),
                row(ORACLE, 1.0, Some(0.0), 0.0),
            ],
            vec![
                row(ORACLE, 1.0, Some(0.0), 0.0),
                row("greedy", 0.9, Some(0.1), 9.0),
                row("flat", 0.3, Some(0.3), 7.0),
            ],
            vec![row("greedy", 0.7, None, 3.0)],
        ];
        let standings = ranked(&tasks);
        let names: Vec<&str> = standings.iter().map(|standing| standing.policy.as_str()).collect();
        assert_eq!(names, [ORACLE, "greedy", "flat", "partial"]);
        let [greedy, flat] = [&standings[1], &standings[2]];
        let close = |found: Option<Mean>, mean: f64, width: f64| {
            found.is_some_and(|found| (found.mean - mean).abs() < 1e-12 && (found.ci95.unwrap() - width).abs() < 1e-12)
        };
        assert!(close(flat.ratio, 0.4, 0.2), "{flat:?}");
        assert_eq!((flat.decision_p99_us, flat.qos_met, flat.difference_ratio, flat.tasks), (Some(7.0), None, None, 2));
        assert_eq!(greedy.ratio.unwrap().ci95, None, "one task has no interval");
    }
}
