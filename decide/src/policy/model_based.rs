//! Policies that solve the channel model at every tick; they need no training and no file.

use heliostat_channel::{
    ChannelModel,
    mirrors::MirrorAngles,
    solver::{Method, MinimumRates, QOS_PENALTY, Solver},
};

use super::{Policy, PolicyError};
use crate::observation::Observation;

/// Passes of single mirror moves after the fixed point: three reach 0.998 of the oracle with two blocked users.
const GREEDY_PASSES: usize = 3;

/// The damped fixed point over the users' weights, with or without single mirror moves after it, started from the last answer; or
/// the oracle.
pub struct ModelBased {
    name: &'static str,
    method: Method,
    solver: Solver,
    /// The solver's memory during a rehearsal.
    remembered: Vec<f64>,
}

impl ModelBased {
    /// The fixed point alone.
    pub fn fixed_point(users: usize, mirrors: usize) -> Self {
        Self::new("fixed-point", Method::FixedPoint, users, mirrors)
    }

    /// The fixed point, then passes of single mirror moves.
    pub fn greedy(users: usize, mirrors: usize) -> Self {
        Self::new("greedy", Method::Greedy { passes: GREEDY_PASSES }, users, mirrors)
    }

    /// The yardstick itself, on what the observation says.
    pub fn oracle(users: usize, mirrors: usize) -> Self {
        Self::new("oracle", Method::Oracle, users, mirrors)
    }

    fn new(name: &'static str, method: Method, users: usize, mirrors: usize) -> Self {
        Self { name, method, solver: Solver::new(users, mirrors), remembered: Vec::with_capacity(users) }
    }
}

impl Policy for ModelBased {
    fn name(&self) -> &str {
        self.name
    }

    fn act(
        &mut self,
        model: &ChannelModel,
        observation: &Observation,
        out: &mut MirrorAngles,
    ) -> Result<(), PolicyError> {
        let need = MinimumRates { min_rate_bps: &observation.min_rate_bps, qos_penalty: QOS_PENALTY };
        self.solver.solve(model, &observation.scene, &need, self.method, out);
        Ok(())
    }

    fn rehearse(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) {
        if self.method == Method::Oracle {
            // Longer than a tick: it would be in the way of the report that it prepares for.
            return;
        }
        self.remembered.clear();
        self.remembered.extend_from_slice(self.solver.weights());
        let _ = self.act(model, observation, out);
        self.solver.set_weights(&self.remembered);
    }
}
