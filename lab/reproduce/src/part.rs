//! The parts of figures: each is computed alone, and has a key of all its inputs.

use anyhow::Result;
use heliostat_core::policy::PolicyKind;
use heliostat_models::ActorSource;
use heliostat_scenario::Scenario;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::figure::{Floor, Series};
use crate::job::Job;

/// One part of a figure.
#[derive(Clone, Debug)]
pub struct Part {
    /// The id of its figure.
    pub figure: &'static str,
    /// A hash of the code that computes it.
    pub code: &'static str,
    /// The room's name.
    pub room: String,
    /// Its name, unique among the parts of the same figure and seed.
    pub name: String,
    /// Seed of every random choice.
    pub seed: u64,
    /// The room; its own seed is replaced by the part's.
    pub scenario: Scenario,
    /// Where the policy ddpg comes from.
    pub actor: ActorSource,
    /// The computation.
    pub job: Job,
    /// Estimated processor time in s.
    pub cost_s: f64,
}

/// The results of a part.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Values along an axis.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub curves: Vec<Curve>,
    /// Values over the floor, each with the objects in the room.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub floors: Vec<(Floor, Vec<Series>)>,
}

/// Values of one seed along an axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// The panel or quantity.
    pub group: String,
    /// The policy or condition.
    pub name: String,
    /// x and y; missing values are omitted.
    pub points: Vec<[f64; 2]>,
}

impl Part {
    /// A hash of all inputs: code, room, seed, settings, and the actor.
    ///
    /// # Errors
    /// An actor that cannot be loaded, if the part needs one.
    pub fn key(&self) -> Result<String> {
        let mut hash = Sha256::new();
        let mut add = |text: &str| {
            hash.update((text.len() as u64).to_le_bytes());
            hash.update(text);
        };
        add(self.code);
        add(self.figure);
        add(&self.scenario().to_toml());
        add(&serde_json::to_string(&self.job)?);
        if self.job.needs_actor() {
            hash.update(Sha256::digest(&self.actor.fetch(PolicyKind::Ddpg, &self.scenario)?.bytes));
        }
        Ok(hash.finalize().iter().take(10).map(|byte| format!("{byte:02x}")).collect())
    }

    /// The room with the part's seed.
    pub fn scenario(&self) -> Scenario {
        Scenario { seed: self.seed, ..self.scenario.clone() }
    }

    /// One line for progress and lists.
    pub fn label(&self) -> String {
        format!("{} {}: {}, seed {}", self.figure, self.room, self.name, self.seed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::Map;

    #[test]
    fn the_key_of_a_part_depends_on_the_code() {
        let part = |code: &'static str| Part {
            figure: "map",
            code,
            room: "paper".into(),
            name: "floor".into(),
            seed: 1,
            scenario: Scenario::builtin("paper").unwrap(),
            actor: ActorSource::Shipped,
            job: Job::Map(Map { step_cm: 50.0 }),
            cost_s: 1.0,
        };
        assert_eq!(part("one").key().unwrap(), part("one").key().unwrap());
        assert_ne!(part("one").key().unwrap(), part("other").key().unwrap());
    }
}
