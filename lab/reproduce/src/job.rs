//! What a part computes: the type of each computation, with every number that it takes.
//!
//! The serialised form enters the key of a finished part, see [`crate::part`].

use serde::Serialize;

/// A computation, with all its parameters.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Job {
    /// One training run with evaluations.
    Learning(Learning),
    /// Policies without training, for comparison with the training runs.
    Baselines(Baselines),
    /// Sum rates at several powers.
    Power(Power),
    /// SINR kept with delayed reports.
    Aim(Aim),
    /// Decision times.
    Timing(Timing),
    /// Outages in closed loop.
    Outage(Outage),
    /// Rates over the floor.
    Map(Map),
}

impl Job {
    /// Whether it evaluates a ready-made actor.
    pub fn needs_actor(&self) -> bool {
        !matches!(self, Self::Learning(_) | Self::Baselines(_))
    }
}

/// One training run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Learning {
    /// The learner.
    pub learner: String,
    /// Rows and columns.
    pub side: usize,
    /// Users whose direct path is blocked in the evaluation states.
    pub blocked: usize,
    /// Episodes.
    pub episodes: usize,
    /// Evaluations after the start.
    #[serde(rename = "judgements")]
    pub evaluations: usize,
    /// Evaluation states.
    pub states: usize,
}

/// Policies that do not learn, evaluated on the states on which the learners are evaluated.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Baselines {
    /// Rows and columns.
    pub side: usize,
    /// As in [`Learning`].
    pub blocked: usize,
    /// As in [`Learning`].
    pub states: usize,
    /// Episode at which the lines end.
    pub episodes: usize,
}

/// One seed of one number of blocked users.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Power {
    /// Users whose direct path is blocked.
    pub blocked: usize,
    /// Optical powers in W.
    pub powers_w: Vec<f64>,
    /// States at each power.
    pub states: usize,
}

/// One seed of one delay, for all speeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Aim {
    /// Time between two reports in ms.
    pub interval_ms: f64,
    /// Age of a report at its arrival in ms.
    pub latency_ms: f64,
    /// Whether the controller predicts with constant velocity.
    pub prediction: bool,
    /// Instants at each speed.
    pub instants: usize,
}

/// One seed of one array.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Timing {
    /// Whether the array has nine mirrors and the room three users, for the exhaustive search.
    pub small: bool,
    /// Decisions of each fast policy.
    pub decisions: usize,
    /// Decisions of each other policy.
    pub slow_decisions: usize,
    /// Evaluations of the metaheuristics for one decision, without a time limit.
    pub trials: u32,
}

/// One seed, for all numbers of blocked users.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outage {
    /// Numbers of users whose direct path is blocked.
    pub blocked: Vec<usize>,
    /// Instants for each of them.
    pub instants: usize,
}

/// One room at one instant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Map {
    /// Distance between points in cm.
    pub step_cm: f64,
}
