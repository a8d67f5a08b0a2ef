//! Transitions of learners with one weight per user: kept as rows, drawn as tensors.

use candle_core::{Device, Result, Tensor};
use heliostat_channel::MirrorAngles;
use rand::Rng;

use super::replay::Replay;
use super::settings::RunSettings;
use super::store::{Persistent, Store};
use crate::environment::features::{BaselineWeight, Layout};
use crate::environment::room::{Environment, Outcome};
use crate::networks::actor::States;

/// A minibatch of transitions.
pub struct Transition {
    /// The states.
    pub states: States,
    /// Actions in [-1, 1], (batch, slots).
    pub actions: Tensor,
    /// Each user's part of the reward, (batch, slots), 0 in empty slots.
    pub rewards: Tensor,
    /// The next states, where they are kept.
    pub next: Option<States>,
}

/// The replay buffer, with the layout of its states.
pub struct Transitions {
    replay: Replay,
    layout: Layout,
    baseline_weight: BaselineWeight,
    keeps_next: bool,
}

impl Transitions {
    /// An empty buffer of this capacity, ready when it holds `needed` transitions. `keeps_next`:
    /// whether a discounted value needs the next states.
    pub fn new(
        (layout, baseline_weight): (Layout, BaselineWeight),
        (capacity, needed): (usize, usize),
        keeps_next: bool,
    ) -> Self {
        let (width, slots) = (States::width(layout), layout.slots());
        let next = if keeps_next { width } else { 0 };
        Self { replay: Replay::new(capacity, needed, [width, slots, slots, next]), layout, baseline_weight, keeps_next }
    }

    /// Whether it holds enough transitions for an update.
    pub fn is_ready(&self) -> bool {
        self.replay.is_ready()
    }

    /// Turns the mirrors of a room to the angles of an action, lets time pass, and keeps the
    /// transition.
    ///
    /// # Errors
    /// Errors of the room.
    pub fn act(
        &mut self,
        room: &mut Environment,
        (state, action, angles): (&[f32], &[f32], &MirrorAngles),
        run: &RunSettings,
    ) -> anyhow::Result<Outcome> {
        let mut rewards = vec![0.0; self.layout.slots()];
        let outcome = room.act(angles, run.reward, &mut rewards);
        room.step(run.step_s)?;
        let next = if self.keeps_next { States::row(self.layout, room.vector()) } else { Vec::new() };
        self.replay.push([state, action, &rewards, &next]);
        Ok(outcome)
    }

    /// Draws `count` transitions with replacement.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn sample(&self, count: usize, rng: &mut impl Rng) -> Result<Transition> {
        let [states, actions, rewards, next] = self.replay.sample(count, rng);
        let matrix = |values: Vec<f32>| Tensor::from_vec(values, (count, self.layout.slots()), &Device::Cpu);
        let of_rows = |rows: Vec<f32>| States::new(rows, count, self.layout, self.baseline_weight);
        Ok(Transition {
            states: of_rows(states)?,
            actions: matrix(actions)?,
            rewards: matrix(rewards)?,
            next: self.keeps_next.then(|| of_rows(next)).transpose()?,
        })
    }
}

impl Persistent for Transitions {
    fn save(&self, name: &str, store: &mut Store) -> anyhow::Result<()> {
        self.replay.save(name, store)
    }

    fn restore(&mut self, name: &str, store: &Store) -> anyhow::Result<()> {
        self.replay.restore(name, store)
    }
}
