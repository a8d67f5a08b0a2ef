//! The invariants about a complete run: recovery, the gap after the loss of a leader, and replay.

use heliostat_core::tenure::{Standing, TenureEvent};

use super::pauses::PAUSE_MAX_NS;
use super::{Process, World};
use crate::clock::{MS, TrueNs};
use crate::hosts::controller::ControllerNode;
use crate::network::DELAY_MAX_NS;
use crate::plan::{Fault, Timed};
use crate::violation::Invariant;

/// Arrays follow again so long after the last fault, in ns.
const RECOVERY_NS: u64 = 5000 * MS;

/// Time that is observed after the recovery, in ns.
const OBSERVED_NS: u64 = 800 * MS;

/// Longest time between two commands then, in report intervals.
const REGULAR_INTERVALS: u64 = 5;

/// Time without another fault around the loss of a leader, in ms: before, and after.
pub(super) const ALONE_MS: (u64, u64) = (2000, 1000);

/// When a run ends, after the end of the last fault.
pub(super) fn end_ns(last_ns: TrueNs) -> TrueNs {
    last_ns + RECOVERY_NS + OBSERVED_NS
}

/// The loss of a leader beside a standby, without another fault.
pub(super) struct Loss {
    at: TrueNs,
    /// Longest gap beyond two report intervals in ns.
    slack_ns: u64,
}

impl World {
    /// Judges the run, unless there is a violation already.
    pub(super) fn judge(&mut self, last_ns: TrueNs) {
        if self.monitor.violation.is_some() {
            return;
        }
        self.now = end_ns(last_ns);
        for array in 0..self.setup.arrays {
            self.judge_recovery(array, last_ns + RECOVERY_NS);
            for index in 0..self.losses.len() {
                self.judge_gap(array, index);
            }
        }
        self.judge_confirmation();
        self.judge_visits();
        for host in 0..self.hosts.len() {
            let Some(process) = self.hosts[host].process.take() else { continue };
            self.note_occurred(&process);
            if let Process::Controller(node) = &process {
                self.check_replay(node);
            }
        }
    }

    pub(super) fn check_replay(&mut self, node: &ControllerNode) {
        if !node.replays() {
            self.monitor.fail(self.now, (Invariant::Replay, "the recorded inputs give other outputs".into()));
        }
    }

    /// Notes the loss of a controller that led beside a standby of rank 1, if it is the only fault.
    pub(super) fn note_loss(&mut self, index: usize, host: usize, slack_ns: u64) {
        let Timed { at_ms, for_ms, .. } = self.faults[index];
        // A leader that is back at once competes with its standby.
        let is_alone = for_ms >= ALONE_MS.1 && self.is_alone(index, at_ms);
        let adapter = |host: usize| match &self.hosts[host].process {
            Some(Process::Controller(node)) => Some(node.adapter()),
            _ => None,
        };
        let leads = adapter(host).is_some_and(|adapter| adapter.is_everywhere(Standing::Leading));
        let stands_by = |other: usize| {
            adapter(other).is_some_and(|adapter| adapter.is_next() && adapter.count(TenureEvent::Contested) == 0)
        };
        let has_standby = (0..self.hosts.len()).any(|other| other != host && stands_by(other));
        if is_alone && leads && has_standby && self.is_driven() {
            self.losses.push(Loss { at: self.now, slack_ns: slack_ns + self.slack_ns() });
        }
    }

    /// By how much the gaps that are promised may be longer, in ns: delays and pauses.
    pub(super) fn slack_ns(&self) -> u64 {
        2 * DELAY_MAX_NS + self.pauses_ns()
    }

    /// The pauses of tracker, controller and array on a busy machine.
    fn pauses_ns(&self) -> u64 {
        if self.setup.is_busy { 3 * PAUSE_MAX_NS } else { 0 }
    }

    /// Whether no other fault is in force, shortly before this one begins and until a time after it.
    pub(super) fn is_alone(&self, index: usize, until_ms: u64) -> bool {
        let at_ms = self.faults[index].at_ms;
        let is_near = |(other, fault): (usize, &Timed)| {
            other != index && fault.end_ms() + ALONE_MS.0 > at_ms && fault.at_ms < until_ms + ALONE_MS.1
        };
        !self.faults.iter().enumerate().any(is_near)
    }

    /// Whether each array follows commands.
    pub(super) fn is_driven(&self) -> bool {
        self.monitor.arrays.iter().all(|array| {
            let last = array.accepted_at.last().copied().unwrap_or_default();
            !array.is_stopped() && self.now - last <= 2 * self.room.interval_ns
        })
    }

    /// A stop that nobody releases reaches every array, and is confirmed.
    fn judge_confirmation(&mut self) {
        let releases = |timed: &Timed| matches!(timed.fault, Fault::Rearm(_) | Fault::Attack(_));
        if self.setup.rearms_at_end || self.faults.iter().any(releases) {
            return;
        }
        let unconfirmed = self.hosts.iter().find_map(|host| match &host.process {
            Some(Process::Operator(operator)) => operator.unconfirmed(),
            _ => None,
        });
        if let Some(name) = unconfirmed {
            self.monitor.fail(self.now, (Invariant::Recovery, format!("the stop {name} is not confirmed")));
        }
    }

    fn judge_gap(&mut self, array: usize, index: usize) {
        let Loss { at: lost, slack_ns } = self.losses[index];
        let accepted = &self.monitor.arrays[array].accepted_at;
        let next = accepted.partition_point(|at| *at <= lost);
        let Some(last) = next.checked_sub(1).map(|index| accepted[index]) else { return };
        let gap_ns = accepted.get(next).map_or(u64::MAX, |at| at - last);
        if gap_ns > 2 * self.room.interval_ns + slack_ns {
            let text = format!("array {array} followed nothing for {} ms after the loss of the leader", gap_ns / MS);
            self.monitor.fail(self.now, (Invariant::Gap, text));
        }
    }

    fn judge_recovery(&mut self, array: usize, since: TrueNs) {
        let observed = &self.monitor.arrays[array];
        if observed.is_stopped() {
            if self.setup.rearms_at_end {
                self.monitor.fail(self.now, (Invariant::Recovery, format!("array {array} is still stopped")));
            }
            return;
        }
        let after = observed.accepted_at.iter().copied().filter(|at| *at > since);
        let times: Vec<TrueNs> = std::iter::once(since).chain(after).chain([since + OBSERVED_NS]).collect();
        let longest_ns = times.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or_default();
        if longest_ns > REGULAR_INTERVALS * self.room.interval_ns + self.pauses_ns() {
            let text = format!("array {array} follows nothing for {} ms after the last fault", longest_ns / MS);
            self.monitor.fail(self.now, (Invariant::Recovery, text));
        }
    }
}
