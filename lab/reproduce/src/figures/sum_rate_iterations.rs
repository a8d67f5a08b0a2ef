//! Fig. 4: sum rate against iterations (episodes of training), for two sizes of the array.
//!
//! Each learner is evaluated on the same held-out states, without exploration, before its first
//! episode and then at even steps. `ddpg-raw` is the paper's algorithm; `ddpg` is this project's,
//! with one weight for each user as its action.

use anyhow::{Result, ensure};
use clap::ValueEnum;
use heliostat_learn::comparison::{Loop, Settings, compare_under};
use heliostat_learn::evaluation::HeldOut;
use heliostat_learn::training::{Algorithm, Preset};
use heliostat_models::ActorSource;
use heliostat_scenario::Scenario;
use indicatif::ProgressBar;

use super::finished_parts::{Done, groups, intervals, series};
use crate::figure::{Axis, Figure, Panel};
use crate::job::{Baselines, Job, Learning};
use crate::part::{Curve, Measured, Part};
use crate::plan::{Plan, Room};

/// The id on the command line.
pub const ID: &str = "sum-rate-iterations";

/// The learners, with the estimated time of one episode on 7 x 7 and on 10 x 10 mirrors in s.
const LEARNERS: [(&str, [f64; 2]); 3] = [("ddpg-raw", [0.6, 0.8]), ("ddpg", [1.0, 1.1]), ("dql", [0.3, 0.4])];

/// Policies for comparison; every comparison includes the oracle.
const POLICIES: [&str; 3] = ["flat", "random", "no-irs"];

/// Rows and columns of the paper's arrays.
const SIDES: [usize; 2] = [7, 10];

/// Blocked users, as in the paper's other figures.
const BLOCKED: usize = 2;

/// The group of the curves of an array.
pub fn group(side: usize) -> String {
    format!("{side} x {side} mirrors")
}

pub(super) fn parts(room: &Room, plan: &Plan) -> Result<Vec<Part>> {
    ensure!(
        room.scenario.users.trace.is_none(),
        "{ID} draws rooms from the random walk, but room {} uses a recording; remove users.trace",
        room.name
    );
    let effort = &plan.effort;
    let blocked = BLOCKED.min(room.scenario.users.count);
    let mut parts = Vec::new();
    for (index, side) in SIDES.into_iter().enumerate() {
        let states = effort.watched_states;
        let part = |name: String, seed: u64, job: Job, cost_s: f64| Part {
            actor: ActorSource::Shipped,
            ..room.part([ID, env!("HELIOSTAT_CODE_SUM_RATE_ITERATIONS")], (name, seed), job, cost_s)
        };
        sized(&room.scenario, side, blocked)?;
        let baselines = Baselines { side, blocked, states, episodes: effort.episodes };
        parts.push(part(
            format!("baselines {side}x{side}"),
            plan.first_seed,
            Job::Baselines(baselines),
            4e-3 * states as f64,
        ));
        for (learner, episode_s) in LEARNERS {
            for seed in plan.training_seeds() {
                let job = Learning {
                    learner: learner.into(),
                    side,
                    blocked,
                    episodes: effort.episodes,
                    evaluations: effort.evaluations,
                    states,
                };
                let cost_s = episode_s[index] * effort.episodes as f64;
                parts.push(part(format!("{learner} {side}x{side}"), seed, Job::Learning(job), cost_s));
            }
        }
    }
    Ok(parts)
}

fn algorithm(name: &str) -> Result<Algorithm> {
    Algorithm::from_str(name, false).map_err(anyhow::Error::msg)
}

fn sized(scenario: &Scenario, side: usize, blocked: usize) -> Result<Scenario> {
    let overrides =
        [format!("mirrors.rows={side}"), format!("mirrors.columns={side}"), format!("blockage.forced_users={blocked}")];
    Ok(scenario.with_overrides(&overrides)?)
}

impl Learning {
    /// Trains and evaluates.
    pub(crate) fn run(&self, scenario: &Scenario) -> Result<Measured> {
        let scenario = sized(scenario, self.side, self.blocked)?;
        let mut learner = algorithm(&self.learner)?.begin(
            scenario.clone(),
            Preset::Tuned,
            &[format!("episodes={}", self.episodes)],
        )?;
        let mut held_out = HeldOut::default();
        held_out.add(&scenario, self.states)?;
        let mut points = vec![[0.0, held_out.score(|room| learner.act(room))?.sum_rate_mbps.mean]];
        for evaluation in 1..=self.evaluations {
            let until = self.episodes * evaluation / self.evaluations;
            while learner.episodes_done() < until {
                learner.run_episode()?;
            }
            points.push([until as f64, held_out.score(|room| learner.act(room))?.sum_rate_mbps.mean]);
        }
        let curve = Curve { group: group(self.side), name: self.learner.clone(), points };
        Ok(Measured { curves: vec![curve], ..Measured::default() })
    }
}

impl Baselines {
    /// Evaluates on the states of the learners: those of set 0, independent of the seed.
    pub(crate) fn run(&self, scenario: &Scenario) -> Result<Measured> {
        let scenario = Scenario { seed: 0, ..sized(scenario, self.side, self.blocked)? };
        let settings = Settings::of_names(scenario, &POLICIES, &ActorSource::Shipped, (Loop::Static, self.states))?;
        let report = compare_under(&settings, &ProgressBar::hidden())?;
        let oracle = std::iter::once(("oracle", &report.oracle));
        let rows = oracle.chain(report.policies.iter().map(|(name, row)| (name.as_str(), row)));
        let curve = |(name, row): (&str, &heliostat_learn::comparison::Row)| {
            let rate = row.sum_rate_mbps.mean;
            let points = vec![[0.0, rate], [self.episodes as f64, rate]];
            Curve { group: group(self.side), name: name.to_owned(), points }
        };
        Ok(Measured { curves: rows.map(curve).collect(), ..Measured::default() })
    }
}

pub(super) fn figure(done: &[Done]) -> Figure {
    let names = ["oracle", "ddpg", "ddpg-raw", "dql", "flat", "random", "no-irs"];
    let panel = |name: &str| Panel { title: name.to_owned(), series: series(done, name, &names), ..Panel::default() };
    let job = done.iter().find_map(|(part, _)| match &part.job {
        Job::Learning(job) => Some(job.clone()),
        _ => None,
    });
    let (episodes, states, blocked) = job.map_or((0, 0, 0), |job| (job.episodes, job.states, job.blocked));
    Figure {
        title: "Sum rate against iterations".into(),
        caption: vec![
            format!(
                "Each learner is evaluated on the same {states} held-out states with {blocked} users blocked, without exploration; iterations are episodes of 40 steps, \
                 {episodes} in all (the paper: 1000, of unstated length). {}",
                intervals(done)
            ),
            "The policies without training are evaluated on the same states, `random` as the mean of 30 draws. They do not depend on a training seed, so they \
             have no interval."
                .into(),
            "`ddpg-raw` is the paper's algorithm: all angles are outputs of the actor; rates, networks and buffer are the paper's. `ddpg` is this project's: one weight \
             for each user, decoded by geometry. `dql` chooses among quantised angles. The oracle replaces the exhaustive search, which is impossible for 2 M continuous angles. It \
             meets minimum rates where possible, so a policy that drops a user can exceed it."
                .into(),
        ],
        x: Axis::linear("iterations (episodes)"),
        y: Axis::linear("sum rate on held-out states (Mbit/s)"),
        panels: groups(done).into_iter().map(panel).collect(),
        ..Figure::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn baselines_do_not_depend_on_the_seed() {
        let baselines = Baselines { side: 7, blocked: 2, states: 2, episodes: 5 };
        let of_seed = |seed: u64| baselines.run(&Scenario { seed, ..Scenario::builtin("specular").unwrap() }).unwrap();
        assert_eq!(of_seed(1), of_seed(2));
    }
}
