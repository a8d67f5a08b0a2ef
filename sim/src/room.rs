//! The simulated room: the world, and the driver kit around the simulated array, on the same time
//! line.

use heliostat_array::Kit;
use heliostat_array::calibration::Unfit;
use heliostat_array::content::Content;
use heliostat_array::latch::LatchedStop;
use heliostat_array::moment::Moment;
use heliostat_array::refusal_counts::RefusalCounts;
use heliostat_array::rules::{Array, Refusal};
use heliostat_channel::MirrorAngles;
use heliostat_proto::{Calibration, Capabilities, MirrorCommand, MirrorTelemetry, SafetyReport, Stamp};
use heliostat_scenario::Scenario;

use crate::mirrors::SimulatedMirrors;
use crate::mirrors::actuator::Actuator;
use crate::mismatch::true_room;
use crate::world::{World, WorldError};

/// A complete simulated room.
#[derive(Clone, Debug)]
pub struct SimulatedRoom {
    world: World,
    kit: Kit<SimulatedMirrors>,
    world_ns: u64,
    /// Room time minus local time, as of the last arrival.
    room_ahead_ns: u64,
}

impl SimulatedRoom {
    /// The room of a scenario at local time 0, its mirrors parked.
    ///
    /// # Errors
    /// [`WorldError`] as from [`World::new`].
    pub fn new(scenario: &Scenario, trace: Option<&str>, seed: u64) -> Result<Self, WorldError> {
        let world = World::new(scenario, trace, seed)?;
        let mirrors = SimulatedMirrors::new(&true_room(scenario, seed).actuator, &world.model().mirrors, seed);
        let mut room = Self { world, kit: Kit::new(mirrors), world_ns: 0, room_ahead_ns: 0 };
        room.kit.advance(Moment::default());
        Ok(room)
    }

    /// Gives a command to the array at the time of its arrival.
    ///
    /// The arrival may be shortly before the time up to which the world was advanced, because the
    /// mirrors have their own time line.
    ///
    /// # Errors
    /// [`Refusal`]: the array does not change.
    pub fn handle_command(&mut self, at: Moment, command: &MirrorCommand) -> Result<(), Refusal> {
        self.keep_time(at);
        self.kit.handle_command(at, command)
    }

    /// Gives an arrival of any kind to the array; returns the command if it was one that was
    /// accepted.
    pub fn handle(&mut self, at: Moment, content: Content, refused: &mut RefusalCounts) -> Option<MirrorCommand> {
        self.keep_time(at);
        self.kit.handle(at, content, refused)
    }

    /// Latches a stop: the room starts stopped, as its state before a restart requires.
    pub fn stop(&mut self, at: Moment, stop: LatchedStop) {
        self.keep_time(at);
        self.kit.stop(at, stop);
    }

    /// Refuses re-arms of kind 9, because any process that may stop can publish one.
    pub fn refuse_unnamed_rearm(&mut self, refuse: bool) {
        self.kit.refuse_unnamed_rearm(refuse);
    }

    /// Gives the array a calibration of its mirrors' mounting, before the first step.
    ///
    /// # Errors
    /// [`Unfit`]: the calibration in use remains.
    pub fn set_calibration(&mut self, calibration: &Calibration) -> Result<(), Unfit> {
        self.kit.set_calibration(calibration)
    }

    /// Advances users and mirrors to a time and computes the scene.
    pub fn advance(&mut self, to_ns: u64) {
        self.kit.advance(self.moment(to_ns));
        self.kit.device_mut().advance(to_ns);
        self.world.step(to_ns.saturating_sub(self.world_ns) as f64 * 1e-9);
        self.world_ns = self.world_ns.max(to_ns);
    }

    /// Users, obstacles and the channel.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The world, for changes in a running room.
    pub fn world_mut(&mut self) -> &mut World {
        &mut self.world
    }

    /// The state machine of the array's rules.
    pub fn array(&self) -> &Array {
        self.kit.array()
    }

    /// Where the mirrors point.
    pub fn angles(&self) -> &MirrorAngles {
        self.actuator().angles()
    }

    /// The actuators of the mirrors.
    pub fn actuator(&self) -> &Actuator {
        self.kit.device().actuator()
    }

    /// The actuators, to set faults in a running room.
    pub fn actuator_mut(&mut self) -> &mut Actuator {
        self.kit.device_mut().actuator_mut()
    }

    /// The array's telemetry.
    pub fn telemetry(&mut self, stamp: Stamp) -> MirrorTelemetry {
        let now = Moment { local_ns: self.kit.device().time_ns(), room_ns: stamp.time_ns };
        self.kit.telemetry(now, stamp)
    }

    /// The array's capabilities.
    pub fn capabilities(&self, stamp: Stamp) -> Capabilities {
        self.kit.capabilities(stamp)
    }

    /// The emergency stop in force, and the bounds on commands.
    pub fn safety(&self, stamp: Stamp) -> SafetyReport {
        self.kit.safety(stamp)
    }

    fn keep_time(&mut self, at: Moment) {
        self.room_ahead_ns = at.room_ns.saturating_sub(at.local_ns);
    }

    fn moment(&self, local_ns: u64) -> Moment {
        Moment { local_ns, room_ns: local_ns.saturating_add(self.room_ahead_ns) }
    }
}
