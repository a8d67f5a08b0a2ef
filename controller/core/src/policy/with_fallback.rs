//! A policy with the fallback that proposes when the policy fails.

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};
use serde::{Deserialize, Serialize};

use super::{
    proposal::{Policy, PolicyError, PolicyMemory, PolicyResult},
    tally::Tallies,
    warm_up::warm_up,
};
use crate::{observe::observation::Observation, output::safety};

/// The policy of a room, its fallback, and its last failure.
pub struct WithFallback {
    policy: Box<dyn Policy>,
    fallback: Option<Box<dyn Policy>>,
    last_failure: Option<PolicyError>,
    /// The figures of each policy.
    pub tallies: Tallies,
}

/// The states of a policy and of its fallback.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FallbackMemory {
    /// Name of the policy.
    policy: String,
    states: [PolicyMemory; 2],
}

/// Which policy has proposed angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProposedBy {
    /// The policy.
    Policy,
    /// The fallback, because the policy failed.
    Fallback,
    /// None: both failed, or there is no fallback.
    None,
}

impl WithFallback {
    /// A policy, with or without a fallback.
    pub fn new(policy: Box<dyn Policy>, fallback: Option<Box<dyn Policy>>) -> Self {
        Self { tallies: Tallies::new(policy.name()), policy, fallback, last_failure: None }
    }

    /// A copy with these policies of the same names, which continue from the present states.
    pub fn duplicate(&self, policy: Box<dyn Policy>, fallback: Option<Box<dyn Policy>>) -> Self {
        let mut copy = Self { policy, fallback, last_failure: None, tallies: self.tallies.clone() };
        copy.restore(&self.memory());
        copy
    }

    /// The policy.
    pub fn policy(&self) -> &dyn Policy {
        self.policy.as_ref()
    }

    /// How many of this number of users the policy leaves out.
    pub fn unserved(&self, users: usize) -> usize {
        users.saturating_sub(self.policy.users_max())
    }

    /// The last failure of the policy.
    pub fn last_failure(&self) -> Option<&PolicyError> {
        self.last_failure.as_ref()
    }

    /// Replaces the policy, and returns the former one.
    pub fn replace_policy(&mut self, policy: Box<dyn Policy>) -> Box<dyn Policy> {
        self.tallies.switch_to(policy.name());
        std::mem::replace(&mut self.policy, policy)
    }

    /// Lets the policy propose angles, or the fallback if the policy fails.
    pub fn propose(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) -> ProposedBy {
        let Err(failure) = attempt(self.policy.as_mut(), model, observation, out) else { return ProposedBy::Policy };
        self.last_failure = Some(failure);
        if self.fall_back(model, observation, out) { ProposedBy::Fallback } else { ProposedBy::None }
    }

    /// Lets the fallback propose angles; false if it fails, or there is none.
    pub fn fall_back(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) -> bool {
        let Some(fallback) = self.fallback.as_mut() else { return false };
        attempt(fallback.as_mut(), model, observation, out).is_ok()
    }

    /// The present states.
    pub fn memory(&self) -> FallbackMemory {
        let fallback = self.fallback.as_ref().map(|fallback| fallback.memory()).unwrap_or_default();
        FallbackMemory { policy: self.policy.name().to_owned(), states: [self.policy.memory(), fallback] }
    }

    /// Replaces the states; that of another policy is left out.
    pub fn restore(&mut self, memory: &FallbackMemory) {
        let [policy, fallback] = &memory.states;
        if memory.policy == self.policy.name() {
            self.policy.restore(policy);
        }
        if let Some(own) = self.fallback.as_mut() {
            own.restore(fallback);
        }
    }

    /// Lets both decide for a synthetic room of `users` users, once for each item of `runs`.
    pub fn warm_up(&mut self, model: &ChannelModel, users: usize, runs: impl Iterator) {
        let mut policies: Vec<&mut dyn Policy> = vec![self.policy.as_mut()];
        if let Some(fallback) = self.fallback.as_mut() {
            policies.push(fallback.as_mut());
        }
        warm_up(&mut policies, model, users, runs);
    }
}

/// One proposal, checked for values that are not finite.
fn attempt(
    policy: &mut dyn Policy,
    model: &ChannelModel,
    observation: &Observation,
    out: &mut MirrorAngles,
) -> PolicyResult {
    policy.act(model, observation, out)?;
    Ok(safety::check_finite(out)?)
}
