//! The simulated room: the world, and a driver kit around each simulated array, on the same time
//! line.

use heliostat_array::Kit;
use heliostat_array::calibration::Unfit;
use heliostat_array::content::Content;
use heliostat_array::latch::LatchedStop;
use heliostat_array::moment::Moment;
use heliostat_array::refusal_counts::RefusalCounts;
use heliostat_array::rules::{Array, Refusal};
use heliostat_channel::MirrorAngles;
use heliostat_proto::{Calibration, Capabilities, MirrorCommand, MirrorTelemetry, SafetyReport, Stamp, StopReport};
use heliostat_scenario::Scenario;

use crate::mirrors::SimulatedMirrors;
use crate::mirrors::actuator::Actuator;
use crate::mismatch::true_room;
use crate::world::{World, WorldError};

/// A complete simulated room.
#[derive(Clone, Debug)]
pub struct SimulatedRoom {
    world: World,
    /// One for each array.
    kits: Vec<Kit<SimulatedMirrors>>,
    /// Where the mirrors of several arrays point, array after array; unused for one array.
    joint: MirrorAngles,
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
        let actuator = true_room(scenario, seed).actuator;
        let arrays = world.model().mirrors.arrays().iter().zip(0..);
        let kits = arrays.map(|(array, index)| Kit::new(SimulatedMirrors::new(&actuator, array, seed, index)));
        let kits = kits.collect();
        let joint = MirrorAngles::flat(world.model().mirrors.len());
        let mut room = Self { world, kits, joint, world_ns: 0, room_ahead_ns: 0 };
        room.kits.iter_mut().for_each(|kit| kit.advance(Moment::default()));
        room.join_angles();
        Ok(room)
    }

    /// Number of arrays.
    pub fn arrays(&self) -> usize {
        self.kits.len()
    }

    /// Gives a command to an array at the time of its arrival.
    ///
    /// The arrival may be shortly before the time up to which the world was advanced, because the
    /// mirrors have their own time line.
    ///
    /// # Errors
    /// [`Refusal`]: the array does not change.
    pub fn handle_command(&mut self, array: usize, at: Moment, command: &MirrorCommand) -> Result<(), Refusal> {
        self.keep_time(at);
        let result = self.kits[array].handle_command(at, command);
        self.join_angles();
        result
    }

    /// Gives a message of any kind, which arrived at the first time and is handled at the second, to an
    /// array; returns the command if it was one that was accepted.
    pub fn handle(
        &mut self,
        array: usize,
        (arrived, now): (Moment, Moment),
        content: Content,
        refused: &mut RefusalCounts,
    ) -> Option<MirrorCommand> {
        self.keep_time(now);
        let accepted = self.kits[array].handle((arrived, now), content, refused);
        self.join_angles();
        accepted
    }

    /// Latches a stop: the array starts stopped, as its state before a restart requires.
    pub fn stop(&mut self, array: usize, at: Moment, stop: LatchedStop) {
        self.keep_time(at);
        self.kits[array].stop(at, stop);
    }

    /// Refuses re-arms of kind 9, because any process that may stop can publish one.
    pub fn refuse_unnamed_rearm(&mut self, refuse: bool) {
        self.kits.iter_mut().for_each(|kit| kit.refuse_unnamed_rearm(refuse));
    }

    /// Gives an array a calibration of its mirrors' mounting, before the first step: the mirrors, which are
    /// connected already, park with it.
    ///
    /// # Errors
    /// [`Unfit`]: the calibration in use remains.
    pub fn set_calibration(&mut self, array: usize, calibration: &Calibration) -> Result<(), Unfit> {
        let replaced = self.kits[array].handle_calibration(Moment::default(), calibration);
        self.join_angles();
        replaced
    }

    /// Advances users and mirrors to a time and computes the scene.
    pub fn advance(&mut self, to_ns: u64) {
        let now = self.moment(to_ns);
        for kit in &mut self.kits {
            kit.advance(now);
            kit.device_mut().advance(to_ns);
        }
        self.join_angles();
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

    /// The state machine of the rules of an array.
    pub fn array(&self, array: usize) -> &Array {
        self.kits[array].array()
    }

    /// Where the mirrors of all arrays point.
    pub fn angles(&self) -> &MirrorAngles {
        match self.kits.as_slice() {
            [kit] => kit.device().actuator().angles(),
            _ => &self.joint,
        }
    }

    /// The actuators of the mirrors of an array.
    pub fn actuator(&self, array: usize) -> &Actuator {
        self.kits[array].device().actuator()
    }

    /// The actuators of an array, to set faults in a running room.
    pub fn actuator_mut(&mut self, array: usize) -> &mut Actuator {
        self.kits[array].device_mut().actuator_mut()
    }

    /// Number of mirrors with a fault.
    pub fn faulty_mirrors(&self) -> usize {
        (0..self.arrays()).map(|array| self.actuator(array).faulty_mirrors()).sum()
    }

    /// The telemetry of an array.
    pub fn telemetry(&mut self, array: usize, stamp: Stamp) -> MirrorTelemetry {
        let kit = &mut self.kits[array];
        let now = Moment { local_ns: kit.device().time_ns(), room_ns: stamp.time_ns };
        kit.telemetry(now, stamp)
    }

    /// The capabilities of an array.
    pub fn capabilities(&self, array: usize, stamp: Stamp) -> Capabilities {
        self.kits[array].capabilities(stamp)
    }

    /// The emergency stops in force on an array, and whether its mirrors have stopped.
    pub fn stops(&self, array: usize, stamp: Stamp) -> StopReport {
        self.kits[array].stops(stamp)
    }

    /// Whether the mirrors of an array have executed the stop that is latched.
    pub fn device_stopped(&self, array: usize) -> bool {
        self.kits[array].device_stopped()
    }

    /// The emergency stop that was latched last on an array, and its bounds on commands.
    pub fn safety(&self, array: usize, stamp: Stamp) -> SafetyReport {
        self.kits[array].safety(stamp)
    }

    /// Joins the angles of several arrays. Does not allocate.
    fn join_angles(&mut self) {
        if self.kits.len() == 1 {
            return;
        }
        let MirrorAngles { roll, yaw } = &mut self.joint;
        for ((_, mirrors), kit) in self.world.model().mirrors.ranges().zip(&self.kits) {
            let angles = kit.device().actuator().angles();
            roll[mirrors.clone()].copy_from_slice(&angles.roll);
            yaw[mirrors].copy_from_slice(&angles.yaw);
        }
    }

    fn keep_time(&mut self, at: Moment) {
        self.room_ahead_ns = at.room_ns.saturating_sub(at.local_ns);
    }

    fn moment(&self, local_ns: u64) -> Moment {
        Moment { local_ns, room_ns: local_ns.saturating_add(self.room_ahead_ns) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirrors_park_with_the_calibration_of_the_start_and_none_is_unusable() {
        let scenario = Scenario::builtin("hall").expect("a built-in scenario");
        let mut room = SimulatedRoom::new(&scenario, None, 1).expect("a room");
        let mirrors = scenario.mirror_count();
        let calibration = Calibration {
            stamp: Stamp { sequence: 1, ..Stamp::default() },
            roll_offset_rad: vec![0.02; mirrors],
            roll_gain: vec![1.0; mirrors],
            yaw_offset_rad: vec![0.0; mirrors],
            yaw_gain: vec![1.0; mirrors],
        };
        room.set_calibration(0, &calibration).expect("a sound calibration");
        for step in 1..=20 {
            room.advance(step * 50_000_000);
            let telemetry = room.telemetry(0, Stamp::default());
            assert!(telemetry.unusable.is_empty(), "{:?}", telemetry.unusable);
        }
        let roll = room.actuator(0).measured().roll[0];
        assert!((roll - 0.02).abs() < 1e-3, "{roll}");
    }
}
