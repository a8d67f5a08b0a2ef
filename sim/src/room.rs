//! The room with its mirrors: people, and the driver kit around the simulated array, moving through the same time.

use heliostat_array::Kit;
use heliostat_array::content::Content;
use heliostat_array::moment::Moment;
use heliostat_array::refused::Refused;
use heliostat_array::rules::{Array, Refusal};
use heliostat_channel::MirrorAngles;
use heliostat_proto::{Calibration, Capabilities, MirrorCommand, MirrorTelemetry, Stamp};
use heliostat_scenario::Scenario;

use crate::actuator::Actuator;
use crate::mirrors::SimulatedMirrors;
use crate::world::{World, WorldError};

/// A whole simulated room.
#[derive(Clone, Debug)]
pub struct SimulatedRoom {
    world: World,
    kit: Kit<SimulatedMirrors>,
    world_ns: u64,
    /// Room time less local time, as far as it is known from what arrived.
    room_ahead_ns: u64,
}

impl SimulatedRoom {
    /// The room of a scenario at local time 0, its mirrors parked.
    ///
    /// # Errors
    /// [`WorldError`] as from [`World::new`].
    pub fn new(scenario: &Scenario, trace: Option<&str>, seed: u64) -> Result<Self, WorldError> {
        let world = World::new(scenario, trace, seed)?;
        let mirrors = SimulatedMirrors::new(&scenario.actuator, &world.model().mirrors, seed);
        let mut room = Self { world, kit: Kit::new(mirrors), world_ns: 0, room_ahead_ns: 0 };
        room.kit.advance(Moment::default());
        Ok(room)
    }

    /// Gives a command to the array at the time of its arrival, which may lie a little before the time up to which the world was
    /// moved: mirrors move on their own time line.
    ///
    /// # Errors
    /// [`Refusal`]: the array goes on as if nothing had come.
    pub fn receive(&mut self, at: Moment, command: &MirrorCommand) -> Result<(), Refusal> {
        self.keep_time(at);
        self.kit.command(at, command)
    }

    /// Gives the array whatever arrived for it; gives the command where it was one that is followed.
    pub fn take(&mut self, at: Moment, content: Content, refused: &mut Refused) -> Option<MirrorCommand> {
        self.keep_time(at);
        self.kit.take(at, content, refused)
    }

    /// Corrects the mirrors' mounting.
    ///
    /// # Errors
    /// [`Unfit`](heliostat_array::calibration::Unfit): the correction in use stays.
    pub fn calibrate(
        &mut self,
        at: Moment,
        calibration: &Calibration,
    ) -> Result<(), heliostat_array::calibration::Unfit> {
        self.keep_time(at);
        self.kit.calibrate(at, calibration)
    }

    /// Moves people and mirrors to a time and computes the scene there.
    pub fn advance(&mut self, to_ns: u64) {
        self.kit.advance(self.moment(to_ns));
        self.kit.device_mut().move_to(to_ns);
        self.world.step(to_ns.saturating_sub(self.world_ns) as f64 * 1e-9);
        self.world_ns = self.world_ns.max(to_ns);
    }

    /// People, obstacles and the channel.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// For changes in a running room.
    pub fn world_mut(&mut self) -> &mut World {
        &mut self.world
    }

    /// The array's guard.
    pub fn array(&self) -> &Array {
        self.kit.array()
    }

    /// Where the mirrors point.
    pub fn angles(&self) -> &MirrorAngles {
        self.actuator().angles()
    }

    /// The mirrors themselves.
    pub fn actuator(&self) -> &Actuator {
        self.kit.device().actuator()
    }

    /// For faults in a running room.
    pub fn actuator_mut(&mut self) -> &mut Actuator {
        self.kit.device_mut().actuator_mut()
    }

    /// What the array tells about itself.
    pub fn telemetry(&mut self, stamp: Stamp) -> MirrorTelemetry {
        let now = Moment { local_ns: self.kit.device().time_ns(), room_ns: stamp.time_ns };
        self.kit.telemetry(now, stamp)
    }

    /// What the array is and can do.
    pub fn capabilities(&self, stamp: Stamp) -> Capabilities {
        self.kit.capabilities(stamp)
    }

    fn keep_time(&mut self, at: Moment) {
        self.room_ahead_ns = at.room_ns.saturating_sub(at.local_ns);
    }

    fn moment(&self, local_ns: u64) -> Moment {
        Moment { local_ns, room_ns: local_ns.saturating_add(self.room_ahead_ns) }
    }
}
