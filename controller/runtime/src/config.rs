//! What a controller process needs to start.

use std::time::Duration;

use heliostat_bus::BusConfig;
use heliostat_core::capabilities::Force;
use heliostat_models::{BuildError, PolicyArgs, build};
use heliostat_proto::Room;
use heliostat_scenario::Scenario;
use heliostat_service::MetricsArgs;

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
    /// The policy, and the file of its actor.
    pub policy: PolicyArgs,
    /// Time is that of the reports, and the epoch is 1: the same reports give the same commands, bit for bit. Otherwise
    /// time is UTC, and the first command chooses an epoch above UTC in ms.
    pub is_lockstep: bool,
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
    /// Checks that the policy can be built from the file of its actor, if one is given.
    ///
    /// # Errors
    /// The file is missing, or does not fit the policy or the room.
    pub fn check_model(&self) -> Result<(), BuildError> {
        match &self.policy.model {
            Some(_) => build(self.policy.kind(), &self.scenario, &self.policy.actor()).map(drop),
            None => Ok(()),
        }
    }
}
