//! What figures are made with: rooms, seeds and sizes.

use heliostat_controller::policy::ActorSource;
use heliostat_scenario::Scenario;

use crate::effort::Effort;

/// A room in which figures are made.
#[derive(Clone, Debug)]
pub struct Room {
    /// Its name in the report: that of its scenario.
    pub name: String,
    /// The room.
    pub scenario: Scenario,
    /// Where the policy ddpg comes from there.
    pub actor: ActorSource,
    /// The flags of the command line on which figures in it depend.
    pub flags: String,
}

/// What all figures are made with.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The sizes.
    pub effort: Effort,
    /// The first seed.
    pub first_seed: u64,
    /// Numbers of users whose direct path is off, for the power figure.
    pub blocked: Vec<usize>,
}

impl Plan {
    /// The seeds of everything but training and timing.
    pub fn seeds(&self) -> std::ops::Range<u64> {
        self.first_seed..self.first_seed + self.effort.seeds
    }

    /// The seeds of training and of timing.
    pub fn training_seeds(&self) -> std::ops::Range<u64> {
        self.first_seed..self.first_seed + self.effort.training_seeds
    }
}
