//! The parameters of figures: rooms, seeds and sizes.

use anyhow::{Result, ensure};
use heliostat_models::ActorSource;
use heliostat_scenario::Scenario;

use crate::effort::Effort;
use crate::job::Job;
use crate::part::Part;

/// A room for figures.
#[derive(Clone, Debug)]
pub struct Room {
    /// Its name in the report: that of its scenario.
    pub name: String,
    /// The room.
    pub scenario: Scenario,
    /// The source of the policy ddpg in this room.
    pub actor: ActorSource,
    /// The command-line flags that the figures of this room depend on.
    pub flags: String,
}

impl Room {
    /// A part of a figure in this room: id and code of the figure, name and seed of the part.
    pub fn part(&self, [figure, code]: [&'static str; 2], (name, seed): (String, u64), job: Job, cost_s: f64) -> Part {
        let (room, scenario, actor) = (self.name.clone(), self.scenario.clone(), self.actor.clone());
        Part { figure, code, room, name, seed, scenario, actor, job, cost_s }
    }
}

/// The parameters of all figures.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The sizes.
    pub effort: Effort,
    /// The first seed.
    pub first_seed: u64,
    /// Numbers of blocked users in the power figure.
    pub blocked: Vec<usize>,
}

impl Plan {
    /// The seeds of everything but training and timing.
    pub fn seeds(&self) -> std::ops::Range<u64> {
        self.first_seed..self.first_seed + self.effort.seeds
    }

    /// Refuses numbers of blocked users that a room of a figure does not have.
    ///
    /// # Errors
    /// A number above the number of users.
    pub fn check_blocked(&self, id: &str, room: &Room) -> Result<()> {
        let users = room.scenario.users.count;
        let most = self.blocked.iter().copied().max().unwrap_or(0);
        ensure!(
            most <= users,
            "{id} blocks up to {most} users, but room {} has {users} (users.count): give --blocked numbers up to {users}",
            room.name
        );
        Ok(())
    }

    /// The seeds of training and of timing.
    pub fn training_seeds(&self) -> std::ops::Range<u64> {
        self.first_seed..self.first_seed + self.effort.training_seeds
    }
}
