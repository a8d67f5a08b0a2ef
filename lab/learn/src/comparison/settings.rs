//! The settings of a comparison.

use std::time::Duration;

use heliostat_scenario::Scenario;
use serde::Serialize;

use super::evaluated_policy::EvaluatedPolicy;

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
}

/// The policies and the states of a comparison.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The room; its seed is the first room seed.
    pub scenario: Scenario,
    /// The policies.
    pub policies: Vec<EvaluatedPolicy>,
    /// States of each room seed.
    pub states: usize,
    /// Number of consecutive room seeds.
    pub seeds: usize,
    /// Static or closed loop.
    pub mode: Loop,
    /// In closed loop, the time from the controller's start to the first sampling interval.
    pub warm: Duration,
    /// Training seed of the built-in actors to evaluate; `None` evaluates all of them.
    pub training_seed: Option<u32>,
}
