//! The rules of CONTRACT.md for drivers, as a pure state machine: time and messages come in, targets come out.
//!
//! It trusts no controller. Its rules, in the order in which they are looked at:
//! 1. A wrong number of mirrors or an angle that is not finite is refused; anything at all while an emergency stop is latched.
//! 2. An epoch lower than the one followed, or a sequence number that is not new within its epoch, is refused. A higher epoch takes
//!    over at once, whatever its sequence number.
//! 3. A command whose validity has ended, or which is from the future, is refused.
//! 4. Angles beyond the limits are cut to them, and the command counts as clipped.
//! 5. The last command is followed until its validity ends, held for [`Limits::hold_ns`] longer, and then the array parks.
//!
//! Validity is measured from the command's own time, but never reaches further than from its arrival. Clocks may disagree by
//! [`CLOCK_LEAD_MAX_NS`] before a command counts as one from the future. An array without a clock counts from arrival alone.

use heliostat_channel::MirrorAngles;
use heliostat_proto::messages::fault;
use heliostat_proto::{
    ArrayState, CLOCK_LEAD_MAX_NS, Capabilities, Counters, EmergencyStop, MirrorCommand, Nanos, StopAction,
    ValidityClock,
};
use thiserror::Error;

use crate::moment::Moment;

/// What an array may be told.
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
    /// From the end of validity to parking in ns.
    pub hold_ns: u64,
    /// From when validity is counted.
    pub clock: ValidityClock,
}

impl Limits {
    /// What the capabilities promise is what is enforced.
    pub fn new(capabilities: &Capabilities) -> Self {
        let Capabilities { roll, yaw, .. } = capabilities;
        Self {
            mirrors: capabilities.mirrors(),
            roll_rad: [roll.min_rad, roll.max_rad].map(f64::from),
            yaw_rad: [yaw.min_rad, yaw.max_rad].map(f64::from),
            park_rad: capabilities.park_rad.map(f64::from),
            hold_ns: u64::from(capabilities.park_after_ms) * 1_000_000,
            clock: capabilities.validity_clock,
        }
    }
}

/// Why a command is not followed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Refusal {
    /// Another number of mirrors.
    #[error("a command for {found} mirrors at an array of {wanted}")]
    WrongCount {
        /// Mirrors in the command.
        found: usize,
        /// Mirrors of the array.
        wanted: usize,
    },
    /// An angle is not a number or infinite.
    #[error("the angle of mirror {mirror} is not finite")]
    NonFinite {
        /// The first such mirror.
        mirror: usize,
    },
    /// An emergency stop is latched.
    #[error("a command while an emergency stop is latched: re-arm the array first")]
    Stopped,
    /// The sender was deposed by one with a higher epoch.
    #[error("a command of epoch {found} after epoch {followed}")]
    LowerEpoch {
        /// Epoch of the command.
        found: u64,
        /// Epoch that the array follows.
        followed: u64,
    },
    /// The command was overtaken or repeated.
    #[error("sequence {found} after {last} of the same epoch")]
    OldSequence {
        /// Sequence number of the command.
        found: u64,
        /// Last sequence number that was accepted.
        last: u64,
    },
    /// The command arrived after its validity.
    #[error("a command {age_ms:.1} ms old that was valid for {validity_ms} ms")]
    Expired {
        /// Age on arrival in ms.
        age_ms: f64,
        /// Its validity in ms.
        validity_ms: u32,
    },
    /// The command is from the future: the clocks disagree.
    #[error("a command from {lead_ms:.1} ms in the future")]
    FromFuture {
        /// How far ahead its time is in ms.
        lead_ms: f64,
    },
}

impl Refusal {
    /// The name under which it is counted.
    pub fn name(&self) -> &'static str {
        match self {
            Self::WrongCount { .. } => "wrong-mirror-count",
            Self::NonFinite { .. } => "not-finite",
            Self::Stopped => "stopped",
            Self::LowerEpoch { .. } => "lower-epoch",
            Self::OldSequence { .. } => "old-sequence",
            Self::Expired { .. } => "expired",
            Self::FromFuture { .. } => "from-future",
        }
    }
}

/// The command that is followed, as telemetry tells it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Followed {
    /// Epoch of its sender.
    pub epoch: u64,
    /// Its sequence number.
    pub sequence: u64,
    /// The tick that it answers.
    pub answers: u64,
    /// When it arrived.
    pub received: Moment,
}

/// The guard of an array.
#[derive(Clone, Debug)]
pub struct Array {
    limits: Limits,
    state: ArrayState,
    followed: Option<Followed>,
    valid_until_ns: u64,
    stopped_at_ns: Nanos,
    target: MirrorAngles,
    counters: Counters,
    faults: u32,
}

impl Array {
    /// An array that is parked and has followed nobody yet.
    pub fn new(limits: Limits) -> Self {
        let mut array = Self {
            limits,
            state: ArrayState::Parked,
            followed: None,
            valid_until_ns: 0,
            stopped_at_ns: 0,
            target: MirrorAngles::flat(limits.mirrors),
            counters: Counters::default(),
            faults: 0,
        };
        array.aim_at_park();
        array
    }

    /// Takes a command.
    ///
    /// # Errors
    /// [`Refusal`]; the array goes on as if nothing had come.
    pub fn receive(&mut self, now: Moment, command: &MirrorCommand) -> Result<(), Refusal> {
        self.advance(now.local_ns);
        let remaining_ns = self.check(now, command).inspect_err(|refusal| self.count(refusal))?;
        self.counters.accepted += 1;
        self.faults &= !fault::CLOCK;
        self.counters.late += u64::from(self.followed.is_some() && self.state != ArrayState::Following);
        let mut clipped = false;
        let axes = [
            (&mut self.target.roll, &command.roll, self.limits.roll_rad),
            (&mut self.target.yaw, &command.yaw, self.limits.yaw_rad),
        ];
        for (list, commanded, [min, max]) in axes {
            // A limit of 90 degrees in single precision is a little above the same limit in double precision.
            let slack = 1e-6 * min.abs().max(max.abs());
            for (target, &angle) in list.iter_mut().zip(commanded) {
                let angle = f64::from(angle);
                clipped |= angle < min - slack || angle > max + slack;
                *target = angle.clamp(min, max);
            }
        }
        self.counters.clipped += u64::from(clipped);
        let MirrorCommand { epoch, sequence, answers, .. } = *command;
        self.followed = Some(Followed { epoch, sequence, answers, received: now });
        self.valid_until_ns = now.local_ns.saturating_add(remaining_ns);
        self.state = ArrayState::Following;
        Ok(())
    }

    /// Counts a payload on the command key that is no command.
    pub fn count_malformed(&mut self) {
        self.counters.rejected += 1;
    }

    /// Obeys an operator; true where the state changed. A stop counts whatever its time; a re-arm only when it is later than the
    /// last stop, and then the array is told to park.
    pub fn order(&mut self, order: &EmergencyStop) -> bool {
        let stopped = self.state == ArrayState::Stopped;
        match order.action {
            StopAction::Stop => {
                self.stopped_at_ns = self.stopped_at_ns.max(order.stamp.time_ns);
                self.state = ArrayState::Stopped;
                !stopped
            }
            StopAction::Rearm if stopped && order.stamp.time_ns > self.stopped_at_ns => {
                self.state = ArrayState::Parked;
                self.aim_at_park();
                true
            }
            StopAction::Rearm => false,
        }
    }

    /// Mirrors that were stopped on their way are asked to be where they are.
    pub fn stay_at(&mut self, angles: &MirrorAngles) {
        self.target.clone_from(angles);
    }

    /// Lets time pass; true when the array parks, and its target with it.
    pub fn advance(&mut self, local_ns: u64) -> bool {
        if self.state == ArrayState::Following && local_ns >= self.valid_until_ns {
            self.state = ArrayState::Holding;
        }
        let parks = self.state == ArrayState::Holding && local_ns >= self.park_at_ns();
        if parks {
            self.state = ArrayState::Parked;
            self.aim_at_park();
        }
        parks
    }

    /// When the array will park if nothing comes, in local time.
    pub fn parks_at_ns(&self) -> Option<u64> {
        matches!(self.state, ArrayState::Following | ArrayState::Holding).then(|| self.park_at_ns())
    }

    /// When the state will change if nothing comes, in local time.
    pub fn changes_at_ns(&self) -> Option<u64> {
        match self.state {
            ArrayState::Following => Some(self.valid_until_ns),
            _ => self.parks_at_ns(),
        }
    }

    /// What the array does.
    pub fn state(&self) -> ArrayState {
        self.state
    }

    /// The last command that was accepted; it stays known while the array is parked.
    pub fn followed(&self) -> Option<&Followed> {
        self.followed.as_ref()
    }

    /// Where the mirrors are told to point.
    pub fn target(&self) -> &MirrorAngles {
        &self.target
    }

    /// What became of the commands so far.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Fault bits of the telemetry: the clock's, from a command of the future until one is accepted.
    pub fn faults(&self) -> u32 {
        self.faults
    }

    /// What the array may be told.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    fn park_at_ns(&self) -> u64 {
        self.valid_until_ns.saturating_add(self.limits.hold_ns)
    }

    fn aim_at_park(&mut self) {
        let [roll, yaw] = self.limits.park_rad;
        self.target.roll.fill(roll);
        self.target.yaw.fill(yaw);
    }

    /// The time that a good command stays valid, in ns.
    fn check(&self, now: Moment, command: &MirrorCommand) -> Result<u64, Refusal> {
        let wanted = self.limits.mirrors;
        if let Some(found) = [command.roll.len(), command.yaw.len()].into_iter().find(|found| *found != wanted) {
            return Err(Refusal::WrongCount { found, wanted });
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
        let validity_ns = u64::from(command.validity_ms) * 1_000_000;
        if self.limits.clock == ValidityClock::Arrival {
            return Ok(validity_ns);
        }
        let lead_ns = command.time_ns.saturating_sub(now.room_ns);
        if lead_ns > CLOCK_LEAD_MAX_NS {
            return Err(Refusal::FromFuture { lead_ms: lead_ns as f64 * 1e-6 });
        }
        let age_ns = now.room_ns.saturating_sub(command.time_ns);
        validity_ns
            .checked_sub(age_ns)
            .filter(|remaining_ns| *remaining_ns > 0)
            .ok_or(Refusal::Expired { age_ms: age_ns as f64 * 1e-6, validity_ms: command.validity_ms })
    }

    fn count(&mut self, refusal: &Refusal) {
        let counter = match refusal {
            Refusal::WrongCount { .. } | Refusal::NonFinite { .. } => &mut self.counters.rejected,
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
