//! One row of the table of algorithms; [`crate::learners`] has the table.

use anyhow::{Context, bail, ensure};
use clap::ValueEnum;
use heliostat_core::policy::PolicyKind;
use heliostat_scenario::Scenario;
use rand_chacha::ChaCha8Rng;
use serde::{Serialize, de::DeserializeOwned};

use super::learner::Learner;
use super::run::Training;
use super::settings::with_options;

/// A set of default hyperparameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Preset {
    /// Hyperparameters of the built-in actors
    Tuned,
    /// Network sizes, learning rates and replay-buffer size from the paper
    Paper,
}

/// An algorithm that `heliostat-lab train` knows.
#[derive(Clone, Copy, Debug)]
pub struct Algorithm {
    /// The name on the command line, which is also that of the policy.
    pub name: &'static str,
    /// The policy that it trains.
    pub policy: PolicyKind,
    /// One line for `--help`.
    pub help: &'static str,
    /// One sentence for the card, with the file that documents the algorithm.
    pub summary: &'static str,
    /// Whether it has the preset [`Preset::Paper`].
    pub has_paper_preset: bool,
    /// Makes a run before its first episode.
    pub start: fn(Scenario, Preset, &[String]) -> anyhow::Result<Training>,
}

impl Algorithm {
    /// A run before its first episode, with options of the form `key=value` applied to the preset.
    ///
    /// # Errors
    /// The scenario, the preset or an option is invalid.
    pub fn begin(&self, scenario: Scenario, preset: Preset, options: &[String]) -> anyhow::Result<Training> {
        ensure!(
            preset == Preset::Tuned || self.has_paper_preset,
            "--preset paper: {} has one preset only; expected no --preset, or --preset tuned",
            self.name
        );
        self.require_one_led(&scenario)?;
        let one_array = scenario
            .require_one_array()
            .with_context(|| format!("an actor of {} is trained in a room with one array", self.name))?;
        (self.start)(one_array, preset, options)
    }

    /// Refuses a room with several LEDs, and says how an actor for it is trained, if there is one.
    fn require_one_led(&self, scenario: &Scenario) -> anyhow::Result<()> {
        let leds = &scenario.led.positions_m;
        let [first, _, ..] = &leds[..] else { return Ok(()) };
        let advice = if self.policy.fits_any_array() {
            format!(
                "its actor runs in rooms of several, too: train with --set 'led.positions_m=[{first:?}]', and evaluate the actor in \
                 the room of several"
            )
        } else {
            let fitting = PolicyKind::value_variants().iter().filter(|kind| kind.fits_any_array());
            let names: Vec<String> = fitting.map(|kind| kind.name()).collect();
            format!("its actor runs in the room of its training only: choose {}", names.join(" or "))
        };
        bail!(
            "led.positions_m lists {} LEDs: expected 1, because training of {} needs a room with one LED; {advice}",
            leds.len(),
            self.name
        )
    }
}

/// A run of one learner with options applied to its settings.
///
/// # Errors
/// An option is invalid, or `build` fails.
pub fn start<S, L>(
    scenario: Scenario,
    settings: S,
    options: &[String],
    build: fn(&Scenario, S, &mut ChaCha8Rng) -> anyhow::Result<L>,
) -> anyhow::Result<Training>
where
    S: Serialize + DeserializeOwned,
    L: Learner + 'static,
{
    Training::new(scenario, with_options(settings, options)?, build)
}
