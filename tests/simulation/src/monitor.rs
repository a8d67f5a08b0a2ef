//! The invariants: what each host reports is compared with models of the contract.
//!
//! The models read the payloads as they arrived, and share no code with the hosts.

pub(crate) mod array;
pub(crate) mod commands;
mod stops;

use heliostat_array::arrivals::Arrival;
use heliostat_array::moment::Moment;
use heliostat_proto::StopName;

use crate::clock::{MS, TrueNs};
use crate::hosts::array::SimStation;
use crate::hosts::device::Hardware;
use crate::plan::Setup;
use crate::violation::{Invariant, Violation};
use array::{ArrayMonitor, Before};
use commands::CommandMonitor;

/// All invariants of a run.
pub(crate) struct Monitor {
    pub arrays: Vec<ArrayMonitor>,
    pub commands: CommandMonitor,
    /// The first violation.
    pub violation: Option<Violation>,
}

/// What a controller did about a position report.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Tally {
    pub commands: u64,
    pub degraded: u64,
    pub refused: u64,
    /// Reports that a newer one superseded before a decision.
    pub superseded: u64,
    /// 1 while a report waits for its decision.
    pub due: u64,
}

impl Tally {
    fn total(self) -> u64 {
        self.commands + self.degraded + self.refused + self.superseded + self.due
    }
}

impl Monitor {
    pub fn new(setup: &Setup, slew_rad_s: f64) -> Self {
        let array = || ArrayMonitor::new(setup.counts_from_arrival);
        let commands = CommandMonitor::new(slew_rad_s);
        Self { arrays: (0..setup.arrays).map(|_| array()).collect(), commands, violation: None }
    }

    /// Notes a violation; the first one counts.
    pub fn fail(&mut self, now: TrueNs, (invariant, text): (Invariant, String)) {
        self.violation.get_or_insert(Violation { invariant, at_ns: now, text });
    }

    pub fn before_message(
        &mut self,
        array: usize,
        arrival: &Arrival,
        station: &SimStation,
        hardware: &Hardware,
    ) -> Before {
        self.arrays[array].before_message(arrival, station, hardware)
    }

    pub fn after_message(
        &mut self,
        array: usize,
        before: Before,
        now: TrueNs,
        station: &SimStation,
        hardware: &Hardware,
    ) {
        let found = self.arrays[array].after_message(now, before, station, hardware);
        self.keep(array, now, found);
    }

    pub fn after_advance(
        &mut self,
        array: usize,
        (now, at): (TrueNs, Moment),
        station: &SimStation,
        hardware: &Hardware,
    ) {
        let found = self.arrays[array].after_advance(now, at, station, hardware);
        self.keep(array, now, found);
    }

    pub fn after_reports(&mut self, array: usize, now: TrueNs, station: &SimStation, hardware: &Hardware) {
        let found = self.arrays[array].check_stop(now, station, hardware);
        self.keep(array, now, found);
    }

    /// Checks between two steps of a running array that none is overdue.
    pub fn audit(&mut self, array: usize, now: TrueNs, at: Moment, station: &SimStation) {
        let found = self.arrays[array].audit(at, station);
        self.keep(array, now, found);
    }

    /// A controller sent a payload to an array.
    pub fn sent(&mut self, now: TrueNs, source: u64, array: usize, payload: &[u8]) {
        let found = self.commands.sent(now, source, array, payload);
        self.keep(array, now, found);
    }

    /// A controller chose an epoch for an array that follows another one, as far as it knows.
    pub fn chose(&mut self, now: TrueNs, array: usize, epoch: u64, followed: Option<u64>) {
        self.keep(array, now, CommandMonitor::chose(epoch, followed));
    }

    /// A controller handled an input, which is a position report or not.
    pub fn accounted(&mut self, now: TrueNs, [before, after]: [Tally; 2], is_report: bool) {
        if after.total() < before.total() + u64::from(is_report) {
            self.fail(now, (Invariant::Answer, "a position report gave neither a command nor a counted reason".into()));
        }
    }

    /// A controller sent a command that answers a position report of this age.
    pub fn answered(&mut self, now: TrueNs, age_ns: u64, age_max_ns: u64) {
        if age_ns > age_max_ns {
            let text = format!("a position report of {} ms was answered", age_ns / MS);
            self.fail(now, (Invariant::Answer, text));
        }
    }

    /// The operator was told that the room is stopped by this stop.
    pub fn told(&mut self, now: TrueNs, name: StopName) {
        for array in 0..self.arrays.len() {
            if !self.arrays[array].has_executed(name) {
                let text = format!("the operator was told \"stopped\", and array {array} has not executed {name}");
                self.fail(now, (Invariant::ToldStopped, text));
            }
        }
    }

    /// The operator was shown that an array is stopped by this stop.
    pub fn shown(&mut self, now: TrueNs, array: usize, name: StopName) {
        if !self.arrays[array].has_executed(name) {
            let text = format!("array {array} is shown as stopped, and has not executed {name}");
            self.fail(now, (Invariant::ToldStopped, text));
        }
    }

    fn keep(&mut self, array: usize, now: TrueNs, found: Result<(), (Invariant, String)>) {
        if let Err((invariant, text)) = found {
            self.fail(now, (invariant, format!("array {array}: {text}")));
        }
    }
}
