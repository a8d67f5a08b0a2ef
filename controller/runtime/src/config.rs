//! What a controller process needs to start.

use std::{path::PathBuf, time::Duration};

use heliostat_bus::BusConfig;
use heliostat_core::{capabilities::Force, policy::PolicyKind};
use heliostat_models::{ActorSource, BuildError, build};
use heliostat_proto::Room;
use heliostat_scenario::Scenario;
use heliostat_service::MetricsArgs;

/// The source of time and epochs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pace {
    /// UTC; the first command chooses an epoch above UTC in ms.
    #[default]
    Live,
    /// The time of the reports; the epoch is 1. The same reports give the same commands, bit for
    /// bit.
    Lockstep,
}

/// The configuration of a controller process.
#[derive(Clone, Debug)]
pub struct NodeConfig {
    /// The room.
    pub scenario: Scenario,
    /// The endpoints, and the name of the first room.
    pub bus: BusConfig,
    /// Further rooms to serve, all with the same scenario and over the same session.
    pub also_rooms: Vec<Room>,
    /// The statistics of times begin with the report of this tick.
    pub times_from_tick: u64,
    /// The policy.
    pub policy: PolicyKind,
    /// The actor's file in place of the built-in one.
    pub model: Option<PathBuf>,
    /// Live or lockstep.
    pub pace: Pace,
    /// Stand by from the start, with this rank or the rank by source ids.
    pub standby: Option<Option<u8>>,
    /// Mismatches between array and scenario that the operator accepts.
    pub force: Force,
    /// When to end without a signal.
    pub run_for: Option<Duration>,
    /// Where metrics are served.
    pub metrics: MetricsArgs,
}

impl NodeConfig {
    /// Where the actor of the policy comes from.
    pub fn actor(&self) -> ActorSource {
        self.model.clone().into()
    }

    /// Checks that the policy can be built from the file of its actor, if one is given.
    ///
    /// # Errors
    /// The file is missing, or does not fit the policy or the room.
    pub fn check_model(&self) -> Result<(), BuildError> {
        match &self.model {
            Some(_) => build(self.policy, &self.scenario, &self.actor()).map(drop),
            None => Ok(()),
        }
    }
}
