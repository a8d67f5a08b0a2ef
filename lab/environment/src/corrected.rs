//! The policy of a learner that corrects the belief.

use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::observation::Observation;
use heliostat_core::policy::{ModelBased, Policy, PolicyError};
use heliostat_scenario::Scenario;

/// The policy `greedy`, for which the core keeps the evidence that a learner reads. The corrections
/// come from the learner
/// ([`Controller::poll_corrected`](heliostat_core::core::Controller::poll_corrected)).
pub(crate) struct CorrectedGreedy {
    solver: ModelBased,
}

impl CorrectedGreedy {
    /// For the users and mirrors of a room.
    pub fn new(scenario: &Scenario) -> Self {
        Self { solver: ModelBased::greedy(scenario.users.count, scenario.mirror_count()) }
    }
}

impl Policy for CorrectedGreedy {
    fn name(&self) -> &str {
        self.solver.name()
    }

    fn reads_evidence(&self) -> bool {
        true
    }

    fn act(
        &mut self,
        model: &ChannelModel,
        observation: &Observation,
        out: &mut MirrorAngles,
    ) -> Result<(), PolicyError> {
        self.solver.act(model, observation, out)
    }
}
