//! Compares the commands of a replay with the recorded ones, and counts the results.

use std::collections::BTreeMap;

use heliostat_proto::{EPOCH_SLOTS, MirrorCommand, Nanos};

use super::plan::Clock;
use super::verdict::difference;

/// Counts of a replay, and the commands that wait for their counterpart.
#[derive(Default)]
pub(super) struct Comparison {
    /// The clock of the room.
    room: Clock,
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

/// The array, the controller, and the tick that a command answers; or the time of a command that answers none.
type Answer = (usize, u64, u64, Nanos);

/// A command as it is compared. A replay repeats the epochs of the first array; those of the others
/// may differ, and with them the numbers.
fn comparable(array: usize, command: MirrorCommand) -> MirrorCommand {
    if array == 0 { command } else { MirrorCommand { epoch: 0, sequence: 0, ..command } }
}

impl Comparison {
    /// No commands, of a room with this clock.
    pub fn of(room: Clock) -> Self {
        Self { room, ..Self::default() }
    }

    /// What a command and its counterpart have in common. In a live room two controllers may answer one
    /// report: the remainder of the epoch names the controller.
    fn answer(&self, array: usize, command: &MirrorCommand) -> Answer {
        let controller = if self.room == Clock::Live { command.epoch % EPOCH_SLOTS } else { 0 };
        let (tick, time_ns) = if command.answers == 0 { (0, command.time_ns) } else { (command.answers, 0) };
        (array, controller, tick, time_ns)
    }

    /// Takes a command of this process to an array.
    pub fn add_ours(&mut self, array: usize, command: MirrorCommand, counts: bool, clock: Clock) {
        let (answer, command) = (self.answer(array, &command), comparable(array, command));
        match self.theirs.remove(&answer) {
            Some(theirs) => self.compare(&command, &theirs, counts, clock),
            None => drop(self.ours.insert(answer, (command, counts))),
        }
    }

    /// Takes a recorded command to an array.
    pub fn add_theirs(&mut self, array: usize, command: MirrorCommand, clock: Clock) {
        let (answer, command) = (self.answer(array, &command), comparable(array, command));
        match self.ours.remove(&answer) {
            Some((ours, counts)) => self.compare(&ours, &command, counts, clock),
            None => drop(self.theirs.insert(answer, command)),
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

#[cfg(test)]
mod tests {
    use super::*;

    const LEADER: u64 = 5 * EPOCH_SLOTS + 624;
    const NEXT: u64 = 8 * EPOCH_SLOTS + 763;

    fn command(epoch: u64, roll: f32) -> MirrorCommand {
        MirrorCommand { epoch, sequence: 9, answers: 40, roll: vec![roll], yaw: vec![0.0], ..MirrorCommand::default() }
    }

    /// The number of equal commands and the first difference, after one command of the replay.
    fn compared(room: Clock, ours: MirrorCommand, recorded: &[MirrorCommand]) -> (u64, Option<String>) {
        let mut comparison = Comparison::of(room);
        recorded.iter().for_each(|theirs| comparison.add_theirs(0, theirs.clone(), room));
        comparison.add_ours(0, ours, true, room);
        assert_eq!(comparison.without_report(), recorded.len() as u64 - 1);
        (comparison.same, comparison.first_difference)
    }

    #[test]
    fn a_command_is_compared_with_that_of_its_own_controller_where_two_answered_one_report() {
        let recorded = [command(LEADER, 0.25), command(NEXT, 0.125)];
        for ours in &recorded {
            assert_eq!(compared(Clock::Live, ours.clone(), &recorded), (1, None));
        }
    }

    #[test]
    fn epoch_and_sequence_are_compared_in_lockstep_only() {
        let ours = MirrorCommand { sequence: 1, ..command(LEADER + EPOCH_SLOTS, 0.25) };
        assert_eq!(compared(Clock::Live, ours, &[command(LEADER, 0.25)]), (1, None));
        for (ours, recorded, name) in [(2, 1, "epoch"), (1, 1, "sequence")] {
            let ours = MirrorCommand { sequence: 1, ..command(ours, 0.25) };
            let (same, difference) = compared(Clock::Lockstep, ours, &[command(recorded, 0.25)]);
            assert!(same == 0 && difference.is_some_and(|found| found.contains(name)), "{name}");
        }
    }
}
