//! What a [`Tenure`](super::Tenure) reads of telemetry, what it keeps of it, and what it says of a change.

use heliostat_proto::{ArrayState, EPOCH_SLOTS, MirrorTelemetry, Nanos, named};

use super::{BACK_OFF_MAX, FORGIVEN_NS, HAND_OVER_NS, TELEMETRY_TIMEOUT_NS};

/// Accepted commands after which a contested takeover does not delay the next one.
const SETTLED: u64 = 8;

/// Time in ns after a takeover in which a command of the former leader shows that it was slow. A later one is that
/// of a leader that hung.
const SLOW_NS: Nanos = 1_000_000_000;

/// Time in ns after a takeover in which the token of the former leader shows that it had lost only that. A later one
/// may be that of a link that was repaired.
const TOKEN_NS: Nanos = 60_000_000_000;

/// Longest time in ns from the token of a controller to its lead, for a lead that it takes on purpose.
const GUEST_NS: Nanos = 1_000_000_000;

/// Controllers that are known to be no guests.
const RESIDENTS_MAX: usize = 16;

/// Period in ns of the shortest delay of a stream. A delay that stays for two periods is the shortest one.
const DELAY_PERIOD_NS: Nanos = TELEMETRY_TIMEOUT_NS / 2;

/// Longest time in ns for which a leader that ends is seen to command on without a token.
const ENDING_NS: Nanos = 2 * HAND_OVER_NS;

named! {
    /// A change of the standing or of the epoch, or a reason that commands are refused.
    pub enum TenureEvent {
        /// Telemetry shows a higher epoch: standby begins.
        Superseded = "superseded",
        /// Standby ends, with the same epoch: telemetry shows no higher one, or is absent. With a
        /// new epoch: a guest has given the lead back.
        Resumed = "resumed",
        /// A new epoch: the controller has just started, or it ends a standby in which the array
        /// accepted no command or the leader left.
        TookOver = "took-over",
        /// The array refused every command: a new epoch.
        LockedOut = "locked-out",
        /// The array applied a command of the own epoch that this controller never sent: a new epoch.
        ForeignSequence = "foreign-sequence",
        /// The array refused every command as expired: the clocks differ. The epoch stays.
        ClocksDiffer = "clocks-differ",
        /// The array follows another controller at the first report: standby begins.
        StoodBy = "stood-by",
        /// The former leader was not gone at a takeover: it commanded on, or its token is back.
        Contested = "contested",
    }
}

/// What telemetry shows about the commands that the array accepts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Evidence {
    /// Source id of the driver.
    pub source: u64,
    /// When it was sampled, by the clock of the driver.
    pub sampled_ns: Nanos,
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
    /// The last command is valid.
    pub following: bool,
}

impl From<&MirrorTelemetry> for Evidence {
    fn from(telemetry: &MirrorTelemetry) -> Self {
        let counters = &telemetry.counters;
        Self {
            source: telemetry.stamp.source,
            sampled_ns: telemetry.stamp.time_ns,
            epoch: telemetry.epoch,
            applied_sequence: telemetry.applied_sequence,
            accepted: counters.accepted,
            refused: counters.rejected.saturating_add(counters.old_epoch).saturating_add(counters.old_sequence),
            expired: counters.expired,
            stopped: telemetry.state == ArrayState::Stopped,
            following: telemetry.state == ArrayState::Following,
        }
    }
}

/// How long the messages of a stream were on their way, beside the shortest delay of the last second: a constant
/// difference of the clocks does not count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Delay {
    /// The sender.
    source: u64,
    /// When the latest message was sampled, and when the first one of this time came.
    sampled_ns: Nanos,
    came_ns: Nanos,
    /// When it would have come with the shortest delay.
    undelayed_ns: Nanos,
    /// The shortest delay since the last period began, and in the period before, each with the difference of the clocks.
    shortest_ns: [i64; 2],
    began_ns: Nanos,
    /// The clock of the sender stands still.
    is_still: bool,
}

impl Delay {
    /// When a message of this source and sample, which comes at `now`, would have come with the shortest delay. Another
    /// sender, a clock that steps back behind the latest sample, and one that stands still, begin again.
    pub(super) fn undelayed(&mut self, now: Nanos, (source, sampled_ns): (u64, Nanos)) -> Nanos {
        let delay_ns = now.wrapping_sub(sampled_ns) as i64;
        let is_same = source == self.source && self.came_ns > 0 && now >= self.came_ns;
        let is_repeated = is_same && sampled_ns == self.sampled_ns;
        if is_repeated && !self.is_still && now - self.came_ns <= DELAY_PERIOD_NS {
            return self.undelayed_ns;
        }
        if !is_same || sampled_ns <= self.sampled_ns {
            (self.shortest_ns, self.began_ns) = ([delay_ns; 2], now);
        } else if now - self.began_ns > DELAY_PERIOD_NS {
            (self.shortest_ns, self.began_ns) = ([delay_ns, self.shortest_ns[0]], now);
        }
        self.shortest_ns[0] = self.shortest_ns[0].min(delay_ns);
        let further_ns = delay_ns.abs_diff(self.shortest_ns[0].min(self.shortest_ns[1]));
        self.undelayed_ns = now.saturating_sub(further_ns);
        (self.source, self.sampled_ns, self.came_ns, self.is_still) = (source, sampled_ns, now, is_repeated);
        self.undelayed_ns
    }
}

/// Commands that were due since the array last accepted one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Unaccepted {
    pub(super) since_ns: Nanos,
    pub(super) last_ns: Nanos,
    /// Counted up to [`DUE_MIN`](super::DUE_MIN).
    pub(super) due: u8,
    /// The evidence at the beginning.
    pub(super) before: Evidence,
}

/// What a standby has seen of the leader.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Watch {
    /// The report whose answer is awaited, and the commands accepted before it.
    pub(super) awaited: Option<(Nanos, u64)>,
    /// When a command was due last, for a report or for the absence of reports.
    pub(super) last_ns: Nanos,
    /// The last report; 0 before the first.
    pub(super) reported_ns: Nanos,
    /// The first report after a pause that is as long as the loss of a link, until telemetry comes; after several such
    /// pauses, after the last one that is longer than the wait for telemetry.
    pub(super) returned_ns: Option<Nanos>,
    /// There was such a pause, and no report after it is judged.
    pub(super) was_lost: bool,
    /// Reports without an accepted command, in sequence.
    pub(super) unanswered: u8,
    /// The liveliness token of the leader has ended, and the leader ends with it.
    pub(super) has_left: bool,
    /// The first report after that which was answered: the leader commands on, at least until a standby does.
    pub(super) answered_ns: Option<Nanos>,
}

impl Watch {
    /// A report has come. A pause of the reports longer than `lost_ns` is the loss of the link.
    pub(super) fn note_report(&mut self, now: Nanos, lost_ns: Nanos) {
        let before_ns = std::mem::replace(&mut self.reported_ns, now);
        let pause_ns = now.abs_diff(before_ns);
        if before_ns > 0 && pause_ns > lost_ns {
            (self.awaited, self.was_lost) = (None, true);
            // A link that flaps faster does not put off the end of the wait.
            let is_continued = |_: &Nanos| pause_ns <= TELEMETRY_TIMEOUT_NS;
            self.returned_ns = self.returned_ns.filter(is_continued).or(Some(now));
        }
    }

    /// A command is due: the time since the one before, in ns.
    pub(super) fn note_due(&mut self, now: Nanos) -> Nanos {
        now.abs_diff(std::mem::replace(&mut self.last_ns, now))
    }

    /// Whether telemetry that is not recent is missing: after the loss of a link it may come later than reports.
    pub(super) fn misses_telemetry(&self, now: Nanos) -> bool {
        self.returned_ns.is_none_or(|returned_ns| now.abs_diff(returned_ns) > TELEMETRY_TIMEOUT_NS)
    }

    /// Judges by telemetry, with the time at which it would have come without further delay, whether the awaited report is answered. `None` where the observation
    /// of the leader begins again. The next report to await is due at `next_ns`, after the commands of this telemetry.
    pub(super) fn judge(
        &mut self,
        (now, next_ns): (Nanos, Nanos),
        (shown_ns, shown): (Nanos, Evidence),
        interval_ns: Nanos,
        is_paused: bool,
    ) -> Option<bool> {
        // Fewer accepted commands than before are those of a driver that has started since.
        let is_compared = |(_, accepted): &(Nanos, u64)| !is_paused && *accepted <= shown.accepted;
        let Some((since_ns, accepted)) = self.awaited.filter(is_compared) else {
            self.awaited = Some((next_ns, shown.accepted));
            self.unanswered = 0;
            return None;
        };
        let is_answered = shown.accepted > accepted;
        if shown_ns >= since_ns.saturating_add(interval_ns / 4) {
            self.unanswered = if is_answered { 0 } else { self.unanswered.saturating_add(1) };
            self.awaited = Some((next_ns, shown.accepted));
            // The awaited report came after the end of the token.
            if std::mem::take(&mut self.was_lost) && is_answered && self.has_left {
                self.note_answer(now);
            }
        }
        Some(is_answered)
    }

    /// The token of the leader has ended, or there is one.
    pub(super) fn set_left(&mut self, has_left: bool) {
        (self.has_left, self.answered_ns) = (has_left, None);
    }

    /// The leader has answered after the end of its token. One that answers for longer than an end has lost only its
    /// token.
    pub(super) fn note_answer(&mut self, now: Nanos) {
        let first_ns = *self.answered_ns.get_or_insert(now);
        self.has_left = now.abs_diff(first_ns) <= ENDING_NS;
    }

    /// Whether the end of the token counts as an unanswered report.
    pub(super) fn is_gone(&self) -> bool {
        self.has_left && self.answered_ns.is_none() && !self.was_lost
    }
}

/// A takeover from a leader that may be alive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Takeover {
    at_ns: Nanos,
    /// Commands refused and accepted by the evidence that decided it.
    refused: u64,
    accepted: u64,
    /// The last number that was given in its epoch before it.
    sequence: u64,
    is_settled: bool,
}

impl Takeover {
    /// Whether another sender commanded after the evidence of the takeover, by evidence of its epoch.
    fn is_contested(&self, evidence: Evidence) -> bool {
        let own = evidence.applied_sequence.saturating_sub(self.sequence);
        evidence.refused > self.refused || self.accepted_since(evidence) > own
    }

    fn accepted_since(&self, evidence: Evidence) -> u64 {
        evidence.accepted.saturating_sub(self.accepted)
    }
}

/// Whether takeovers proved to be contested.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Contest {
    /// The last takeover in this epoch, while it can be contested.
    takeover: Option<Takeover>,
    /// The remainder in the epochs of the former leader and the time of the takeover, where the end of its token alone
    /// decided it.
    left: Option<(u64, Nanos)>,
    /// Contested takeovers in sequence, and the time of the last one.
    contested: u8,
    contested_ns: Nanos,
}

impl Contest {
    /// Unanswered reports that the next takeover needs beside the rank, where this many standbys have one. A multiple of
    /// their number keeps the turns of two standbys apart.
    pub(super) fn back_off(&self, now: Nanos, standbys: u8) -> u8 {
        let is_forgiven = now.abs_diff(self.contested_ns) > FORGIVEN_NS;
        if is_forgiven { 0 } else { standbys * self.contested.min(BACK_OFF_MAX / standbys) }
    }

    /// A takeover by this evidence. `sequence` is the last number in its epoch.
    pub(super) fn begin(&mut self, at_ns: Nanos, shown: Evidence, sequence: u64) {
        let Evidence { refused, accepted, .. } = shown;
        self.takeover = Some(Takeover { at_ns, refused, accepted, sequence, is_settled: false });
        self.left = None;
    }

    /// The end of a token had a part in the takeover; it alone that of this remainder, at this time. A leader that ends
    /// commands until its successor is obeyed, which contests nothing.
    pub(super) fn note_gone(&mut self, left: Option<(u64, Nanos)>) {
        (self.takeover, self.left) = (None, left);
    }

    /// A new epoch. The own commands of the former one are refused too.
    pub(super) fn end(&mut self) {
        self.takeover = None;
    }

    /// Whether a token of this remainder shows that the former leader had lost only its token, by the time of the
    /// latest telemetry.
    pub(super) fn is_back(&mut self, slot: u64, seen_ns: Nanos) -> bool {
        self.left.take_if(|left| left.0 == slot).is_some_and(|(_, at_ns)| seen_ns.abs_diff(at_ns) <= TOKEN_NS)
    }

    /// Whether the takeover proves to be contested, by evidence of its epoch.
    pub(super) fn is_contested(&mut self, now: Nanos, evidence: Evidence) -> bool {
        // The counts of a driver that has started since tell nothing.
        self.takeover = self.takeover.filter(|takeover| takeover.accepted <= evidence.accepted);
        let Some(takeover) = &mut self.takeover else { return false };
        let (is_contested, was_settled) = (takeover.is_contested(evidence), takeover.is_settled);
        takeover.is_settled |= takeover.accepted_since(evidence) >= SETTLED;
        if is_contested && !was_settled {
            let is_first = now.abs_diff(self.contested_ns) > FORGIVEN_NS;
            self.contested = if is_first { 1 } else { BACK_OFF_MAX.min(self.contested + 1) };
            self.contested_ns = now;
        } else if takeover.is_settled {
            self.contested = 0;
        }
        if is_contested || (was_settled && now.abs_diff(takeover.at_ns) > SLOW_NS) {
            self.takeover = None;
        }
        is_contested
    }
}

/// Whether the leader is a guest: a controller that took the lead when it joined, from one that had not failed and
/// is in the room.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Guest {
    /// The remainder in the epochs of the controller that joined last, and the time of the latest telemetry before.
    joined: Option<(u64, Nanos)>,
    /// Whether that one has left.
    left: bool,
    pub(super) leads: bool,
    /// The remainder in the epochs of the last guest.
    last: Option<u64>,
    /// Source ids of controllers that left while another one led: each is back when its link is.
    residents: Vec<u64>,
}

impl Guest {
    /// A controller has joined after the telemetry of this time. Without telemetry it may have led before.
    pub(super) fn handle_joined(&mut self, source: u64, seen_ns: Option<Nanos>) {
        let is_resident = self.residents.contains(&source);
        self.joined = seen_ns.filter(|_| !is_resident).map(|seen_ns| (source % EPOCH_SLOTS, seen_ns));
        self.left = false;
    }

    /// A controller has left, which the array followed or not.
    pub(super) fn handle_left(&mut self, source: u64, is_followed: bool) {
        let slot = source % EPOCH_SLOTS;
        self.left |= self.joined.is_some_and(|(joined, _)| joined == slot);
        if is_followed || self.last == Some(slot) || self.residents.contains(&source) {
            return;
        }
        if self.residents.len() == RESIDENTS_MAX {
            self.residents.remove(0);
        }
        self.residents.push(source);
    }

    /// Whether a guest leads whose token has ended.
    pub(super) fn has_left(&self) -> bool {
        self.leads && self.left
    }

    /// The array follows an epoch of this remainder since `now`; `has_lent` where the former leader answered and is
    /// in the room.
    pub(super) fn handle_epoch(&mut self, now: Nanos, slot: u64, has_lent: bool) {
        let has_joined = |(joined, seen_ns): (u64, Nanos)| joined == slot && now.abs_diff(seen_ns) <= GUEST_NS;
        self.leads = has_lent && self.joined.is_some_and(has_joined);
        if self.leads {
            // It may have left before telemetry showed its lead.
            self.last = Some(slot);
            self.residents.retain(|source| *source % EPOCH_SLOTS != slot);
        }
    }
}
