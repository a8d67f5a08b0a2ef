//! The parts of which figures are made: each can be computed alone, and is named by all that it depends on.

use anyhow::Result;
use heliostat_controller::policy::{ActorSource, PolicyKind};
use heliostat_scenario::Scenario;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::figure::{Floor, Series};
use crate::job::Job;

/// One part of a figure.
#[derive(Clone, Debug)]
pub struct Part {
    /// Which figure it belongs to.
    pub figure: &'static str,
    /// A hash of the code that computes it.
    pub code: &'static str,
    /// The room's name.
    pub room: String,
    /// What sets it apart from the other parts of the same figure and seed.
    pub name: String,
    /// Seed of every random choice.
    pub seed: u64,
    /// The room; its own seed is replaced by the part's.
    pub scenario: Scenario,
    /// Where the policy ddpg comes from.
    pub actor: ActorSource,
    /// What is to be done.
    pub job: Job,
    /// About how long it takes on one core of the machine on which this was measured, in s.
    pub cost_s: f64,
}

/// What a part found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Values along an axis.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub curves: Vec<Curve>,
    /// Values over the floor, each with what stands on it.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub floors: Vec<(Floor, Vec<Series>)>,
}

/// Values of one seed along an axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Which panel or quantity.
    pub group: String,
    /// Which policy or condition.
    pub name: String,
    /// x and y; values that do not exist are left out.
    pub points: Vec<[f64; 2]>,
}

impl Part {
    /// A hash of all that the result depends on: code, room, seed, settings, and the built-in or given actor.
    ///
    /// # Errors
    /// An actor that cannot be fetched, where the part needs one.
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
    fn a_part_has_another_key_under_other_code_and_the_same_under_the_same() {
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
