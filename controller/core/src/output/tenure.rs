//! Under which epoch this controller commands, and when it stands by for another controller.
//!
//! # Theory of operation
//!
//! An array obeys the highest epoch that it has accepted. [`Tenure`] chooses the epoch at the first
//! command, and compares it with the epoch in each telemetry message. It has no clock: each call
//! has the time as an argument, and UTC in ms is the unit of an epoch.
//!
//! ```text
//!                                    locked out: a new epoch
//!                                        +------+
//!                                        |      v      telemetry: a higher epoch
//!         +---------+ first command  +---------+-------------------------------->+---------+
//! ------->| Waiting |--------------->| Leading |                                 | Standby |
//!         +---------+                +---------+<--------------------------------+---------+
//!                                      telemetry no longer shows a higher epoch, or is
//!                                      absent: the same epoch;
//!                                      the array accepts no command: a new epoch
//! ```
//!
//! | standing | commands |
//! | --- | --- |
//! | Waiting | the first one chooses an epoch above UTC and above every epoch that the array reported |
//! | Leading | sent |
//! | Standby | withheld |
//!
//! - **A start takes over**: the first epoch of a controller may be too low, because telemetry came
//!   after its first command. Before the array has obeyed it, it answers one higher epoch by a new
//!   epoch of its own, and stands by from the second on.
//! - **Standby ends** with a new epoch when reports arrive that this controller would answer, and
//!   the array has accepted no command for [`PATIENCE_NS`] plus a spread that differs between
//!   controllers. While the commands of another controller are accepted, it stands by.
//! - **Locked out**: a leading controller sends commands, the array accepts none for
//!   [`PATIENCE_NS`], and its counters of refusals rise. Or telemetry shows a sequence in its own
//!   epoch that it never sent: another sender uses the epoch. A new epoch ends both.
//! - **A new epoch** is above the epoch in the latest telemetry. Attempts that fail alternate
//!   between a base with UTC and one without: a clock that is wrong, and telemetry that is forged,
//!   each fail in one of them only. The pause doubles from the third attempt on, up to
//!   [`PAUSE_MAX`] times.
//! - **Epochs are unique**: each controller uses only epochs with its own remainder modulo
//!   [`EPOCH_SLOTS`]. Two controllers that choose at the same time choose different epochs.
//!
//! The latest telemetry alone counts: an epoch that one message claims is forgotten with the next.
//! Nothing here ends a process.

use heliostat_proto::{ArrayState, MirrorTelemetry, Nanos};

/// Time without an accepted command after which a controller takes a new epoch, in ns.
pub const PATIENCE_NS: Nanos = 1_000_000_000;

/// Each controller uses only the epochs with its own remainder modulo this number. A new epoch is
/// the first of them above its base, so it exceeds the base by at most this number of ms.
pub const EPOCH_SLOTS: u64 = 1024;

/// Longest pause between two attempts, in units of [`PATIENCE_NS`].
pub const PAUSE_MAX: u64 = 8;

/// Telemetry older than this in ns is no reason to stand by.
const TELEMETRY_TIMEOUT_NS: Nanos = 1_000_000_000;

/// Commands that must have been due before a new epoch, so that one lost message is no reason.
const DUE_MIN: u8 = 3;

/// How the epoch is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Rule {
    /// One epoch; telemetry is ignored.
    Fixed,
    /// One epoch; stands by while another sender's commands are followed.
    Lockstep,
    /// As in the diagram.
    Live { slot: u64, gap_ns: Nanos },
}

/// Whether the controller commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Standing {
    /// No command was due so far.
    Waiting,
    /// Commands are sent.
    Leading,
    /// Commands are withheld: the array follows another controller.
    Standby,
}

/// A change of the standing or of the epoch, or a reason that commands are refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TenureEvent {
    /// Telemetry shows a higher epoch: standby begins.
    Superseded,
    /// Telemetry shows no higher epoch, or is absent: standby ends, with the same epoch.
    Resumed,
    /// A new epoch: the controller has just started, or it ends a standby in which the array
    /// accepted no command.
    TookOver,
    /// The array refused every command: a new epoch.
    LockedOut,
    /// The array applied a command of the own epoch that this controller never sent: a new epoch.
    ForeignSequence,
    /// The array refused every command as expired: the clocks differ. The epoch stays.
    ClocksDiffer,
}

impl TenureEvent {
    /// All events, in the order of their counters.
    pub const ALL: [Self; 6] =
        [Self::Superseded, Self::Resumed, Self::TookOver, Self::LockedOut, Self::ForeignSequence, Self::ClocksDiffer];

    /// The name in counters.
    pub fn name(self) -> &'static str {
        match self {
            Self::Superseded => "superseded",
            Self::Resumed => "resumed",
            Self::TookOver => "took-over",
            Self::LockedOut => "locked-out",
            Self::ForeignSequence => "foreign-sequence",
            Self::ClocksDiffer => "clocks-differ",
        }
    }
}

/// What telemetry shows about the commands that the array accepts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Evidence {
    /// Epoch of the command last applied; 0 before the first.
    pub epoch: u64,
    /// Its sequence number.
    pub applied_sequence: u64,
    /// Commands accepted.
    pub accepted: u64,
    /// Commands refused as malformed or out of bounds, for their epoch, or for their sequence.
    pub refused: u64,
    /// Commands refused as expired.
    pub expired: u64,
    /// An emergency stop is latched.
    pub stopped: bool,
}

impl From<&MirrorTelemetry> for Evidence {
    fn from(telemetry: &MirrorTelemetry) -> Self {
        let counters = &telemetry.counters;
        Self {
            epoch: telemetry.epoch,
            applied_sequence: telemetry.applied_sequence,
            accepted: counters.accepted,
            refused: counters.rejected.saturating_add(counters.old_epoch).saturating_add(counters.old_sequence),
            expired: counters.expired,
            stopped: telemetry.state == ArrayState::Stopped,
        }
    }
}

/// Commands that were due since the array last accepted one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Unaccepted {
    since_ns: Nanos,
    last_ns: Nanos,
    /// Counted up to [`DUE_MIN`].
    due: u8,
    /// The evidence at the beginning.
    before: Evidence,
}

/// The epoch of one controller.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Tenure {
    rule: Rule,
    standing: Standing,
    epoch: u64,
    /// Highest sequence number sent in this epoch.
    sent: u64,
    /// The latest telemetry, and its arrival.
    seen: Option<(Nanos, Evidence)>,
    /// The epoch that the array announced before the first telemetry.
    announced: u64,
    unaccepted: Option<Unaccepted>,
    /// New epochs since a command was last accepted.
    attempts: u8,
    /// The array has not obeyed this controller so far.
    is_new: bool,
}

impl Tenure {
    /// One epoch, independently of telemetry: for replay and evaluation.
    pub fn fixed(epoch: u64) -> Self {
        Self {
            rule: Rule::Fixed,
            standing: Standing::Leading,
            epoch,
            sent: 0,
            seen: None,
            announced: 0,
            unaccepted: None,
            attempts: 0,
            is_new: false,
        }
    }

    /// One epoch, for a room in lockstep: stands by while the array follows another sender.
    pub fn lockstep(epoch: u64) -> Self {
        Self { rule: Rule::Lockstep, ..Self::fixed(epoch) }
    }

    /// For a live room, in which a report is due every `interval_ns`. `source` is the random id of
    /// the controller.
    pub fn live(source: u64, interval_ns: Nanos) -> Self {
        let gap_ns = interval_ns.saturating_mul(3).saturating_add(PATIENCE_NS / 4);
        Self { rule: Rule::Live { slot: source % EPOCH_SLOTS, gap_ns }, standing: Standing::Waiting, ..Self::fixed(0) }
    }

    /// Whether the controller commands.
    pub fn standing(&self) -> Standing {
        self.standing
    }

    /// The epoch of the commands; 0 while waiting.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// The epoch of the command that the array applied last, by the latest telemetry.
    pub fn followed_epoch(&self) -> Option<u64> {
        self.seen.map(|(_, evidence)| evidence.epoch)
    }

    /// Notes the highest epoch that the array announces; it counts until telemetry arrives.
    pub fn handle_announced_epoch(&mut self, epoch: u64) {
        self.announced = epoch;
    }

    /// Notes the sequence number of the last command sent, with its epoch; to be called before the
    /// telemetry that can show it.
    pub fn handle_sent(&mut self, epoch: u64, sequence: u64) {
        if epoch == self.epoch {
            self.sent = self.sent.max(sequence);
        }
    }

    /// A command is due at `now`: its epoch, or `None` in standby.
    ///
    /// The event is the end of a standby because telemetry is absent.
    pub fn permit(&mut self, now: Nanos) -> (Option<u64>, Option<TenureEvent>) {
        let mut event = None;
        match self.standing {
            Standing::Waiting => {
                self.epoch = self.first_epoch(now);
                self.is_new = true;
                self.standing = Standing::Leading;
            }
            Standing::Standby if !self.is_current(now) => {
                self.standing = Standing::Leading;
                event = Some(TenureEvent::Resumed);
            }
            Standing::Leading | Standing::Standby => {}
        }
        self.note_due(now);
        ((self.standing == Standing::Leading).then_some(self.epoch), event)
    }

    /// Compares telemetry that arrived at `now`.
    pub fn handle_telemetry(&mut self, now: Nanos, evidence: Evidence) -> Option<TenureEvent> {
        let former = self.seen.replace((now, evidence)).map(|(_, evidence)| evidence);
        let is_accepting = former.is_some_and(|former| former.accepted != evidence.accepted);
        if is_accepting {
            self.attempts = 0;
        }
        if is_accepting || evidence.stopped {
            self.unaccepted = None;
        }
        match self.standing {
            Standing::Waiting => None,
            _ if self.rule == Rule::Fixed => None,
            Standing::Leading => self.compare_leading(now, evidence),
            Standing::Standby => self.compare_standby(now, evidence),
        }
    }

    fn compare_leading(&mut self, now: Nanos, evidence: Evidence) -> Option<TenureEvent> {
        let is_foreign = self.is_foreign_sequence(evidence);
        let is_superseded = evidence.epoch > self.epoch;
        let is_new = self.is_new && is_superseded;
        self.is_new &= evidence.epoch < self.epoch;
        if is_new {
            self.renew(now, evidence);
            return Some(TenureEvent::TookOver);
        }
        if is_superseded || (is_foreign && self.rule == Rule::Lockstep) {
            self.standing = Standing::Standby;
            self.unaccepted = None;
            return Some(TenureEvent::Superseded);
        }
        if is_foreign {
            self.renew(now, evidence);
            return Some(TenureEvent::ForeignSequence);
        }
        let before = self.unaccepted_for(now, 0)?;
        if evidence.refused > before.refused {
            self.renew(now, evidence);
            return Some(TenureEvent::LockedOut);
        }
        self.unaccepted = None;
        (evidence.expired > before.expired).then_some(TenureEvent::ClocksDiffer)
    }

    fn compare_standby(&mut self, now: Nanos, evidence: Evidence) -> Option<TenureEvent> {
        if evidence.epoch <= self.epoch && !self.is_foreign_sequence(evidence) {
            self.standing = Standing::Leading;
            self.unaccepted = None;
            return Some(TenureEvent::Resumed);
        }
        let Rule::Live { slot, .. } = self.rule else { return None };
        self.unaccepted_for(now, slot * 1_000_000)?;
        self.renew(now, evidence);
        self.standing = Standing::Leading;
        Some(TenureEvent::TookOver)
    }

    /// Whether the array applied a command of this epoch that this controller did not send.
    fn is_foreign_sequence(&self, evidence: Evidence) -> bool {
        evidence.epoch == self.epoch && evidence.applied_sequence > self.sent
    }

    /// Whether the latest telemetry is recent.
    fn is_current(&self, now: Nanos) -> bool {
        self.seen.is_some_and(|(at_ns, _)| now.abs_diff(at_ns) <= TELEMETRY_TIMEOUT_NS)
    }

    /// Counts a command that is due. A pause of the reports, and a step of the clock, begin again.
    fn note_due(&mut self, now: Nanos) {
        let Rule::Live { gap_ns, .. } = self.rule else { return };
        let Some((_, before)) = self.seen else { return };
        match &mut self.unaccepted {
            Some(unaccepted) if now.checked_sub(unaccepted.last_ns).is_some_and(|gap| gap <= gap_ns) => {
                unaccepted.last_ns = now;
                unaccepted.due = DUE_MIN.min(unaccepted.due + 1);
            }
            slot => *slot = Some(Unaccepted { since_ns: now, last_ns: now, due: 1, before }),
        }
    }

    /// The evidence before the array accepted nothing for the patience plus `spread_ns`.
    fn unaccepted_for(&self, now: Nanos, spread_ns: Nanos) -> Option<Evidence> {
        let unaccepted = self.unaccepted.filter(|unaccepted| unaccepted.due >= DUE_MIN)?;
        let patience_ns = PATIENCE_NS * PAUSE_MAX.min(1 << self.attempts.saturating_sub(1)) + spread_ns;
        let is_over = now.checked_sub(unaccepted.since_ns).is_some_and(|passed_ns| passed_ns >= patience_ns);
        is_over.then_some(unaccepted.before)
    }

    /// The epoch of the first command.
    fn first_epoch(&self, now: Nanos) -> u64 {
        let utc_ms = now / 1_000_000;
        let seen = self.seen.map_or(self.announced, |(_, evidence)| evidence.epoch);
        self.above(utc_ms.max(seen)).or_else(|| self.above(utc_ms)).unwrap_or(utc_ms)
    }

    /// Takes a new epoch. Where no epoch is above the one in telemetry, telemetry is wrong.
    fn renew(&mut self, now: Nanos, evidence: Evidence) {
        let utc_ms = now / 1_000_000;
        let (claimed, both) = (evidence.epoch, utc_ms.max(evidence.epoch));
        let bases = if self.attempts.is_multiple_of(2) { [both, claimed, utc_ms] } else { [claimed, both, utc_ms] };
        let mut candidates = bases.into_iter().filter_map(|base| self.above(base));
        if let Some(epoch) = candidates.find(|epoch| *epoch != self.epoch) {
            self.epoch = epoch;
            self.sent = 0;
        }
        self.attempts = 6.min(self.attempts + 1);
        self.unaccepted = None;
    }

    /// The lowest epoch of this controller above a base; `None` where there is none.
    fn above(&self, base: u64) -> Option<u64> {
        let Rule::Live { slot, .. } = self.rule else { return base.checked_add(1) };
        let next = base.checked_add(1)?;
        next.checked_add((slot + EPOCH_SLOTS - next % EPOCH_SLOTS) % EPOCH_SLOTS)
    }
}
