//! What telemetry changes: the end of a lead or of a standby, and the reasons for a new epoch.

use heliostat_proto::{EPOCH_SLOTS, Nanos};

use super::numbers::Rule;
use super::{DUE_MIN, Evidence, PATIENCE_NS, PAUSE_MAX, Standing, Tenure, TenureEvent};

impl Tenure {
    /// Compares telemetry that arrived at `now`.
    pub fn handle_telemetry(&mut self, now: Nanos, evidence: Evidence) -> Option<TenureEvent> {
        let former = self.seen.replace((now, evidence)).map(|(_, evidence)| evidence);
        self.shown_ns = self.delay.undelayed(now, (evidence.source, evidence.sampled_ns));
        if let Some(former) = former.filter(|former| former.epoch != evidence.epoch) {
            self.note_followed(now, former, evidence.epoch);
        }
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
            Standing::Standby => {
                self.watch.returned_ns = None;
                self.compare_standby(now, evidence)
            }
        }
    }

    /// The array follows another epoch than in this former evidence.
    fn note_followed(&mut self, now: Nanos, former: Evidence, epoch: u64) {
        let is_answered = self.standing != Standing::Standby || self.watch.unanswered == 0;
        let has_lent = former.following && is_answered && self.is_present(former.epoch);
        self.guest.handle_epoch(now, epoch % EPOCH_SLOTS, has_lent);
        // The token that has ended is of the former leader.
        if self.standing == Standing::Standby && former.epoch % EPOCH_SLOTS != epoch % EPOCH_SLOTS {
            self.watch.set_left(self.guest.has_left());
        }
    }

    fn compare_leading(&mut self, now: Nanos, evidence: Evidence) -> Option<TenureEvent> {
        let is_foreign = self.is_foreign_sequence(evidence);
        let is_superseded = evidence.epoch > self.epoch();
        let is_new = self.is_new && is_superseded;
        self.is_new &= evidence.epoch < self.epoch();
        if is_new {
            self.renew(now, evidence);
            return Some(TenureEvent::TookOver);
        }
        if is_superseded || (is_foreign && self.rule == Rule::Lockstep) {
            self.stand_by();
            return Some(TenureEvent::Superseded);
        }
        if is_foreign {
            self.renew(now, evidence);
            return Some(TenureEvent::ForeignSequence);
        }
        if evidence.epoch == self.epoch() && self.contest.is_contested(now, evidence) {
            return Some(TenureEvent::Contested);
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
        if self.epoch() > 0 && evidence.epoch <= self.epoch() && !self.is_foreign_sequence(evidence) {
            return Some(self.resume(now));
        }
        let Rule::Live { source, .. } = self.rule else { return None };
        self.unaccepted_for(now, source % EPOCH_SLOTS * 1_000_000)?;
        self.take_over(now, evidence);
        Some(TenureEvent::TookOver)
    }

    /// Whether the array applied a command of this epoch that this controller did not number.
    fn is_foreign_sequence(&self, evidence: Evidence) -> bool {
        evidence.epoch == self.epoch() && evidence.applied_sequence > self.numbers.sequence()
    }

    /// The evidence before the array accepted nothing for the patience plus `spread_ns`.
    fn unaccepted_for(&self, now: Nanos, spread_ns: Nanos) -> Option<Evidence> {
        let unaccepted = self.unaccepted.filter(|unaccepted| unaccepted.due >= DUE_MIN)?;
        let patience_ns = PATIENCE_NS * PAUSE_MAX.min(1 << self.attempts.saturating_sub(1)) + spread_ns;
        let is_over = now.checked_sub(unaccepted.since_ns).is_some_and(|passed_ns| passed_ns >= patience_ns);
        is_over.then_some(unaccepted.before)
    }
}
