//! A batch of environments: one for `gymnasium.Env`, several for `gymnasium.vector.VectorEnv`.
//!
//! The buffers belong to the caller: NumPy arrays into which a step writes without a copy in
//! between. The interpreter lock is released while environments step, and several environments step
//! on all cores.

mod slot;

use std::sync::Arc;

use heliostat_environment::score::Sample;
use heliostat_environment::task::{Step, TaskSettings};
use numpy::{
    PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadwriteArray1, PyReadwriteArray2,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyRuntimeError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use rayon::prelude::*;

use self::slot::{Actions, Autoreset, Row, Rules, Saved, Slot};
use crate::error::{guarded, refused};
use crate::exclusive::{Exclusive, Held};
use crate::settings::Settings;
use crate::threads::on_all_cores;

/// Figures of a step besides the reward: sum rate in Mbit/s, share of minimum rates met, sum rate
/// of the oracle in Mbit/s or NaN.
const FIGURES: usize = 3;

/// Memory for the actions of the present episodes of a batch, from which a pickled batch is made
/// again, in components of an action.
const ACTIONS_MAX: usize = 1 << 26;

/// The result of a step of one environment: observation, reward, truncated, figures, rates.
type One<'py> = (Bound<'py, PyArray1<f32>>, f64, bool, (f64, f64, f64), Bound<'py, PyArray1<f64>>);

/// Environments of the same settings, each with its own seed.
#[pyclass(frozen, module = "heliostat._core")]
pub struct Batch {
    /// Empty after `close`.
    slots: Exclusive<Vec<Slot>>,
    settings: Arc<TaskSettings>,
    autoreset: Autoreset,
    steps_max: u64,
    #[pyo3(get)]
    num_envs: usize,
    #[pyo3(get)]
    action_len: usize,
    #[pyo3(get)]
    observation_len: usize,
    /// Largest number of users.
    #[pyo3(get)]
    users_max: usize,
    /// Slots of an observation.
    #[pyo3(get)]
    slots_max: usize,
}

impl Batch {
    /// A batch of these environments.
    fn of_slots(settings: Arc<TaskSettings>, slots: Vec<Slot>, (autoreset, steps_max): (Autoreset, u64)) -> Self {
        let users = &settings.scenario.users;
        let task = &slots[0].task;
        Self {
            autoreset,
            steps_max,
            num_envs: slots.len(),
            action_len: task.action_len(),
            observation_len: task.observation_len(),
            slots_max: task.encoder().users_max(),
            users_max: users.arrivals.as_ref().map_or(users.count, |arrivals| arrivals.max_users),
            slots: Exclusive::new(slots),
            settings,
        }
    }

    fn rules(&self) -> Rules {
        Rules { autoreset: self.autoreset, steps_max: self.steps_max, actions_max: ACTIONS_MAX / self.num_envs }
    }

    fn open(&self) -> PyResult<Held<'_, Vec<Slot>>> {
        let slots = self.slots.hold()?;
        if slots.is_empty() {
            return Err(PyRuntimeError::new_err("the environment is closed: make a new one"));
        }
        Ok(slots)
    }

    /// Checks an action for each environment before any of them steps.
    fn check(&self, slots: &[Slot], actions: &[f32]) -> PyResult<()> {
        for (index, (slot, action)) in slots.iter().zip(actions.chunks_exact(self.action_len)).enumerate() {
            if slot.ended && self.autoreset == Autoreset::NextStep {
                // The step restarts this environment and ignores its action.
                continue;
            }
            if slot.ended {
                return Err(PyRuntimeError::new_err(format!(
                    "the episode of environment {index} has ended: reset it before the next step"
                )));
            }
            slot.task.check_action(action).map_err(|reason| refused(format!("environment {index}: {reason}")))?;
        }
        Ok(())
    }
}

#[pymethods]
impl Batch {
    #[new]
    fn new(py: Python<'_>, settings: &Settings, seeds: Vec<u64>, autoreset: &str, steps_max: u64) -> PyResult<Self> {
        let autoreset = Autoreset::find(autoreset)?;
        if seeds.is_empty() || steps_max == 0 {
            return Err(refused("a batch needs at least one environment and one step"));
        }
        let settings = Arc::clone(&settings.inner);
        let slots = py.detach(|| {
            on_all_cores(|| {
                guarded(|| {
                    seeds.par_iter().map(|seed| Slot::new(Arc::clone(&settings), *seed)).collect::<PyResult<Vec<_>>>()
                })
            })
        })?;
        Ok(Self::of_slots(settings, slots, (autoreset, steps_max)))
    }

    /// A copy: the same actions give the same steps.
    #[pyo3(signature = (_memo = None))]
    fn __deepcopy__(&self, py: Python<'_>, _memo: Option<Bound<'_, PyAny>>) -> PyResult<Self> {
        let slots = py.detach(|| {
            let slots = self.open()?;
            guarded(|| Ok((*slots).clone()))
        })?;
        Ok(Self::of_slots(Arc::clone(&self.settings), slots, (self.autoreset, self.steps_max)))
    }

    fn __copy__(&self, py: Python<'_>) -> PyResult<Self> {
        self.__deepcopy__(py, None)
    }

    /// For pickles: settings and, of each environment, where its episode began and its actions since.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let slots = self.open()?;
        let most = ACTIONS_MAX / self.num_envs / self.action_len;
        let mut saved: Vec<Saved<'py>> = Vec::with_capacity(slots.len());
        for (index, slot) in slots.iter().enumerate() {
            let (Actions::Last(actions) | Actions::All(actions)) = &slot.actions else {
                return Err(PyTypeError::new_err(format!(
                    "cannot pickle environment {index}: its episode has more than {most} actions, which are not kept; \
                     pickle it within {most} steps of a reset, copy it with copy.deepcopy, or make an equal one with \
                     the same settings, seed and actions"
                )));
            };
            let Step { reward, sum_rate_mbps, met, oracle_mbps } = slot.last;
            let figures = (reward, sum_rate_mbps, met, oracle_mbps);
            let actions = PyArray1::from_slice(py, actions);
            saved.push((slot.first_seed, slot.episode, slot.begin, slot.steps, slot.ended, figures, actions));
        }
        let settings = Settings { inner: Arc::clone(&self.settings) }.into_pyobject(py)?.into_any();
        let arguments = (settings, self.autoreset.name(), self.steps_max, saved).into_pyobject(py)?;
        Ok((py.import("heliostat._core")?.getattr("restored_batch")?, arguments))
    }

    /// Restarts the environments for which `mask` is true, or all; `None` as a seed is the next
    /// one.
    #[pyo3(signature = (seeds, observations, mask = None))]
    fn reset(
        &self,
        py: Python<'_>,
        seeds: Vec<Option<u64>>,
        mut observations: PyReadwriteArray2<'_, f32>,
        mask: Option<PyReadonlyArray1<'_, bool>>,
    ) -> PyResult<()> {
        let mask: Option<Vec<bool>> = mask.map(|mask| mask.as_array().iter().copied().collect());
        if seeds.len() != self.num_envs || mask.as_ref().is_some_and(|mask| mask.len() != self.num_envs) {
            let (num, found) = (self.num_envs, mask.as_ref().map_or(seeds.len(), Vec::len));
            return Err(refused(format!("expected {num} seeds, and a mask of the same length; found {found}")));
        }
        check_shape(observations.shape(), [self.num_envs, self.observation_len], "observations")?;
        let rows = observations.as_slice_mut()?;
        py.detach(|| {
            let mut slots = self.open()?;
            let rows = rows.par_chunks_exact_mut(self.observation_len);
            let slots = &mut *slots;
            on_all_cores(|| {
                guarded(|| {
                    slots.par_iter_mut().zip(rows).enumerate().try_for_each(|(index, (slot, row))| {
                        if mask.as_ref().is_none_or(|mask| mask[index]) {
                            slot.restart(seeds[index])?;
                            slot.task.write_observation(row);
                        }
                        Ok(())
                    })
                })
            })
        })
    }

    /// Steps all environments, and writes into the arrays.
    #[expect(clippy::too_many_arguments, reason = "one array for each quantity of a step")]
    fn step(
        &self,
        py: Python<'_>,
        actions: PyReadonlyArray2<'_, f32>,
        mut observations: PyReadwriteArray2<'_, f32>,
        mut last_observations: PyReadwriteArray2<'_, f32>,
        mut rewards: PyReadwriteArray1<'_, f64>,
        mut truncated: PyReadwriteArray1<'_, bool>,
        mut figures: PyReadwriteArray2<'_, f64>,
        mut rates: PyReadwriteArray2<'_, f64>,
    ) -> PyResult<()> {
        let count = self.num_envs;
        check_shape(actions.shape(), [count, self.action_len], "actions")?;
        check_shape(observations.shape(), [count, self.observation_len], "observations")?;
        check_shape(last_observations.shape(), [count, self.observation_len], "last_observations")?;
        check_shape(figures.shape(), [count, FIGURES], "figures")?;
        check_shape(rates.shape(), [count, self.users_max], "rates")?;
        if rewards.len() != count || truncated.len() != count {
            return Err(refused(format!("rewards and truncated: expected the length {count}")));
        }
        let actions = actions.as_slice()?;
        let (observations, last_observations) = (observations.as_slice_mut()?, last_observations.as_slice_mut()?);
        let (rewards, truncated) = (rewards.as_slice_mut()?, truncated.as_slice_mut()?);
        let (figures, rates) = (figures.as_slice_mut()?, rates.as_slice_mut()?);
        let rules = self.rules();
        py.detach(|| {
            let mut slots = self.open()?;
            self.check(&slots, actions)?;
            let slots = &mut *slots;
            let environments = slots.par_iter_mut().zip(actions.par_chunks_exact(self.action_len));
            let seen = observations.par_chunks_exact_mut(self.observation_len);
            let last = last_observations.par_chunks_exact_mut(self.observation_len);
            let results = rewards.par_iter_mut().zip(truncated.par_iter_mut());
            let shown = figures.par_chunks_exact_mut(FIGURES).zip(rates.par_chunks_exact_mut(self.users_max));
            on_all_cores(|| {
                guarded(|| {
                    environments.zip(seen.zip(last)).zip(results.zip(shown)).try_for_each(
                        |(
                            ((slot, action), (observation, last_observation)),
                            ((reward, truncated), (figures, rates)),
                        )| {
                            slot.step(
                                action,
                                rules,
                                Row { observation, last_observation, reward, truncated, figures, rates },
                            )
                        },
                    )
                })
            })
        })
    }

    /// Steps the only environment of a batch of one.
    fn step_one<'py>(&self, py: Python<'py>, action: PyReadonlyArray1<'py, f32>) -> PyResult<One<'py>> {
        if self.num_envs != 1 {
            return Err(refused("step_one is for a batch of one environment"));
        }
        if action.len() != self.action_len {
            return Err(refused(format!("an action of shape ({},), expected ({},)", action.len(), self.action_len)));
        }
        let action = action.as_slice()?;
        // The caller receives the observation and may keep it, so each step has a new one.
        let observation = PyArray1::<f32>::zeros(py, self.observation_len, false);
        let rates = PyArray1::<f64>::zeros(py, self.users_max, false);
        let (mut reward, mut truncated, mut figures) = (0.0, false, [0.0; FIGURES]);
        {
            let (mut seen, mut shown) = (observation.readwrite(), rates.readwrite());
            let row = Row {
                observation: seen.as_slice_mut()?,
                last_observation: &mut [],
                reward: &mut reward,
                truncated: &mut truncated,
                figures: &mut figures,
                rates: shown.as_slice_mut()?,
            };
            py.detach(|| {
                let mut slots = self.open()?;
                self.check(&slots, action)?;
                guarded(|| slots[0].step(action, self.rules(), row))
            })?;
        }
        let [sum_rate, met, oracle] = figures;
        Ok((observation, reward, truncated, (sum_rate, met, oracle), rates))
    }

    /// Restarts the only environment of a batch of one in episode `index` of a comparison with `states`
    /// states of each of `seeds` seeds; a static room has one state in each. Returns the observation.
    fn begin_episode<'py>(
        &self,
        py: Python<'py>,
        index: usize,
        states: usize,
        seeds: usize,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let observation = PyArray1::<f32>::zeros(py, self.observation_len, false);
        let mut seen = observation.readwrite();
        let seen = seen.as_slice_mut()?;
        py.detach(|| {
            let mut slots = self.open()?;
            guarded(|| {
                slots[0].begin_episode((index, states, seeds))?;
                slots[0].task.write_observation(seen);
                Ok(())
            })
        })?;
        Ok(observation)
    }

    /// Whether all sampling times of the episode have passed, and the values of [`Sample`] at each of them, in the
    /// order of its fields: shape (n, 5).
    fn samples<'py>(&self, py: Python<'py>) -> PyResult<(bool, Bound<'py, PyArray2<f64>>)> {
        let slots = self.open()?;
        let sampling = slots[0].task.sampling().ok_or_else(|| refused("no episode of a comparison has begun"))?;
        let rows: Vec<f64> = sampling.samples().iter().flat_map(Sample::row).collect();
        Ok((sampling.is_over(), PyArray1::from_vec(py, rows).reshape([sampling.samples().len(), 5])?))
    }

    /// The true state of one environment, for pictures and analysis: arrays by name.
    fn state<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Bound<'py, PyDict>> {
        let slots = self.open()?;
        let slot = slots.get(index).ok_or_else(|| refused(format!("no environment {index}")))?;
        let (world, angles) = (slot.task.world(), slot.task.angles());
        let state = PyDict::new(py);
        let positions: Vec<f64> = world.positions().iter().flat_map(|place| place.iter().copied()).collect();
        state.set_item("positions", PyArray1::from_vec(py, positions).reshape([world.positions().len(), 3])?)?;
        let normals = world.orientations().iter().map(|held| held.normal());
        let normals: Vec<f64> = normals.flat_map(|normal| [normal.x, normal.y, normal.z]).collect();
        state.set_item("normals", PyArray1::from_vec(py, normals).reshape([world.orientations().len(), 3])?)?;
        let blockers: Vec<f64> = world
            .blockers()
            .iter()
            .flat_map(|cylinder| [cylinder.x_m, cylinder.y_m, cylinder.radius_m, cylinder.height_m])
            .collect();
        state.set_item("blockers", PyArray1::from_vec(py, blockers).reshape([world.blockers().len(), 4])?)?;
        let headings = world.users().iter().map(|user| user.heading()).collect();
        state.set_item("headings", PyArray1::from_vec(py, headings))?;
        state
            .set_item("min_rates_mbps", PyArray1::from_iter(py, world.min_rate_bps().iter().map(|rate| 1e-6 * rate)))?;
        // Those of the last step of a static room are of the places before its users walked on.
        let mut rates_bps = vec![0.0; world.scene().users()];
        world.scene().rates_bps(world.model(), angles, &mut rates_bps);
        state.set_item("rates_mbps", PyArray1::from_iter(py, rates_bps.iter().map(|rate| 1e-6 * rate)))?;
        state.set_item("blocked", PyArray1::from_slice(py, world.scene().los_blocked()))?;
        state.set_item("roll", PyArray1::from_slice(py, &angles.roll))?;
        state.set_item("yaw", PyArray1::from_slice(py, &angles.yaw))?;
        state.set_item("time_s", world.time_s())?;
        Ok(state)
    }

    /// The ranges of the parts of a flat observation: name, first index, shape.
    fn layout(&self) -> PyResult<Vec<(&'static str, usize, Vec<usize>)>> {
        let slots = self.open()?;
        let parts = slots[0].task.encoder().parts();
        Ok(parts.into_iter().map(|part| (part.name, part.values.start, part.shape)).collect())
    }

    /// Whether `close` was called.
    #[getter]
    fn closed(&self) -> PyResult<bool> {
        Ok(self.slots.hold()?.is_empty())
    }

    /// The hash of the scenario's optical geometry.
    #[getter]
    fn geometry(&self) -> String {
        self.settings.scenario.geometry_hash()
    }

    /// Frees the environments; later calls are refused.
    fn close(&self) -> PyResult<()> {
        self.slots.hold()?.clear();
        Ok(())
    }
}

/// The batch of a pickle.
#[pyfunction]
pub fn restored_batch(
    py: Python<'_>,
    settings: &Settings,
    autoreset: &str,
    steps_max: u64,
    saved: Vec<Saved<'_>>,
) -> PyResult<Batch> {
    if saved.is_empty() {
        return Err(refused("a pickle of a batch without environments"));
    }
    let settings = Arc::clone(&settings.inner);
    let mut slots = Vec::with_capacity(saved.len());
    for one in &saved {
        py.check_signals()?;
        let actions = one.6.readonly();
        let actions = actions.as_slice()?;
        slots.push(guarded(|| Slot::restored(Arc::clone(&settings), one, actions))?);
    }
    Ok(Batch::of_slots(settings, slots, (Autoreset::find(autoreset)?, steps_max)))
}

fn check_shape(found: &[usize], expected: [usize; 2], name: &str) -> PyResult<()> {
    if found == expected {
        return Ok(());
    }
    Err(refused(format!("{name} has the shape {found:?}, expected {expected:?}")))
}
