//! The interface of a learner. [`crate::training::run`] has the loop that calls it.

use heliostat_channel::{ChannelModel, MirrorAngles};
use rand_chacha::ChaCha8Rng;

use super::store::Persistent;
use crate::environment::room::{Environment, Outcome};

/// One episode of a run, as a learner sees it.
pub struct Episode<'a> {
    /// Its number, counted from 0.
    pub index: usize,
    /// Number of episodes in the run.
    pub count: usize,
    /// The step, counted from 0.
    pub step: usize,
    /// Its rooms, as many as [`Learner::rooms`] returns.
    pub rooms: Vec<Environment>,
    /// The generator of the run. Every random choice of a learner comes from it.
    pub rng: &'a mut ChaCha8Rng,
}

impl Episode<'_> {
    /// The share of the run that is done, from 0.
    pub fn progress(&self) -> f64 {
        self.index as f64 / self.count.max(1) as f64
    }
}

/// A part of a learner's state with its name in a checkpoint.
pub type Part<'a> = (String, &'a mut dyn Persistent);

/// A training algorithm with its state.
///
/// To add one: write a file in `learners/` with an [`Algorithm`](super::Algorithm) and a type that
/// implements this trait, list it in `learners.rs`, and add a row `Learned` of the same name to the
/// table of policies (`registry.rs` of `heliostat-core`). Checkpoints, curve, card, scores and
/// the command line need no change.
pub trait Learner {
    /// Number of rooms in which each step acts.
    fn rooms(&self) -> usize {
        1
    }

    /// One step: acts in each room, lets time pass, and learns. Returns the outcome in each room.
    ///
    /// # Errors
    /// Errors of the rooms and of the networks.
    fn step(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<Vec<Outcome>>;

    /// The angles for the present observation of a room, without exploration.
    ///
    /// # Errors
    /// Errors of the networks.
    fn act(&self, room: &Environment) -> anyhow::Result<MirrorAngles>;

    /// The best angles among the learner's actions, where these are few enough to evaluate each.
    fn best_action(&self, _room: &Environment) -> Option<MirrorAngles> {
        None
    }

    /// Further rows of the card: name and text.
    fn notes(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }

    /// Everything that the next episode depends on, generator and number of episodes excepted.
    fn state(&mut self) -> Vec<Part<'_>>;

    /// The policy as an ONNX file with the ports of [`heliostat_core::policy::actor_file`].
    ///
    /// # Errors
    /// Errors of the networks.
    fn export(&self, model: &ChannelModel, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>>;
}

/// A part of the state, for [`Learner::state`].
pub fn part<'a>(name: &str, value: &'a mut dyn Persistent) -> Part<'a> {
    (name.to_owned(), value)
}
