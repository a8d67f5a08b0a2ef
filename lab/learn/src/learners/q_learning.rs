//! Q-learning with a table: cells of the floor by codewords.
//!
//! ```text
//! Q(s, a) <- Q(s, a) + alpha [r + gamma max_b Q(s', b) - Q(s, a)]
//! ```
//!
//! The method `step` of [`QLearning`] is the complete algorithm. The paper names Q-learning and
//! SARSA as earlier work and states that tables cannot hold large spaces of states and actions. It
//! gives none of their hyperparameters. [`super::sarsa`] is this learner with the value of the
//! action that is taken next instead of the largest value.
//!
//! # Deviations from the paper
//! 1. **State.** Positions of five users in quadrants are 1024 states with 144 actions each, and
//!    quadrants are far coarser than a spot. The state is the cell of the [target
//!    user](crate::environment::target_user). In `specular` there are 12 x 12 cells, as many as
//!    codewords. In the paper's modes there are 6 x 6, because a mirror spreads its light widely.
//! 2. **Action.** The action is one codeword, which sets the angles of all mirrors
//!    ([`crate::environment::codebook`]).
//! 3. **Reward.** The reward minus that of flat mirrors, over the bandwidth, so that a room with
//!    much direct light does not raise the value of a codeword. The shortfall is penalised instead
//!    of the met minimum rate, as in [`super::ddpg`].
//! 4. **gamma = 0.3** instead of 0.9. An action does not influence later states here. With 0.9 a
//!    value is ten times the reward. The error of a pair that was not visited for long then exceeds
//!    the differences between codewords.
//! 5. **alpha = 0.05**, the learning rate of the paper's text. The first visits of a pair form a
//!    mean: alpha = max(0.05, 1 / n).
//! 6. **Exploration.** Epsilon-greedy, decaying from 0.995 as in the paper, to 0.05. A table does
//!    not generalise to codewords nearby.
//! 7. **Episodes.** There are 1000 episodes of 80 steps of one second.

use heliostat_channel::MirrorAngles;
use heliostat_core::policy::PolicyKind;
use heliostat_core::policy::actor_file::{ActionKind, INPUT_NAME, ObservationKind};
use heliostat_onnx::graph::Graph;
use heliostat_scenario::{ChannelMode, Scenario};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::table::Table;
use crate::environment::codebook::{Codebook, GRID};
use crate::environment::room::{Environment, Outcome};
use crate::environment::target_user::{Cells, TargetUser};
use crate::export::dense::{Form, all_columns, finish};
use crate::training::algorithm::{Algorithm, start};
use crate::training::exploration::{Exploration, Kind};
use crate::training::learner::{Episode, Learner, Part, part};
use crate::training::settings::RunSettings;

/// The row in the table of algorithms.
pub const ALGORITHM: Algorithm = Algorithm {
    name: "q-learning",
    policy: PolicyKind::QLearning,
    help: "Q-learning with a table, on a codebook of angles",
    summary: "Q-learning with a table on a codebook; see the head of `lab/learn/src/learners/q_learning.rs`",
    has_paper_preset: false,
    start: |scenario, _, options| {
        let settings = Settings::new(scenario.seed, scenario.channel.mode);
        start(scenario, settings, options, QLearning::new)
    },
};

/// The next value in the target of an update.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Target {
    /// The largest value: Q-learning.
    Best,
    /// The value of the codeword that is taken next: SARSA.
    Taken,
}

/// The hyperparameters of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The next value in the target of an update.
    pub target: Target,
    /// Cells along each side of the room.
    pub cells: usize,
    /// Discount factor gamma.
    pub gamma: f32,
    /// Smallest learning rate of a pair of state and codeword.
    pub alpha: f32,
    /// Exploration: the probability of a random codeword.
    pub exploration: Exploration,
    /// The hyperparameters that every run has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl Settings {
    /// The hyperparameters of the shipped tables.
    pub fn new(seed: u64, mode: ChannelMode) -> Self {
        Self {
            target: Target::Best,
            cells: if mode == ChannelMode::Specular { GRID } else { 6 },
            gamma: 0.3,
            alpha: 0.05,
            exploration: Exploration { kind: Kind::EpsilonGreedy, start: 0.995, end: 0.05 },
            run: RunSettings { steps: 80, ..RunSettings::paper(seed) },
        }
    }
}

/// Q-learning with its state between two steps; also the learner of [`super::sarsa`].
pub struct QLearning {
    settings: Settings,
    codebook: Codebook,
    target_user: TargetUser,
    cells: Cells,
    table: Table,
    /// The codeword that the next step takes.
    next_codeword: usize,
}

impl QLearning {
    /// The learner before its first episode.
    ///
    /// # Errors
    /// The scenario describes no channel, or a setting is invalid.
    pub fn new(scenario: &Scenario, settings: Settings, _: &mut ChaCha8Rng) -> anyhow::Result<Self> {
        anyhow::ensure!((1..=100).contains(&settings.cells), "cells = {}: expected 1 to 100", settings.cells);
        settings.exploration.check_choices()?;
        let cells = Cells::of(scenario, settings.cells);
        let codebook = Codebook::of(scenario)?;
        Ok(Self {
            table: Table::new(cells.count(), codebook.codewords().len()),
            target_user: TargetUser::of(scenario),
            codebook,
            cells,
            settings,
            next_codeword: 0,
        })
    }

    /// The state that an observation vector describes.
    pub fn state_of(&self, vector: &[f32]) -> usize {
        self.cells.cell(self.target_user.position(vector))
    }

    /// A codeword by the epsilon-greedy rule.
    fn choose(&self, epsilon: f64, state: usize, rng: &mut impl Rng) -> usize {
        let codewords = self.codebook.codewords().len();
        Exploration::draw(epsilon, codewords, rng).unwrap_or_else(|| self.table.best(state))
    }
}

impl Learner for QLearning {
    fn step(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<Vec<Outcome>> {
        let epsilon = self.settings.exploration.magnitude(episode.index, episode.count);
        let (first, room) = (episode.step == 0, &mut episode.rooms[0]);
        let state = self.state_of(room.vector());
        let codeword = if first { self.choose(epsilon, state, episode.rng) } else { self.next_codeword };
        let (reward, outcome) = self.codebook.act(room, codeword, self.settings.run.reward);
        room.step(self.settings.run.step_s)?;
        let next_state = self.state_of(room.vector());
        self.next_codeword = self.choose(epsilon, next_state, episode.rng);
        let next_value = match self.settings.target {
            Target::Best => self.table.value(next_state, self.table.best(next_state)),
            Target::Taken => self.table.value(next_state, self.next_codeword),
        };
        self.table.learn((state, codeword), reward + self.settings.gamma * next_value, self.settings.alpha);
        Ok(vec![outcome])
    }

    fn act(&self, room: &Environment) -> anyhow::Result<MirrorAngles> {
        let best = self.table.best(self.state_of(room.vector()));
        Ok(self.codebook.codewords()[best].clone())
    }

    fn best_action(&self, room: &Environment) -> Option<MirrorAngles> {
        Some(self.codebook.best(room.model(), room.observation()).clone())
    }

    fn notes(&self) -> Vec<(&'static str, String)> {
        let (states, codewords, bytes) = (self.cells.count(), self.codebook.codewords().len(), self.table.bytes());
        let (values, visited) = (states * codewords, self.table.visited());
        vec![
            ("codebook", format!("{codewords} codewords: {}", self.codebook.kind())),
            (
                "table",
                format!("{states} states x {codewords} codewords = {values} values, {bytes} bytes, {visited} visited"),
            ),
        ]
    }

    fn state(&mut self) -> Vec<Part<'_>> {
        vec![part("table", &mut self.table)]
    }

    fn export(&self, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        let (states, codewords) = (self.table.states(), self.table.codewords());
        let mut graph = Graph::default();
        let values = graph.constant("table", &[states, codewords], self.table.values());
        graph.node("MatMul", &[INPUT_NAME, &values]);
        let columns = all_columns(states);
        let (observation, action) = (ObservationKind::Cell, ActionKind::Codebook);
        let row = |weights: &[f32]| {
            let value =
                |codeword| (0..states).map(|state| weights[state] * self.table.value(state, codeword)).sum::<f32>();
            Ok((0..codewords).map(value).collect())
        };
        Ok(finish(graph, &Form { observation, action, columns: &columns, metadata }, codewords, row)?)
    }
}
