//! The simulated mirrors, as a device of `heliostat-array`.
//!
//! - [`actuator`]: the motion of all axes, from commands to mirror angles.
//! - `drive`, `axis`, `mounting`: its three parts, in the order of the signal.
//! - [`fault`]: faults of single mirrors.

use heliostat_array::moment::Moment;
use heliostat_array::{Device, DeviceError};
use heliostat_channel::{MirrorAngles, MirrorArray};
use heliostat_proto::{AxisLimits, Capabilities, Feedback};
use heliostat_scenario::{Actuator as Table, ActuatorParameters};

use self::actuator::Actuator;
use self::fault::{AxisFault, drawn_share};
use crate::random::{self, Purpose};

pub mod actuator;
mod axis;
mod drive;
pub mod fault;
mod mounting;

/// Time for which the array holds the last command after its validity ended, in ms.
pub const HOLD_MS: u32 = 300;

/// Range of the drives beyond the announced limits, on either side, in rad: for the corrections of
/// a calibration.
pub const CALIBRATION_RESERVE_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// The actuators of all mirrors of an array, with the time up to which they were advanced.
#[derive(Clone, Debug)]
pub struct SimulatedMirrors {
    actuator: Actuator,
    parameters: ActuatorParameters,
    hardware: String,
    rows: usize,
    columns: usize,
    time_ns: u64,
}

impl SimulatedMirrors {
    /// Mirrors at rest, at local time 0; mounting, jitter, drift and which of them are stuck come
    /// from the seed. `index` is that of the array in its room.
    pub fn new(table: &Table, mirrors: &MirrorArray, seed: u64, index: u32) -> Self {
        let parameters = table.parameters();
        let drive =
            ActuatorParameters { range_rad: parameters.range_rad + CALIBRATION_RESERVE_RAD, ..parameters.clone() };
        let mut actuator = Actuator::new(&drive, mirrors.len(), random::stream(seed, Purpose::Actuator, index));
        let stuck = drawn_share(table.stuck_share.unwrap_or(0.0), seed.wrapping_add(index.into()), mirrors.len());
        actuator.set_faults(&stuck, |_| (AxisFault::Stuck, AxisFault::Stuck));
        Self {
            actuator,
            hardware: format!("simulated mirrors, profile {:?}", table.profile).to_lowercase(),
            rows: mirrors.rows(),
            columns: mirrors.columns(),
            parameters,
            time_ns: 0,
        }
    }

    /// The actuators.
    pub fn actuator(&self) -> &Actuator {
        &self.actuator
    }

    /// The actuators, to set faults in a running room.
    pub fn actuator_mut(&mut self) -> &mut Actuator {
        &mut self.actuator
    }

    /// The time up to which the mirrors were advanced, in ns of local time.
    pub fn time_ns(&self) -> u64 {
        self.time_ns
    }

    /// Advances the mirrors to a time; an earlier time changes nothing.
    pub fn advance(&mut self, local_ns: u64) {
        self.actuator.step(local_ns.saturating_sub(self.time_ns) as f64 * 1e-9);
        self.time_ns = self.time_ns.max(local_ns);
    }

    /// Advances the mirrors to the time of a call; fails while the array is offline.
    fn advance_online(&mut self, now: Moment) -> Result<(), DeviceError> {
        if now.local_ns > self.time_ns {
            self.advance(now.local_ns);
        }
        if self.actuator.is_offline() {
            return Err(DeviceError::new(
                "simulated mirrors",
                "offline or restarting, as an operator ordered: wait until it is back",
            ));
        }
        Ok(())
    }
}

impl Device for SimulatedMirrors {
    fn capabilities(&self) -> Capabilities {
        let parameters = &self.parameters;
        let range = parameters.range_rad;
        // The envelope of a step decays to two per cent after four time constants.
        let settling_s =
            parameters.second_order.map_or(0.0, |(frequency, damping)| 4.0 / (damping.min(1.0) * frequency));
        let steps = parameters.resolution_bits.map(|bits| 2.0_f64.powi(bits as i32));
        let axis = AxisLimits {
            min_rad: -range as f32,
            max_rad: range as f32,
            slew_rad_s: parameters.slew_rad_per_s.unwrap_or(0.0) as f32,
            settling_s: if settling_s.is_finite() { (settling_s + parameters.delay_s) as f32 } else { 0.0 },
            resolution_rad: steps.map_or(0.0, |steps| 2.0 * (range + CALIBRATION_RESERVE_RAD) / steps) as f32,
        };
        Capabilities {
            hardware: self.hardware.clone(),
            driver: concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned(),
            rows: self.rows as u32,
            columns: self.columns as u32,
            roll: axis,
            yaw: axis,
            feedback: Feedback::ClosedLoop,
            park_after_ms: HOLD_MS,
            ..Capabilities::default()
        }
    }

    fn travel_rad(&self) -> [[f64; 2]; 2] {
        let travel = self.parameters.range_rad + CALIBRATION_RESERVE_RAD;
        [[-travel, travel]; 2]
    }

    fn connect(&mut self, now: Moment) -> Result<(), DeviceError> {
        self.advance_online(now)
    }

    fn apply(&mut self, now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError> {
        self.advance_online(now)?;
        self.actuator.command(angles);
        Ok(())
    }

    fn measure(&mut self, now: Moment, into: &mut MirrorAngles) -> Result<bool, DeviceError> {
        self.advance_online(now)?;
        into.clone_from(self.actuator.measured());
        Ok(true)
    }

    fn stop(&mut self, now: Moment) -> Result<(), DeviceError> {
        self.advance_online(now)?;
        self.actuator.halt();
        Ok(())
    }
}
