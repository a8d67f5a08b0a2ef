//! Fig4: sum rate against iterations (episodes of training), for two sizes of the array.
//!
//! A learner is judged on the same held-out states, without exploration, before its first episode and then at even steps. `ddpg-raw` is the
//! paper's algorithm to the letter; `ddpg` is ours, with one weight a user as its action.

use anyhow::{Result, ensure};
use clap::ValueEnum;
use heliostat_controller::policy::ActorSource;
use heliostat_models::comparison::{Entrant, Loop, Settings, compare_under};
use heliostat_models::evaluation::HeldOut;
use heliostat_models::training::{Algorithm, Preset};
use heliostat_scenario::Scenario;
use indicatif::ProgressBar;
use serde::Serialize;

use super::{Done, Plan, Room, groups, intervals, series};
use crate::figure::{Axis, Figure, Panel};
use crate::part::{Curve, Job, Measured, Part};

/// The word on the command line.
pub const ID: &str = "sum-rate-iterations";

/// Who learns: the paper's DDPG, ours, and the paper's rival. With the time of one episode on 7 x 7 and on 10 x 10 mirrors in s.
const LEARNERS: [(&str, [f64; 2]); 3] = [("ddpg-raw", [0.6, 0.8]), ("ddpg", [1.0, 1.1]), ("dql", [0.3, 0.4])];

/// What stands beside them; the oracle comes with every comparison.
const POLICIES: [&str; 3] = ["flat", "random", "no-irs"];

/// Rows and columns of the paper's arrays.
const SIDES: [usize; 2] = [7, 10];

/// Users whose direct path is off, as in the paper's other figures.
const BLOCKED: usize = 2;

/// One training run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Learning {
    /// Who learns.
    pub learner: String,
    /// Rows and columns.
    pub side: usize,
    /// Users whose direct path is off in the states on which it is judged.
    pub blocked: usize,
    /// Episodes.
    pub episodes: usize,
    /// Times it is judged after its beginning.
    pub judgements: usize,
    /// States on which it is judged.
    pub states: usize,
}

/// The lines that do not learn, on the same states: those of other seeds would be other rooms than the learners are judged in, and no yardstick.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Yardsticks {
    /// Rows and columns.
    pub side: usize,
    /// As in [`Learning`].
    pub blocked: usize,
    /// As in [`Learning`].
    pub states: usize,
    /// Where the lines end.
    pub episodes: usize,
}

/// The group of the curves of an array.
pub fn group(side: usize) -> String {
    format!("{side} x {side} mirrors")
}

pub(super) fn parts(room: &Room, plan: &Plan) -> Result<Vec<Part>> {
    ensure!(
        room.scenario.users.trace.is_none(),
        "{ID} draws rooms from the random walk, but room {} follows a recording: leave users.trace out",
        room.name
    );
    let effort = &plan.effort;
    let blocked = BLOCKED.min(room.scenario.users.count);
    let mut parts = Vec::new();
    for (index, side) in SIDES.into_iter().enumerate() {
        let states = effort.watched_states;
        let part = |name: String, seed: u64, job: Job, cost_s: f64| Part {
            figure: ID,
            code: env!("HELIOSTAT_CODE_SUM_RATE_ITERATIONS"),
            room: room.name.clone(),
            name,
            seed,
            scenario: room.scenario.clone(),
            actor: ActorSource::Shipped,
            job,
            cost_s,
        };
        sized(&room.scenario, side, blocked)?;
        let yardsticks = Yardsticks { side, blocked, states, episodes: effort.episodes };
        parts.push(part(
            format!("yardsticks {side}x{side}"),
            plan.first_seed,
            Job::Yardsticks(yardsticks),
            4e-3 * states as f64,
        ));
        for (learner, episode_s) in LEARNERS {
            for seed in plan.training_seeds() {
                let job = Learning {
                    learner: learner.into(),
                    side,
                    blocked,
                    episodes: effort.episodes,
                    judgements: effort.judgements,
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
    /// Trains and judges.
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
        for judgement in 1..=self.judgements {
            let until = self.episodes * judgement / self.judgements;
            while learner.episodes_done() < until {
                learner.run_episode()?;
            }
            points.push([until as f64, held_out.score(|room| learner.act(room))?.sum_rate_mbps.mean]);
        }
        let curve = Curve { group: group(self.side), name: self.learner.clone(), points };
        Ok(Measured { curves: vec![curve], ..Measured::default() })
    }
}

impl Yardsticks {
    /// Compares on the states on which learners are judged: those of set 0, whatever the seed.
    pub(crate) fn run(&self, scenario: &Scenario) -> Result<Measured> {
        let scenario = Scenario { seed: 0, ..sized(scenario, self.side, self.blocked)? };
        let source = ActorSource::Shipped;
        let entrants = POLICIES.iter().map(|name| Entrant::parse(name, &source)).collect::<Result<_, _>>()?;
        let settings =
            Settings { scenario, entrants, states: self.states, seeds: 1, mode: Loop::Static, training_seed: Some(1) };
        let report = compare_under(&settings, &ProgressBar::hidden())?;
        let oracle = std::iter::once(("oracle", &report.oracle));
        let rows = oracle.chain(report.policies.iter().map(|(name, row)| (name.as_str(), row)));
        let curve = |(name, row): (&str, &heliostat_models::comparison::Row)| {
            let rate = row.sum_rate_mbps.mean;
            let points = vec![[0.0, rate], [self.episodes as f64, rate]];
            Curve { group: group(self.side), name: name.to_owned(), points }
        };
        Ok(Measured { curves: rows.map(curve).collect(), ..Measured::default() })
    }
}

pub(super) fn figure(room: &Room, done: &[Done]) -> Figure {
    let names = ["oracle", "ddpg", "ddpg-raw", "dql", "flat", "random", "no-irs"];
    let panel = |name: &str| Panel { title: name.to_owned(), series: series(done, name, &names), ..Panel::default() };
    let job = done.iter().find_map(|(part, _)| match &part.job {
        Job::Learning(job) => Some(job.clone()),
        _ => None,
    });
    let (episodes, states, blocked) = job.map_or((0, 0, 0), |job| (job.episodes, job.states, job.blocked));
    Figure {
        id: ID.into(),
        room: room.name.clone(),
        title: "Sum rate against iterations".into(),
        caption: vec![
            format!(
                "Each learner is judged on the same {states} held-out states with {blocked} users blocked, without exploration; iterations are episodes of 40 steps, \
                 {episodes} in all (the paper: 1000, of unstated length). {}",
                intervals(done)
            ),
            "The lines that do not learn stand on those same states, `random` as the mean of 30 draws. Nothing in them depends on a seed of training, so that they \
             have no band."
                .into(),
            "`ddpg-raw` is the paper's algorithm to the letter: all angles are outputs of the actor, rates, networks and buffer are the paper's. `ddpg` is ours: one weight \
             a user, decoded by geometry. `dql` chooses among quantised angles. The oracle stands for the exhaustive search, which 2 M continuous angles rule out; it \
             keeps minimum rates where it can, so that a policy that gives a user up can pass it."
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
    fn yardsticks_do_not_depend_on_the_seed_and_so_have_no_interval() {
        let yardsticks = Yardsticks { side: 7, blocked: 2, states: 2, episodes: 5 };
        let of_seed = |seed: u64| yardsticks.run(&Scenario { seed, ..Scenario::builtin("specular").unwrap() }).unwrap();
        assert_eq!(of_seed(1), of_seed(2));
    }
}
