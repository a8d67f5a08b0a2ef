//! What all algorithms that learn have in common: a run of episodes that can be watched, stopped, resumed and exported.
//!
//! `heliostat train` knows no algorithm, only [`Learner`]; [`crate::algorithm`] says which there are.

use anyhow::{Context, bail};
use heliostat_channel::MirrorAngles;
use heliostat_scenario::Scenario;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::checkpoint::Store;
use crate::env::{Environment, Reward, Rooms};

/// A training run between two episodes.
pub trait Learner {
    /// The room that the run is about.
    fn scenario(&self) -> &Scenario;

    /// The part of the run's numbers that every algorithm has.
    fn run(&self) -> &RunSettings;

    /// All numbers of the run, for the card and for the refusal to resume under others.
    fn settings(&self) -> serde_json::Value;

    /// Episodes done.
    fn episodes_done(&self) -> usize;

    /// Trains for one episode in a room of its own.
    ///
    /// # Errors
    /// Those of the room and of the networks.
    fn run_episode(&mut self) -> anyhow::Result<Episode>;

    /// The angles for what a room shows, without exploration.
    ///
    /// # Errors
    /// Those of the networks.
    fn act(&self, environment: &Environment) -> anyhow::Result<MirrorAngles>;

    /// What the card tells besides, as rows of a name and a text.
    fn notes(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }

    /// The best angles that the learner could ever give here, where it chooses among so few that all can be tried.
    fn best_possible(&self, _environment: &Environment) -> Option<MirrorAngles> {
        None
    }

    /// Writes all that the run needs to go on as if it had never stopped; settings and scenario are written by the caller.
    ///
    /// # Errors
    /// Those of the networks.
    fn save(&self, store: &mut Store) -> anyhow::Result<()>;

    /// Takes the place of the run that wrote the store.
    ///
    /// # Errors
    /// A part that is missing or does not fit.
    fn restore(&mut self, store: &Store) -> anyhow::Result<()>;

    /// The policy as an ONNX file with the ports that a controller expects ([`heliostat_controller::policy::actor_file`]).
    ///
    /// # Errors
    /// Those of the channel and of the networks.
    fn export(&self, metadata: &[(String, String)]) -> anyhow::Result<Vec<u8>>;
}

/// What one episode brought, as means over its steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Episode {
    /// Its number, counted from 1.
    pub number: usize,
    /// Steps taken since the start of training.
    pub steps: usize,
    /// Reward of the disturbed actions in Mbit/s.
    pub reward_mbps: f64,
    /// Their sum rate in Mbit/s.
    pub sum_rate_mbps: f64,
}

/// The numbers that every algorithm has; they stand beside its own in options and cards.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunSettings {
    /// The reward.
    pub reward: Reward,
    /// Which rooms.
    pub rooms: Rooms,
    /// Episodes.
    pub episodes: usize,
    /// Steps in an episode.
    pub steps: usize,
    /// Seconds between two steps.
    pub step_s: f64,
    /// Seed of every random choice.
    pub seed: u64,
}

/// Numbers that mean the same in every algorithm: where they stand in the settings, the least and the most, and both in words.
const DOMAINS: [(&str, f64, f64, &str); 20] = [
    ("/episodes", 1.0, 1e9, "at least 1"),
    ("/steps", 1.0, 1e6, "1 to 1e6"),
    ("/step_s", f64::MIN_POSITIVE, 1e6, "above 0"),
    ("/batch", 1.0, 1e6, "1 to 1e6"),
    ("/replay", 1.0, 1e8, "1 to 1e8"),
    ("/warm_up", 0.0, 1e8, "0 to 1e8"),
    ("/steps_per_update", 1.0, 1e6, "1 to 1e6"),
    ("/rounds", 1.0, 16.0, "1 to 16"),
    ("/cells", 1.0, 1000.0, "1 to 1000"),
    ("/gamma", 0.0, 1.0 - f64::EPSILON, "0 to 1, without 1"),
    ("/tau", f64::MIN_POSITIVE, 1.0, "above 0 and at most 1"),
    ("/alpha", f64::MIN_POSITIVE, 1.0, "above 0 and at most 1"),
    ("/rate", f64::MIN_POSITIVE, 1.0, "above 0 and at most 1"),
    ("/actor_rate", f64::MIN_POSITIVE, 1.0, "above 0 and at most 1"),
    ("/critic_rate", f64::MIN_POSITIVE, 1.0, "above 0 and at most 1"),
    ("/rate_end", f64::MIN_POSITIVE, 1.0, "above 0 and at most 1"),
    ("/exploration/start", f64::MIN_POSITIVE, 10.0, "above 0 and at most 10"),
    ("/exploration/end", f64::MIN_POSITIVE, 10.0, "above 0 and at most 10"),
    ("/reward/lambda", 0.0, 1e6, "0 to 1e6"),
    ("/reward/margin", f64::MIN_POSITIVE, 1e3, "above 0"),
];

/// Refuses numbers outside their domain, and a replay buffer in which learning would never begin.
fn check(tree: &serde_json::Value) -> anyhow::Result<()> {
    let number = |pointer: &str| tree.pointer(pointer).and_then(serde_json::Value::as_f64);
    for (pointer, least, most, wanted) in DOMAINS {
        if let Some(value) = number(pointer).filter(|value| !(least..=most).contains(value)) {
            bail!("{} = {value}: wanted {wanted}", pointer[1..].replace('/', "."));
        }
    }
    for needed in ["warm_up", "batch"] {
        if let (Some(kept), Some(wanted)) = (number("/replay"), number(&format!("/{needed}")))
            && kept < wanted
        {
            bail!(
                "replay = {kept} holds fewer transitions than {needed} = {wanted}, so that learning would never begin"
            );
        }
    }
    Ok(())
}

/// The same numbers with changes of the form `key=value`; a dot leads into a group, as in `exploration.start=0.2`.
///
/// # Errors
/// A message that names the change when there is no such key or the value does not fit, or the number that is outside its domain.
pub fn with_options<S: Serialize + DeserializeOwned>(settings: S, options: &[String]) -> anyhow::Result<S> {
    let mut tree = serde_json::to_value(&settings)?;
    for option in options {
        let (path, value) = option.split_once('=').with_context(|| format!("--option {option}: wanted KEY=VALUE"))?;
        let pointer = format!("/{}", path.trim().replace('.', "/"));
        let Some(place) = tree.pointer_mut(&pointer) else {
            bail!("--option {option}: no such key; there are {}", serde_json::to_string(&settings)?);
        };
        *place = serde_json::from_str(value).unwrap_or_else(|_| value.into());
        serde_json::from_value::<S>(tree.clone()).with_context(|| format!("--option {option}"))?;
    }
    check(&tree)?;
    Ok(serde_json::from_value(tree)?)
}
