//! A function of a user as a policy: from the observation vector of an environment to an action.
//!
//! The function sees what an environment shows with the observation `flat`, and answers in the forms
//! of [`ActionForm`]. A function that fails, or answers with another length or with a value that is
//! not finite, is a failed decision: the controller's fallback then proposes.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::observation::{Observation, ObservationEncoder, USERS_CAPACITY};
use heliostat_core::policy::{Policy, PolicyError, PolicyResult};
use heliostat_core::safety::Limits;
use heliostat_core::selection::Selection;
use heliostat_scenario::Scenario;

use crate::action::{ActionDecoder, ActionForm, Seen};

/// A policy around a function from an observation vector to an action, or to the reason of its
/// failure.
pub struct FunctionPolicy<F> {
    name: String,
    function: F,
    encoder: ObservationEncoder,
    selection: Selection,
    vector: Vec<f32>,
    decoder: ActionDecoder,
    failures: Arc<AtomicU64>,
}

impl<F: FnMut(&[f32]) -> Result<Vec<f32>, String> + Send> FunctionPolicy<F> {
    /// The policy for a scenario's room under a name of reports.
    pub fn new(name: &str, scenario: &Scenario, form: ActionForm, function: F) -> Self {
        let slots = USERS_CAPACITY.max(scenario.users.count);
        let encoder = ObservationEncoder::new(slots, scenario.mirror_count());
        Self {
            name: name.into(),
            function,
            selection: Selection::new(slots),
            vector: vec![0.0; encoder.len()],
            decoder: ActionDecoder::new(form, encoder, Limits::new(&scenario.control).range_rad()),
            encoder,
            failures: Arc::default(),
        }
    }

    /// The number of failed decisions, which counts on.
    pub fn failures(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.failures)
    }

    fn propose(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) -> PolicyResult {
        let chosen = self.selection.choose(observation);
        self.encoder.encode_users(model, observation, chosen.iter().copied(), &mut self.vector)?;
        let failed = |message: String| PolicyError::Function { name: self.name.clone(), message };
        let action = (self.function)(&self.vector).map_err(failed)?;
        let seen = Seen { observation, chosen, encoder: self.encoder, vector: &self.vector };
        self.decoder.decode(model, seen, &action, out).map_err(|error| failed(error.to_string()))
    }
}

impl<F: FnMut(&[f32]) -> Result<Vec<f32>, String> + Send> Policy for FunctionPolicy<F> {
    fn name(&self) -> &str {
        &self.name
    }

    fn act(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) -> PolicyResult {
        let proposed = self.propose(model, observation, out);
        if proposed.is_err() {
            self.failures.fetch_add(1, Ordering::Relaxed);
        }
        proposed
    }

    fn users_max(&self) -> usize {
        self.encoder.users_max()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_action_becomes_angles_and_a_failure_is_counted_with_its_reason() {
        let scenario = Scenario::builtin("specular").expect("built in");
        let model = scenario.channel_model().expect("a channel");
        let observation = Observation::new(&model, scenario.users.count);
        let mut angles = MirrorAngles::flat(model.mirrors.len());
        let answers = [Ok(vec![0.5; 200]), Ok(vec![0.5; 3]), Ok(vec![f32::NAN; 200]), Err("it raised".to_owned())];
        let mut answers = answers.into_iter();
        let function = |seen: &[f32]| {
            assert_eq!(seen.len(), ObservationEncoder::new(USERS_CAPACITY, 100).len());
            answers.next().expect("four calls")
        };
        let mut policy = FunctionPolicy::new("mine", &scenario, ActionForm::Angles, function);
        let failures = policy.failures();
        policy.act(&model, &observation, &mut angles).expect("a proposal");
        assert!(angles.roll.iter().chain(&angles.yaw).all(|angle| *angle > 0.0));
        for part in ["length 3", "length 3", "it raised"] {
            let error = policy.act(&model, &observation, &mut angles).expect_err("it fails").to_string();
            let expected = if error.contains("NaN") { "finite" } else { part };
            assert!(error.starts_with("the function mine failed: ") && error.contains(expected), "{error}");
        }
        assert_eq!(failures.load(Ordering::Relaxed), 3);
    }
}
