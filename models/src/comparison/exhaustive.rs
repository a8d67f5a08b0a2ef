//! Every assignment of mirrors to users: the best there is by the table of gains, where it can be found at all.

use heliostat_channel::solver::{Need, Problem, QOS_PENALTY, Solver};
use heliostat_channel::{ChannelModel, MirrorAngles, decode};
use heliostat_controller::observation::Observation;
use heliostat_controller::policy::{Policy, PolicyError};

/// Tries everything; for arrays of a dozen mirrors at most, and only where mirrors obey the law of reflection.
pub(super) struct Exhaustive {
    solver: Solver,
}

impl Exhaustive {
    pub(super) fn new(users: usize, mirrors: usize) -> Self {
        Self { solver: Solver::new(users, mirrors) }
    }
}

impl Policy for Exhaustive {
    fn name(&self) -> &str {
        "exhaustive"
    }

    fn act(
        &mut self,
        model: &ChannelModel,
        observation: &Observation,
        out: &mut MirrorAngles,
    ) -> Result<(), PolicyError> {
        let need = Need { min_rate_bps: &observation.min_rate_bps, qos_penalty: QOS_PENALTY };
        self.solver.exhaustive(&Problem::of_scene(model, &observation.scene, &need))?;
        decode::aim(model, &observation.scene, self.solver.served(), out);
        Ok(())
    }
}
