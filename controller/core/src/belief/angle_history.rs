//! The angles of the mirrors at the time of a measurement: a short history of the commands.

use heliostat_channel::mirrors::{MirrorAngles, copy_widened};
use heliostat_proto::{MirrorCommand, Nanos};
use serde::{Deserialize, Serialize};

/// Commands that are kept: at 100 per second those of the last 0.6 s. The angles of an older
/// measurement are not known, whatever age of a report the scenario accepts.
const COMMANDS: usize = 64;

/// While the mirrors turn to another command, their angles count as known if the two differ by at
/// most this in rad: a hundredth of the angle under which a device sees its own body.
const SAME_RAD: f32 = 2e-3;

/// The angles of a command, and when they are valid.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Entry {
    from_ns: Nanos,
    until_ns: Nanos,
    roll: Vec<f32>,
    yaw: Vec<f32>,
}

impl Entry {
    /// Length in a recorded state in bytes, which the times hardly change.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.roll[..]) + size_of_val(&self.yaw[..])
    }

    fn resembles(&self, other: &Self) -> bool {
        let near = |one: &[f32], two: &[f32]| one.iter().zip(two).all(|(one, two)| (one - two).abs() <= SAME_RAD);
        near(&self.roll, &other.roll) && near(&self.yaw, &other.yaw)
    }
}

/// The latest commands, in the order in which they were given.
#[derive(Clone, Debug)]
pub struct AngleHistory {
    /// A ring; `next` is the oldest entry, or the first unused one.
    entries: Vec<Entry>,
    next: usize,
    /// From a command to the rest of the mirrors, in ns; at least 1, since a measurement at the
    /// time of a command precedes its effect.
    settling_ns: Nanos,
}

impl AngleHistory {
    /// A history without commands to this many mirrors; allocates all memory.
    pub fn new(mirrors: usize) -> Self {
        let entry = Entry { roll: vec![0.0; mirrors], yaw: vec![0.0; mirrors], ..Entry::default() };
        Self { entries: vec![entry; COMMANDS], next: 0, settling_ns: 1 }
    }

    /// The array announces its settling time in s.
    pub fn set_settling(&mut self, settling_s: f64) {
        self.settling_ns = ((settling_s * 1e9) as Nanos).max(1);
    }

    /// The commands that were valid after a time, in their order.
    pub(super) fn since(&self, time_ns: Nanos) -> Vec<Entry> {
        let (later, earlier) = self.entries.split_at(self.next);
        earlier.iter().chain(later).filter(|entry| entry.until_ns > time_ns).cloned().collect()
    }

    /// Replaces the commands; false, without a change, where they are not those of this array.
    pub(super) fn restore(&mut self, entries: &[Entry]) -> bool {
        let mirrors = self.entries[0].roll.len();
        let fits = entries.len() <= COMMANDS
            && entries.iter().all(|entry| [entry.roll.len(), entry.yaw.len()] == [mirrors; 2])
            && entries.iter().all(|entry| entry.roll.iter().chain(&entry.yaw).all(|angle| angle.is_finite()));
        if fits {
            self.clear();
            self.entries[..entries.len()].clone_from_slice(entries);
            self.next = entries.len() % COMMANDS;
        }
        fits
    }

    /// Forgets all commands.
    pub fn clear(&mut self) {
        self.entries.iter_mut().for_each(|entry| entry.until_ns = 0);
    }

    /// Notes a command.
    pub fn handle_command(&mut self, command: &MirrorCommand) {
        let entry = &mut self.entries[self.next];
        entry.from_ns = command.time_ns;
        entry.until_ns = command.time_ns + u64::from(command.validity_ms) * 1_000_000;
        entry.roll.copy_from_slice(&command.roll);
        entry.yaw.copy_from_slice(&command.yaw);
        self.next = (self.next + 1) % COMMANDS;
    }

    /// Writes the angles that the mirrors had at a time; false where they are not known: without a
    /// valid command, and while the mirrors turn.
    pub fn at(&self, time_ns: Nanos, out: &mut MirrorAngles) -> bool {
        let before = |entry: &&Entry, delay_ns: Nanos| entry.until_ns > 0 && entry.from_ns + delay_ns <= time_ns;
        let settled =
            self.entries.iter().filter(|entry| before(entry, self.settling_ns)).max_by_key(|entry| entry.from_ns);
        let Some(settled) = settled.filter(|entry| time_ns <= entry.until_ns) else { return false };
        let mut turning = self.entries.iter().filter(|entry| entry.from_ns > settled.from_ns && before(entry, 1));
        if !turning.all(|entry| entry.resembles(settled)) {
            return false;
        }
        copy_widened(&settled.roll, &mut out.roll);
        copy_widened(&settled.yaw, &mut out.yaw);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Nanos = 1_000_000;

    fn command(at_ms: Nanos, roll: f32) -> MirrorCommand {
        MirrorCommand {
            epoch: 1,
            sequence: 1,
            answers: 1,
            time_ns: at_ms * MS,
            validity_ms: 400,
            roll: vec![roll; 2],
            yaw: vec![0.0; 2],
        }
    }

    fn at(history: &AngleHistory, at_ms: Nanos) -> Option<f64> {
        let mut angles = MirrorAngles::flat(2);
        history.at(at_ms * MS, &mut angles).then(|| angles.roll[1])
    }

    #[test]
    fn a_command_counts_from_its_settling_to_the_end_of_its_validity() {
        let mut history = AngleHistory::new(2);
        history.set_settling(0.005);
        assert_eq!(at(&history, 1000), None);
        history.handle_command(&command(1000, 0.5));
        history.handle_command(&command(1100, 0.25));
        assert_eq!(at(&history, 1004), None, "still turning");
        assert_eq!(at(&history, 1005), Some(0.5));
        assert_eq!(at(&history, 1100), Some(0.5), "a command of the same time has no effect yet");
        assert_eq!(at(&history, 1103), None, "turning to the next command");
        assert_eq!(at(&history, 1500), Some(0.25));
        assert_eq!(at(&history, 1501), None, "no command is valid");
        history.clear();
        assert_eq!(at(&history, 1200), None);
    }

    #[test]
    fn a_measurement_at_the_time_of_a_command_has_the_angles_before_it_even_of_ideal_mirrors() {
        let mut history = AngleHistory::new(2);
        history.set_settling(0.0);
        history.handle_command(&command(1000, 0.5));
        assert_eq!(at(&history, 1000), None);
        history.handle_command(&command(1100, 0.25));
        assert_eq!(at(&history, 1100), Some(0.5));
        assert_eq!(at(&history, 1101), Some(0.25));
    }

    #[test]
    fn a_small_turn_leaves_the_angles_known_and_old_commands_are_forgotten() {
        let mut history = AngleHistory::new(2);
        history.set_settling(0.005);
        for index in 0..200 {
            history.handle_command(&command(1000 + index, 0.001 * (index % 2) as f32));
        }
        assert_eq!(at(&history, 1150), Some(f64::from(0.001_f32)));
        assert_eq!(at(&history, 1100), None);
    }
}
