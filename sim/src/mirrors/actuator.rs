//! How mirrors follow their commands: instantly, as fast-steering mirrors, or as servos.
//!
//! command -> delay -> range and quantisation -> hysteresis -> rate-limited set-point -> low-pass -> second order -> times scale, plus
//! offset, drift and jitter.
//!
//! Hysteresis is play: a target u moves the held target w to min(max(w, u - h/2), u + h/2) for a loop of width h, so that an axis comes to rest
//! h/2 short of its command from either side, and steps within h after a turn round are lost. It depends on the order of commands alone.
//! Scale s and offset o are the mounting's: the mirror stands at s angle + o, which the drive's own sensor does not see.
//!
//! The slew limit acts on the set-point ahead of the filters, which is where a drive electronics limits it; the mirror itself may
//! be faster by its overshoot for a moment. Between two changes everything before the last sum has a closed form, so the result
//! does not depend on the step size: a step is cut where a delayed command takes effect and where a set-point arrives.
//! Scale and offset are drawn once, drift is Brownian motion, jitter is drawn anew at each step. No call allocates once the command queue has
//! reached its length.
//!
//! Any axis can be given a fault, and the whole array can be late, away for a while or restarted ([`Actuator::set_fault`],
//! [`Actuator::set_lateness`], [`Actuator::go_offline`], [`Actuator::reboot`]).

use std::collections::VecDeque;

use heliostat_channel::mirrors::MirrorAngles;
use heliostat_scenario::ActuatorParameters;

use crate::axis::{AxisState, Dynamics, SecondOrder};
use crate::random::{self, RoomRng};

/// What is wrong with one axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AxisFault {
    /// Nothing.
    #[default]
    None,
    /// It stays where it is.
    Stuck,
    /// It has no drive and returns to 0.
    Dead,
    /// It turns the wrong way.
    Flipped,
}

impl AxisFault {
    /// Where an axis at `angle` goes that is told to go to `target`.
    fn bend(self, target: f64, angle: f64) -> f64 {
        match self {
            Self::None => target,
            Self::Stuck => angle,
            Self::Dead => 0.0,
            Self::Flipped => -target,
        }
    }
}

/// A command on its way through the drive.
#[derive(Clone, Debug)]
struct Pending {
    effective_at: f64,
    targets: Vec<f64>,
}

/// All mirrors of an array, two axes each, at rest and flat at first.
#[derive(Clone, Debug)]
pub struct Actuator {
    parameters: ActuatorParameters,
    dynamics: Dynamics,
    /// Seconds since the start.
    time: f64,
    pending: VecDeque<Pending>,
    spare: Vec<Vec<f64>>,
    /// Roll of every mirror, then yaw of every mirror; so are the lists below.
    targets: Vec<f64>,
    axes: Vec<AxisState>,
    scale: Vec<f64>,
    offset: Vec<f64>,
    drift: Vec<f64>,
    faults: Vec<AxisFault>,
    /// Added to the drive's delay, in s.
    lateness_s: f64,
    /// When the array answers again.
    away_until: f64,
    rng: RoomRng,
    angles: MirrorAngles,
    measured: MirrorAngles,
}

impl Actuator {
    /// Mirrors at rest, facing straight into the room.
    ///
    /// The offsets of the mounting are drawn from `rng` here; drift and jitter follow from it. Scales have the generator's next stream.
    pub fn new(parameters: &ActuatorParameters, mirrors: usize, mut rng: RoomRng) -> Self {
        let axes = 2 * mirrors;
        let second_order = parameters.second_order.map(|(frequency, damping)| SecondOrder { frequency, damping });
        let offset = (0..axes).map(|_| parameters.offset_rad * random::normal(&mut rng)).collect();
        let mut scales = rng.clone();
        scales.set_stream(rng.get_stream() + 1);
        let scale = (0..axes).map(|_| 1.0 + parameters.scale_error_relative * random::normal(&mut scales)).collect();
        let flat = MirrorAngles { roll: vec![0.0; mirrors], yaw: vec![0.0; mirrors] };
        let mut actuator = Self {
            dynamics: Dynamics::new(parameters.low_pass_rad_per_s, second_order),
            parameters: parameters.clone(),
            time: 0.0,
            pending: VecDeque::new(),
            spare: Vec::new(),
            targets: vec![0.0; axes],
            axes: vec![AxisState::default(); axes],
            scale,
            offset,
            drift: vec![0.0; axes],
            faults: vec![AxisFault::None; axes],
            lateness_s: 0.0,
            away_until: 0.0,
            rng,
            angles: flat.clone(),
            measured: flat,
        };
        actuator.write_angles();
        actuator
    }

    /// Gives a command now; it takes effect after the drive's delay.
    ///
    /// Angles beyond the range are cut to it. The lists must have the array's length; longer ones are cut, missing angles keep
    /// their command. An array that is away does not hear it.
    pub fn command(&mut self, angles: &MirrorAngles) {
        if self.is_away() {
            return;
        }
        let mut targets = self.spare.pop().unwrap_or_default();
        targets.clone_from(self.pending.back().map_or(&self.targets, |last| &last.targets));
        let mirrors = targets.len() / 2;
        let (roll, yaw) = targets.split_at_mut(mirrors);
        for (list, commanded) in [(roll, &angles.roll), (yaw, &angles.yaw)] {
            for (target, &angle) in list.iter_mut().zip(commanded) {
                *target = reachable(angle, &self.parameters);
            }
        }
        // Never before one that is under way: a drive keeps the order of its commands.
        let earliest = self.pending.back().map_or(0.0, |last| last.effective_at);
        let effective_at = (self.time + self.parameters.delay_s + self.lateness_s).max(earliest);
        self.pending.push_back(Pending { effective_at, targets });
        self.take_effect();
    }

    /// Lets `dt_s` seconds pass.
    pub fn step(&mut self, dt_s: f64) {
        let end = self.time + dt_s;
        while let Some(effective_at) = self.pending.front().map(|next| next.effective_at).filter(|at| *at < end) {
            self.advance(effective_at - self.time);
            self.time = effective_at;
            self.take_effect();
        }
        self.advance(end - self.time);
        self.time = end;
        self.take_effect();
        self.wander(dt_s);
        self.write_angles();
    }

    /// Where the mirrors point.
    pub fn angles(&self) -> &MirrorAngles {
        &self.angles
    }

    /// Where the drives' own sensors see the mirrors: without the mounting's scale and offset, drift and jitter, which they cannot know.
    pub fn measured(&self) -> &MirrorAngles {
        &self.measured
    }

    /// Gives both axes of a mirror these faults, roll first, in place of those they had.
    ///
    /// # Panics
    /// Where there is no such mirror.
    pub fn set_fault(&mut self, mirror: usize, roll: AxisFault, yaw: AxisFault) {
        let mirrors = self.faults.len() / 2;
        for (axis, fault) in [(mirror, roll), (mirrors + mirror, yaw)] {
            self.faults[axis] = fault;
            if fault == AxisFault::Stuck {
                let state = &mut self.axes[axis];
                *state = AxisState { set_point: state.angle, filtered: state.angle, angle: state.angle, speed: 0.0 };
            }
        }
        self.take_effect();
    }

    /// The faults of a mirror's axes, roll first.
    ///
    /// # Panics
    /// Where there is no such mirror.
    pub fn fault(&self, mirror: usize) -> (AxisFault, AxisFault) {
        (self.faults[mirror], self.faults[self.faults.len() / 2 + mirror])
    }

    /// Number of mirrors with a fault on either axis.
    pub fn faulty_mirrors(&self) -> usize {
        (0..self.faults.len() / 2).filter(|mirror| self.fault(*mirror) != (AxisFault::None, AxisFault::None)).count()
    }

    /// Lets every later command take so many seconds more.
    pub fn set_lateness(&mut self, seconds: f64) {
        self.lateness_s = seconds;
    }

    /// Does not hear commands for so many seconds; what is under way is lost, and the mirrors stay where they are told to be.
    pub fn go_offline(&mut self, seconds: f64) {
        self.pending.clear();
        self.away_until = self.time + seconds;
    }

    /// Starts anew: the mirrors return to 0, and no command is heard for so many seconds.
    pub fn reboot(&mut self, seconds: f64) {
        self.go_offline(seconds);
        self.targets.fill(0.0);
        self.take_effect();
    }

    /// Whether the array is offline or starting.
    pub fn is_away(&self) -> bool {
        self.time < self.away_until
    }

    /// Stays where it is: what is under way is dropped, and every axis is told to be where it stands.
    pub fn halt(&mut self) {
        self.pending.clear();
        for ((target, axis), fault) in self.targets.iter_mut().zip(&mut self.axes).zip(&self.faults) {
            *target = if *fault == AxisFault::Flipped { -axis.angle } else { axis.angle };
            *axis = AxisState { set_point: axis.angle, filtered: axis.angle, angle: axis.angle, speed: 0.0 };
        }
    }

    /// Moves the commands whose time has come into the targets.
    fn take_effect(&mut self) {
        while self.pending.front().is_some_and(|next| next.effective_at <= self.time) {
            if let Some(next) = self.pending.pop_front() {
                let half = 0.5 * self.parameters.hysteresis_rad;
                for (held, told) in self.targets.iter_mut().zip(&next.targets) {
                    *held = held.clamp(told - half, told + half);
                }
                self.spare.push(next.targets);
            }
        }
        if self.dynamics.is_instant() && self.parameters.slew_rad_per_s.is_none() {
            for ((axis, &target), fault) in self.axes.iter_mut().zip(&self.targets).zip(&self.faults) {
                let target = fault.bend(target, axis.angle);
                *axis = AxisState { set_point: target, filtered: target, angle: target, speed: 0.0 };
            }
            self.write_angles();
        }
    }

    /// Moves every axis on by a time in which no command changes.
    fn advance(&mut self, dt_s: f64) {
        if dt_s <= 0.0 {
            return;
        }
        let dynamics = self.dynamics;
        let whole = dynamics.propagator(dt_s);
        for ((axis, &target), fault) in self.axes.iter_mut().zip(&self.targets).zip(&self.faults) {
            let target = fault.bend(target, axis.angle);
            let distance = target - axis.set_point;
            let rate = self.parameters.slew_rad_per_s.map_or(0.0, |slew| slew.copysign(distance));
            let arrival_s = if rate == 0.0 { 0.0 } else { distance / rate };
            if arrival_s >= dt_s {
                dynamics.advance(axis, rate, &whole);
            } else if arrival_s > 0.0 {
                dynamics.advance(axis, rate, &dynamics.propagator(arrival_s));
                axis.set_point = target;
                dynamics.advance(axis, 0.0, &dynamics.propagator(dt_s - arrival_s));
            } else {
                axis.set_point = target;
                dynamics.advance(axis, 0.0, &whole);
            }
        }
    }

    fn wander(&mut self, dt_s: f64) {
        if self.parameters.drift_rad_per_sqrt_s > 0.0 {
            let scale = self.parameters.drift_rad_per_sqrt_s * dt_s.max(0.0).sqrt();
            for drift in &mut self.drift {
                *drift += scale * random::normal(&mut self.rng);
            }
        }
    }

    fn write_angles(&mut self) {
        let mirrors = self.axes.len() / 2;
        let jitter = self.parameters.jitter_rad;
        let Self { axes, scale, offset, drift, rng, angles, measured, .. } = self;
        for (i, axis) in axes.iter().enumerate() {
            let shake = if jitter > 0.0 { jitter * random::normal(rng) } else { 0.0 };
            let (to, seen) = if i < mirrors {
                (&mut angles.roll[i], &mut measured.roll[i])
            } else {
                (&mut angles.yaw[i - mirrors], &mut measured.yaw[i - mirrors])
            };
            *to = scale[i] * axis.angle + offset[i] + drift[i] + shake;
            *seen = axis.angle;
        }
    }
}

/// The nearest angle that the drive can be told: within the range, on the converter's grid.
///
/// A converter of n bits has 2^n codes from -range to one step below +range, so that straight ahead is one of them.
fn reachable(angle: f64, parameters: &ActuatorParameters) -> f64 {
    let range = parameters.range_rad;
    let bounded = angle.clamp(-range, range);
    match parameters.resolution_bits {
        Some(bits) => {
            let half = (1_u64 << (bits.min(52) - 1)) as f64;
            (bounded / range * half).round().clamp(-half, half - 1.0) * range / half
        }
        None => bounded,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    fn still() -> ActuatorParameters {
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
    fn ideal_is_there_at_once_and_within_its_range() {
        let mut ideal = actuator(&still(), 1);
        ideal.command(&to(0.4, -3.0));
        assert_eq!(ideal.angles(), &to(0.4, -1.0));
        assert_eq!(ideal.measured(), &to(0.4, -1.0));
    }

    #[test]
    fn delay_and_slew_add_up_whatever_the_steps() {
        let parameters = ActuatorParameters { slew_rad_per_s: Some(10.0), delay_s: 0.01, ..still() };
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
    fn commands_in_flight_take_effect_in_order() {
        let mut delayed = actuator(&ActuatorParameters { delay_s: 0.01, ..still() }, 1);
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
    fn quantisation_has_two_to_the_bits_codes_with_zero_among_them() {
        let parameters = ActuatorParameters { resolution_bits: Some(3), ..still() };
        let codes: Vec<f64> = (-100..=100).map(|i| reachable(f64::from(i) / 100.0, &parameters)).collect();
        let mut distinct = codes.clone();
        distinct.dedup();
        assert_eq!(distinct, [-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75]);
    }

    #[test]
    fn hysteresis_lags_behind_and_depends_on_the_direction_alone() {
        let parameters = ActuatorParameters { hysteresis_rad: 0.02, delay_s: 0.01, ..still() };
        for steps in [1, 9] {
            let mut loose = actuator(&parameters, 1);
            let mut rests = |told: f64| {
                loose.command(&to(told, -told));
                for _ in 0..steps {
                    loose.step(0.02 / f64::from(steps));
                }
                assert!((loose.angles().roll[0] + loose.angles().yaw[0]).abs() < 1e-12);
                loose.angles().roll[0]
            };
            let near = |angle: f64, expected: f64| assert!((angle - expected).abs() < 1e-12, "{angle} for {expected}");
            near(rests(0.1), 0.09);
            near(rests(0.3), 0.29);
            // A turn round is lost up to the width of the loop, and no further.
            near(rests(0.285), 0.29);
            near(rests(0.28), 0.29);
            near(rests(0.1), 0.11);
            near(rests(0.105), 0.11);
            near(rests(0.3), 0.29);
        }
    }

    #[test]
    fn scale_errors_grow_with_the_angle_and_leave_offsets_as_they_were() {
        let scaled = ActuatorParameters { scale_error_relative: 0.02, ..still() };
        let mean_square = |told: f64| {
            let mut array = actuator(&scaled, 4000);
            array.command(&MirrorAngles { roll: vec![told; 4000], yaw: vec![0.0; 4000] });
            assert!(array.measured().roll.iter().all(|angle| *angle == told));
            (array.angles().roll.iter().map(|angle| (angle - told).powi(2)).sum::<f64>() / 4000.0).sqrt()
        };
        assert!((mean_square(0.5) / 0.01 - 1.0).abs() < 0.06 && mean_square(0.0) == 0.0);
        let offsets = |parameters: &ActuatorParameters| {
            actuator(&ActuatorParameters { offset_rad: 0.02, ..parameters.clone() }, 3).angles().clone()
        };
        assert_eq!(offsets(&scaled), offsets(&still()));
    }

    #[test]
    fn offset_drift_and_jitter_have_their_size_and_the_sensor_does_not_see_them() {
        let mean_square = |parameters: &ActuatorParameters, seconds: f64| {
            let mut array = actuator(parameters, 4000);
            array.step(0.3 * seconds);
            array.step(0.7 * seconds);
            assert!(array.measured().roll.iter().all(|angle| *angle == 0.0));
            (array.angles().roll.iter().map(|angle| angle * angle).sum::<f64>() / 4000.0).sqrt()
        };
        let near = |value: f64, expected: f64| assert!((value / expected - 1.0).abs() < 0.06, "{value} for {expected}");
        near(mean_square(&ActuatorParameters { offset_rad: 0.02, ..still() }, 1.0), 0.02);
        near(mean_square(&ActuatorParameters { jitter_rad: 0.01, ..still() }, 1.0), 0.01);
        near(mean_square(&ActuatorParameters { drift_rad_per_sqrt_s: 0.01, ..still() }, 9.0), 0.03);
    }
}
