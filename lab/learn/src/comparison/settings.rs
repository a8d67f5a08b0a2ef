//! The settings of a comparison.

use std::time::Duration;

use heliostat_channel::MirrorAngles;
use heliostat_core::policy::Fixed;
use heliostat_core::safety::Limits;
use heliostat_models::ActorSource;
use heliostat_scenario::Scenario;
use serde::Serialize;

use super::evaluated_policy::{EvaluatedPolicy, UnknownPolicy};

/// Draws over which a random policy is averaged.
pub(super) const RANDOM_DRAWS: usize = 30;

/// The origin of the states, and the effect of commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Loop {
    /// Held-out states, one by one.
    Static,
    /// Reports, latency, noise and actuators in simulated time.
    ClosedLoop,
}

impl Settings {
    /// The usual time from the controller's start to the first sampling interval.
    pub const WARM: Duration = heliostat_environment::episodes::WARM;

    /// Policies by their names on one seed, with built-in actors of training seed 1.
    ///
    /// # Errors
    /// As [`EvaluatedPolicy::parse`], to which `ddpg` is given.
    pub fn of_names(
        scenario: Scenario,
        names: &[&str],
        ddpg: &ActorSource,
        (mode, states): (Loop, usize),
    ) -> Result<Self, UnknownPolicy> {
        let policies = names.iter().map(|name| EvaluatedPolicy::parse(name, ddpg)).collect::<Result<_, _>>()?;
        let (warm, training_seed) = (Self::WARM, Some(1));
        Ok(Self { scenario, policies, states, seeds: 1, mode, warm, training_seed, without_mirrors: false })
    }
}

/// The policies and the states of a comparison.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The room; its seed is the first one.
    pub scenario: Scenario,
    /// The policies.
    pub policies: Vec<EvaluatedPolicy>,
    /// States of each seed.
    pub states: usize,
    /// Number of consecutive seeds.
    pub seeds: usize,
    /// Static or closed loop.
    pub mode: Loop,
    /// In closed loop, the time from the controller's start to the first sampling interval.
    pub warm: Duration,
    /// Training seed of the built-in actors to evaluate; `None` evaluates all of them.
    pub training_seed: Option<u32>,
    /// A room without mirrors: the scenario's mirrors reflect no light to users, whatever the policy
    /// or the oracle.
    pub without_mirrors: bool,
}

impl Settings {
    /// In a room without mirrors, the angles with which the scenario's mirrors reflect no light to users.
    pub(super) fn dark_angles(&self) -> Option<MirrorAngles> {
        let range_rad = Limits::new(&self.scenario.control).range_rad();
        let mirrors = self.scenario.mirror_count();
        self.without_mirrors.then(|| Fixed::no_irs(mirrors, range_rad).angles().clone())
    }

    /// Number of independent groups of states of each seed: episodes in closed loop, states in
    /// a static comparison.
    pub fn episodes(&self) -> usize {
        match self.mode {
            Loop::Static => self.states,
            Loop::ClosedLoop => self.states.div_ceil(heliostat_environment::episodes::INSTANTS),
        }
    }
}
