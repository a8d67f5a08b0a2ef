//! Policies that solve the channel model at every tick, without training and without a file.

use heliostat_channel::{
    ChannelModel,
    mirrors::MirrorAngles,
    solver::{Method, MinimumRates, QOS_PENALTY, Solver, Start},
};

use heliostat_proto::MAX_USERS;

use super::proposal::{Policy, PolicyMemory, PolicyResult};
use crate::observe::{observation::Observation, slots::Slots};

/// Passes of single mirror moves after the fixed point; docs/evaluation.md compares the result with
/// the oracle.
const GREEDY_PASSES: usize = 3;

/// The damped fixed point over the users' weights, started from the last solution, with or without
/// single mirror moves after it; or the oracle.
pub struct ModelBased {
    name: &'static str,
    method: Method,
    solver: Solver,
    /// The users of the solver's weights.
    slots: Slots,
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

    /// The multi-start solver, applied to the observation instead of the true state.
    pub fn oracle(users: usize, mirrors: usize) -> Self {
        Self::new("oracle", Method::Oracle, users, mirrors)
    }

    fn new(name: &'static str, method: Method, users: usize, mirrors: usize) -> Self {
        let solver = Solver::with_capacity(users, MAX_USERS, mirrors);
        Self { name, method, solver, slots: Slots::of(users) }
    }
}

impl Policy for ModelBased {
    fn name(&self) -> &str {
        self.name
    }

    fn act(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) -> PolicyResult {
        if self.slots.follow(&observation.ids) {
            self.solver.change_users(self.slots.former());
        }
        let minimum_rates = MinimumRates { min_rate_bps: &observation.min_rate_bps, qos_penalty: QOS_PENALTY };
        self.solver.solve(model, &observation.scene, &minimum_rates, self.method, out);
        Ok(())
    }

    fn memory(&self) -> PolicyMemory {
        let mut start = self.solver.start_buffer();
        self.solver.copy_start(&mut start);
        let Start { weights, served, midpoints } = start;
        PolicyMemory { users: self.slots.ids().to_vec(), weights, served, midpoints, ..PolicyMemory::default() }
    }

    fn restore(&mut self, memory: &PolicyMemory) {
        let PolicyMemory { users, weights, served, midpoints, .. } = memory.clone();
        if !(1..=MAX_USERS).contains(&users.len()) {
            return;
        }
        if self.slots.follow(&users) {
            self.solver.change_users(self.slots.former());
        }
        self.solver.set_start(&Start { weights, served, midpoints });
    }
}
