//! Decision times, compared with the paper's 0.5 ms and with methods that search at every decision.

use anyhow::{Result, ensure};
use heliostat_learn::comparison::{Loop, Row, Settings, compare_under};
use heliostat_models::ActorSource;
use heliostat_scenario::{ChannelMode, Scenario};
use indicatif::ProgressBar;

use super::finished_parts::{Done, curves, groups, seeds};
use crate::figure::{Axis, Figure, Panel, Point, Quoted, Series};
use crate::job::{Job, Timing};
use crate::part::{Curve, Measured, Part};
use crate::plan::{Plan, Room};
use crate::statistics::mean;

/// The id on the command line.
pub const ID: &str = "inference";

/// The paper's time for a decision in us.
pub const QUOTED_US: f64 = 500.0;

/// The policies for the full array.
const POLICIES: [&str; 7] = ["ddpg", "nearest", "fixed-point", "greedy", "oracle", "pso", "sine-cosine"];

/// The policies for an array small enough for the exhaustive search.
pub(crate) const SMALL: [&str; 4] = ["exhaustive", "oracle", "greedy", "fixed-point"];

/// Rows and columns, and users, of the array for the exhaustive search.
const SMALL_SIDE: usize = 3;
const SMALL_USERS: usize = 3;

/// Below this median in us a policy makes enough decisions for a 99th percentile.
const FAST_US: f64 = 1000.0;

pub(super) fn parts(room: &Room, plan: &Plan) -> Result<Vec<Part>> {
    ensure!(
        room.scenario.users.trace.is_none(),
        "{ID} draws states from the random walk, but room {} uses a recording; remove users.trace",
        room.name
    );
    let (decisions, slow_decisions, trials) = (plan.effort.timed, plan.effort.timed_slow, plan.effort.trials);
    let part = |small: bool, seed: u64| {
        let name = if small { "9 mirrors".into() } else { format!("{} mirrors", room.scenario.mirror_count()) };
        let job = Job::Timing(Timing { small, decisions, slow_decisions, trials });
        let cost_s = slow_decisions as f64 * if small { 2e-2 } else { 5e-3 + 4e-5 * f64::from(trials) }
            + decisions as f64 * if small { 2e-3 } else { 8e-3 };
        room.part([ID, env!("HELIOSTAT_CODE_INFERENCE")], (name, seed), job, cost_s)
    };
    // Under the paper's equations angles are continuous, so there is no list of assignments.
    let both: &[bool] = if room.scenario.channel.mode == ChannelMode::Specular { &[false, true] } else { &[false] };
    Ok(both.iter().flat_map(|small| plan.training_seeds().map(|seed| part(*small, seed))).collect())
}

impl Timing {
    /// Times every policy on the same states, then the fast ones on more states.
    pub(crate) fn run(&self, scenario: &Scenario, actor: &ActorSource) -> Result<Measured> {
        let mut scenario = scenario.clone();
        scenario.control.search_time_us = 0.0;
        scenario.control.search_evaluations = self.trials;
        let mut names: &[&str] = &POLICIES;
        if self.small {
            let array = scenario.mirrors.first_mut();
            (array.rows, array.columns) = (SMALL_SIDE, SMALL_SIDE);
            scenario.users.count = SMALL_USERS;
            scenario.blockage.forced_users = scenario.blockage.forced_users.min(SMALL_USERS);
            names = &SMALL;
        }
        let group = format!("{} mirrors, {} users", scenario.mirror_count(), scenario.users.count);
        let compared = |names: &[&str], states: usize| -> Result<Vec<(String, Row)>> {
            let settings = Settings::of_names(scenario.clone(), names, actor, (Loop::Static, states))?;
            Ok(compare_under(&settings, &ProgressBar::hidden())?.policies)
        };
        let all = compared(names, self.slow_decisions)?;
        let is_fast = |(_, row): &&(String, Row)| row.decision_us.is_some_and(|times| times.p50 < FAST_US);
        let fast: Vec<&str> = all.iter().filter(is_fast).map(|(name, _)| name.as_str()).collect();
        let again = if fast.is_empty() { Vec::new() } else { compared(&fast, self.decisions)? };
        let mut curves = Vec::new();
        for (name, row) in &all {
            let timed = again.iter().find(|(other, _)| other == name).map_or(row, |(_, row)| row);
            let Some(times) = timed.decision_us else { continue };
            // Both times are drawn at the ratio on the states that all policies share.
            let points = vec![[times.p50, row.ratio_to_oracle.mean], [times.p99, row.ratio_to_oracle.mean]];
            curves.push(Curve { group: group.clone(), name: name.clone(), points });
        }
        Ok(Measured { curves, ..Measured::default() })
    }
}

pub(super) fn figure(room: &Room, done: &[Done]) -> Figure {
    let panel = |group: &str| {
        let mut names: Vec<&str> = Vec::new();
        for curve in curves(done).filter(|curve| curve.group == group) {
            if !names.contains(&curve.name.as_str()) {
                names.push(&curve.name);
            }
        }
        Panel {
            title: group.to_owned(),
            series: names.into_iter().map(|name| times(done, group, name)).collect(),
            quoted: vec![Quoted { x: Some(QUOTED_US), y: None, text: "paper: 0.5 ms".into() }],
            floor: None,
        }
    };
    let machine = done.first().map_or("", |(_, finished)| &finished.origin.machine);
    let job = done.iter().find_map(|(part, _)| match &part.job {
        Job::Timing(job) => Some(job.clone()),
        _ => None,
    });
    let (decisions, slow, trials) = job.map_or((0, 0, 0), |job| (job.decisions, job.slow_decisions, job.trials));
    let intervals = match seeds(done) {
        1 => "One seed, so no intervals.".into(),
        seeds => format!(
            "Means over {seeds} seeds; medians and ratios with 95 % intervals of the mean over seeds (Student's t)."
        ),
    };
    let mut caption = vec![
        format!(
            "Each policy from its median (left end) to its 99th percentile (right end) of {decisions} decisions a seed in a hot loop, one thread; \
             the policy alone, encoding of the observation included. A policy whose median is {FAST_US} us or more makes {slow}, so that its right end is about \
             its slowest. The vertical axis is the sum rate relative to the oracle. {intervals}"
        ),
        format!("`pso` and `sine-cosine` make {trials} trials for each decision. Machine: {machine}."),
    ];
    let overload = done.iter().filter_map(|(_, finished)| Some((finished.origin.overload()?, finished.origin.cores)));
    if let Some((load, cores)) = overload.max_by(|one, other| one.0.total_cmp(&other.0)) {
        caption.push(format!(
            "Other work ran on the machine (load average up to {load:.1} on {cores} cores), which increases the right ends most."
        ));
    }
    if room.scenario.channel.mode != ChannelMode::Specular {
        caption.push(
            "No exhaustive search: under the paper's equations a mirror has a continuum of useful angles, so the best one is in no finite list of assignments.".into(),
        );
    }
    Figure {
        title: "Decision time and sum rate".into(),
        caption,
        x: Axis::log("time for a decision (us)", [1.0, 1e6]),
        y: Axis::linear("sum rate over the oracle's (1)"),
        panels: groups(done).into_iter().map(panel).collect(),
        ..Figure::default()
    }
}

/// Median and 99th percentile at the height of the ratio, each a mean over seeds. The 99th
/// percentile has no interval: its distribution over few seeds is far from normal, and the interval
/// would include negative times.
fn times(done: &[Done], group: &str, name: &str) -> Series {
    let same: Vec<&Curve> = curves(done).filter(|curve| curve.group == group && curve.name == name).collect();
    let points = (0..2).map(|end| {
        let of = |part: usize| same.iter().map(|curve| curve.points[end][part]).collect::<Vec<_>>();
        let ((x, x_ci95), (y, ci95)) = (mean(&of(0)), mean(&of(1)));
        Point { x, y, ci95, x_ci95: x_ci95.filter(|_| end == 0) }
    });
    Series { name: name.into(), points: points.collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::args::ReproduceArgs;
    use crate::claims::claims;
    use crate::figures::Kind;
    use crate::store::{Finished, Origin};

    /// The figure for given medians and 99th percentiles of `ddpg`, one pair for each seed, with a
    /// load on 2 cores.
    fn figure_of(times_us: &[[f64; 2]], load: f64) -> Figure {
        let seeds = times_us.len();
        let args = ReproduceArgs::of_command(&format!(
            "heliostat-lab reproduce inference --out DIR --mode paper --training-seeds {seeds}"
        ));
        let rooms = args.rooms().unwrap();
        let parts = parts(&rooms[0], &args.plan(args.effort())).unwrap();
        let finished = |(part, times): (Part, &[f64; 2])| {
            let points = times.map(|time| [time, 1.0]).into();
            let curve = Curve { group: "100 mirrors, 5 users".into(), name: "ddpg".into(), points };
            let origin = Origin { load: Some(load), cores: 2, ..Origin::default() };
            (part, Finished { origin, measured: Measured { curves: vec![curve], ..Measured::default() } })
        };
        Kind::Inference.figure(&rooms[0], &parts.into_iter().zip(times_us).map(finished).collect::<Vec<_>>())
    }

    #[test]
    fn a_median_has_an_interval_over_seeds_and_one_seed_has_none() {
        let ends = |figure: &Figure| figure.panels[0].series[0].points.clone();
        let one = ends(&figure_of(&[[200.0, 900.0]], 1.0));
        let three = ends(&figure_of(&[[100.0, 300.0], [200.0, 400.0], [300.0, 500.0]], 1.0));
        assert_eq!((one[0].x_ci95, three[0].x, three[1].x, three[1].x_ci95), (None, 200.0, 400.0, None));
        // Student's t for 2 degrees of freedom, 0.95 sqrt(2 / (1 - 0.95^2)), times 100 / sqrt(3).
        assert!((three[0].x_ci95.unwrap() - 95.0 * (2.0 / 0.0975_f64).sqrt() / 3.0_f64.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn more_decisions_of_fast_policies_leave_their_sum_rate_unchanged() {
        let scenario = Scenario::builtin("paper").unwrap().with_overrides(&["users.count=2"]).unwrap();
        let worth = |decisions: usize| {
            let job = Timing { small: false, decisions, slow_decisions: 2, trials: 10 };
            let curves = job.run(&scenario, &ActorSource::Shipped).unwrap().curves;
            curves.into_iter().map(|curve| (curve.name, curve.points[0][1])).collect::<Vec<_>>()
        };
        assert_eq!(worth(2), worth(9));
    }

    #[test]
    fn other_work_is_reported_if_the_load_exceeds_the_cores() {
        let (quiet, busy) = (figure_of(&[[200.0, 900.0]], 1.2), figure_of(&[[200.0, 900.0]], 7.0));
        let is_reported = |figure: &Figure| figure.caption.iter().any(|line| line.contains("Other work ran"));
        let is_in_verdict =
            |figure: &Figure| claims(std::slice::from_ref(figure))[0].findings[0].why.contains("other work");
        assert_eq!([is_reported(&quiet), is_in_verdict(&quiet)], [false; 2]);
        assert_eq!([is_reported(&busy), is_in_verdict(&busy)], [true; 2]);
        assert!(busy.caption.iter().any(|line| line.contains("up to 7.0 on 2 cores")));
    }
}
