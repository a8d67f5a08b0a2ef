//! Learning to correct the belief from channel residuals, with the truth of simulated rooms.
//!
//! The paper has no such algorithm. A network reads the row of a user
//! ([`heliostat_core::evidence`]) and corrects how the receiver is held
//! ([`heliostat_core::correction`]); the model-based solver then acts. Each episode draws
//! new rooms ([`crate::environment::reported`]), in which the present network decides in closed
//! loop, and learns from their examples once.
//!
//! # The loss
//! The negative logarithm of the likelihood of the true change t of the receiver's normal, by a normal
//! distribution with the variance v of the same output: |t - t0|^2 / v + ln v, up to constants.
//!
//! [`analytic`] and [`ddpg`] fine-tune such a network on the true future rate.
//!
//! A room and its mirror image are equally likely, so a random half of the examples is mirrored. The
//! output layer starts at zero: an untrained network changes nothing.

pub(super) mod actor;
pub mod analytic;
pub mod ddpg;
mod explorer;

use analytic::Analytic;
use anyhow::bail;
use candle_core::{Device, Result, Tensor};
use ddpg::Ddpg;
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::evidence::{ALL_USERS, FEATURES, LAST_REPORT, MEANS, MIRRORED};
use heliostat_core::policy::PolicyKind;
use heliostat_scenario::{MismatchKind, Scenario};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::environment::reported::{Example, RoomChoice, Walks, examples};
use crate::environment::room::{Environment, Outcome};
use crate::networks::adam::Adam;
use crate::networks::layers::{Network, assign};
use crate::training::algorithm::{Algorithm, start};
use crate::training::learner::{Episode, Learner, Part, part};
use crate::training::settings::RunSettings;

/// The row in the table of algorithms.
pub const ALGORITHM: Algorithm = Algorithm {
    name: "residual",
    policy: PolicyKind::Residual,
    help: "A network that corrects the belief by channel residuals; one actor for every room",
    summary: "a network that corrects the belief by channel residuals; see the head of `lab/learn/src/learners/residual.rs`",
    has_paper_preset: false,
    start: |scenario, _, options| {
        let (chosen, options): (Vec<_>, Vec<_>) =
            options.iter().cloned().partition(|option| option.starts_with(FINE_TUNE));
        let choice = rooms();
        let seed = scenario.seed;
        match chosen.last().map(|option| &option[FINE_TUNE.len()..]) {
            None => start(scenario, Settings::new(seed), &options, Residual::new),
            Some("analytic") => {
                let choice = RoomChoice { offices: OFFICES, ..choice };
                start(scenario, analytic::Settings::new(seed, choice), &options, Analytic::new)
            }
            Some("ddpg") => start(scenario, ddpg::Settings::new(seed, choice), &options, Ddpg::new),
            Some(other) => bail!("--fine-tune {other}: expected analytic or ddpg"),
        }
    },
};

/// Share of offices in the fine-tuning by a gradient.
const OFFICES: f64 = 0.35;

/// The start of the option that chooses a fine-tuning in place of the supervised training.
const FINE_TUNE: &str = "fine_tune=";

/// A fine-tuning of a network that the supervised training has made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum FineTuning {
    /// By the gradient of the true future rate through the channel
    Analytic,
    /// By DDPG with a critic that knows the true room
    Ddpg,
}

impl FineTuning {
    /// The option of a run that chooses it.
    pub fn option(self) -> String {
        let name = clap::ValueEnum::to_possible_value(&self).map_or_else(String::new, |value| value.get_name().into());
        FINE_TUNE.to_owned() + &name
    }
}

/// The rooms of the supervised training.
fn rooms() -> RoomChoice {
    RoomChoice { walks: Walks::ALL.to_vec(), mismatch: MISMATCH.to_vec(), offices: 0.0, scenario_only: false }
}

/// The kinds of mismatch from which rooms are drawn.
const MISMATCH: [MismatchKind; 7] = {
    use MismatchKind::{Bodies, Floor, Led, Mirrors, Receiver, Tilt, Tracker};
    [Bodies, Tilt, Mirrors, Led, Receiver, Floor, Tracker]
};

/// Features that the network does not read, for comparisons.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Without {
    /// It reads all.
    Nothing,
    /// Neither the user's last residuals and their means, nor the residuals of all users.
    Residuals,
    /// The user's means over time.
    History,
    /// The residuals of all users, the user included.
    Neighbours,
}

impl Without {
    fn features(self) -> std::ops::Range<usize> {
        match self {
            Self::Nothing => 0..0,
            Self::Residuals => LAST_REPORT.start..ALL_USERS.end,
            Self::History => MEANS,
            Self::Neighbours => ALL_USERS,
        }
    }
}

/// The hyperparameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Learning rate at the start.
    pub rate: f64,
    /// Factor on the learning rate at the end.
    pub rate_end: f64,
    /// Examples of a step of the optimiser.
    pub batch: usize,
    /// Rooms of an episode.
    pub room_count: usize,
    /// Time in each room in s.
    pub room_s: f64,
    /// The rooms.
    #[serde(flatten)]
    pub choice: RoomChoice,
    /// Features that are left out.
    pub without: Without,
    /// The hyperparameters that every run has; those of the reward and of static rooms are not used.
    #[serde(flatten)]
    pub run: RunSettings,
}

impl Settings {
    /// The hyperparameters of the built-in actors.
    pub fn new(seed: u64) -> Self {
        Self {
            rate: 3e-3,
            rate_end: 0.03,
            batch: 256,
            room_count: 24,
            room_s: 10.0,
            choice: rooms(),
            without: Without::Nothing,
            run: RunSettings { episodes: 100, steps: 1, ..RunSettings::paper(seed) },
        }
    }
}

impl AsRef<RunSettings> for Settings {
    fn as_ref(&self) -> &RunSettings {
        &self.run
    }
}

/// The learner with its state between two episodes.
pub struct Residual {
    settings: Settings,
    scenario: Scenario,
    network: Network,
    adam: Adam,
    /// Mean loss of the last episode.
    loss: f64,
}

impl Residual {
    /// The learner before its first episode.
    ///
    /// # Errors
    /// Errors of candle, when memory runs out.
    pub fn new(scenario: &Scenario, settings: Settings, rng: &mut ChaCha8Rng) -> anyhow::Result<Self> {
        let network = actor::untrained(rng)?;
        // The gradient of a weight is zero where its feature is always zero.
        let mut first = network.layer("first").weight.to_vec2::<f32>()?;
        first[settings.without.features()].iter_mut().for_each(|row| row.fill(0.0));
        let shape = network.layer("first").weight.shape().clone();
        assign(&network.layer("first").weight, &Tensor::from_vec(first.concat(), shape, &Device::Cpu)?)?;
        Ok(Self { adam: Adam::new(&network).clipped(1.0), network, scenario: scenario.clone(), settings, loss: 0.0 })
    }

    /// The examples of newly drawn rooms, in which the present network decides.
    fn examples(&self, rng: &mut ChaCha8Rng) -> anyhow::Result<Vec<Example>> {
        let file = actor::present(&self.network)?;
        let run = |room: &Scenario, seed| examples(room, seed, actor::policy(&file, room)?, self.settings.room_s);
        Ok(self.settings.choice.in_rooms((&self.scenario, self.settings.room_count), rng, run)?.concat())
    }

    /// One pass over shuffled examples; returns the mean loss.
    fn learn(&mut self, mut all: Vec<Example>, rate: f64, rng: &mut ChaCha8Rng) -> anyhow::Result<f64> {
        for example in &mut all {
            example.row[self.settings.without.features()].fill(0.0);
            if rng.random_bool(0.5) {
                mirror(example);
            }
        }
        shuffle(&mut all, rng);
        let (mut sum, mut count) = (0.0, 0.0);
        for batch in all.chunks_exact(self.settings.batch.min(all.len().max(1))) {
            let loss = loss(&self.network, batch)?;
            self.adam.step(&self.network, &loss.backward()?, rate)?;
            sum += f64::from(loss.to_scalar::<f32>()?);
            count += 1.0;
        }
        Ok(sum / f64::max(count, 1.0))
    }
}

/// The mirror image of an example.
fn mirror(example: &mut Example) {
    MIRRORED.iter().for_each(|index| example.row[*index] = -example.row[*index]);
    example.tilt[1] = -example.tilt[1];
}

/// A random order (Fisher and Yates).
pub(super) fn shuffle<T>(all: &mut [T], rng: &mut ChaCha8Rng) {
    for last in (1..all.len()).rev() {
        all.swap(last, rng.random_range(0..=last));
    }
}

/// The mean loss of a network; the [module](self) has the equations.
fn loss(network: &Network, batch: &[Example]) -> Result<Tensor> {
    let table = |values: Vec<f32>, width: usize| Tensor::from_vec(values, (batch.len(), width), &Device::Cpu);
    let rows = table(batch.iter().flat_map(|example| example.row).collect(), FEATURES)?;
    let tilt = table(batch.iter().flat_map(|example| example.tilt).collect(), 2)?;
    let output = network.forward_rows(&rows)?;
    let log_variance = actor::log_variance(&output)?;
    let squared = (output.narrow(1, 0, 2)? - tilt)?.sqr()?.sum_keepdim(1)?;
    ((squared * log_variance.neg()?.exp()?)? + log_variance)?.mean_all()
}

impl Learner for Residual {
    fn rooms(&self) -> usize {
        0
    }

    fn is_scored(&self) -> bool {
        false
    }

    fn step(&mut self, episode: &mut Episode<'_>) -> anyhow::Result<Vec<Outcome>> {
        let Settings { rate, rate_end, .. } = self.settings;
        let rate = rate * rate_end.powf(episode.progress());
        let all = self.examples(episode.rng)?;
        self.loss = self.learn(all, rate, episode.rng)?;
        Ok(Vec::new())
    }

    fn act(&self, room: &Environment) -> anyhow::Result<MirrorAngles> {
        Ok(actor::act_on_truth(room))
    }

    fn notes(&self) -> Vec<(&'static str, String)> {
        vec![("loss of the last episode", format!("{:.3}", self.loss))]
    }

    fn state(&mut self) -> Vec<Part<'_>> {
        vec![part("corrections", &mut self.network), part("corrections", &mut self.adam)]
    }

    fn export(&self, _: &ChannelModel, entries: &[(String, String)]) -> anyhow::Result<Vec<u8>> {
        Ok(actor::file(&self.network, entries)?)
    }
}
