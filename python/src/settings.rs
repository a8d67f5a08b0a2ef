//! The settings of an environment, checked once.

use std::sync::Arc;

use heliostat_channel::MirrorAngles;
use heliostat_core::policy::removed;
use heliostat_environment::action::ActionForm;
use heliostat_environment::episodes::{HeldOutEpisode, WARM, held_out_episodes};
use heliostat_environment::room::{Reward, RewardForm};
use heliostat_environment::sampling::Sampled;
use heliostat_environment::task::{Dynamics, ObservationForm, TaskSettings};
use heliostat_room::World;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::error::{guarded, refused};
use crate::scenario::Scenario;

/// What an environment is: scenario, dynamics, forms of action and observation, reward.
#[pyclass(frozen, module = "heliostat._core")]
pub struct Settings {
    pub inner: Arc<TaskSettings>,
}

/// The value of a setting by its name.
fn choice<T: Copy>(setting: &str, name: &str, known: &[(&str, T)]) -> PyResult<T> {
    known.iter().find(|(found, _)| *found == name).map(|(_, value)| *value).ok_or_else(|| {
        if let Some(removed) = removed(name) {
            return refused(format!("{setting} = {name:?}: {removed}"));
        }
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
        let actions = [("angles", ActionForm::Angles), ("weights", ActionForm::Weights)];
        let action = choice("action", action, &actions)?;
        let forms = [
            ("flat", ObservationForm::Vector),
            ("dict", ObservationForm::Vector),
            ("paper", ObservationForm::AngleState),
            ("belief", ObservationForm::Belief),
        ];
        let observation = choice("observation", observation, &forms)?;
        let form =
            choice("reward", reward, &[("shortfall", RewardForm::Shortfall), ("printed", RewardForm::AsPrinted)])?;
        let trace = guarded(|| scenario.inner.read_trace().map_err(refused))?;
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

/// Sum rate in Mbit/s and share of minimum rates met of the oracle at each sampling time of each
/// episode of a comparison in closed loop, in the order of the episodes: shape (n, 2).
#[pyfunction]
pub fn oracle_samples<'py>(
    py: Python<'py>,
    scenario: &Scenario,
    states: usize,
    seeds: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let room = &scenario.inner;
    let samples = py.detach(|| {
        guarded(|| {
            let trace = room.read_trace().map_err(refused)?;
            let episodes = held_out_episodes(room, trace.as_deref(), (states, seeds), WARM).map_err(refused)?;
            let solve = |episode: &HeldOutEpisode| {
                let mut rows = Vec::new();
                let look = |world: &World, angles: &MirrorAngles| {
                    let Sampled { sum_rate_mbps, met } = Sampled::of(world, angles);
                    rows.extend([sum_rate_mbps, met]);
                };
                episode.solve(room, trace.as_deref(), look).map_err(refused)?;
                Ok(rows)
            };
            let rows: PyResult<Vec<Vec<f64>>> = episodes.par_iter().map(solve).collect();
            Ok(rows?.concat())
        })
    })?;
    let count = samples.len() / 2;
    PyArray1::from_vec(py, samples).reshape([count, 2])
}
