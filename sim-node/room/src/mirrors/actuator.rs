//! How mirrors follow their commands: instantly, as fast-steering mirrors, or as servos.
//!
//! command -> delay -> range and quantisation -> hysteresis (`drive`) -> rate-limited set-point ->
//! low-pass -> second order (`axis`) -> scale, offset, drift and jitter (`mounting`).
//!
//! The slew limit acts on the set-point ahead of the filters, where drive electronics limit it. The
//! mirror itself may be faster for a moment, by its overshoot. Between two changes, everything
//! before the mounting has a closed form, so the result does not depend on the step size: a step is
//! divided where a delayed command takes effect and where a set-point arrives. No call allocates
//! once the command queue has reached its length.
//!
//! Each axis can have a fault, and the complete array can have a delay fault, be offline or restart
//! ([`Actuator::set_fault`], [`Actuator::set_delay_fault`], [`Actuator::go_offline`],
//! [`Actuator::reboot`]).

use heliostat_channel::mirrors::MirrorAngles;
use heliostat_scenario::ActuatorParameters;

use super::axis::{AxisState, Dynamics, SecondOrder};
use super::drive::Drive;
use super::fault::AxisFault;
use super::mounting::Mounting;
use crate::random::RoomRng;

/// All mirrors of an array with two axes each, at first at rest and flat.
#[derive(Clone, Debug)]
pub struct Actuator {
    slew_rad_per_s: Option<f64>,
    dynamics: Dynamics,
    /// Seconds since the start.
    time: f64,
    drive: Drive,
    /// Roll of every mirror, then yaw of every mirror; so are the faults.
    axes: Vec<AxisState>,
    faults: Vec<AxisFault>,
    /// Until this time in s the array accepts no commands.
    offline_until: f64,
    mounting: Mounting,
    angles: MirrorAngles,
    measured: MirrorAngles,
}

impl Actuator {
    /// Mirrors at rest that face straight into the room; `rng` yields the mounting, its drift and
    /// jitter.
    pub fn new(parameters: &ActuatorParameters, mirrors: usize, rng: RoomRng) -> Self {
        let axes = 2 * mirrors;
        let second_order = parameters.second_order.map(|(frequency, damping)| SecondOrder { frequency, damping });
        let flat = MirrorAngles::flat(mirrors);
        let mut actuator = Self {
            slew_rad_per_s: parameters.slew_rad_per_s,
            dynamics: Dynamics::new(parameters.low_pass_rad_per_s, second_order),
            time: 0.0,
            drive: Drive::new(parameters, axes),
            axes: vec![AxisState::default(); axes],
            faults: vec![AxisFault::None; axes],
            offline_until: 0.0,
            mounting: Mounting::new(parameters, axes, rng),
            angles: flat.clone(),
            measured: flat,
        };
        actuator.write_angles();
        actuator
    }

    /// Accepts a command now; it takes effect after the drive's delay.
    ///
    /// Angles beyond the range are clamped to it. Surplus entries are ignored, and mirrors without
    /// an entry keep their command. An offline array ignores the command.
    pub fn command(&mut self, angles: &MirrorAngles) {
        if self.is_offline() {
            return;
        }
        self.drive.command(self.time, angles);
        self.take_effect();
    }

    /// Advances by `dt_s` seconds.
    pub fn step(&mut self, dt_s: f64) {
        let end = self.time + dt_s;
        while let Some(effective_at) = self.drive.next_effective_s().filter(|at| *at < end) {
            self.advance(effective_at - self.time);
            self.time = effective_at;
            self.take_effect();
        }
        self.advance(end - self.time);
        self.time = end;
        self.take_effect();
        self.mounting.step(dt_s);
        self.write_angles();
    }

    /// Where the mirrors point.
    pub fn angles(&self) -> &MirrorAngles {
        &self.angles
    }

    /// What the drives' own sensors measure: the angles without scale, offset, drift and jitter of
    /// the mounting.
    pub fn measured(&self) -> &MirrorAngles {
        &self.measured
    }

    /// Sets the faults of both axes of a mirror, in place of the previous ones.
    ///
    /// # Panics
    /// If there is no such mirror.
    pub fn set_fault(&mut self, mirror: usize, roll: AxisFault, yaw: AxisFault) {
        self.set_faults(&[mirror], |_| (roll, yaw));
    }

    /// Sets the faults of both axes of some mirrors; `change` gets the previous ones, roll first.
    ///
    /// The time grows with the number of mirrors of the array, once a call.
    ///
    /// # Panics
    /// If a mirror does not exist.
    pub fn set_faults(&mut self, mirrors: &[usize], change: impl Fn((AxisFault, AxisFault)) -> (AxisFault, AxisFault)) {
        for &mirror in mirrors {
            let (roll, yaw) = change(self.fault(mirror));
            for (axis, fault) in [(mirror, roll), (self.faults.len() / 2 + mirror, yaw)] {
                self.faults[axis] = fault;
                if fault == AxisFault::Stuck {
                    self.axes[axis] = AxisState::at_rest(self.axes[axis].angle);
                }
            }
        }
        self.take_effect();
    }

    /// The faults of a mirror's axes, roll first.
    ///
    /// # Panics
    /// If there is no such mirror.
    pub fn fault(&self, mirror: usize) -> (AxisFault, AxisFault) {
        (self.faults[mirror], self.faults[self.faults.len() / 2 + mirror])
    }

    /// Number of mirrors with a fault on either axis.
    pub fn faulty_mirrors(&self) -> usize {
        (0..self.faults.len() / 2).filter(|mirror| self.fault(*mirror) != (AxisFault::None, AxisFault::None)).count()
    }

    /// Delays later commands by so many seconds more.
    pub fn set_delay_fault(&mut self, seconds: f64) {
        self.drive.set_delay_fault(seconds);
    }

    /// Ignores commands for so many seconds and drops those that have not taken effect; targets
    /// remain.
    pub fn go_offline(&mut self, seconds: f64) {
        self.drive.drop_pending();
        self.offline_until = self.time + seconds;
    }

    /// Restarts: the mirrors return to 0, and the array ignores commands for so many seconds.
    pub fn reboot(&mut self, seconds: f64) {
        self.go_offline(seconds);
        self.drive.targets_mut().fill(0.0);
        self.take_effect();
    }

    /// Whether the array is offline or restarting.
    pub fn is_offline(&self) -> bool {
        self.time < self.offline_until
    }

    /// Stops all motion: drops commands that have not taken effect and makes each present angle the
    /// target.
    pub fn halt(&mut self) {
        self.drive.drop_pending();
        for ((target, axis), fault) in self.drive.targets_mut().iter_mut().zip(&mut self.axes).zip(&self.faults) {
            *target = if *fault == AxisFault::Flipped { -axis.angle } else { axis.angle };
            *axis = AxisState::at_rest(axis.angle);
        }
    }

    /// Applies the commands whose delay has passed; an instant actuator reaches them at once.
    fn take_effect(&mut self) {
        self.drive.take_effect(self.time);
        if self.dynamics.is_instant() && self.slew_rad_per_s.is_none() {
            for ((axis, &target), fault) in self.axes.iter_mut().zip(self.drive.targets()).zip(&self.faults) {
                *axis = AxisState::at_rest(fault.faulty_target(target, axis.angle));
            }
            self.write_angles();
        }
    }

    /// Advances every axis by a time in which no command takes effect.
    fn advance(&mut self, dt_s: f64) {
        if dt_s <= 0.0 {
            return;
        }
        let dynamics = self.dynamics;
        let full = dynamics.propagator(dt_s);
        for ((axis, &target), fault) in self.axes.iter_mut().zip(self.drive.targets()).zip(&self.faults) {
            let target = fault.faulty_target(target, axis.angle);
            let distance = target - axis.set_point;
            let rate = self.slew_rad_per_s.map_or(0.0, |slew| slew.copysign(distance));
            let arrival_s = if rate == 0.0 { 0.0 } else { distance / rate };
            if arrival_s >= dt_s {
                dynamics.advance(axis, rate, &full);
            } else if arrival_s > 0.0 {
                dynamics.advance(axis, rate, &dynamics.propagator(arrival_s));
                axis.set_point = target;
                dynamics.advance(axis, 0.0, &dynamics.propagator(dt_s - arrival_s));
            } else {
                axis.set_point = target;
                dynamics.advance(axis, 0.0, &full);
            }
        }
    }

    fn write_angles(&mut self) {
        let mirrors = self.axes.len() / 2;
        let Self { axes, mounting, angles, measured, .. } = self;
        for (i, axis) in axes.iter().enumerate() {
            let (to, seen) = if i < mirrors {
                (&mut angles.roll[i], &mut measured.roll[i])
            } else {
                (&mut angles.yaw[i - mirrors], &mut measured.yaw[i - mirrors])
            };
            *to = mounting.mirror_angle(i, axis.angle);
            *seen = axis.angle;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    fn ideal() -> ActuatorParameters {
        ActuatorParameters {
            second_order: None,
            low_pass_rad_per_s: None,
            slew_rad_per_s: None,
            range_rad: 1.0,
            resolution_bits: None,
            delay_s: 0.0,
            jitter_rad: 0.0,
            offset_rad: 0.0,
            drift_rad_per_sqrt_s: 0.0,
            scale_error_relative: 0.0,
            hysteresis_rad: 0.0,
        }
    }

    fn actuator(parameters: &ActuatorParameters, mirrors: usize) -> Actuator {
        Actuator::new(parameters, mirrors, stream(1, Purpose::Actuator, 0))
    }

    fn to(roll: f64, yaw: f64) -> MirrorAngles {
        MirrorAngles { roll: vec![roll], yaw: vec![yaw] }
    }

    #[test]
    fn an_ideal_actuator_arrives_at_once_and_stays_within_its_range() {
        let mut actuator = actuator(&ideal(), 1);
        actuator.command(&to(0.4, -3.0));
        assert_eq!(actuator.angles(), &to(0.4, -1.0));
        assert_eq!(actuator.measured(), &to(0.4, -1.0));
    }

    #[test]
    fn delay_and_slew_do_not_depend_on_the_step_size() {
        let parameters = ActuatorParameters { slew_rad_per_s: Some(10.0), delay_s: 0.01, ..ideal() };
        for steps in [1, 7, 300] {
            let mut limited = actuator(&parameters, 1);
            limited.command(&to(0.5, -0.2));
            for _ in 0..steps {
                limited.step(0.04 / f64::from(steps));
            }
            // 0.03 s at 10 rad/s is 0.3 rad.
            assert!((limited.angles().roll[0] - 0.3).abs() < 1e-12, "{steps}: {:?}", limited.angles());
            assert!((limited.angles().yaw[0] + 0.2).abs() < 1e-12, "{steps}: {:?}", limited.angles());
        }
    }

    #[test]
    fn delayed_commands_take_effect_in_order() {
        let mut delayed = actuator(&ActuatorParameters { delay_s: 0.01, ..ideal() }, 1);
        delayed.command(&to(0.1, 0.0));
        delayed.step(0.006);
        delayed.command(&to(0.2, 0.0));
        assert_eq!(delayed.angles().roll[0], 0.0);
        delayed.step(0.006);
        assert_eq!(delayed.angles().roll[0], 0.1);
        delayed.step(0.006);
        assert_eq!(delayed.angles().roll[0], 0.2);
    }

    #[test]
    fn hysteresis_lags_and_depends_only_on_the_direction() {
        let parameters = ActuatorParameters { hysteresis_rad: 0.02, delay_s: 0.01, ..ideal() };
        for steps in [1, 9] {
            let mut loose = actuator(&parameters, 1);
            let mut rest_angle = |commanded: f64| {
                loose.command(&to(commanded, -commanded));
                for _ in 0..steps {
                    loose.step(0.02 / f64::from(steps));
                }
                assert!((loose.angles().roll[0] + loose.angles().yaw[0]).abs() < 1e-12);
                loose.angles().roll[0]
            };
            let near = |angle: f64, expected: f64| assert!((angle - expected).abs() < 1e-12, "{angle} for {expected}");
            near(rest_angle(0.1), 0.09);
            near(rest_angle(0.3), 0.29);
            // A reversal has no effect up to the width of the loop.
            near(rest_angle(0.285), 0.29);
            near(rest_angle(0.28), 0.29);
            near(rest_angle(0.1), 0.11);
            near(rest_angle(0.105), 0.11);
            near(rest_angle(0.3), 0.29);
        }
    }

    #[test]
    fn scale_errors_grow_with_the_angle_and_do_not_change_the_offsets() {
        let scaled = ActuatorParameters { scale_error_relative: 0.02, ..ideal() };
        let root_mean_square = |commanded: f64| {
            let mut array = actuator(&scaled, 4000);
            array.command(&MirrorAngles { roll: vec![commanded; 4000], yaw: vec![0.0; 4000] });
            assert!(array.measured().roll.iter().all(|angle| *angle == commanded));
            (array.angles().roll.iter().map(|angle| (angle - commanded).powi(2)).sum::<f64>() / 4000.0).sqrt()
        };
        assert!((root_mean_square(0.5) / 0.01 - 1.0).abs() < 0.06 && root_mean_square(0.0) == 0.0);
        let offsets = |parameters: &ActuatorParameters| {
            actuator(&ActuatorParameters { offset_rad: 0.02, ..parameters.clone() }, 3).angles().clone()
        };
        assert_eq!(offsets(&scaled), offsets(&ideal()));
    }

    #[test]
    fn offset_drift_and_jitter_have_their_size_and_are_not_measured() {
        let root_mean_square = |parameters: &ActuatorParameters, seconds: f64| {
            let mut array = actuator(parameters, 4000);
            array.step(0.3 * seconds);
            array.step(0.7 * seconds);
            assert!(array.measured().roll.iter().all(|angle| *angle == 0.0));
            (array.angles().roll.iter().map(|angle| angle * angle).sum::<f64>() / 4000.0).sqrt()
        };
        let near = |value: f64, expected: f64| assert!((value / expected - 1.0).abs() < 0.06, "{value} for {expected}");
        near(root_mean_square(&ActuatorParameters { offset_rad: 0.02, ..ideal() }, 1.0), 0.02);
        near(root_mean_square(&ActuatorParameters { jitter_rad: 0.01, ..ideal() }, 1.0), 0.01);
        near(root_mean_square(&ActuatorParameters { drift_rad_per_sqrt_s: 0.01, ..ideal() }, 9.0), 0.03);
    }
}
