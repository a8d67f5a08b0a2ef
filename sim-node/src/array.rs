//! The command side of a mirror array: which commands are followed, and what happens when none comes.
//!
//! A pure state machine: the time and the command come in, targets come out. It is the array's own guard and does not rely on the
//! controller. Its rules:
//! 1. A wrong number of mirrors, an angle that is not finite, an epoch lower than the one followed, a sequence number that is not
//!    new within its epoch, and a command whose validity has ended or begins in the future are refused, each under its name.
//! 2. A higher epoch takes over at once, whatever its sequence number.
//! 3. Angles beyond the range are cut to it, and the command counts as clipped.
//! 4. The last command is followed until its validity ends, held for [`Limits::hold_ns`] longer, and then the array parks: flat.
//!
//! Validity is measured from the command's own time, but never reaches further than from its arrival. Clocks may disagree by
//! [`CLOCK_LEAD_MAX_NS`] before a command counts as one from the future.

use heliostat_channel::MirrorAngles;
use heliostat_proto::messages::fault;
use heliostat_proto::{ArrayState, CLOCK_LEAD_MAX_NS, Counters, MirrorCommand};
use thiserror::Error;

use crate::clock::Moment;

/// How long the last command is held after its validity has ended, unless told otherwise.
pub const HOLD_NS: u64 = 300_000_000;

/// What the array can do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Number of mirrors.
    pub mirrors: usize,
    /// Mechanical range of each axis, plus and minus, in rad.
    pub range_rad: f64,
    /// From the end of validity to parking in ns.
    pub hold_ns: u64,
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
    target: MirrorAngles,
    counters: Counters,
    faults: u32,
}

impl Array {
    /// An array that is parked and has followed nobody yet.
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            state: ArrayState::Parked,
            followed: None,
            valid_until_ns: 0,
            target: MirrorAngles::flat(limits.mirrors),
            counters: Counters::default(),
            faults: 0,
        }
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
        let range = self.limits.range_rad;
        let mut clipped = false;
        for (list, commanded) in [(&mut self.target.roll, &command.roll), (&mut self.target.yaw, &command.yaw)] {
            for (target, &angle) in list.iter_mut().zip(commanded) {
                let angle = f64::from(angle);
                // A range of 90 degrees in single precision is a little above the same range in double precision.
                clipped |= angle.abs() > range * (1.0 + 1e-6);
                *target = angle.clamp(-range, range);
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

    /// Lets time pass; true when the array parks, and its target with it.
    pub fn advance(&mut self, local_ns: u64) -> bool {
        if self.state == ArrayState::Following && local_ns >= self.valid_until_ns {
            self.state = ArrayState::Holding;
        }
        let parks = self.state == ArrayState::Holding && local_ns >= self.park_at_ns();
        if parks {
            self.state = ArrayState::Parked;
            self.target.roll.fill(0.0);
            self.target.yaw.fill(0.0);
        }
        parks
    }

    /// When the array will park if nothing comes, in local time.
    pub fn parks_at_ns(&self) -> Option<u64> {
        matches!(self.state, ArrayState::Following | ArrayState::Holding).then(|| self.park_at_ns())
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

    /// What the array can do.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    fn park_at_ns(&self) -> u64 {
        self.valid_until_ns.saturating_add(self.limits.hold_ns)
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
        if let Some(followed) = self.followed {
            if command.epoch < followed.epoch {
                return Err(Refusal::LowerEpoch { found: command.epoch, followed: followed.epoch });
            }
            if command.epoch == followed.epoch && command.sequence <= followed.sequence {
                return Err(Refusal::OldSequence { found: command.sequence, last: followed.sequence });
            }
        }
        let lead_ns = command.time_ns.saturating_sub(now.room_ns);
        if lead_ns > CLOCK_LEAD_MAX_NS {
            return Err(Refusal::FromFuture { lead_ms: lead_ns as f64 * 1e-6 });
        }
        let age_ns = now.room_ns.saturating_sub(command.time_ns);
        let validity_ns = u64::from(command.validity_ms) * 1_000_000;
        validity_ns
            .checked_sub(age_ns)
            .filter(|remaining_ns| *remaining_ns > 0)
            .ok_or(Refusal::Expired { age_ms: age_ns as f64 * 1e-6, validity_ms: command.validity_ms })
    }

    fn count(&mut self, refusal: &Refusal) {
        let counter = match refusal {
            Refusal::WrongCount { .. } | Refusal::NonFinite { .. } => &mut self.counters.rejected,
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
