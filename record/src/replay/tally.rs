//! Compares the commands of a replay with the recorded ones, and counts the results.

use std::collections::BTreeMap;

use heliostat_proto::{MirrorCommand, Nanos};

use super::plan::Clock;
use super::verdict::difference;

/// Counts of a replay, and the commands that wait for their counterpart.
#[derive(Default)]
pub(super) struct Tally {
    pub reports: u64,
    pub unanswered: u64,
    pub compared: u64,
    pub not_counted: u64,
    pub same: u64,
    pub held: u64,
    pub largest_difference_rad: f64,
    pub first_difference: Option<String>,
    /// Commands of this process, each with whether it counts.
    ours: BTreeMap<Answer, (MirrorCommand, bool)>,
    /// Recorded commands.
    theirs: BTreeMap<Answer, MirrorCommand>,
}

/// The tick that a command answers; or the time of a command that answers none.
type Answer = (u64, Nanos);

fn answer(command: &MirrorCommand) -> Answer {
    if command.answers == 0 { (0, command.time_ns) } else { (command.answers, 0) }
}

impl Tally {
    /// Takes a command of this process.
    pub fn add_ours(&mut self, command: MirrorCommand, counts: bool, clock: Clock) {
        match self.theirs.remove(&answer(&command)) {
            Some(theirs) => self.compare(&command, &theirs, counts, clock),
            None => drop(self.ours.insert(answer(&command), (command, counts))),
        }
    }

    /// Takes a recorded command.
    pub fn add_theirs(&mut self, command: MirrorCommand, clock: Clock) {
        match self.ours.remove(&answer(&command)) {
            Some((ours, counts)) => self.compare(&ours, &command, counts, clock),
            None => drop(self.theirs.insert(answer(&command), command)),
        }
    }

    /// Recorded commands without a counterpart.
    pub fn without_report(&self) -> u64 {
        self.theirs.len() as u64
    }

    /// Compares a command of this process with the recorded one.
    pub fn compare(&mut self, ours: &MirrorCommand, theirs: &MirrorCommand, counts: bool, clock: Clock) {
        self.compared += 1;
        if !counts {
            self.not_counted += 1;
            return;
        }
        match difference(ours, theirs, clock) {
            None => self.same += 1,
            Some(found) => {
                self.first_difference.get_or_insert_with(|| format!("tick {}: {found}", theirs.answers));
                let angles = |command: &MirrorCommand| [command.roll.clone(), command.yaw.clone()].concat();
                let apart = angles(ours).into_iter().zip(angles(theirs)).map(|(a, b)| f64::from((a - b).abs()));
                self.largest_difference_rad = apart.fold(self.largest_difference_rad, f64::max);
            }
        }
    }
}
