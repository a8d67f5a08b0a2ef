//! The settings of a task: the room, and what an action and an observation are.

use heliostat_scenario::Scenario;

use crate::action::ActionForm;
use crate::error::EnvironmentError;
use crate::held_out::SETTLE_S;
use crate::room::{Reward, RewardForm};

/// How the room answers an action.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Dynamics {
    /// True state, instant mirrors; `step_s` seconds between two actions.
    Static {
        /// Time between two actions in s.
        step_s: f64,
    },
    /// Reports, belief and mirrors as in a running room.
    ClosedLoop,
}

/// What the learner observes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObservationForm {
    /// The vector of [`heliostat_core::observation`], which an exported actor reads.
    Vector,
    /// The paper's state: presence, positions, gains, minimum rates and angles
    /// ([`AngleState`](crate::angle_state::AngleState)).
    AngleState,
    /// One row for each slot: [`believed`](crate::believed).
    Belief,
}

/// The settings of a task.
#[derive(Clone, Debug)]
pub struct TaskSettings {
    /// The room.
    pub scenario: Scenario,
    /// The text of the file `users.trace`.
    pub trace: Option<String>,
    /// How the room answers an action.
    pub dynamics: Dynamics,
    /// What an action means.
    pub action: ActionForm,
    /// What the learner observes.
    pub observation: ObservationForm,
    /// The reward.
    pub reward: Reward,
    /// Seconds that users walk before the first observation.
    pub settle_s: f64,
    /// Whether each step also evaluates the oracle, which takes far longer than the step.
    pub oracle: bool,
}

impl TaskSettings {
    /// A room with its true state, one second between two actions.
    pub fn of_true_state(scenario: Scenario) -> Self {
        Self {
            scenario,
            trace: None,
            dynamics: Dynamics::Static { step_s: 1.0 },
            action: ActionForm::Angles,
            observation: ObservationForm::Vector,
            reward: Reward { form: RewardForm::Shortfall, lambda: 1.0, margin: 1.0 },
            settle_s: SETTLE_S,
            oracle: false,
        }
    }

    /// A room in closed loop.
    pub fn closed_loop(scenario: Scenario) -> Self {
        Self { dynamics: Dynamics::ClosedLoop, ..Self::of_true_state(scenario) }
    }

    pub(crate) fn check(&self) -> Result<(), EnvironmentError> {
        let refuse =
            |name, value: f64, expected| Err(EnvironmentError::Setting { name, value: value.to_string(), expected });
        if let Dynamics::Static { step_s } = self.dynamics
            && !(step_s > 0.0 && step_s <= 86_400.0)
        {
            return refuse("step_s", step_s, "seconds above 0, up to 86400");
        }
        if !(0.0..=86_400.0).contains(&self.settle_s) {
            return refuse("settle_s", self.settle_s, "0 to 86400 seconds");
        }
        let Reward { lambda, margin, .. } = self.reward;
        if !(lambda.is_finite() && lambda >= 0.0) {
            return refuse("penalty", lambda, "a number from 0");
        }
        if !(margin.is_finite() && margin >= 0.0) {
            return refuse("margin", margin, "a number from 0");
        }
        Ok(())
    }
}
