//! What the core keeps of one array: its limits, its guard, and whether it gets a command.

use std::ops::Range;

use heliostat_channel::{MirrorAngles, MirrorArrays, mirrors::copy_widened};
use heliostat_proto::{ArrayState, MirrorCommand, MirrorTelemetry, Nanos};
use heliostat_scenario::Scenario;
use serde::{Deserialize, Serialize};

use crate::output::{
    guard::{Guard, GuardMemory},
    outcome::{Counters, DegradedMode},
    safety::{Clipped, Limits},
    tenure::Tenure,
};

/// An array is absent after this time without telemetry. Section 4 of CONTRACT.md requires ten messages
/// a second.
pub(super) const ABSENT_AFTER_NS: Nanos = 1_000_000_000;

/// Messages of a slower telemetry stream that must be missing before the array is lost.
const LOST_AFTER_MESSAGES: f64 = 3.0;

/// One array of the room.
#[derive(Clone)]
pub(super) struct ArrayOutput {
    /// Its mirrors among those of the room.
    pub mirrors: Range<usize>,
    pub limits: Limits,
    pub guard: Guard,
    /// Settling time of its mirrors in s.
    pub settling_s: f64,
    /// Time of its last command by this controller; absent before the first.
    pub commanded_ns: Option<Nanos>,
    /// Epoch of the command that is due, or the reason for which there is none.
    pub permit: Result<u64, DegradedMode>,
    /// Time in s since the mirrors received their present command.
    elapsed_s: f64,
    /// Arrival of its last telemetry; before the first, time of the first decision.
    pub heard_ns: Option<Nanos>,
    /// Arrival of its first telemetry. No decision depends on it, so no recording holds it.
    pub first_heard_ns: Option<Nanos>,
    /// The source of its telemetry has left.
    pub has_left: bool,
    /// Absent in a room with one array, which is never lost.
    lost_after_ns: Option<Nanos>,
}

/// The state of an array as a recording of a room with several arrays holds it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct ArrayOutputMemory {
    pub axes_rad: [[f64; 2]; 2],
    pub guard: GuardMemory,
    settling_s: f64,
    commanded_ns: Option<Nanos>,
    heard_ns: Option<Nanos>,
    has_left: bool,
}

impl ArrayOutput {
    /// The arrays of a scenario, under one epoch.
    pub fn of(scenario: &Scenario, mirrors: &MirrorArrays, epoch: u64) -> Vec<Self> {
        let rate_hz = scenario.streams.telemetry.rate_hz;
        let silence_ns = (LOST_AFTER_MESSAGES * 1e9 / rate_hz) as Nanos;
        let lost_after_ns = (mirrors.arrays().len() > 1 && rate_hz > 0.0).then_some(silence_ns.max(ABSENT_AFTER_NS));
        let validity_ms = scenario.control.command_validity_ms();
        let output = |mirrors: Range<usize>| Self {
            mirrors,
            limits: Limits::new(&scenario.control),
            guard: Guard::new(Tenure::fixed(epoch), validity_ms),
            settling_s: 0.0,
            commanded_ns: None,
            permit: Ok(epoch),
            elapsed_s: 0.0,
            heard_ns: None,
            first_heard_ns: None,
            has_left: false,
            lost_after_ns,
        };
        mirrors.ranges().map(|(_, mirrors)| output(mirrors)).collect()
    }

    /// Notes telemetry that arrived at `now`.
    pub fn handle_telemetry(&mut self, now: Nanos, telemetry: &MirrorTelemetry, counters: &mut Counters) {
        (self.heard_ns, self.has_left) = (Some(now), false);
        self.first_heard_ns.get_or_insert(now);
        self.guard.handle_telemetry(now, telemetry, counters);
    }

    /// Decides whether the array gets the command that is due at `now`, for a report or for the absence
    /// of reports. A withheld command is counted.
    pub fn update_permit(
        &mut self,
        (now, is_report): (Nanos, bool),
        telemetry: Option<&MirrorTelemetry>,
        counters: &mut Counters,
    ) {
        self.permit = if self.is_lost(now) {
            Err(DegradedMode::Withheld)
        } else {
            self.guard.permit((now, is_report), telemetry, counters)
        };
        if let Err(withheld) = self.permit {
            counters.count_degraded(withheld);
        }
    }

    /// Repeats a recorded decision about the command, for a replay.
    pub fn repeat_permit(&mut self, is_given: bool) {
        let epoch = self.guard.tenure.epoch();
        self.permit = if is_given { Ok(epoch) } else { Err(DegradedMode::Withheld) };
    }

    /// Numbers the command of a decision at `now`: epoch and sequence, or `None` where the array gets
    /// none.
    pub fn number(&mut self, now: Nanos) -> Option<(u64, u64)> {
        let epoch = self.permit.ok()?;
        self.commanded_ns = Some(now);
        Some((epoch, self.guard.tenure.next_sequence()))
    }

    /// Sets `angles` to those of the mirrors: of the last command while it is valid, and otherwise
    /// of the last telemetry. Without telemetry all mirrors are flat. `interval_s` is the nominal
    /// time between commands.
    pub fn settle(
        &mut self,
        now: Nanos,
        telemetry: Option<&MirrorTelemetry>,
        interval_s: f64,
        angles: &mut MirrorAngles,
    ) {
        if let Some(since_ns) = self.since_valid_command_ns(now) {
            self.elapsed_s = since_ns as f64 * 1e-9;
            return;
        }
        self.elapsed_s = interval_s;
        let (roll, yaw) = (&mut angles.roll[self.mirrors.clone()], &mut angles.yaw[self.mirrors.clone()]);
        match telemetry {
            Some(telemetry) => {
                copy_widened(&telemetry.roll_commanded, roll);
                copy_widened(&telemetry.yaw_commanded, yaw);
            }
            None => {
                roll.fill(0.0);
                yaw.fill(0.0);
            }
        }
    }

    /// Takes the command that the array follows by telemetry as the last one, unless one of this
    /// controller is valid at `now`: it is of another controller then.
    ///
    /// The tenure has no part in it, because a replay does not have it.
    pub fn adopt(&self, now: Nanos, telemetry: &MirrorTelemetry, last: &mut MirrorCommand) {
        if telemetry.state != ArrayState::Following || self.since_valid_command_ns(now).is_some() {
            return;
        }
        last.roll[self.mirrors.clone()].copy_from_slice(&telemetry.roll_commanded);
        last.yaw[self.mirrors.clone()].copy_from_slice(&telemetry.yaw_commanded);
        last.time_ns = now;
    }

    /// Time in ns since the last command of this controller, while that is valid at `now`.
    fn since_valid_command_ns(&self, now: Nanos) -> Option<Nanos> {
        let since_ns = now.saturating_sub(self.commanded_ns?);
        (since_ns <= u64::from(self.guard.validity_ms()) * 1_000_000).then_some(since_ns)
    }

    /// Limits proposed angles of its mirrors. Where the array gets no command, they stay where they
    /// are.
    pub fn bound(&self, from: &MirrorAngles, angles: &mut MirrorAngles) -> Clipped {
        if self.permit.is_ok() {
            return self.limits.bound_array(from, self.elapsed_s, angles, self.mirrors.clone());
        }
        let mirrors = self.mirrors.clone();
        angles.roll[mirrors.clone()].copy_from_slice(&from.roll[mirrors.clone()]);
        angles.yaw[mirrors.clone()].copy_from_slice(&from.yaw[mirrors]);
        Clipped::default()
    }

    pub fn memory(&self) -> ArrayOutputMemory {
        ArrayOutputMemory {
            axes_rad: self.limits.axes_rad(),
            guard: self.guard.memory(),
            settling_s: self.settling_s,
            commanded_ns: self.commanded_ns,
            heard_ns: self.heard_ns,
            has_left: self.has_left,
        }
    }

    /// Replaces the state; false where it is not one of this scenario.
    pub fn restore(&mut self, memory: &ArrayOutputMemory) -> bool {
        self.guard.restore(&memory.guard);
        (self.commanded_ns, self.heard_ns, self.has_left) = (memory.commanded_ns, memory.heard_ns, memory.has_left);
        self.settling_s = memory.settling_s;
        memory.settling_s.is_finite() && self.limits.restore_axes(memory.axes_rad)
    }

    fn is_lost(&mut self, now: Nanos) -> bool {
        let Some(lost_after_ns) = self.lost_after_ns else { return false };
        let heard_ns = *self.heard_ns.get_or_insert(now);
        self.has_left || now.abs_diff(heard_ns) > lost_after_ns
    }
}

pub(super) fn copy_narrowed(from: &[f64], to: &mut [f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_array_adopts_the_angles_of_its_mirrors_once_its_own_command_has_expired() {
        let two = "[[mirrors]]\nrows = 1\ncolumns = 2\n[[mirrors]]\nrows = 1\ncolumns = 3\nwall = \"-x\"\n";
        let scenario = Scenario::from_toml(two).unwrap();
        let model = scenario.channel_model().unwrap();
        let mut arrays = ArrayOutput::of(&scenario, &model.mirrors, 7);
        let (start, valid_ns) = (1_000_000_000, u64::from(arrays[1].guard.validity_ms()) * 1_000_000);
        assert!(arrays[1].number(start).is_some());
        let flat = vec![0.0; 5];
        let mut last = MirrorCommand { time_ns: start, roll: flat.clone(), yaw: flat, ..MirrorCommand::default() };
        let shown = |state, angle| MirrorTelemetry {
            state,
            roll_commanded: vec![angle; 3],
            yaw_commanded: vec![-angle; 3],
            ..MirrorTelemetry::default()
        };
        arrays[1].adopt(start + valid_ns, &shown(ArrayState::Following, 0.25), &mut last);
        arrays[1].adopt(start + valid_ns + 1, &shown(ArrayState::Holding, 0.25), &mut last);
        assert_eq!((last.time_ns, &last.roll[..]), (start, &[0.0; 5][..]));
        arrays[1].adopt(start + valid_ns + 1, &shown(ArrayState::Following, 0.25), &mut last);
        assert_eq!((last.time_ns, &last.roll[..]), (start + valid_ns + 1, &[0.0, 0.0, 0.25, 0.25, 0.25][..]));
        assert_eq!(last.yaw[1..3], [0.0, -0.25]);
    }
}
