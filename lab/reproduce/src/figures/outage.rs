//! Service in closed loop by number of blocked users: the share of time below the minimum rate, the
//! lengths of outages, and Jain's fairness index.
//!
//! An outage is a time in which a user is below the minimum rate. The distribution of their lengths is
//! shown by time: the share of the users' time in outages longer than a given length. It is defined
//! for a policy without outages too, and at length 0 it is the share of time below the minimum rate.

use anyhow::Result;
use heliostat_learn::comparison::{Loop, OUTAGE_LENGTHS_S, Row, Settings, compare_under};
use heliostat_models::ActorSource;
use heliostat_scenario::Scenario;
use indicatif::ProgressBar;

use super::finished_parts::{Done, groups, intervals, series};
use crate::figure::{Axis, Figure, Panel};
use crate::job::{Job, Outage};
use crate::part::{Curve, Measured, Part};
use crate::plan::{Plan, Room};

/// The id on the command line.
pub const ID: &str = "outage";

/// The compared policies; the oracle has no closed loop, so it has no outages.
const POLICIES: [&str; 4] = ["ddpg", "greedy", "flat", "no-irs"];

/// The panel of the share of time below the minimum rate.
pub const TIME_BELOW: &str = "time below the minimum rate";
/// The panel of Jain's fairness index.
pub const FAIRNESS: &str = "Jain's fairness index";

/// The panel of the share of time in outages longer than a length.
pub fn longer_than(length_s: f64) -> String {
    format!("time in outages longer than {length_s} s")
}

/// The quantities of a policy by their panels.
fn quantities(row: &Row) -> Vec<(String, f64)> {
    let below = row.outage_time.map_or(f64::NAN, |share| share.mean);
    let longer = row.outages.map_or([f64::NAN; OUTAGE_LENGTHS_S.len()], |outages| outages.time_in_longer);
    let mut quantities = vec![(TIME_BELOW.into(), below)];
    quantities.extend(OUTAGE_LENGTHS_S.into_iter().map(longer_than).zip(longer));
    quantities.push((FAIRNESS.into(), row.jain.mean));
    quantities
}

pub(super) fn parts(room: &Room, plan: &Plan) -> Result<Vec<Part>> {
    plan.check_blocked(ID, room)?;
    let instants = plan.effort.loop_instants;
    let part = |seed: u64| {
        let job = Job::Outage(Outage { blocked: plan.blocked.clone(), instants });
        let cost_s = 1e-2 * (instants * plan.blocked.len()) as f64;
        room.part([ID, env!("HELIOSTAT_CODE_OUTAGE")], ("closed loop".into(), seed), job, cost_s)
    };
    Ok(plan.seeds().map(part).collect())
}

impl Outage {
    /// The comparison for each number of blocked users.
    pub(crate) fn run(&self, scenario: &Scenario, actor: &ActorSource) -> Result<Measured> {
        let mut curves: Vec<Curve> = Vec::new();
        for blocked in &self.blocked {
            let mut scenario = scenario.clone();
            scenario.blockage.forced_users = *blocked;
            let settings = Settings::of_names(scenario, &POLICIES, actor, (Loop::ClosedLoop, self.instants))?;
            let report = compare_under(&settings, &ProgressBar::hidden())?;
            let oracle = ("oracle", &report.oracle);
            let policies = report.policies.iter().map(|(name, row)| (name.as_str(), row));
            for (name, row) in [oracle].into_iter().chain(policies) {
                for (group, share) in quantities(row).into_iter().filter(|(_, share)| share.is_finite()) {
                    let point = [*blocked as f64, share];
                    match curves.iter_mut().find(|curve| curve.group == group && curve.name == name) {
                        Some(curve) => curve.points.push(point),
                        None => curves.push(Curve { group, name: name.into(), points: vec![point] }),
                    }
                }
            }
        }
        Ok(Measured { curves, ..Measured::default() })
    }
}

pub(super) fn figure(done: &[Done]) -> Figure {
    let names = ["oracle", "ddpg", "greedy", "flat", "no-irs"];
    let panel =
        |title: &str| Panel { title: title.to_owned(), series: series(done, title, &names), ..Panel::default() };
    let instants = done.iter().find_map(|(part, _)| match &part.job {
        Job::Outage(job) => Some(job.instants),
        _ => None,
    });
    Figure {
        title: "Outages and fairness in closed loop".into(),
        caption: vec![
            "Not in the paper. Reports, delays, noise and mirrors are those of the room's scenario, and users walk. The minimum rate is `users.min_rate_mbps`. The oracle knows the true \
             state, and its mirrors turn at once; it is evaluated at the instants only, so it has no outages."
                .into(),
            format!(
                "An outage is a time in which a user is below the minimum rate, sampled every 20 ms; it ends with its episode of 20 instants. {} Each seed has {} instants for each \
                 number of blocked users.",
                intervals(done),
                instants.unwrap_or(0)
            ),
        ],
        x: Axis::linear("users without a direct path"),
        y: Axis { range: Some([0.0, 1.0]), ..Axis::linear("share, or index (1)") },
        panels: groups(done).into_iter().map(panel).collect(),
        ..Figure::default()
    }
}
