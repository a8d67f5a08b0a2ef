//! One environment of a batch: its episodes, and the actions from which a pickle makes it again.

use std::sync::Arc;

use heliostat_environment::episodes::{WARM, held_out_episodes};
use heliostat_environment::held_out::{held_out_seed, held_out_state};
use heliostat_environment::task::{Dynamics, Step, Task, TaskSettings};
use numpy::PyArray1;
use pyo3::prelude::*;

use crate::error::refused;

/// Difference of the seeds of two successive episodes: 2^64 over the golden ratio, so that the
/// seeds of neighbouring environments do not meet.
const SEED_STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// When an environment restarts after the end of an episode.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Autoreset {
    NextStep,
    SameStep,
    Disabled,
}

impl Autoreset {
    const NAMES: [(&str, Self); 3] =
        [("next-step", Self::NextStep), ("same-step", Self::SameStep), ("disabled", Self::Disabled)];

    pub(super) fn find(name: &str) -> PyResult<Self> {
        let found = Self::NAMES.into_iter().find(|(known, _)| *known == name).map(|(_, mode)| mode);
        found.ok_or_else(|| refused(format!("autoreset = {name:?}: expected next-step, same-step or disabled")))
    }

    pub(super) fn name(self) -> &'static str {
        Self::NAMES.into_iter().find(|(_, mode)| *mode == self).map_or("", |(name, _)| name)
    }
}

/// Where the present episode began.
#[derive(Clone, Copy, FromPyObject, IntoPyObject)]
pub enum Begin {
    /// In the room of this seed.
    #[pyo3(transparent)]
    Seed(u64),
    /// Episode `index` of a comparison with `states` states of each of `seeds` seeds.
    #[pyo3(transparent)]
    Episode((usize, usize, usize)),
}

/// The actions since the present episode began.
#[derive(Clone)]
pub(super) enum Actions {
    /// The last one: in a static room no state depends on the others.
    Last(Vec<f32>),
    /// All, one after the other.
    All(Vec<f32>),
    /// There were too many.
    Dropped,
}

impl Actions {
    fn none(settings: &TaskSettings) -> Self {
        match settings.dynamics {
            Dynamics::Static { .. } => Self::Last(Vec::new()),
            Dynamics::ClosedLoop => Self::All(Vec::new()),
        }
    }

    fn push(&mut self, action: &[f32], most: usize) {
        match self {
            Self::Last(last) => {
                last.clear();
                last.extend_from_slice(action);
            }
            Self::All(all) if all.len() + action.len() <= most => all.extend_from_slice(action),
            Self::All(_) | Self::Dropped => *self = Self::Dropped,
        }
    }
}

/// One environment.
#[derive(Clone)]
pub(super) struct Slot {
    pub(super) task: Task,
    pub(super) first_seed: u64,
    pub(super) episode: u64,
    pub(super) steps: u64,
    pub(super) ended: bool,
    pub(super) last: Step,
    pub(super) begin: Begin,
    pub(super) actions: Actions,
}

/// An environment as a pickle holds it: first seed, episode, begin, steps, whether the episode has
/// ended, the figures of the last step, and the actions.
pub type Saved<'py> = (u64, u64, Begin, u64, bool, (f64, f64, f64, Option<f64>), Bound<'py, PyArray1<f32>>);

/// The rules of a step: the restart, the length of an episode, and the memory for actions.
#[derive(Clone, Copy)]
pub(super) struct Rules {
    pub(super) autoreset: Autoreset,
    pub(super) steps_max: u64,
    pub(super) actions_max: usize,
}

impl Slot {
    pub(super) fn new(settings: Arc<TaskSettings>, seed: u64) -> PyResult<Self> {
        let actions = Actions::none(&settings);
        let task = Task::new(settings, seed).map_err(refused)?;
        let begin = Begin::Seed(seed);
        Ok(Self { task, first_seed: seed, episode: 0, steps: 0, ended: false, last: unknown(), begin, actions })
    }

    /// Begins an episode of a comparison.
    pub(super) fn begin_episode(&mut self, (index, states, seeds): (usize, usize, usize)) -> PyResult<()> {
        let TaskSettings { scenario, trace, dynamics, .. } = self.task.settings();
        match dynamics {
            Dynamics::Static { .. } => {
                let (set, index) = held_out_state(scenario.seed, states, index);
                self.task.begin_state(held_out_seed(set, index)).map_err(refused)?;
            }
            Dynamics::ClosedLoop => {
                let episodes = held_out_episodes(scenario, trace.as_deref(), (states, seeds), WARM).map_err(refused)?;
                let count = episodes.len();
                let episode = episodes.get(index).ok_or_else(|| refused(format!("episode {index} of {count}")))?;
                self.task.begin_episode(episode).map_err(refused)?;
            }
        }
        (self.steps, self.ended, self.begin) = (0, false, Begin::Episode((index, states, seeds)));
        self.actions = Actions::none(self.task.settings());
        Ok(())
    }

    /// The environment of a pickle: the episode begins again and its actions are repeated.
    pub(super) fn restored(settings: Arc<TaskSettings>, saved: &Saved<'_>, actions: &[f32]) -> PyResult<Self> {
        let (first_seed, episode, begin, steps, ended, (reward, sum_rate_mbps, met, oracle_mbps), _) = *saved;
        let mut slot = match begin {
            Begin::Seed(seed) => Self::new(settings, seed)?,
            Begin::Episode(place) => {
                let mut slot = Self::new(settings, first_seed)?;
                slot.begin_episode(place)?;
                slot
            }
        };
        let len = slot.task.action_len();
        let is_last = matches!(slot.actions, Actions::Last(_));
        let expected = if is_last { len * usize::from(steps > 0) } else { len * steps as usize };
        if actions.len() != expected {
            return Err(refused(format!("a pickle with {} components of actions: expected {expected}", actions.len())));
        }
        for step in 0..steps as usize {
            let first = if is_last { 0 } else { step * len };
            slot.task.step(&actions[first..first + len]).map_err(refused)?;
        }
        slot.actions = if is_last { Actions::Last(actions.to_vec()) } else { Actions::All(actions.to_vec()) };
        (slot.first_seed, slot.episode, slot.steps, slot.ended) = (first_seed, episode, steps, ended);
        slot.last = Step { reward, sum_rate_mbps, met, oracle_mbps };
        Ok(slot)
    }

    /// Starts an episode: of this seed, or of the next one.
    pub(super) fn restart(&mut self, seed: Option<u64>) -> PyResult<()> {
        match seed {
            Some(seed) => (self.first_seed, self.episode) = (seed, 0),
            None => self.episode += 1,
        }
        (self.steps, self.ended, self.last) = (0, false, unknown());
        let seed = self.first_seed.wrapping_add(self.episode.wrapping_mul(SEED_STEP));
        self.begin = Begin::Seed(seed);
        self.actions = Actions::none(self.task.settings());
        self.task.reset(seed).map_err(refused)
    }

    pub(super) fn step(&mut self, action: &[f32], rules: Rules, out: Row<'_>) -> PyResult<()> {
        let Rules { autoreset, steps_max, actions_max } = rules;
        (*out.reward, *out.truncated) = (0.0, false);
        if self.ended && autoreset == Autoreset::NextStep {
            self.restart(None)?;
        } else {
            self.last = self.task.step(action).map_err(refused)?;
            self.steps += 1;
            self.actions.push(action, actions_max);
            *out.reward = self.last.reward;
            self.ended = self.steps >= steps_max;
            *out.truncated = self.ended;
        }
        let Step { sum_rate_mbps, met, oracle_mbps, .. } = self.last;
        out.figures.copy_from_slice(&[sum_rate_mbps, met, oracle_mbps.unwrap_or(f64::NAN)]);
        out.rates.fill(f64::NAN);
        let rates = self.task.rates_bps();
        out.rates.iter_mut().zip(rates).for_each(|(entry, rate)| *entry = 1e-6 * rate);
        if self.ended && autoreset == Autoreset::SameStep {
            self.task.write_observation(out.last_observation);
            self.restart(None)?;
        }
        self.task.write_observation(out.observation);
        Ok(())
    }
}

/// The figures before the first step of an episode.
fn unknown() -> Step {
    Step { reward: 0.0, sum_rate_mbps: f64::NAN, met: f64::NAN, oracle_mbps: None }
}

/// Where one environment writes.
pub(super) struct Row<'a> {
    pub(super) observation: &'a mut [f32],
    pub(super) last_observation: &'a mut [f32],
    pub(super) reward: &'a mut f64,
    pub(super) truncated: &'a mut bool,
    pub(super) figures: &'a mut [f64],
    pub(super) rates: &'a mut [f64],
}
