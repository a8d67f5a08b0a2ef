//! The settings of an environment, checked once.

use std::sync::Arc;

use heliostat_channel::MirrorAngles;
use heliostat_core::belief::conditions::{Condition, conditions};
use heliostat_environment::action::ActionForm;
use heliostat_environment::episodes::{HeldOutEpisode, WARM, held_out_episodes};
use heliostat_environment::exact_states;
use heliostat_environment::held_out::held_out_state;
use heliostat_environment::room::{Reward, RewardForm};
use heliostat_environment::score::{Figure, Sample};
use heliostat_environment::statistics::{Estimate, Spread};
use heliostat_environment::task::{Dynamics, ObservationForm, TaskSettings};
use heliostat_room::World;
use heliostat_scenario::similar;
use numpy::ndarray::ArrayView1;
use numpy::{PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use rayon::prelude::*;

use crate::error::{guarded, refused};
use crate::scenario::Scenario;
use crate::threads::on_all_cores;

/// What an environment is: scenario, dynamics, forms of action and observation, reward.
#[pyclass(frozen, module = "heliostat._core")]
pub struct Settings {
    pub inner: Arc<TaskSettings>,
}

/// The value of a setting by its name.
fn choice<T: Copy>(setting: &str, name: &str, known: &[(&str, T)]) -> PyResult<T> {
    known.iter().find(|(found, _)| *found == name).map(|(_, value)| *value).ok_or_else(|| {
        let names: Vec<String> = known.iter().map(|(name, _)| format!("{name:?}")).collect();
        let hint = similar::hint(name, known.iter().map(|(known, _)| *known));
        refused(format!("{setting} = {name:?}: expected {}{hint}", names.join(", ")))
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
        let trace = guarded(|| scenario.inner.read_trace().map_err(refused))?;
        let text = (scenario, trace);
        settings_of(text, (dynamics, action, observation, reward), (penalty, margin, step_s, settle_s), oracle)
    }

    /// A copy, which equals the settings.
    #[pyo3(signature = (_memo = None))]
    fn __deepcopy__(&self, _memo: Option<Bound<'_, PyAny>>) -> Self {
        Self { inner: Arc::clone(&self.inner) }
    }

    /// For pickles: with the text of a recorded walk, which another machine may not have.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let TaskSettings { scenario, trace, dynamics, action, observation, reward, settle_s, oracle } = &*self.inner;
        let (dynamics, step_s) = match dynamics {
            Dynamics::Static { step_s } => ("static", *step_s),
            Dynamics::ClosedLoop => ("closed-loop", 1.0),
        };
        let action = name_of(*action, &ACTIONS);
        let observation = name_of(*observation, &OBSERVATIONS);
        let form = name_of(reward.form, &REWARDS);
        let scenario = Scenario { inner: scenario.clone() }.into_pyobject(py)?.into_any();
        let arguments = (
            scenario,
            trace,
            (dynamics, action, observation, form),
            (reward.lambda, reward.margin, step_s, *settle_s),
            *oracle,
        );
        Ok((py.import("heliostat._core")?.getattr("restored_settings")?, arguments.into_pyobject(py)?))
    }
}

/// The settings of a pickle.
#[pyfunction]
pub fn restored_settings(
    scenario: &Scenario,
    trace: Option<String>,
    names: (String, String, String, String),
    numbers: (f64, f64, f64, f64),
    oracle: bool,
) -> PyResult<Settings> {
    let (dynamics, action, observation, reward) = &names;
    settings_of((scenario, trace), (dynamics, action, observation, reward), numbers, oracle)
}

const ACTIONS: [(&str, ActionForm); 2] = [("angles", ActionForm::Angles), ("weights", ActionForm::Weights)];

const OBSERVATIONS: [(&str, ObservationForm); 4] = [
    ("flat", ObservationForm::Vector),
    ("dict", ObservationForm::Vector),
    ("paper", ObservationForm::AngleState),
    ("belief", ObservationForm::Belief),
];

const REWARDS: [(&str, RewardForm); 2] = [("shortfall", RewardForm::Shortfall), ("printed", RewardForm::AsPrinted)];

/// The form of an action by its name.
pub fn action_form(name: &str) -> PyResult<ActionForm> {
    choice("action", name, &ACTIONS)
}

/// The name of a value of a setting.
fn name_of<T: PartialEq + Copy>(value: T, known: &[(&'static str, T)]) -> &'static str {
    known.iter().find(|(_, found)| *found == value).map_or("", |(name, _)| name)
}

/// The checked settings of names and numbers.
fn settings_of(
    (scenario, trace): (&Scenario, Option<String>),
    (dynamics, action, observation, reward): (&str, &str, &str, &str),
    (penalty, margin, step_s, settle_s): (f64, f64, f64, f64),
    oracle: bool,
) -> PyResult<Settings> {
    let dynamics = choice(
        "dynamics",
        dynamics,
        &[("static", Dynamics::Static { step_s }), ("closed-loop", Dynamics::ClosedLoop)],
    )?;
    let action = choice("action", action, &ACTIONS)?;
    let observation = choice("observation", observation, &OBSERVATIONS)?;
    let form = choice("reward", reward, &REWARDS)?;
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
    Ok(Settings { inner: Arc::new(inner) })
}

/// Refuses overrides of the form "table.key=value" that have no effect on exact states; the conditions of a
/// scenario with late, noisy or lost reports or with slow or faulty mirrors, which a static room does not have, that of
/// places out of the range of the controller, and those of keys without effect.
#[pyfunction]
pub fn check_exact(scenario: &Scenario, overrides: Vec<String>) -> PyResult<Vec<String>> {
    exact_states::check_overrides(&overrides).map_err(refused)?;
    let advice = "choose dynamics=\"closed-loop\"";
    let found = guarded(|| exact_states::conditions(&scenario.inner, "a static room", advice).map_err(refused))?;
    Ok(as_texts(&found))
}

/// The conditions of a scenario in closed loop: those of `heliostat-lab eval --closed-loop`, policies excepted.
#[pyfunction]
pub fn closed_loop_conditions(scenario: &Scenario) -> PyResult<Vec<String>> {
    let scenario = &scenario.inner;
    guarded(|| Ok(as_texts(&conditions(scenario, &scenario.channel_model().map_err(refused)?))))
}

fn as_texts(found: &[Condition]) -> Vec<String> {
    found.iter().map(ToString::to_string).collect()
}

/// The seed of a held-out room, which training never uses: `heliostat-lab eval` takes its states from
/// the rooms `index` = 0, 1, ... of the set `scenario_seed`.
#[pyfunction]
pub fn held_out_seed(scenario_seed: u64, index: u64) -> u64 {
    heliostat_environment::held_out::held_out_seed(scenario_seed, index)
}

/// A figure by its name: mean, half the width of its 95 % interval, and whether this interval reaches beyond what the
/// figure can be; then the mean of each episode, NaN where the figure is missing.
type Figures = Vec<(&'static str, (f64, f64, bool), Vec<f64>)>;

/// The figures of samples in the held-out rooms of a comparison beside those of the oracle, as `heliostat-lab eval`
/// computes them, and the sum rate of the oracle as `oracle_mbps`.
///
/// `samples`: of each episode in its order, the samples that `Batch.samples` returns.
#[pyfunction]
pub fn score(
    py: Python<'_>,
    scenario: &Scenario,
    closed_loop: bool,
    states: usize,
    seeds: usize,
    samples: Vec<Bound<'_, PyArray2<f64>>>,
) -> PyResult<Figures> {
    let own = samples.iter().map(of_group).collect::<PyResult<Vec<_>>>()?;
    let room = &scenario.inner;
    let oracle = py.detach(|| on_all_cores(|| guarded(|| oracle_samples(room, closed_loop, (states, seeds)))))?;
    let lengths = |groups: &[Vec<Sample>]| groups.iter().map(Vec::len).collect::<Vec<_>>();
    if lengths(&own) != lengths(&oracle) {
        let [found, expected] = [lengths(&own), lengths(&oracle)].map(|lengths| lengths.iter().sum::<usize>());
        return Err(refused(format!("{found} samples: expected those of the {expected} states of the comparison")));
    }
    let entry = |name: &'static str, figure: Figure, of: &[Vec<Sample>]| {
        let Spread { mean, ci95, crosses_bound, .. } = figure.spread(&[of], &oracle);
        (name, (mean, ci95, crosses_bound), figure.means(of, &oracle))
    };
    let common =
        [Figure::RATIO, Figure::SUM_RATE, Figure::QOS_MET, Figure::JAIN, Figure::BLOCKED_RATE, Figure::BER].into_iter();
    let figures = common.chain(closed_loop.then_some(Figure::OUTAGE_TIME));
    let of_oracle = entry("oracle_mbps", Figure::SUM_RATE, &oracle);
    Ok(figures.map(|figure| entry(figure.name, figure, &own)).chain([of_oracle]).collect())
}

/// Half the width of the 95 % interval of the mean of independent values; NaN for a single one.
#[pyfunction]
pub fn half_width(values: Vec<f64>) -> f64 {
    Estimate::of(&values).ci95
}

/// The samples of an episode from an array of shape (n, 5).
fn of_group(group: &Bound<'_, PyArray2<f64>>) -> PyResult<Vec<Sample>> {
    let group = group.readonly();
    let rows = group.as_array();
    let sample = |row: ArrayView1<'_, f64>| {
        let row: [f64; 5] = row.to_vec().try_into().map_err(|_| refused("samples: expected the shape (n, 5)"))?;
        Ok(Sample::of_row(row))
    };
    rows.rows().into_iter().map(sample).collect()
}

/// The oracle's samples of a comparison, one list for each episode.
fn oracle_samples(
    room: &heliostat_scenario::Scenario,
    closed_loop: bool,
    (states, seeds): (usize, usize),
) -> PyResult<Vec<Vec<Sample>>> {
    let trace = room.read_trace().map_err(refused)?;
    let trace = trace.as_deref();
    if !closed_loop {
        let solve = |index: usize| {
            let state = held_out_state(room.seed, states, index);
            Ok(vec![Sample::of_oracle(room, trace, state).map_err(refused)?])
        };
        return (0..states * seeds).into_par_iter().map(solve).collect();
    }
    let solve = |episode: &HeldOutEpisode| {
        let mut samples = Vec::new();
        let look = |world: &World, angles: &MirrorAngles| samples.push(Sample::of(world, angles));
        episode.solve(room, trace, look).map_err(refused)?;
        Ok(samples)
    };
    held_out_episodes(room, trace, (states, seeds), WARM).map_err(refused)?.par_iter().map(solve).collect()
}
