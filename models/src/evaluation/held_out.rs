//! Held-out states, and how near to the best possible a learner comes on them.
//!
//! The yardstick is the oracle with minimum rates: its angles and the learner's are judged by the same true evaluation. The
//! oracle ignores that a spot spills onto other users, so a ratio slightly above 1 is legitimate.

use anyhow::Context;
use heliostat_channel::mirrors::MirrorAngles;
use heliostat_channel::solver::{Method, MinimumRates, QOS_PENALTY, Solver};
use heliostat_channel::{ChannelModel, Scene};
use heliostat_scenario::Scenario;
use heliostat_sim::World;
use serde::Serialize;

use crate::env::Environment;
use crate::learner::Learner;

/// Seconds that users walk before a state is taken, so that places and headings are those of a walk that goes on.
pub(crate) const SETTLE_S: f64 = 20.0;

/// Keeps held-out rooms apart from those of training, whose seeds are drawn from the trainer's generator.
const HELD_OUT_SEED: u64 = 0x4e1d_0000_0000;

/// The seed of a held-out room: `set` tells apart rooms of different comparisons, `index` those of one. Set 0 is what training watches.
pub(crate) fn held_out_seed(set: u64, index: u64) -> u64 {
    HELD_OUT_SEED.wrapping_add(set << 20).wrapping_add(index)
}

/// A held-out room at the instant at which its state is taken.
pub(crate) fn held_out_world(scenario: &Scenario, set: u64, index: u64) -> anyhow::Result<World> {
    let mut world = World::new(scenario, scenario.read_trace()?.as_deref(), held_out_seed(set, index))?;
    world.step(SETTLE_S);
    Ok(world)
}

/// The angles of the oracle with minimum rates.
pub(crate) fn best_angles(
    solver: &mut Solver,
    model: &ChannelModel,
    scene: &Scene,
    min_rate_bps: &[f64],
) -> MirrorAngles {
    let mut angles = MirrorAngles::flat(model.mirrors.len());
    solver.solve(model, scene, &MinimumRates { min_rate_bps, qos_penalty: QOS_PENALTY }, Method::Oracle, &mut angles);
    angles
}

/// Two-sided 95 % quantiles of Student's t distribution for 1 to 30 degrees of freedom.
const T_95: [f64; 30] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131, 2.120,
    2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
];

/// A mean with half the width of its 95 % interval by Student's t.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// The quantile of Student's t times the standard error; NaN for a single value.
    pub ci95: f64,
}

impl Estimate {
    /// The estimate from independent values.
    pub fn of(values: &[f64]) -> Self {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
        let quantile = values.len().checked_sub(2).and_then(|index| T_95.get(index)).copied().unwrap_or(1.96);
        Self { mean, ci95: quantile * (variance / count).sqrt() }
    }
}

/// A score on held-out states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Score {
    /// Mean sum rate in Mbit/s.
    pub sum_rate_mbps: Estimate,
    /// The same without the array.
    pub no_irs_mbps: Estimate,
    /// The same of the oracle with minimum rates.
    pub oracle_mbps: Estimate,
    /// Ratio of sum rates to the oracle, state by state.
    pub ratio_to_oracle: Estimate,
    /// Share of users whose minimum rate is met.
    pub qos_met: f64,
    /// The same of the oracle.
    pub oracle_qos_met: f64,
}

struct State {
    environment: Environment,
    no_irs_bps: f64,
    oracle_bps: f64,
    oracle_met: f64,
}

/// A set of states that training never sees; the same for every training seed.
#[derive(Default)]
pub struct HeldOut {
    states: Vec<State>,
}

impl HeldOut {
    /// Adds states of a scenario, each in a room of its own and solved by the oracle.
    ///
    /// # Errors
    /// A scenario that makes no room.
    pub fn add(&mut self, scenario: &Scenario, count: usize) -> anyhow::Result<()> {
        let mut solver = Solver::new(scenario.users.count, scenario.mirror_count());
        for index in 0..count as u64 {
            let mut environment = Environment::new(scenario, held_out_seed(0, index))?;
            environment.step(SETTLE_S)?;
            self.states.push(Self::solve(environment, &mut solver));
        }
        Ok(())
    }

    fn solve(environment: Environment, solver: &mut Solver) -> State {
        let (model, seen) = (environment.model(), environment.observation());
        let users = seen.users();
        let angles = best_angles(solver, model, &seen.scene, &seen.min_rate_bps);
        let mut rates = vec![0.0; users];
        seen.scene.rates_bps(model, &angles, &mut rates);
        let direct = seen.scene.los_gain().iter().map(|gain| model.budget.rate_bps(model.budget.sinr(*gain), users));
        State {
            no_irs_bps: direct.sum(),
            oracle_bps: rates.iter().sum(),
            oracle_met: met(&rates, &seen.min_rate_bps),
            environment,
        }
    }

    /// The score of what a learner has learned so far, without exploration.
    ///
    /// # Errors
    /// Those of [`Learner::act`].
    pub fn score(&mut self, learner: &dyn Learner) -> anyhow::Result<Score> {
        self.judge(|environment| learner.act(environment))
    }

    /// The score of the best that a learner could ever give; `None` where that cannot be tried.
    ///
    /// # Errors
    /// A learner that knows its best in one state and not in another.
    pub fn ceiling(&mut self, learner: &dyn Learner) -> anyhow::Result<Option<Score>> {
        let known = self.states.first().is_some_and(|state| learner.best_possible(&state.environment).is_some());
        let best = |environment: &Environment| learner.best_possible(environment).context("no best angles here");
        if known { self.judge(best).map(Some) } else { Ok(None) }
    }

    fn judge(&mut self, act: impl Fn(&Environment) -> anyhow::Result<MirrorAngles>) -> anyhow::Result<Score> {
        let mut rows = Vec::with_capacity(self.states.len());
        for state in &mut self.states {
            let angles = act(&state.environment)?;
            let rates = state.environment.rates_bps(&angles).to_vec();
            rows.push((rates.iter().sum::<f64>(), met(&rates, &state.environment.observation().min_rate_bps)));
        }
        let mbps = |value: f64| 1e-6 * value;
        let estimate = |value: &dyn Fn(usize) -> f64| Estimate::of(&(0..rows.len()).map(value).collect::<Vec<_>>());
        Ok(Score {
            sum_rate_mbps: estimate(&|index| mbps(rows[index].0)),
            no_irs_mbps: estimate(&|index| mbps(self.states[index].no_irs_bps)),
            oracle_mbps: estimate(&|index| mbps(self.states[index].oracle_bps)),
            ratio_to_oracle: self.ratio(&rows),
            qos_met: estimate(&|index| rows[index].1).mean,
            oracle_qos_met: estimate(&|index| self.states[index].oracle_met).mean,
        })
    }

    /// States in which nobody can be served have no ratio.
    fn ratio(&self, rows: &[(f64, f64)]) -> Estimate {
        let pairs = rows.iter().zip(&self.states).filter(|(_, state)| state.oracle_bps > 0.0);
        Estimate::of(&pairs.map(|(row, state)| row.0 / state.oracle_bps).collect::<Vec<_>>())
    }
}

/// Share of users whose need is met; a need that is missed by rounding alone counts as met.
pub(crate) fn met(rates: &[f64], needs: &[f64]) -> f64 {
    let count = rates.iter().zip(needs).filter(|(rate, need)| **rate >= **need * (1.0 - 1e-9)).count();
    count as f64 / rates.len() as f64
}
