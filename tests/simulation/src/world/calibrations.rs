//! Calibrations: their begin and end, and what holds while one leads.

use heliostat_proto::EPOCH_SLOTS;

use super::verdicts::ALONE_MS;
use super::{Process, World};
use crate::clock::{MS, TrueNs};
use crate::hosts::calibration::Calibration;
use crate::plan::{DiskAfterCrash, Role};
use crate::violation::Invariant;

/// A calibration without another fault, in a room whose arrays follow a controller.
pub(super) struct Visit {
    array: usize,
    begin: TrueNs,
    end: TrueNs,
    /// The remainder of its epochs.
    slot: u64,
}

impl World {
    /// Starts a calibration. The holder of the receiver stands still.
    pub(super) fn begin_calibration(&mut self, index: usize, array: usize) {
        let (host, room) = (self.number(Role::Calibration), self.room.clone());
        self.kill(host, DiskAfterCrash::Kept);
        let source = self.new_source(host, Role::Calibration);
        self.hosts[host].generation += 1;
        let end_ms = self.faults[index].end_ms();
        if self.is_alone(index, end_ms) && self.is_driven() {
            let slot = source % EPOCH_SLOTS;
            self.visits.push(Visit { array, begin: self.now, end: end_ms * MS, slot });
        }
        self.hold_receiver(true);
        self.dispatch(host, |process, ctx| {
            *process = Some(Process::Calibration(Box::new(Calibration::start(array, source, &room, ctx))));
        });
        self.update_presence();
    }

    /// Asks the calibration to end.
    pub(super) fn end_calibration(&mut self) {
        self.hold_receiver(false);
        let host = self.number(Role::Calibration);
        if let Some(Process::Calibration(node)) = &mut self.hosts[host].process {
            node.ask_to_end();
        }
        if self.is_running(host) {
            self.dispatch(host, |process, ctx| {
                if let Some(Process::Calibration(node)) = process {
                    node.advance(ctx);
                }
            });
        }
    }

    /// Passes on what the calibration has done about its token, and notes whether it leads undisturbed.
    pub(super) fn note_lead(&mut self, host: usize, had_token: bool) {
        let Some(Process::Calibration(node)) = &self.hosts[host].process else { return };
        let (array, lead) = (node.array(), node.lead());
        let is_undisturbed = self.visits.iter().any(|visit| visit.array == array && visit.end >= self.now);
        self.monitor.arrays[array].guest = lead.filter(|_| is_undisturbed);
        if self.hosts[host].has_token() != had_token {
            self.update_presence();
        }
    }

    /// An array is driven from the begin of a calibration until after its end, and then follows a controller.
    pub(super) fn judge_visits(&mut self) {
        for Visit { array, begin, end, slot } in std::mem::take(&mut self.visits) {
            let until = end + ALONE_MS.1 * MS;
            let within = |at: &TrueNs| (begin..until).contains(at);
            let accepted = self.monitor.arrays[array].accepted_at.iter().copied().filter(within);
            let times: Vec<TrueNs> = std::iter::once(begin).chain(accepted).chain([until]).collect();
            let gap_ns = times.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or_default();
            if gap_ns > 2 * self.room.interval_ns + self.slack_ns() {
                let text = format!("array {array} followed nothing for {} ms beside a calibration", gap_ns / MS);
                self.monitor.fail(self.now, (Invariant::Guest, text));
            }
            let followed = self.monitor.arrays[array].epoch();
            if followed.is_some_and(|epoch| epoch % EPOCH_SLOTS == slot) {
                let text = format!("array {array} still follows a calibration that was asked to end");
                self.monitor.fail(self.now, (Invariant::Guest, text));
            }
        }
    }

    fn hold_receiver(&mut self, begins: bool) {
        let host = self.number(Role::Tracker);
        if let Some(Process::Tracker(tracker)) = &mut self.hosts[host].process {
            // A process that has started meanwhile knows nothing of the holder.
            tracker.standing = if begins { tracker.standing + 1 } else { tracker.standing.saturating_sub(1) };
        }
    }
}
