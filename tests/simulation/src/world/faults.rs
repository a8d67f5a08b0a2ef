//! What each fault does at its begin and at its end.

use heliostat_core::tenure::HAND_OVER_NS;

use super::{Event, Process, World};
use crate::clock::MS;
use crate::plan::{DiskAfterCrash, Fault, PolicyFault, Role, Timed};

/// A standby judges by telemetry that a leader hangs: two messages of the arrays, in ns.
const HANG_NS: u64 = 100 * MS;

impl World {
    pub(super) fn begin(&mut self, index: usize) {
        let Timed { fault, .. } = self.faults[index].clone();
        self.trace.note(self.now, || format!("begin {fault:?}"));
        if let Fault::Partition { pairs, .. } = &fault {
            self.note_cut_off(index, pairs);
        }
        if self.network.begin(&fault) {
            return self.update_presence();
        }
        match fault {
            Fault::Crash { host, disk } => self.crash(index, self.number(host), disk),
            Fault::End { controller } => {
                let host = self.number(Role::Controller(controller));
                self.note_loss(index, host, 0);
                self.hosts[host].down += 1;
                self.hosts[host].ends_by.get_or_insert(self.now + HAND_OVER_NS);
                self.update_presence();
            }
            Fault::Freeze { host } => {
                let host = self.number(host);
                self.note_loss(index, host, HANG_NS + self.room.interval_ns);
                self.hosts[host].frozen += 1;
                self.update_presence();
            }
            Fault::ClockStep { host, ms } => self.step_clock(host, ms * MS as i64),
            Fault::ClockRate { host, ppm } => self.change_rate(host, ppm),
            Fault::DiskFull { array } => self.disks[array].borrow_mut().full += 1,
            Fault::Device { array, how } => self.hardware[array].borrow_mut().begin(how),
            Fault::SlowPolicy { controller, ms } => self.slow_policy(controller, ms, true),
            Fault::Policy { controller, how } => self.fail_policy(controller, how, true),
            Fault::ReceiversSilent => self.silence_receivers(true),
            Fault::Stop => self.operate(|operator, ctx| operator.stop(ctx)),
            Fault::Calibrate { array } => self.begin_calibration(index, array),
            Fault::Rearm(by) => self.operate(|operator, ctx| operator.rearm(by, ctx)),
            Fault::Attack(attack) => {
                self.dispatch(self.number(Role::Attacker), |process, ctx| {
                    if let Some(Process::Attacker(attacker)) = process {
                        attacker.begin(attack, ctx);
                    }
                });
            }
            _ => {}
        }
    }

    pub(super) fn end(&mut self, index: usize) {
        let Timed { fault, for_ms, .. } = self.faults[index].clone();
        self.trace.note(self.now, || format!("end {fault:?}"));
        if let Fault::Partition { .. } = &fault {
            return self.end_partition(index);
        }
        if self.network.end(&fault) {
            return;
        }
        match fault {
            Fault::Crash { host, .. } => self.restart(self.number(host)),
            Fault::End { controller } => self.restart(self.number(Role::Controller(controller))),
            Fault::Freeze { host } => {
                let host = self.number(host);
                self.hosts[host].frozen -= 1;
                self.update_presence();
                self.drain(host);
                self.wake(host);
            }
            Fault::ClockStep { host, ms } => self.step_clock(host, -ms * MS as i64),
            Fault::ClockRate { host, ppm } => {
                // The clock is set right again, too.
                self.change_rate(host, -ppm);
                self.step_clock(host, -ppm * (for_ms * MS) as i64 / 1_000_000);
            }
            Fault::DiskFull { array } => self.disks[array].borrow_mut().full -= 1,
            Fault::Device { array, how } => self.hardware[array].borrow_mut().end(how),
            Fault::SlowPolicy { controller, ms } => self.slow_policy(controller, ms, false),
            Fault::Policy { controller, how } => self.fail_policy(controller, how, false),
            Fault::ReceiversSilent => self.silence_receivers(false),
            Fault::Calibrate { .. } => self.end_calibration(),
            Fault::Attack(attack) => {
                let host = self.number(Role::Attacker);
                if let Some(Process::Attacker(attacker)) = &mut self.hosts[host].process {
                    attacker.end(attack);
                }
            }
            _ => {}
        }
    }

    /// Notes the loss of a controller that reaches no array.
    fn note_cut_off(&mut self, index: usize, pairs: &[(Role, Role)]) {
        for host in 0..self.hosts.len() {
            let role = self.hosts[host].role;
            let is_cut_off = |array: usize| pairs.contains(&(role, Role::Array(array)));
            if matches!(role, Role::Controller(_)) && (0..self.setup.arrays).all(is_cut_off) {
                self.note_loss(index, host, HANG_NS + self.room.interval_ns);
            }
        }
    }

    /// Ends a process without notice.
    fn crash(&mut self, index: usize, host: usize, disk: DiskAfterCrash) {
        self.note_loss(index, host, 0);
        self.hosts[host].down += 1;
        self.kill(host, disk);
    }

    /// Starts a process again, if no other fault keeps it down.
    fn restart(&mut self, host: usize) {
        self.hosts[host].down -= 1;
        self.start(host);
    }

    /// Ends the controllers that were asked to, when another one is obeyed or the time is over.
    pub(super) fn end_processes(&mut self) {
        for host in 0..self.hosts.len() {
            let Some(ends_by) = self.hosts[host].ends_by.filter(|_| self.hosts[host].frozen == 0) else { continue };
            let awaits = match &self.hosts[host].process {
                Some(Process::Controller(node)) => node.adapter().awaits_successor(),
                _ => false,
            };
            if self.now >= ends_by || !awaits {
                self.kill(host, DiskAfterCrash::Kept);
                self.start(host);
            }
        }
    }

    pub(super) fn kill(&mut self, host: usize, disk: DiskAfterCrash) {
        self.hosts[host].ends_by = None;
        let Some(process) = self.hosts[host].process.take() else { return };
        self.note_occurred(&process);
        if let Process::Controller(node) = &process {
            self.check_replay(node);
        }
        if let Role::Array(array) = self.hosts[host].role {
            self.disks[array].borrow_mut().crash(disk, &mut self.disk_rng);
        }
        let sees = vec![None; self.hosts.len()];
        let host = &mut self.hosts[host];
        host.waiting.clear();
        (host.busy_until, host.wake_at, host.sees) = (0, None, sees);
        self.update_presence();
    }

    fn step_clock(&mut self, role: Role, by_ns: i64) {
        let host = self.number(role);
        self.hosts[host].clock.step(self.now, by_ns);
    }

    fn change_rate(&mut self, role: Role, ppm: i64) {
        let host = self.number(role);
        self.hosts[host].clock.change_rate(self.now, ppm);
        self.schedule_wake(host);
    }

    fn slow_policy(&mut self, controller: usize, ms: u64, begins: bool) {
        let host = self.number(Role::Controller(controller));
        let host = &mut self.hosts[host];
        match begins {
            true => host.slow_ms.push(ms),
            false => host.slow_ms.retain(|known| *known != ms),
        }
        match &mut host.process {
            Some(Process::Controller(node)) if begins => node.begin_slow(ms),
            Some(Process::Controller(node)) => node.end_slow(ms),
            _ => {}
        }
    }

    /// A process that starts again has another policy.
    fn fail_policy(&mut self, controller: usize, how: PolicyFault, begins: bool) {
        let host = self.number(Role::Controller(controller));
        match &mut self.hosts[host].process {
            Some(Process::Controller(node)) if begins => node.begin_fault(how),
            Some(Process::Controller(node)) => node.end_fault(how),
            _ => {}
        }
    }

    fn silence_receivers(&mut self, begins: bool) {
        let host = self.number(Role::Tracker);
        if let Some(Process::Tracker(tracker)) = &mut self.hosts[host].process {
            // A process that has started meanwhile has no such fault.
            tracker.silent = if begins { tracker.silent + 1 } else { tracker.silent.saturating_sub(1) };
        }
    }

    /// Delivers what waited for links that are up again.
    pub(super) fn release_held(&mut self) {
        for (from, to, generation, incoming) in std::mem::take(&mut self.held) {
            if self.network.is_connected(from, to) {
                let at = self.network.carry_surely(self.now, from, to);
                self.schedule(at, Event::Deliver { to, generation, incoming });
            } else {
                self.held.push((from, to, generation, incoming));
            }
        }
    }
}
