//! The training loop: episodes of steps in newly drawn rooms, for any [`Learner`].

use heliostat_channel::MirrorAngles;
use heliostat_scenario::Scenario;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::learner::{Episode, Learner};
use super::settings::RunSettings;
use super::store::{Persistent, Store};
use crate::environment::room::Environment;

/// The means over the steps and rooms of one episode.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EpisodeSummary {
    /// Its number, counted from 1.
    pub number: usize,
    /// Steps since the start of training.
    pub steps: usize,
    /// Reward of the explored actions in Mbit/s.
    pub reward_mbps: f64,
    /// Sum rate of the explored actions in Mbit/s.
    pub sum_rate_mbps: f64,
}

/// A training run between two episodes.
pub struct Training {
    learner: Box<dyn Learner>,
    scenario: Scenario,
    run: RunSettings,
    /// All hyperparameters of the run, for the card and for the check of a resumed run.
    settings: serde_json::Value,
    rng: ChaCha8Rng,
    episodes_done: usize,
}

impl Training {
    /// A run before its first episode. `build` makes the learner from scenario, settings and the
    /// run's generator.
    ///
    /// # Errors
    /// Errors of `build`, or settings without those of every run.
    pub fn new<S, L>(
        scenario: Scenario,
        settings: S,
        build: impl FnOnce(&Scenario, S, &mut ChaCha8Rng) -> anyhow::Result<L>,
    ) -> anyhow::Result<Self>
    where
        S: Serialize,
        L: Learner + 'static,
    {
        let all = serde_json::to_value(&settings)?;
        // They are flattened into those of each learner.
        let run: RunSettings = serde_json::from_value(all.clone())?;
        let mut rng = ChaCha8Rng::seed_from_u64(run.seed);
        let learner = Box::new(build(&scenario, settings, &mut rng)?);
        Ok(Self { learner, scenario, run, settings: all, rng, episodes_done: 0 })
    }

    /// Trains for one episode.
    ///
    /// # Errors
    /// Errors of the rooms and of the learner.
    pub fn run_episode(&mut self) -> anyhow::Result<EpisodeSummary> {
        let Self { learner, scenario, run, rng, .. } = self;
        let trace = scenario.read_trace()?;
        let draw = |_| Environment::new(&run.rooms.draw(scenario, rng), trace.as_deref(), rng.random());
        let rooms = (0..learner.rooms()).map(draw).collect::<Result<Vec<_>, _>>()?;
        let outcomes = (run.steps * rooms.len()) as f64;
        let mut summary = EpisodeSummary::default();
        let mut episode = Episode { index: self.episodes_done, count: run.episodes, step: 0, rooms, rng };
        for step in 0..run.steps {
            episode.step = step;
            for outcome in learner.step(&mut episode)? {
                summary.reward_mbps += outcome.reward_mbps / outcomes;
                summary.sum_rate_mbps += outcome.sum_rate_mbps / outcomes;
            }
        }
        self.episodes_done += 1;
        Ok(EpisodeSummary { number: self.episodes_done, steps: self.episodes_done * run.steps, ..summary })
    }

    /// Number of finished episodes.
    pub fn episodes_done(&self) -> usize {
        self.episodes_done
    }

    /// The scenario of the run.
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// The hyperparameters that every run has.
    pub fn run(&self) -> &RunSettings {
        &self.run
    }

    /// All hyperparameters of the run.
    pub fn settings(&self) -> &serde_json::Value {
        &self.settings
    }

    /// The learner.
    pub fn learner(&self) -> &dyn Learner {
        self.learner.as_ref()
    }

    /// The angles for the present observation of a room, without exploration.
    ///
    /// # Errors
    /// As [`Learner::act`].
    pub fn act(&self, room: &Environment) -> anyhow::Result<MirrorAngles> {
        self.learner.act(room)
    }

    /// The policy as an ONNX file.
    ///
    /// # Errors
    /// As [`Learner::export`].
    pub fn export(&self, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        self.learner.export(metadata)
    }

    /// Writes everything that the next episode depends on; settings and scenario excepted.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn save(&mut self, store: &mut Store) -> anyhow::Result<()> {
        for (name, part) in self.learner.state() {
            part.save(&name, store)?;
        }
        store.put_generator(&self.rng)?;
        self.episodes_done.save("episode", store)
    }

    /// Restores the run that wrote the store.
    ///
    /// # Errors
    /// A part is missing or has another shape.
    pub fn restore(&mut self, store: &Store) -> anyhow::Result<()> {
        for (name, part) in self.learner.state() {
            part.restore(&name, store)?;
        }
        self.rng = store.generator()?;
        self.episodes_done.restore("episode", store)
    }
}
