//! The hyperparameters of a training run, and changes to them from the command line.

use anyhow::{Context, bail};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::environment::room::{Reward, RewardForm, Rooms};

/// The hyperparameters that every run has. Options and cards list them with the learner's own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunSettings {
    /// The reward.
    pub reward: Reward,
    /// The rooms.
    pub rooms: Rooms,
    /// Number of episodes.
    pub episodes: usize,
    /// Steps in an episode.
    pub steps: usize,
    /// Time between two steps in s.
    pub step_s: f64,
    /// Seed of every random choice.
    pub seed: u64,
}

impl RunSettings {
    /// The paper's lambda and 1000 episodes, with a penalised shortfall, randomised rooms, and 40
    /// steps of one second.
    pub fn paper(seed: u64) -> Self {
        Self {
            reward: Reward { form: RewardForm::Shortfall, lambda: 1.0, margin: 1.0 },
            rooms: Rooms::Randomised,
            episodes: 1000,
            steps: 40,
            step_s: 1.0,
            seed,
        }
    }
}

/// The domains of the hyperparameters, the same for every learner: path in the settings, smallest
/// and largest value, and both in words.
const DOMAINS: [(&str, f64, f64, &str); 19] = [
    ("/episodes", 1.0, 1e9, "at least 1"),
    ("/steps", 1.0, 1e6, "1 to 1e6"),
    ("/step_s", f64::MIN_POSITIVE, 1e6, "above 0"),
    ("/batch", 1.0, 1e6, "1 to 1e6"),
    ("/replay", 1.0, 1e8, "1 to 1e8"),
    ("/warm_up", 0.0, 1e8, "0 to 1e8"),
    ("/steps_per_update", 1.0, 1e6, "1 to 1e6"),
    ("/cells", 1.0, 1000.0, "1 to 1000"),
    ("/gamma", 0.0, 1.0 - f64::EPSILON, "at least 0 and below 1"),
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

/// Refuses hyperparameters outside their domain, and a replay buffer that is too small for the
/// first update.
fn check(tree: &serde_json::Value) -> anyhow::Result<()> {
    let number = |pointer: &str| tree.pointer(pointer).and_then(serde_json::Value::as_f64);
    for (pointer, least, most, domain) in DOMAINS {
        if let Some(value) = number(pointer).filter(|value| !(least..=most).contains(value)) {
            bail!("{} = {value}: expected {domain}", pointer[1..].replace('/', "."));
        }
    }
    for needed in ["warm_up", "batch"] {
        if let (Some(replay), Some(count)) = (number("/replay"), number(&format!("/{needed}")))
            && replay < count
        {
            bail!("replay = {replay} with {needed} = {count} allows no update: expected replay of at least {count}");
        }
    }
    Ok(())
}

/// Settings with changes of the form `key=value`; a dot names a member, as in
/// `exploration.start=0.2`.
///
/// # Errors
/// A key does not exist, or a value has another type or lies outside its domain. The message
/// names the change.
pub fn with_options<S: Serialize + DeserializeOwned>(settings: S, options: &[String]) -> anyhow::Result<S> {
    let mut tree = serde_json::to_value(&settings)?;
    for option in options {
        let (path, value) = option.split_once('=').with_context(|| format!("--option {option}: expected KEY=VALUE"))?;
        let pointer = format!("/{}", path.trim().replace('.', "/"));
        let Some(place) = tree.pointer_mut(&pointer) else {
            bail!(
                "--option {option}: no such key; the keys with their values are {}",
                serde_json::to_string(&settings)?
            );
        };
        *place = serde_json::from_str(value).unwrap_or_else(|_| value.into());
        serde_json::from_value::<S>(tree.clone()).with_context(|| format!("--option {option}"))?;
    }
    check(&tree)?;
    Ok(serde_json::from_value(tree)?)
}
