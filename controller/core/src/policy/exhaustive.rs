//! Exhaustive search over all assignments; feasible only for small arrays.

use heliostat_channel::solver::{MinimumRates, QOS_PENALTY, Solver, SolverError};
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_scenario::{ChannelMode, Scenario};

use super::proposal::{Policy, PolicyResult};
use crate::observe::observation::Observation;

/// Tries everything; for arrays of a dozen mirrors at most, and only where mirrors obey the law of
/// reflection.
pub struct Exhaustive {
    solver: Solver,
}

impl Exhaustive {
    /// For the room of a scenario.
    ///
    /// # Errors
    /// [`SolverError`] where there are too many assignments, or angles are continuous.
    pub fn new(scenario: &Scenario) -> Result<Self, SolverError> {
        let (users, mirrors) = (scenario.users.count, scenario.mirror_count());
        if scenario.channel.mode != ChannelMode::Specular {
            return Err(SolverError::Continuous);
        }
        SolverError::check_assignments(users, mirrors)?;
        Ok(Self { solver: Solver::new(users, mirrors) })
    }
}

impl Policy for Exhaustive {
    fn name(&self) -> &str {
        "exhaustive"
    }

    fn act(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) -> PolicyResult {
        self.solver.set_users(observation.users());
        let minimum_rates = MinimumRates { min_rate_bps: &observation.min_rate_bps, qos_penalty: QOS_PENALTY };
        self.solver.solve_exhaustively(model, &observation.scene, &minimum_rates, out)?;
        Ok(())
    }
}
