//! Held-out states, and the score of a policy on them relative to the oracle.
//!
//! The reference is the oracle with minimum rates: the best local optimum that the solver finds
//! from the true state ([`heliostat_channel::solver`]). It is not a proven optimum. The same true
//! evaluation applies to its angles and to the policy's, so a ratio slightly above 1 is possible.

use anyhow::Context;
use heliostat_channel::mirrors::MirrorAngles;
use heliostat_channel::solver::Solver;
pub(crate) use heliostat_environment::held_out::{SETTLE_S, best_angles, held_out_seed, held_out_world, met};
use heliostat_scenario::Scenario;
use serde::Serialize;

use crate::environment::room::Environment;
use heliostat_environment::statistics::Estimate;

/// A score on held-out states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Score {
    /// Mean sum rate in Mbit/s.
    pub sum_rate_mbps: Estimate,
    /// Mean sum rate without the array in Mbit/s.
    pub no_irs_mbps: Estimate,
    /// Mean sum rate of the oracle with minimum rates in Mbit/s.
    pub oracle_mbps: Estimate,
    /// Ratio of the sum rate to the oracle's, state by state.
    pub ratio_to_oracle: Estimate,
    /// Share of users whose minimum rate is met.
    pub qos_met: f64,
    /// Share of users whose minimum rate the oracle meets.
    pub oracle_qos_met: f64,
}

struct State {
    environment: Environment,
    no_irs_bps: f64,
    oracle_bps: f64,
    oracle_met: f64,
}

/// A set of states that training never uses; the same for every training seed.
#[derive(Default)]
pub struct HeldOut {
    states: Vec<State>,
}

impl HeldOut {
    /// Adds states of a scenario, each in a separate room, with the oracle's solution.
    ///
    /// # Errors
    /// The scenario describes no room.
    pub fn add(&mut self, scenario: &Scenario, count: usize) -> anyhow::Result<()> {
        let mut solver = Solver::new(scenario.users.count, scenario.mirror_count());
        for index in 0..count as u64 {
            let trace = scenario.read_trace()?;
            let mut environment = Environment::new(scenario, trace.as_deref(), held_out_seed(0, index))?;
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

    /// The score of the angles that `best` returns; `None` where it returns none.
    ///
    /// # Errors
    /// `best` returns angles in one state and none in another.
    pub fn upper_bound(
        &mut self,
        best: impl Fn(&Environment) -> Option<MirrorAngles>,
    ) -> anyhow::Result<Option<Score>> {
        if self.states.first().is_none_or(|state| best(&state.environment).is_none()) {
            return Ok(None);
        }
        self.score(|environment| best(environment).context("a state without a best action")).map(Some)
    }

    /// The score of the angles that `act` returns.
    ///
    /// # Errors
    /// Errors of `act`.
    pub fn score(&mut self, act: impl Fn(&Environment) -> anyhow::Result<MirrorAngles>) -> anyhow::Result<Score> {
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

    /// The mean ratio; a state in which no user can be served has none.
    fn ratio(&self, rows: &[(f64, f64)]) -> Estimate {
        let pairs = rows.iter().zip(&self.states).filter(|(_, state)| state.oracle_bps > 0.0);
        Estimate::of(&pairs.map(|(row, state)| row.0 / state.oracle_bps).collect::<Vec<_>>())
    }
}
