//! The metadata entries of an actor.

use heliostat_files::excerpt;

use super::ActorProblem;
use crate::policy::weights::Head;

/// The keys of the metadata of an actor.
pub mod key {
    /// Beginning of all keys.
    pub const PREFIX: &str = "heliostat.";
    /// Version of the observation's layout.
    pub const OBSERVATION_VERSION: &str = "heliostat.observation_version";
    /// What the network reads; absent: the observation vector.
    pub const OBSERVATION: &str = "heliostat.observation";
    /// Largest number of users.
    pub const USERS_MAX: &str = "heliostat.users_max";
    /// Number of mirrors.
    pub const MIRRORS: &str = "heliostat.mirrors";
    /// What the network gives; absent: angles.
    pub const ACTION: &str = "heliostat.action";
    /// The baseline weight of a network that gives weights; absent: balanced.
    pub const BASELINE_WEIGHT: &str = "heliostat.baseline_weight";
    /// The constant c of a network that gives weights; absent: 2.
    pub const WEIGHT_RANGE: &str = "heliostat.weight_range";
    /// Outputs of the trainer's own network for four fixed inputs.
    pub const CHECK: &str = "heliostat.check";
    /// Channel mode that the actor was trained in.
    pub const MODE: &str = "heliostat.mode";
    /// Hash of the optical geometry.
    pub const GEOMETRY: &str = "heliostat.geometry";
    /// Command that made the file.
    pub const TRAINING_COMMAND: &str = "heliostat.training_command";
    /// Seed of the training.
    pub const SEED: &str = "heliostat.seed";
    /// Scenario of the training.
    pub const SCENARIO: &str = "heliostat.scenario";
    /// Scores on held-out states.
    pub const SCORES: &str = "heliostat.scores";
    /// Licence of the weights.
    pub const LICENCE: &str = "heliostat.licence";
}

/// The beginning of a text of a file, in quotation marks and without control characters.
pub fn quoted(text: &str) -> String {
    // Escapes are longer than what they stand for.
    excerpt(&format!("{:?}", excerpt(text)))
}

/// Finds entries, and says which one is unusable.
pub struct MetadataReader<'a>(pub &'a [(String, String)]);

impl MetadataReader<'_> {
    pub fn find(&self, key: &str) -> Option<&String> {
        self.0.iter().find(|(name, _)| name == key).map(|(_, value)| value)
    }

    pub fn text(&self, key: &'static str) -> Result<String, ActorProblem> {
        self.find(key).cloned().ok_or_else(|| self.unusable(key))
    }

    pub fn number<T: std::str::FromStr>(&self, key: &'static str) -> Result<T, ActorProblem> {
        self.find(key).and_then(|value| value.parse().ok()).ok_or_else(|| self.unusable(key))
    }

    /// The map from actions to decoder weights.
    pub fn head(&self) -> Result<Head, ActorProblem> {
        let mut head = Head::BALANCED;
        if self.find(key::BASELINE_WEIGHT).is_some() {
            head.baseline_weight = self.number(key::BASELINE_WEIGHT)?;
        }
        if self.find(key::WEIGHT_RANGE).is_some() {
            head.range = self.number(key::WEIGHT_RANGE)?;
        }
        if head.range.is_finite() { Ok(head) } else { Err(self.unusable(key::WEIGHT_RANGE)) }
    }

    fn unusable(&self, key: &'static str) -> ActorProblem {
        ActorProblem::Metadata { key, found: self.find(key).cloned() }
    }
}
