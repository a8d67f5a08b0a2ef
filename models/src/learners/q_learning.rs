//! Q-learning with a table, as earlier work on mirrors had it: a cell of the floor by an entry of the codebook.
//!
//! ```text
//! Q(s, a) <- Q(s, a) + alpha [r + gamma max_b Q(s', b) - Q(s, a)]
//! ```
//!
//! The paper names Q-learning and SARSA as what came before it, and says that tables cannot hold large spaces of states and actions; it gives none of
//! their numbers. [`crate::sarsa`] is this run with the action that is really taken next in place of the best one.
//!
//! # Departures, and why
//! 1. **State.** Positions of five users alone, in quadrants, are 1024 states, of 144 actions each, and quadrants are far coarser than a spot of
//!    light. The state is the cell of one user, the one whom the mirrors could help most ([`crate::needy`]): 12 x 12 cells in `specular`, as the
//!    codebook's points; 6 x 6 in the paper's modes, where light is spread widely.
//! 2. **Action.** An entry of the [codebook](crate::codebook).
//! 3. **Reward.** What the entry brings beyond mirrors that face straight into the room, so that a room with much direct light does not look like a good
//!    choice. The shortfall is punished instead of the met need, as in [`crate::ddpg`]; divided by the bandwidth.
//! 4. **gamma = 0.3** in place of 0.9. An action does not influence later states here; with 0.9 a value is ten times the reward, and a pair
//!    that was tried long ago lags behind by more than entries differ.
//! 5. **alpha = 0.05**, the learning rate that the paper's text names, but the first visits of a pair count as in a mean: alpha = max(0.05, 1 / n).
//! 6. **Exploration.** Epsilon-greedy from 0.995, as in the paper, to 0.05: a table learns nothing about a neighbour of what it tries.
//! 7. **Episodes.** 1000 of 80 steps of one second. In `specular`, seed 1, watched rooms: .50 of the oracle after a run of 600, .54 of 2500.

use heliostat_channel::MirrorAngles;
use heliostat_decide::policy::actor_file::{INPUT_NAME, OUTPUT_NAME};
use heliostat_scenario::{ChannelMode, Scenario};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::checkpoint::Store;
use crate::codebook::{Codebook, GRID};
use crate::env::{Environment, Reward, RewardForm, Rooms};
use crate::explore::{Exploration, Kind};
use crate::learner::{Episode, Learner, RunSettings};
use crate::needy::{Cells, Needy};
use crate::onnx::{Ends, Graph};
use crate::table::Table;

/// Which later value an update counts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Target {
    /// The best entry's: Q-learning.
    Best,
    /// That of the entry which is taken next: SARSA.
    Taken,
}

/// Every number of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Which later value counts.
    pub target: Target,
    /// Cells along each side of the room.
    pub cells: usize,
    /// Discount factor.
    pub gamma: f32,
    /// Smallest learning rate of a pair.
    pub alpha: f32,
    /// How often an entry is drawn.
    pub exploration: Exploration,
    /// What every algorithm has.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl Settings {
    /// The numbers of the shipped tables.
    pub fn new(seed: u64, mode: ChannelMode) -> Self {
        Self {
            target: Target::Best,
            cells: if mode == ChannelMode::Specular { GRID } else { 6 },
            gamma: 0.3,
            alpha: 0.05,
            exploration: Exploration { kind: Kind::EpsilonGreedy, start: 0.995, end: 0.05 },
            run: RunSettings {
                reward: Reward { form: RewardForm::Shortfall, lambda: 1.0, margin: 1.0 },
                rooms: Rooms::Randomised,
                episodes: 1000,
                steps: 80,
                step_s: 1.0,
                seed,
            },
        }
    }
}

/// A training run; also that of [`crate::sarsa`].
pub struct Trainer {
    settings: Settings,
    scenario: Scenario,
    codebook: Codebook,
    needy: Needy,
    cells: Cells,
    table: Table,
    rng: ChaCha8Rng,
    episode: usize,
}

impl Trainer {
    /// A run at its beginning.
    ///
    /// # Errors
    /// A scenario that makes no channel, or a setting without sense.
    pub fn new(scenario: Scenario, settings: Settings) -> anyhow::Result<Self> {
        anyhow::ensure!((1..=100).contains(&settings.cells), "cells = {}: wanted 1 to 100", settings.cells);
        settings.exploration.check_choices()?;
        let cells = Cells::of(&scenario, settings.cells);
        let codebook = Codebook::of(&scenario)?;
        Ok(Self {
            table: Table::new(cells.count(), codebook.entries().len()),
            needy: Needy::of(&scenario),
            rng: ChaCha8Rng::seed_from_u64(settings.run.seed),
            codebook,
            cells,
            scenario,
            settings,
            episode: 0,
        })
    }

    /// The table as it is now.
    pub fn table(&self) -> &Table {
        &self.table
    }

    /// The state of what an observation vector says.
    pub fn state(&self, vector: &[f32]) -> usize {
        self.cells.cell(self.needy.place(vector))
    }

    fn choose(&mut self, epsilon: f64, state: usize) -> usize {
        let entries = self.codebook.entries().len();
        Exploration::draw(epsilon, entries, &mut self.rng).unwrap_or_else(|| self.table.best(state))
    }
}

impl Learner for Trainer {
    fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    fn run(&self) -> &RunSettings {
        &self.settings.run
    }

    fn settings(&self) -> serde_json::Value {
        serde_json::json!(self.settings)
    }

    fn notes(&self) -> Vec<(&'static str, String)> {
        let (states, entries, bytes) = (self.cells.count(), self.codebook.entries().len(), self.table.bytes());
        let tried = self.table.tried();
        vec![
            ("codebook", format!("{entries} entries: {}", self.codebook.kind())),
            (
                "table",
                format!(
                    "{states} states x {entries} entries = {} values, {bytes} bytes, {tried} tried",
                    states * entries
                ),
            ),
        ]
    }

    fn episodes_done(&self) -> usize {
        self.episode
    }

    fn run_episode(&mut self) -> anyhow::Result<Episode> {
        let run = self.settings.run.clone();
        let room = run.rooms.draw(&self.scenario, &mut self.rng);
        let mut environment = Environment::new(&room, self.rng.random())?;
        let epsilon = self.settings.exploration.magnitude(self.episode, run.episodes);
        let mut summary = Episode::default();
        let mut state = self.state(environment.vector());
        let mut entry = self.choose(epsilon, state);
        for _ in 0..run.steps {
            let (reward, outcome) = self.codebook.act(&mut environment, entry, run.reward);
            environment.step(run.step_s)?;
            let next_state = self.state(environment.vector());
            let next_entry = self.choose(epsilon, next_state);
            let counted = match self.settings.target {
                Target::Best => self.table.best(next_state),
                Target::Taken => next_entry,
            };
            let target = reward + self.settings.gamma * self.table.value(next_state, counted);
            self.table.learn((state, entry), target, self.settings.alpha);
            (state, entry) = (next_state, next_entry);
            summary.reward_mbps += outcome.reward_mbps / run.steps as f64;
            summary.sum_rate_mbps += outcome.sum_rate_mbps / run.steps as f64;
        }
        self.episode += 1;
        Ok(Episode { number: self.episode, steps: self.episode * run.steps, ..summary })
    }

    fn act(&self, environment: &Environment) -> anyhow::Result<MirrorAngles> {
        let best = self.table.best(self.state(environment.vector()));
        Ok(self.codebook.entries()[best].clone())
    }

    fn best_possible(&self, environment: &Environment) -> Option<MirrorAngles> {
        Some(self.codebook.best(environment.model(), environment.observation()).clone())
    }

    fn save(&self, store: &mut Store) -> anyhow::Result<()> {
        self.table.save(store)?;
        store.put_generator(&self.rng)?;
        store.put("episode", &self.episode)
    }

    fn restore(&mut self, store: &Store) -> anyhow::Result<()> {
        self.table.restore(store)?;
        self.rng = store.generator()?;
        self.episode = store.get("episode")?;
        Ok(())
    }

    /// In the graph: the needy user's cell, that row of the table, the largest value's place, that entry's angles.
    fn export(&self, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        let mut graph = Graph::default();
        let place = self.needy.place_nodes(&mut graph);
        let state = self.cells.cell_nodes(&mut graph, &place);
        let values = graph.constant("table", &[self.table.states(), self.table.entries()], self.table.values());
        let row = graph.gather(&values, &state, 0);
        self.codebook.choose_nodes(&mut graph, &row);
        let (input, output) = (self.needy.encoder().len(), 2 * self.needy.encoder().mirrors());
        let ends = Ends { name: "heliostat-table", input: (INPUT_NAME, input), output: (OUTPUT_NAME, output) };
        Ok(graph.finish(&ends, metadata))
    }
}
