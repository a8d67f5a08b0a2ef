//! The room with its mirrors: world, array guard and actuator moving through the same time.

use heliostat_channel::MirrorAngles;
use heliostat_proto::messages::fault;
use heliostat_proto::{
    ArrayState, AxisLimits, Capabilities, Feedback, MirrorCommand, MirrorTelemetry, Stamp, ValidityClock,
};
use heliostat_scenario::{ActuatorParameters, Scenario};

use crate::actuator::Actuator;
use crate::array::{Array, HOLD_NS, Limits, Refusal};
use crate::clock::Moment;
use crate::random::{self, Purpose};
use crate::world::{World, WorldError};

/// A whole simulated room.
#[derive(Clone, Debug)]
pub struct SimulatedRoom {
    world: World,
    array: Array,
    actuator: Actuator,
    parameters: ActuatorParameters,
    hardware: String,
    world_ns: u64,
    mirrors_ns: u64,
}

impl SimulatedRoom {
    /// The room of a scenario at local time 0, its mirrors parked.
    ///
    /// # Errors
    /// [`WorldError`] as from [`World::new`].
    pub fn new(scenario: &Scenario, seed: u64) -> Result<Self, WorldError> {
        let world = World::new(scenario, seed)?;
        let mirrors = world.model().mirrors.len();
        let parameters = scenario.actuator.parameters();
        Ok(Self {
            array: Array::new(Limits { mirrors, range_rad: parameters.range_rad, hold_ns: HOLD_NS }),
            actuator: Actuator::new(&parameters, mirrors, random::stream(seed, Purpose::Actuator, 0)),
            hardware: format!("simulated mirrors, profile {:?}", scenario.actuator.profile).to_lowercase(),
            parameters,
            world,
            world_ns: 0,
            mirrors_ns: 0,
        })
    }

    /// Gives a command to the array at the time of its arrival, which may lie a little before the time up to which the world was
    /// moved: mirrors move on their own time line.
    ///
    /// # Errors
    /// [`Refusal`]: the array goes on as if nothing had come.
    pub fn receive(&mut self, at: Moment, command: &MirrorCommand) -> Result<(), Refusal> {
        self.advance_mirrors(at.local_ns);
        self.array.receive(at, command)?;
        self.actuator.command(self.array.target());
        Ok(())
    }

    /// Counts a payload on the command key that is no command.
    pub fn count_malformed(&mut self) {
        self.array.count_malformed();
    }

    /// Moves people and mirrors to a time and computes the scene there.
    pub fn advance(&mut self, to_ns: u64) {
        self.advance_mirrors(to_ns);
        self.world.step(seconds_between(self.world_ns, to_ns));
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
        &self.array
    }

    /// Where the mirrors point.
    pub fn angles(&self) -> &MirrorAngles {
        self.actuator.angles()
    }

    /// The mirrors themselves.
    pub fn actuator(&self) -> &Actuator {
        &self.actuator
    }

    /// For faults in a running room.
    pub fn actuator_mut(&mut self) -> &mut Actuator {
        &mut self.actuator
    }

    /// What the array tells about itself.
    pub fn telemetry(&self, stamp: Stamp) -> MirrorTelemetry {
        let single = |angles: &[f64]| angles.iter().map(|angle| *angle as f32).collect();
        let followed = self.array.followed().copied().unwrap_or_default();
        let (target, measured) = (self.array.target(), self.actuator.measured());
        MirrorTelemetry {
            stamp,
            state: if self.actuator.is_away() { ArrayState::Fault } else { self.array.state() },
            epoch: followed.epoch,
            applied_sequence: followed.sequence,
            answers: followed.answers,
            received_ns: followed.received.room_ns,
            applied_ns: followed.received.room_ns,
            counters: *self.array.counters(),
            faults: self.array.faults() | if self.actuator.is_away() { fault::LINK } else { 0 },
            roll_commanded: single(&target.roll),
            yaw_commanded: single(&target.yaw),
            roll_measured: single(&measured.roll),
            yaw_measured: single(&measured.yaw),
            ..MirrorTelemetry::default()
        }
    }

    /// What the array is and can do.
    pub fn capabilities(&self, stamp: Stamp) -> Capabilities {
        let parameters = &self.parameters;
        let range = parameters.range_rad;
        // Two per cent of a step is left after four time constants of the envelope.
        let settling_s =
            parameters.second_order.map_or(0.0, |(frequency, damping)| 4.0 / (damping.min(1.0) * frequency));
        let resolution = parameters.resolution_bits.map_or(0.0, |bits| 2.0 * range / 2.0_f64.powi(bits as i32));
        let axis = AxisLimits {
            min_rad: -range as f32,
            max_rad: range as f32,
            slew_rad_s: parameters.slew_rad_per_s.unwrap_or(0.0) as f32,
            settling_s: if settling_s.is_finite() { (settling_s + parameters.delay_s) as f32 } else { 0.0 },
            resolution_rad: resolution as f32,
        };
        let mirrors = &self.world.model().mirrors;
        Capabilities {
            stamp,
            hardware: self.hardware.clone(),
            driver: concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned(),
            rows: mirrors.rows() as u32,
            columns: mirrors.columns() as u32,
            roll: axis,
            yaw: axis,
            feedback: Feedback::ClosedLoop,
            validity_clock: ValidityClock::SourceTime,
            command_rate_max_hz: 0.0,
            park_after_ms: (self.array.limits().hold_ns / 1_000_000) as u32,
            park_rad: [0.0, 0.0],
        }
    }

    /// Moves the mirrors; an array that parks on the way does so at its time.
    fn advance_mirrors(&mut self, to_ns: u64) {
        if let Some(parks_at_ns) = self.array.parks_at_ns().filter(|parks_at_ns| *parks_at_ns <= to_ns) {
            self.move_mirrors(parks_at_ns);
            if self.array.advance(parks_at_ns) {
                self.actuator.command(self.array.target());
            }
        }
        self.move_mirrors(to_ns);
        self.array.advance(to_ns);
    }

    fn move_mirrors(&mut self, to_ns: u64) {
        self.actuator.step(seconds_between(self.mirrors_ns, to_ns));
        self.mirrors_ns = self.mirrors_ns.max(to_ns);
    }
}

/// Seconds from one time to a later one; 0 where it is not later.
fn seconds_between(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}
