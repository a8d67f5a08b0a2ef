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
//!             first report, no           |      v      telemetry: a higher epoch
//!         +---------+ valid command   +---------+-------------------------------->+---------+
//! ------->| Waiting |---------------->| Leading |                                 | Standby |
//!         +---------+                 +---------+<--------------------------------+---------+
//!              |                        reports without an accepted command, or      ^
//!              |                        the leader has left: a new epoch             |
//!              |                        no higher epoch, or no telemetry: the same   |
//!              +---------------------------------------------------------------------+
//!                 first report, and the array follows another controller
//! ```
//!
//! | standing | commands |
//! | --- | --- |
//! | Waiting | the first one chooses an epoch above UTC and above every epoch that the array reported |
//! | Leading | sent |
//! | Standby | withheld; the belief about the users goes on, and telemetry shows the last command |
//!
//! - **A start beside a leader stands by**: at the first report the array follows a valid command of another
//!   controller, or the last epoch that it followed is of one that is in the room. Otherwise the controller leads. The first telemetry is awaited for [`FIRST_TELEMETRY_NS`] at most.
//!   Its first epoch may be too low, because telemetry came after its first command. Before the array has obeyed it,
//!   it answers one higher epoch by a new epoch of its own, and stands by from the second on.
//! - **Takeover**: a report is unanswered if telemetry that came a quarter of a report interval or more after it
//!   shows no further accepted command. Telemetry that waited on its way, as in a connection that was interrupted,
//!   counts as if it had not. A report that waited may have been answered before it came: the first one after telemetry is judged in its place. After as many unanswered
//!   reports in sequence as its rank, a standby takes a new epoch and answers the report that is due. A leader whose liveliness token has ended counts as one
//!   unanswered report, until it answers one or its token returns. The rank is 1 plus the number of other standbys
//!   with a lower source id, up to [`RANK_MAX`], or given by the operator.
//! - **A standby that lost its link**, see `LOST_NS`, has lost tokens and telemetry with it.
//!   The end of the leader's token counts again once a report is judged, and missing telemetry after a further 1 s.
//! - **Guest**: a controller that leads within 1 s of its token, as a calibration does, from a leader that answers
//!   and stays in the room. While it has its token, a standby needs one further unanswered
//!   report. When its token ends, a standby resumes: this is no takeover, and former contested ones do not delay it.
//!   A controller that left while another one led, and is back, is no guest.
//! - **Contested takeover**: the former leader was not gone if the array then refuses commands of a lower epoch, or
//!   accepted one after the telemetry that decided. Each such takeover in sequence adds the number of standbys to
//!   the reports that must be unanswered, up to [`BACK_OFF_MAX`], until [`FORGIVEN_NS`] after the last one. A command
//!   after that counts only. So does a token that is back within 60 s,
//!   where its end decided the takeover and every report was answered.
//! - **Last resort**: telemetry that is too sparse to judge reports ends a standby too, when the array has accepted
//!   no command for [`PATIENCE_NS`] plus a spread that differs between controllers.
//! - **Locked out**: a leading controller sends commands, the array accepts none for [`PATIENCE_NS`], and its counters
//!   of refusals rise. Or telemetry shows a sequence in its own epoch that it never sent: another sender uses the
//!   epoch. A new epoch ends both.
//! - **A new epoch** is above the epoch in the latest telemetry. Attempts that fail alternate between a base with UTC
//!   and one without: a clock that is wrong, and telemetry that is forged, each fail in one of them only. The pause
//!   doubles from the third attempt on, up to [`PAUSE_MAX`] times.
//! - **Epochs are unique**: each controller uses only epochs with its own remainder modulo
//!   [`EPOCH_SLOTS`], which also names the leader. Two controllers that choose at the same time choose
//!   different epochs. A controller that returns to a former epoch goes on with its numbers.
//!
//! The latest telemetry alone counts: an epoch that one message claims is forgotten with the next.

mod evidence;
mod numbers;
mod peers;
mod telemetry;

use heliostat_proto::{EPOCH_SLOTS, Nanos, Stamp};

use self::evidence::{Contest, Delay, Guest, Unaccepted, Watch};
pub use self::evidence::{Evidence, TenureEvent};
use self::numbers::{Numbers, Rule};

/// Time without an accepted command after which a controller takes a new epoch, in ns.
pub const PATIENCE_NS: Nanos = 1_000_000_000;

/// Longest pause between two attempts, in units of [`PATIENCE_NS`].
pub const PAUSE_MAX: u64 = 8;

/// Telemetry older than this in ns is no reason to stand by.
const TELEMETRY_TIMEOUT_NS: Nanos = 1_000_000_000;

/// A pause of the reports in ns after which a standby has lost its link, unless a few reports take longer. Telemetry may
/// be older than the last report.
const LOST_NS: Nanos = TELEMETRY_TIMEOUT_NS / 2;

/// Commands that must have been due before a new epoch, so that one lost message is no reason.
const DUE_MIN: u8 = 3;

/// Most unanswered reports that contested takeovers add to the rank.
pub const BACK_OFF_MAX: u8 = 8;

/// Time after which a contested takeover delays no other one: the load that made a leader slow may have ended.
pub const FORGIVEN_NS: Nanos = 600_000_000_000;

/// A pause of the reports, in report intervals, after which the observation of the leader begins again.
const WATCH_GAP: u64 = 3;

/// Longest wait of a start for telemetry: twice the longest interval between two messages.
pub const FIRST_TELEMETRY_NS: Nanos = 200_000_000;

/// Longest time in ns for which a controller that ends commands on, until a standby takes over.
pub const HAND_OVER_NS: Nanos = 500_000_000;

/// Other controllers that are known.
const PEERS_MAX: usize = 16;

/// Highest rank by source ids: anyone in the room can declare tokens.
pub const RANK_MAX: u8 = 4;

/// Whether the controller commands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Standing {
    /// No command was due so far.
    Waiting,
    /// Commands are sent.
    #[default]
    Leading,
    /// Commands are withheld: the array follows another controller.
    Standby,
}

/// The epoch of one controller; by default a fixed one.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Tenure {
    rule: Rule,
    standing: Standing,
    /// The rank that the operator gave.
    rank: Option<u8>,
    /// A standby from the start, whatever the array follows.
    pub is_reserve: bool,
    /// Source ids of the other controllers in the room.
    peers: Vec<u64>,
    watch: Watch,
    guest: Guest,
    contest: Contest,
    numbers: Numbers,
    /// The latest telemetry, and its arrival.
    seen: Option<(Nanos, Evidence)>,
    delay: Delay,
    /// When it would have come with the shortest delay.
    shown_ns: Nanos,
    /// Of the reports.
    report_delay: Delay,
    /// When the report that is due would have come with the shortest delay.
    asked_ns: Option<Nanos>,
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
        Self { numbers: Numbers::of(epoch), ..Self::default() }
    }

    /// One epoch, for a room in lockstep: stands by while the array follows another sender.
    pub fn lockstep(epoch: u64) -> Self {
        Self { rule: Rule::Lockstep, ..Self::fixed(epoch) }
    }

    /// For a live room, in which a report is due every `interval_ns`. `source` is the random id of
    /// the controller.
    pub fn live(source: u64, interval_ns: Nanos) -> Self {
        Self { rule: Rule::Live { source, interval_ns }, standing: Standing::Waiting, ..Self::fixed(0) }
    }

    /// Begins again as [`live`](Self::live), for a lead that is taken again. No number of an epoch is given twice.
    pub fn restart(&mut self) {
        let Rule::Live { source, interval_ns } = self.rule else { return };
        self.numbers.begin(0);
        *self = Self { numbers: std::mem::take(&mut self.numbers), ..Self::live(source, interval_ns) };
    }

    /// Stands by from the start, with this rank from 1, or the rank by source ids.
    #[must_use]
    pub fn in_reserve(self, rank: Option<u8>) -> Self {
        Self { rank, is_reserve: true, ..self }
    }

    /// Whether the controller commands.
    pub fn standing(&self) -> Standing {
        self.standing
    }

    /// Whether the controller stands by. One that begins in reserve does before its first report too.
    pub fn is_standing_by(&self) -> bool {
        self.standing == Standing::Standby || (self.is_reserve && self.standing == Standing::Waiting)
    }

    /// The epoch of the commands; 0 while waiting.
    pub fn epoch(&self) -> u64 {
        self.numbers.epoch()
    }

    /// The epoch of the command that the array applied last, by the latest telemetry.
    pub fn followed_epoch(&self) -> Option<u64> {
        self.seen.map(|(_, evidence)| evidence.epoch)
    }

    /// Notes the highest epoch that the array announces; it counts until telemetry arrives.
    pub fn handle_announced_epoch(&mut self, epoch: u64) {
        self.announced = epoch;
    }

    /// Numbers a command of the present epoch: from 1, rising by one, also over a return to it.
    pub fn next_sequence(&mut self) -> u64 {
        self.numbers.next_sequence()
    }

    /// Whether the former leader ended with its liveliness token before this standby took over.
    pub fn has_leader_ended(&self) -> bool {
        self.standing == Standing::Leading && self.watch.has_left
    }

    /// A report with this stamp comes at `now`, and makes the next command due. One that waited on its way may have been
    /// answered before.
    pub fn handle_report(&mut self, now: Nanos, stamp: &Stamp) {
        if let Rule::Live { .. } = self.rule {
            self.asked_ns = Some(self.report_delay.undelayed(now, (stamp.source, stamp.time_ns)));
        }
    }

    /// A command is due at `now`: its epoch, or `None` in standby.
    ///
    /// The event is the begin or the end of a standby.
    pub fn permit(&mut self, now: Nanos) -> (Option<u64>, Option<TenureEvent>) {
        self.permit_due(now, true)
    }

    /// As [`permit`](Self::permit), for a command that the absence of reports makes due. A standby that has no recent
    /// telemetry either may have lost its link.
    pub fn permit_in_silence(&mut self, now: Nanos) -> (Option<u64>, Option<TenureEvent>) {
        let is_live = matches!(self.rule, Rule::Live { .. });
        if is_live && self.standing == Standing::Standby && !self.is_current(now) {
            return (None, None);
        }
        self.permit_due(now, false)
    }

    /// A report has come; a standby learns from it that its link is there. Each call of [`permit`](Self::permit) notes
    /// its own one.
    pub fn note_report(&mut self, now: Nanos) {
        let Rule::Live { interval_ns, .. } = self.rule else { return };
        if self.standing == Standing::Standby {
            self.watch.note_report(now, interval_ns.saturating_mul(WATCH_GAP).max(LOST_NS));
        }
    }

    fn permit_due(&mut self, now: Nanos, is_report: bool) -> (Option<u64>, Option<TenureEvent>) {
        let asked_ns = self.asked_ns.take().unwrap_or(now);
        let event = match self.standing {
            Standing::Waiting => self.start(now),
            Standing::Standby => self.watch_leader((now, asked_ns), is_report),
            Standing::Leading => None,
        };
        self.note_due(now);
        ((self.standing == Standing::Leading).then_some(self.epoch()), event)
    }

    /// The first report after telemetry, or after the wait for it: leads, or stands by for the controller that leads.
    fn start(&mut self, now: Nanos) -> Option<TenureEvent> {
        let (first_ns, _) = *self.watch.awaited.get_or_insert((now, 0));
        if self.seen.is_none() && now.abs_diff(first_ns) < FIRST_TELEMETRY_NS {
            return None;
        }
        if self.is_led(now) || self.is_reserve {
            self.stand_by();
            // Late telemetry is awaited as after the loss of a link.
            self.watch.returned_ns = Some(now);
            return Some(TenureEvent::StoodBy);
        }
        self.lead_first(now);
        None
    }

    /// Whether another controller leads, as far as a start can see. One that is in the room leads an array that has
    /// parked, or whose device is absent, too.
    fn is_led(&self, now: Nanos) -> bool {
        let has_leader = |shown: Evidence| shown.following || (shown.epoch > 0 && self.has_peer(shown.epoch));
        self.is_current(now) && self.seen.is_some_and(|(_, shown)| has_leader(shown))
    }

    /// A command is due in standby, for a report that would have come at `asked_ns` with the shortest delay: judges whether
    /// the leader has answered the awaited report.
    fn watch_leader(&mut self, (now, asked_ns): (Nanos, Nanos), is_report: bool) -> Option<TenureEvent> {
        let Rule::Live { interval_ns, .. } = self.rule else {
            return (!self.is_current(now)).then(|| self.resume(now));
        };
        if is_report {
            self.note_report(now);
        }
        let gap_ns = interval_ns.saturating_mul(WATCH_GAP);
        let since_last_ns = self.watch.note_due(now);
        if !self.is_current(now) {
            return self.watch.misses_telemetry(now).then(|| self.resume(now));
        }
        let (_, shown) = self.seen?;
        let (rank, is_returned) = (self.rank(), self.guest.leads && self.watch.has_left);
        let back_off = match self.guest.leads {
            true if is_returned => 0,
            // The first report of a guest may have been answered before it came here.
            true => self.contest.back_off(now, self.standbys()).saturating_add(1),
            false => self.contest.back_off(now, self.standbys()),
        };
        let is_paused = shown.stopped || since_last_ns > gap_ns;
        // A clock may step.
        let next_ns = due_after(self.shown_ns, asked_ns, interval_ns).clamp(now, now.saturating_add(interval_ns));
        let watch = &mut self.watch;
        let is_answered = watch.judge((now, next_ns), (self.shown_ns, shown), interval_ns, is_paused)?;
        if watch.unanswered + u8::from(watch.is_gone()) < rank.saturating_add(back_off) {
            // An answer that came before the token ended shows no leader.
            if watch.has_left && is_answered && !is_returned {
                watch.note_answer(now);
            }
            return None;
        }
        let (is_gone, has_answered) = (watch.is_gone(), watch.unanswered == 0);
        self.take_over(now, shown);
        if is_gone {
            let left = has_answered && !is_returned;
            self.contest.note_gone(left.then_some((shown.epoch % EPOCH_SLOTS, now)));
        }
        Some(if is_returned { TenureEvent::Resumed } else { TenureEvent::TookOver })
    }

    /// Leads under a new epoch, by this evidence.
    fn take_over(&mut self, now: Nanos, shown: Evidence) {
        self.renew(now, shown);
        self.lead();
        self.contest.begin(now, shown, self.numbers.sequence());
    }

    fn stand_by(&mut self) {
        self.standing = Standing::Standby;
        self.unaccepted = None;
        // A guest may have left before telemetry shows that it leads.
        self.watch = Watch { has_left: self.guest.has_left(), ..Watch::default() };
    }

    fn lead(&mut self) {
        self.standing = Standing::Leading;
        self.unaccepted = None;
    }

    fn lead_first(&mut self, now: Nanos) {
        self.numbers.begin(self.first_epoch(now));
        self.is_new = true;
        self.lead();
    }

    /// Ends a standby with the own epoch, if there is one.
    fn resume(&mut self, now: Nanos) -> TenureEvent {
        if self.epoch() == 0 {
            self.lead_first(now);
            self.seen.into_iter().for_each(|(_, shown)| self.contest.begin(now, shown, self.numbers.sequence()));
            return TenureEvent::TookOver;
        }
        self.lead();
        TenureEvent::Resumed
    }

    /// Whether the latest telemetry is recent.
    fn is_current(&self, now: Nanos) -> bool {
        self.seen.is_some_and(|(at_ns, _)| now.abs_diff(at_ns) <= TELEMETRY_TIMEOUT_NS)
    }

    /// Counts a command that is due. A pause of the reports, and a step of the clock, begin again.
    fn note_due(&mut self, now: Nanos) {
        let Rule::Live { interval_ns, .. } = self.rule else { return };
        let gap_ns = interval_ns.saturating_mul(3).saturating_add(PATIENCE_NS / 4);
        let Some((_, before)) = self.seen else { return };
        match &mut self.unaccepted {
            Some(unaccepted) if now.checked_sub(unaccepted.last_ns).is_some_and(|gap| gap <= gap_ns) => {
                unaccepted.last_ns = now;
                unaccepted.due = DUE_MIN.min(unaccepted.due + 1);
            }
            slot => *slot = Some(Unaccepted { since_ns: now, last_ns: now, due: 1, before }),
        }
    }

    /// The epoch of the first command.
    fn first_epoch(&self, now: Nanos) -> u64 {
        let utc_ms = now / 1_000_000;
        let seen = self.seen.map_or(self.announced, |(_, evidence)| evidence.epoch);
        self.rule.above(utc_ms.max(seen)).or_else(|| self.rule.above(utc_ms)).unwrap_or(utc_ms)
    }

    /// Takes a new epoch. Where no epoch is above the one in telemetry, telemetry is wrong.
    fn renew(&mut self, now: Nanos, evidence: Evidence) {
        let utc_ms = now / 1_000_000;
        let (claimed, both) = (evidence.epoch, utc_ms.max(evidence.epoch));
        let bases = if self.attempts.is_multiple_of(2) { [both, claimed] } else { [claimed, both] };
        // Where the own epoch is the lowest above the claimed one, a lower one would be refused.
        let own = (self.epoch() > claimed).then_some(self.epoch());
        let mut candidates = bases.into_iter().chain(own).chain([utc_ms]).filter_map(|base| self.rule.above(base));
        if let Some(epoch) = candidates.find(|epoch| *epoch != self.epoch()) {
            self.numbers.begin(epoch);
        }
        self.contest.end();
        // The number counts for the pause, up to the longest one, and for the base, by its last bit.
        self.attempts = if self.attempts < 6 { self.attempts + 1 } else { 5 };
        self.unaccepted = None;
    }
}

/// When the first report after telemetry of `shown_ns` is due, where one was due at `asked_ns` and each after
/// `interval_ns`: that telemetry may show the answers to all before.
fn due_after(shown_ns: Nanos, asked_ns: Nanos, interval_ns: Nanos) -> Nanos {
    let passed_ns = shown_ns.saturating_sub(asked_ns);
    asked_ns.saturating_add(passed_ns.div_ceil(interval_ns.max(1)).saturating_mul(interval_ns))
}
