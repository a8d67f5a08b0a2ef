//! The settings of an environment, checked once.

use std::sync::Arc;

use heliostat_environment::action::ActionForm;
use heliostat_environment::room::{Reward, RewardForm};
use heliostat_environment::task::{Dynamics, ObservationForm, TaskSettings};
use pyo3::prelude::*;

use crate::error::refused;
use crate::scenario::Scenario;

/// What an environment is: scenario, dynamics, forms of action and observation, reward.
#[pyclass(frozen, module = "heliostat._core")]
pub struct Settings {
    pub inner: Arc<TaskSettings>,
}

/// The value of a setting by its name.
fn choice<T: Copy>(setting: &str, name: &str, known: &[(&str, T)]) -> PyResult<T> {
    known.iter().find(|(found, _)| *found == name).map(|(_, value)| *value).ok_or_else(|| {
        let names: Vec<String> = known.iter().map(|(name, _)| format!("{name:?}")).collect();
        refused(format!("{setting} = {name:?}: expected {}", names.join(", ")))
    })
}

#[pymethods]
impl Settings {
    #[new]
    #[pyo3(signature = (
        scenario, *, dynamics, action, observation, reward, penalty, margin, step_s, settle_s, oracle
    ))]
    #[expect(clippy::too_many_arguments, reason = "the keywords of a Python constructor")]
    fn new(
        scenario: &Scenario,
        dynamics: &str,
        action: &str,
        observation: &str,
        reward: &str,
        penalty: f64,
        margin: f64,
        step_s: f64,
        settle_s: f64,
        oracle: bool,
    ) -> PyResult<Self> {
        let dynamics = choice(
            "dynamics",
            dynamics,
            &[("static", Dynamics::Static { step_s }), ("closed-loop", Dynamics::ClosedLoop)],
        )?;
        let action = choice("action", action, &[("angles", ActionForm::Angles), ("weights", ActionForm::Weights)])?;
        let forms = [
            ("flat", ObservationForm::Vector),
            ("dict", ObservationForm::Vector),
            ("paper", ObservationForm::AngleState),
            ("belief", ObservationForm::Belief),
        ];
        let observation = choice("observation", observation, &forms)?;
        let form =
            choice("reward", reward, &[("shortfall", RewardForm::Shortfall), ("printed", RewardForm::AsPrinted)])?;
        let trace = scenario.inner.read_trace().map_err(refused)?;
        let inner = TaskSettings {
            scenario: scenario.inner.clone(),
            trace,
            dynamics,
            action,
            observation,
            reward: Reward { form, lambda: penalty, margin },
            settle_s,
            oracle,
        };
        Ok(Self { inner: Arc::new(inner) })
    }
}

/// The seed of a held-out room, which training never uses: `heliostat eval` takes its states from
/// the rooms `index` = 0, 1, ... of the set `scenario_seed`.
#[pyfunction]
pub fn held_out_seed(scenario_seed: u64, index: u64) -> u64 {
    heliostat_environment::held_out::held_out_seed(scenario_seed, index)
}
