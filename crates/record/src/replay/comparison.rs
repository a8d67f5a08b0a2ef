//! Compares the commands of a replay with the recorded ones, and counts the results.

use std::collections::BTreeMap;

use heliostat_proto::{MirrorCommand, Nanos};

use super::plan::Clock;
use super::verdict::difference;

/// Counts of a replay, and the commands that wait for their counterpart.
#[derive(Default)]
pub(super) struct Comparison {
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

/// The array, and the tick that a command answers; or the time of a command that answers none.
type Answer = (usize, u64, Nanos);

fn answer(array: usize, command: &MirrorCommand) -> Answer {
    if command.answers == 0 { (array, 0, command.time_ns) } else { (array, command.answers, 0) }
}

/// A command as it is compared. A replay repeats the epochs of the first array; those of the others
/// may differ, and with them the numbers.
fn comparable(array: usize, command: MirrorCommand) -> MirrorCommand {
    if array == 0 { command } else { MirrorCommand { epoch: 0, sequence: 0, ..command } }
}

impl Comparison {
    /// Takes a command of this process to an array.
    pub fn add_ours(&mut self, array: usize, command: MirrorCommand, counts: bool, clock: Clock) {
        let command = comparable(array, command);
        match self.theirs.remove(&answer(array, &command)) {
            Some(theirs) => self.compare(&command, &theirs, counts, clock),
            None => drop(self.ours.insert(answer(array, &command), (command, counts))),
        }
    }

    /// Takes a recorded command to an array.
    pub fn add_theirs(&mut self, array: usize, command: MirrorCommand, clock: Clock) {
        let command = comparable(array, command);
        match self.ours.remove(&answer(array, &command)) {
            Some((ours, counts)) => self.compare(&ours, &command, counts, clock),
            None => drop(self.theirs.insert(answer(array, &command), command)),
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
