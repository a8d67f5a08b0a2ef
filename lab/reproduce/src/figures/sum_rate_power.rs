//! Fig. 5: sum rate against optical power for several numbers of blocked users.

use anyhow::{Result, ensure};
use heliostat_learn::comparison::{Loop, Settings, compare_under};
use heliostat_models::ActorSource;
use heliostat_scenario::Scenario;
use indicatif::ProgressBar;

use super::finished_parts::{Done, groups, intervals, series};
use crate::figure::{Axis, Figure, Panel, Quoted, Series};
use crate::job::{Job, Power};
use crate::part::{Curve, Measured, Part};
use crate::plan::{Plan, Room};
use crate::statistics::over_seeds;

/// Largest number of panels in the figure.
const PANELS_MAX: usize = 8;

/// The id on the command line.
pub const ID: &str = "sum-rate-power";

/// The compared policies; every comparison includes the oracle.
const POLICIES: [&str; 4] = ["ddpg", "flat", "random", "no-irs"];

/// The group of the curves of a number of blocked users.
pub fn group(blocked: usize) -> String {
    format!("{blocked} blocked")
}

pub(super) fn parts(room: &Room, plan: &Plan) -> Result<Vec<Part>> {
    ensure!(
        plan.blocked.len() <= PANELS_MAX,
        "{ID} draws a panel for each number of blocked users, and --blocked has {}: give {PANELS_MAX} numbers or fewer",
        plan.blocked.len()
    );
    plan.check_blocked(ID, room)?;
    ensure!(
        room.scenario.users.trace.is_none(),
        "{ID} draws states from the random walk, but room {} uses a recording; remove users.trace",
        room.name
    );
    let effort = &plan.effort;
    let part = |blocked: usize, seed: u64| {
        let job = Job::Power(Power { blocked, powers_w: effort.powers_w.clone(), states: effort.states });
        let cost_s = 1e-2 * (effort.states * effort.powers_w.len()) as f64;
        room.part([ID, env!("HELIOSTAT_CODE_SUM_RATE_POWER")], (group(blocked), seed), job, cost_s)
    };
    Ok(plan.blocked.iter().flat_map(|blocked| plan.seeds().map(|seed| part(*blocked, seed))).collect())
}

impl Power {
    /// The comparison at each power.
    pub(crate) fn run(&self, scenario: &Scenario, actor: &ActorSource) -> Result<Measured> {
        let mut names = vec!["oracle"];
        names.extend(POLICIES);
        let empty = |name: &&str| Curve { group: group(self.blocked), name: (*name).into(), points: Vec::new() };
        let mut curves: Vec<Curve> = names.iter().map(empty).collect();
        for power_w in &self.powers_w {
            let mut scenario = scenario.clone();
            scenario.blockage.forced_users = self.blocked;
            scenario.led.power_w = *power_w;
            let settings = Settings::of_names(scenario, &POLICIES, actor, (Loop::Static, self.states))?;
            let report = compare_under(&settings, &ProgressBar::hidden())?;
            let rows = std::iter::once(&report.oracle).chain(report.policies.iter().map(|(_, row)| row));
            for (row, curve) in rows.zip(&mut curves) {
                curve.points.push([*power_w, row.sum_rate_mbps.mean]);
            }
        }
        Ok(Measured { curves, ..Measured::default() })
    }
}

/// The optical power of the paper's stated rates, in W.
pub const QUOTED_POWER_W: f64 = 2.0;
/// The number of blocked users of the paper's stated rates.
pub const QUOTED_BLOCKED: usize = 2;

pub(super) fn figure(room: &Room, done: &[Done]) -> Figure {
    let names = ["oracle", "ddpg", "flat", "random", "no-irs"];
    let panel = |name: &str| Panel {
        title: name.to_owned(),
        series: series(done, name, &names),
        quoted: if name == group(QUOTED_BLOCKED) { quoted() } else { Vec::new() },
        floor: None,
    };
    let states = done.iter().find_map(|(part, _)| match &part.job {
        Job::Power(job) => Some(job.states),
        _ => None,
    });
    Figure {
        title: "Sum rate against optical power".into(),
        caption: vec![
            format!(
                "{} mirrors, {} users; each panel names the number of users without direct path. {} Each seed has {} rooms.",
                room.scenario.mirror_count(),
                room.scenario.users.count,
                intervals(done),
                states.unwrap_or(0)
            ),
            "Every policy observes the exact state, and its mirrors move instantly, so the walking speed has no effect (the paper: about \
             1 m/s). The paper's benchmark with fixed random angles is `random`, the mean of 30 draws. `flat` (all angles zero) and \
             `no-irs` are shown because random angles have the lowest rate of the three in the paper's equations."
                .into(),
            "`ddpg` is the built-in actor, with one weight for each user as its action. The oracle meets minimum rates where possible; a policy that drops \
             a user can have a larger sum."
                .into(),
        ],
        x: Axis::linear("optical power (W)"),
        y: Axis::linear("sum rate (Mbit/s)"),
        panels: groups(done).into_iter().map(panel).collect(),
        ratios: OVER.iter().filter_map(|policy| gain(done, policy)).collect(),
        ..Figure::default()
    }
}

/// The policies relative to which the gain of `ddpg` is stated.
pub const OVER: [&str; 2] = ["random", "flat"];

/// The name of the quotient of `ddpg` and a policy.
pub fn gain_name(policy: &str) -> String {
    format!("ddpg over {policy}, {}", group(QUOTED_BLOCKED))
}

/// The quotient of `ddpg` and another policy at each power, seed by seed, where the paper states
/// it.
fn gain(done: &[Done], policy: &str) -> Option<Series> {
    let of_seed = |(_, finished): &Done| {
        let curve = |name: &str| {
            let mut curves = finished.measured.curves.iter();
            curves.find(|curve| curve.group == group(QUOTED_BLOCKED) && curve.name == name)
        };
        let pairs = curve("ddpg")?.points.iter().zip(&curve(policy)?.points);
        let points = pairs.filter(|(_, other)| other[1] > 0.0).map(|(own, other)| [own[0], own[1] / other[1]]);
        Some(Curve { group: String::new(), name: gain_name(policy), points: points.collect() })
    };
    let curves: Vec<Curve> = done.iter().filter_map(of_seed).collect();
    over_seeds(&gain_name(policy), &curves.iter().collect::<Vec<_>>())
}

fn quoted() -> Vec<Quoted> {
    let point = |rate: f64, method: &str| Quoted {
        x: Some(QUOTED_POWER_W),
        y: Some(rate),
        text: format!("paper, {method}: {rate}"),
    };
    vec![point(19.2, "DRL"), point(10.0, "fixed")]
}
