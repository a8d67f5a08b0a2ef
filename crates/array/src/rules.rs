//! The rules of CONTRACT.md for drivers, as a pure state machine: time and messages in, target
//! angles out.
//!
//! # Theory of Operation
//!
//! [`Array`] decides which commands an array follows and where its mirrors go when no command is
//! valid. It trusts no controller, and its default is safe: an array starts parked, and it parks
//! again when valid commands no longer arrive. It has no clock: each call has the time as an
//! argument, and [`Array::changes_at_ns`] returns the time at which the caller must call
//! [`Array::advance`] next.
//!
//! ```text
//!                 command accepted
//!           +---------------------------------------------------+
//!           |                                                   v
//!      +--------+  hold_ns passed  +---------+  validity  +-----------+<--+
//! ---->| Parked |<-----------------| Holding |<-----------| Following |   | command accepted
//!      +--------+                  +---------+   ended    +-----------+---+
//!           ^                           |                       ^
//!           |                           +-----------------------+
//!           |                               command accepted
//!           |
//!           |  last stop released            +---------+
//!           +--------------------------------| Stopped |<---- stop, in any state
//!                                            +---------+
//! ```
//!
//! | state | target angles | commands |
//! | --- | --- | --- |
//! | Parked | the park position | accepted |
//! | Following | the last accepted command | accepted |
//! | Holding | the last accepted command | accepted |
//! | Stopped | the angles at which the mirrors came to rest, if they are measured | refused |
//!
//! A command that is accepted in another state than Following is a *resumed command*, unless it is
//! the first. The counter `late` counts resumed commands.
//!
//! Telemetry has a fifth state, Fault. `Kit` reports it while the device does not answer.
//!
//! A command is checked in this order:
//!
//! 1. A wrong number of mirrors or an angle that is not finite is refused.
//! 2. Every command is refused while an emergency stop is latched.
//! 3. An epoch lower than the one followed is refused, and so is a sequence number that is not new
//!    within its epoch. A higher epoch takes over at once, with any sequence number.
//! 4. A command whose validity has ended, or whose time is in the future, is refused.
//! 5. An epoch, a sequence number or a validity beyond its bound is refused, see [`Bounds`]: one
//!    such command would exclude all later ones, or hold the array without a controller.
//! 6. Angles beyond the limits are clamped to them, and the command is counted as clipped.
//!
//! Validity starts at the time in the command, but never ends later than validity_ms after its
//! arrival; it also ends while the command waits to be handled. Clocks may differ by [`CLOCK_LEAD_MAX_NS`] before a time counts as in the future. An
//! array without a synchronised clock counts from arrival alone.
//!
//! Every stop is obeyed. The latch keeps the stops of all senders, see [`Latch`]; the array is
//! stopped until each of them is released. It survives a restart if the caller keeps
//! [`Array::latch`] and passes its stops to [`Array::stop`]. A repetition of a stop that was
//! released here is ignored, and so is one of an earlier stop of its sender: the process that repeats it
//! has not seen the release.

use std::collections::VecDeque;

use heliostat_channel::MirrorAngles;
use heliostat_proto::messages::fault;
use heliostat_proto::{
    ArrayState, CLOCK_LEAD_MAX_NS, Capabilities, Counters, EmergencyStop, MAX_STOPS, MirrorCommand, Rearm, StopAction,
    StopName, StopRepetition, ValidityClock,
};

use crate::bounds::{self, Bounds};
use crate::latch::{Latch, LatchedStop};
use crate::moment::Moment;
pub use crate::refusal::{RearmRefusal, Refusal};

/// What an array enforces on commands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Number of mirrors.
    pub mirrors: usize,
    /// Smallest and largest roll in rad.
    pub roll_rad: [f64; 2],
    /// Smallest and largest yaw in rad.
    pub yaw_rad: [f64; 2],
    /// Roll and yaw of the park position in rad.
    pub park_rad: [f64; 2],
    /// Time from the end of validity to parking in ns.
    pub hold_ns: u64,
    /// The clock by which validity is counted.
    pub clock: ValidityClock,
    /// Bounds on epoch, sequence number and validity.
    pub bounds: Bounds,
}

impl Limits {
    /// The limits that the capabilities announce.
    pub fn new(capabilities: &Capabilities) -> Self {
        let Capabilities { roll, yaw, .. } = capabilities;
        Self {
            mirrors: capabilities.mirrors(),
            roll_rad: [roll.min_rad, roll.max_rad].map(f64::from),
            yaw_rad: [yaw.min_rad, yaw.max_rad].map(f64::from),
            park_rad: capabilities.park_rad.map(f64::from),
            hold_ns: u64::from(capabilities.park_after_ms) * 1_000_000,
            clock: capabilities.validity_clock,
            bounds: Bounds::default(),
        }
    }
}

/// The command that the array follows, as telemetry reports it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Followed {
    /// Epoch of its sender.
    pub epoch: u64,
    /// Its sequence number.
    pub sequence: u64,
    /// The tick of the report that triggered it.
    pub answers: u64,
    /// When it arrived.
    pub received: Moment,
}

/// The state machine of an array's rules.
#[derive(Clone, Debug)]
pub struct Array {
    limits: Limits,
    state: ArrayState,
    followed: Option<Followed>,
    valid_until_ns: u64,
    latch: Latch,
    /// Names of the stops that a re-arm released, the latest last.
    released: VecDeque<StopName>,
    target: MirrorAngles,
    counters: Counters,
    faults: u32,
}

impl Array {
    /// A parked array that has not accepted a command.
    pub fn new(limits: Limits) -> Self {
        let mut array = Self {
            limits,
            state: ArrayState::Parked,
            followed: None,
            valid_until_ns: 0,
            latch: Latch::default(),
            released: VecDeque::with_capacity(MAX_STOPS),
            target: MirrorAngles::flat(limits.mirrors),
            counters: Counters::default(),
            faults: 0,
        };
        array.aim_at_park();
        array
    }

    /// Checks a command that arrives now, and follows it if it is accepted.
    ///
    /// # Errors
    /// [`Refusal`]: it is counted, and nothing else changes.
    pub fn handle_command(&mut self, now: Moment, command: &MirrorCommand) -> Result<(), Refusal> {
        self.handle_waiting_command((now, now), command)
    }

    /// Checks a command that arrived at the first time and is handled at the second, and follows it if it
    /// is accepted.
    ///
    /// # Errors
    /// [`Refusal`]: it is counted, and nothing else changes.
    pub fn handle_waiting_command(
        &mut self,
        (arrived, now): (Moment, Moment),
        command: &MirrorCommand,
    ) -> Result<(), Refusal> {
        self.advance(now.local_ns);
        let waited_ns = now.local_ns.saturating_sub(arrived.local_ns);
        let checked = self.check(arrived, waited_ns, command);
        let remaining_ns = checked.inspect_err(|refusal| self.count(refusal))?;
        self.counters.accepted += 1;
        self.faults &= !fault::CLOCK;
        self.counters.late += u64::from(self.followed.is_some() && self.state != ArrayState::Following);
        let mut clipped = false;
        let axes = [
            (&mut self.target.roll, &command.roll, self.limits.roll_rad),
            (&mut self.target.yaw, &command.yaw, self.limits.yaw_rad),
        ];
        for (list, commanded, [min, max]) in axes {
            // A limit of 90 degrees in single precision is a little above the same limit in double
            // precision.
            let slack = 1e-6 * min.abs().max(max.abs());
            for (target, &angle) in list.iter_mut().zip(commanded) {
                let angle = f64::from(angle);
                clipped |= angle < min - slack || angle > max + slack;
                *target = angle.clamp(min, max);
            }
        }
        self.counters.clipped += u64::from(clipped);
        let MirrorCommand { epoch, sequence, answers, .. } = *command;
        self.followed = Some(Followed { epoch, sequence, answers, received: arrived });
        self.valid_until_ns = now.local_ns.saturating_add(remaining_ns);
        self.state = ArrayState::Following;
        Ok(())
    }

    /// Counts a payload on the command key that is not a command.
    pub fn count_malformed(&mut self) {
        self.counters.rejected += 1;
    }

    /// Latches a stop, in any state.
    pub fn stop(&mut self, stop: LatchedStop) {
        self.released.retain(|name| *name != stop.name());
        self.latch.engage(stop);
        self.state = ArrayState::Stopped;
    }

    /// Applies a stop, or a re-arm by time, which arrived at `now`. The array parks when the last
    /// stop is released.
    ///
    /// # Errors
    /// [`RearmRefusal`]: a re-arm that releases nothing.
    pub fn handle_stop(&mut self, now: Moment, order: &EmergencyStop) -> Result<(), RearmRefusal> {
        match order.action {
            StopAction::Stop => self.stop(LatchedStop::new(order, now.room_ns)),
            StopAction::Rearm => {
                for name in self.latch.release_by_time(order.stamp.time_ns)? {
                    self.note_release(name);
                }
            }
        }
        Ok(())
    }

    /// Applies the repetition of a stop; false where it adds nothing: the stop is latched, or was
    /// released here, itself or by a later one of its sender.
    pub fn handle_repetition(&mut self, now: Moment, order: &StopRepetition) -> bool {
        let is_new = self.is_new_stop(order.name());
        if is_new {
            self.stop(LatchedStop::repeated(order, now.room_ns));
        }
        is_new
    }

    /// Whether the repetition of a stop of this name stops the array.
    pub fn is_new_stop(&self, name: StopName) -> bool {
        !self.latch.covers(name) && !self.released.iter().any(|released| released.replaces(name))
    }

    /// Applies a re-arm that names the stop; the array parks when no other one is latched. A sender repeats a
    /// re-arm until it is confirmed, so one of a stop that was released before changes nothing.
    ///
    /// # Errors
    /// [`RearmRefusal`]: no stop of this name is or was latched.
    pub fn handle_rearm(&mut self, order: &Rearm) -> Result<(), RearmRefusal> {
        match self.latch.release(order.name()) {
            Ok(()) => self.note_release(order.name()),
            Err(_) if self.released.contains(&order.name()) => {}
            Err(refusal) => return Err(refusal),
        }
        Ok(())
    }

    /// Names of the stops that a re-arm released, the latest last.
    pub fn released(&self) -> impl Iterator<Item = StopName> {
        self.released.iter().copied()
    }

    fn note_release(&mut self, name: StopName) {
        if self.released.len() == MAX_STOPS {
            self.released.pop_front();
        }
        self.released.push_back(name);
        if self.latch.stop().is_none() {
            self.park();
        }
    }

    /// Sets the target to the angles at which stopped mirrors came to rest.
    pub fn set_target(&mut self, angles: &MirrorAngles) {
        self.target.clone_from(angles);
    }

    /// Advances to a time; returns true when the array parks, which changes the target.
    pub fn advance(&mut self, local_ns: u64) -> bool {
        if self.state == ArrayState::Following && local_ns >= self.valid_until_ns {
            self.state = ArrayState::Holding;
        }
        let parks = self.state == ArrayState::Holding && local_ns >= self.park_at_ns();
        if parks {
            self.park();
        }
        parks
    }

    /// When the array parks if no command is accepted, in local time.
    pub fn parks_at_ns(&self) -> Option<u64> {
        matches!(self.state, ArrayState::Following | ArrayState::Holding).then(|| self.park_at_ns())
    }

    /// When the state changes if no command is accepted, in local time.
    pub fn changes_at_ns(&self) -> Option<u64> {
        match self.state {
            ArrayState::Following => Some(self.valid_until_ns),
            _ => self.parks_at_ns(),
        }
    }

    /// The state.
    pub fn state(&self) -> ArrayState {
        self.state
    }

    /// The emergency stops in force.
    pub fn latch(&self) -> &Latch {
        &self.latch
    }

    /// The last command that was accepted, also while the array is parked.
    pub fn followed(&self) -> Option<&Followed> {
        self.followed.as_ref()
    }

    /// The target angles of the mirrors.
    pub fn target(&self) -> &MirrorAngles {
        &self.target
    }

    /// How many commands were accepted, and refused for which reason.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Fault bits of the telemetry: the clock's, from a command in the future until one is
    /// accepted.
    pub fn faults(&self) -> u32 {
        self.faults
    }

    /// The limits of commands.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    fn park_at_ns(&self) -> u64 {
        self.valid_until_ns.saturating_add(self.limits.hold_ns)
    }

    fn park(&mut self) {
        self.state = ArrayState::Parked;
        self.aim_at_park();
    }

    fn aim_at_park(&mut self) {
        let [roll, yaw] = self.limits.park_rad;
        self.target.roll.fill(roll);
        self.target.yaw.fill(yaw);
    }

    /// The remaining validity of an acceptable command that has waited since it arrived, in ns.
    fn check(&self, arrived: Moment, waited_ns: u64, command: &MirrorCommand) -> Result<u64, Refusal> {
        let expected = self.limits.mirrors;
        if let Some(found) = [command.roll.len(), command.yaw.len()].into_iter().find(|found| *found != expected) {
            return Err(Refusal::WrongCount { found, expected });
        }
        let angles = || command.roll.iter().zip(&command.yaw);
        if let Some(mirror) = angles().position(|(roll, yaw)| !roll.is_finite() || !yaw.is_finite()) {
            return Err(Refusal::NonFinite { mirror });
        }
        if self.state == ArrayState::Stopped {
            return Err(Refusal::Stopped);
        }
        if let Some(followed) = self.followed {
            if command.epoch < followed.epoch {
                return Err(Refusal::LowerEpoch { found: command.epoch, followed: followed.epoch });
            }
            if command.epoch == followed.epoch && command.sequence <= followed.sequence {
                return Err(Refusal::OldSequence { found: command.sequence, last: followed.sequence });
            }
        }
        let has_clock = self.limits.clock == ValidityClock::SourceTime;
        let age_ns = if has_clock { age_ns(arrived, command)? } else { 0 };
        let remaining_ns = remaining_ns(age_ns.saturating_add(waited_ns), command)?;
        let last = self.followed.map(|followed| (followed.epoch, followed.sequence));
        let utc_ms = bounds::utc_ms(arrived.room_ns).filter(|_| has_clock);
        self.limits.bounds.check(command, last, utc_ms)?;
        Ok(remaining_ns)
    }

    fn count(&mut self, refusal: &Refusal) {
        let counter = match refusal {
            Refusal::WrongCount { .. }
            | Refusal::NonFinite { .. }
            | Refusal::EpochBound { .. }
            | Refusal::SequenceBound { .. }
            | Refusal::ValidityBound { .. } => &mut self.counters.rejected,
            Refusal::Stopped => &mut self.counters.stopped,
            Refusal::LowerEpoch { .. } => &mut self.counters.old_epoch,
            Refusal::OldSequence { .. } => &mut self.counters.old_sequence,
            Refusal::Expired { .. } => &mut self.counters.expired,
            Refusal::FromFuture { .. } => {
                self.faults |= fault::CLOCK;
                &mut self.counters.expired
            }
        };
        *counter += 1;
    }
}

/// Age of a command at its arrival by its time, in ns.
fn age_ns(arrived: Moment, command: &MirrorCommand) -> Result<u64, Refusal> {
    let lead_ns = command.time_ns.saturating_sub(arrived.room_ns);
    if lead_ns > CLOCK_LEAD_MAX_NS {
        return Err(Refusal::FromFuture { lead_ms: lead_ns as f64 * 1e-6 });
    }
    Ok(arrived.room_ns.saturating_sub(command.time_ns))
}

/// Remaining validity of a command of this age, in ns.
fn remaining_ns(age_ns: u64, command: &MirrorCommand) -> Result<u64, Refusal> {
    let validity_ns = u64::from(command.validity_ms) * 1_000_000;
    validity_ns
        .checked_sub(age_ns)
        .filter(|remaining_ns| *remaining_ns > 0)
        .ok_or(Refusal::Expired { age_ms: age_ns as f64 * 1e-6, validity_ms: command.validity_ms })
}
