//! What is said in a policy's stead while it gives no answer.
//!
//! Whoever decides holds the desk, so a policy that does not come back keeps everybody from it, and from the last command. Standby keeps a copy beside the
//! desk, and gives commands of its own after it, unless the array is stopped. When the policy comes back after all, its command is numbered on.

use std::sync::{
    Mutex,
    atomic::{AtomicU64, Ordering},
};

use heliostat_proto::{EmergencyStop, MirrorCommand, Nanos};
use heliostat_scenario::Answer;

use crate::intake::lock;
use heliostat_decide::capabilities::Guard;

/// The last command beside the desk.
pub struct Standby {
    answer: Answer,
    said: Mutex<Said>,
    /// Counts up as decisions begin and end.
    progress: AtomicU64,
}

/// The last command, whoever gave it.
#[derive(Default)]
struct Said {
    command: MirrorCommand,
    by_standby: bool,
    /// Of its own: orders of an operator must not wait for the desk.
    guard: Guard,
}

impl Standby {
    /// One that answers like this: with the last command, by parking, or not at all.
    pub fn new(answer: Answer) -> Self {
        Self { answer, said: Mutex::default(), progress: AtomicU64::new(0) }
    }

    /// What is done while no answer comes, in words.
    pub fn meanwhile(&self) -> &'static str {
        match self.answer {
            Answer::LastGood => "the last command is repeated",
            Answer::Park => "the array is parked",
            Answer::Policy | Answer::Fallback | Answer::Hold => "the array holds, then parks",
        }
    }

    /// Heeds a stop or a re-arm.
    pub fn heed(&self, order: &EmergencyStop) {
        lock(&self.said).guard.heed(order);
    }

    /// A decision begins or ends.
    pub fn tick(&self) {
        self.progress.fetch_add(1, Ordering::Relaxed);
    }

    /// Changes with each beginning and end of a decision.
    pub fn progress(&self) -> u64 {
        self.progress.load(Ordering::Relaxed)
    }

    /// Takes note of a command that is about to be sent, and gives the sequence number that it is to have. Does not allocate once it has seen one.
    pub fn note(&self, command: &MirrorCommand) -> u64 {
        let mut said = lock(&self.said);
        let sequence = if said.by_standby { command.sequence.max(said.command.sequence + 1) } else { command.sequence };
        said.by_standby = false;
        let MirrorCommand { roll, yaw, .. } = &mut said.command;
        let (mut roll, mut yaw) = (std::mem::take(roll), std::mem::take(yaw));
        roll.clear();
        roll.extend_from_slice(&command.roll);
        yaw.clear();
        yaw.extend_from_slice(&command.yaw);
        said.command = MirrorCommand { sequence, roll, yaw, ..*command };
        sequence
    }

    /// The command to give at `now`, where there is one: to park once, the last one again each time.
    pub fn speak(&self, now: Nanos) -> Option<MirrorCommand> {
        let mut said = lock(&self.said);
        let silent = match self.answer {
            Answer::LastGood => false,
            Answer::Park => said.by_standby,
            Answer::Policy | Answer::Fallback | Answer::Hold => true,
        };
        if silent || said.guard.is_stopped() || said.command.sequence == 0 {
            return None;
        }
        if self.answer == Answer::Park {
            said.command.roll.fill(0.0);
            said.command.yaw.fill(0.0);
        }
        said.by_standby = true;
        said.command.sequence += 1;
        said.command.answers = 0;
        said.command.time_ns = now;
        Some(said.command.clone())
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{Stamp, StopAction};

    use super::*;

    fn command(sequence: u64) -> MirrorCommand {
        MirrorCommand {
            epoch: 3,
            sequence,
            answers: sequence,
            time_ns: 5,
            validity_ms: 200,
            roll: vec![0.1, 0.2],
            yaw: vec![-0.1, 0.3],
        }
    }

    #[test]
    fn the_last_command_is_repeated_and_the_next_one_numbered_on() {
        let standby = Standby::new(Answer::LastGood);
        assert_eq!(standby.speak(6), None, "there is no last command yet");
        assert_eq!(standby.note(&command(7)), 7);
        for sequence in [8, 9] {
            let expected = MirrorCommand { sequence, answers: 0, time_ns: 6, ..command(7) };
            assert_eq!(standby.speak(6), Some(expected));
        }
        assert_eq!(standby.note(&command(8)), 10);
        assert_eq!(standby.note(&command(11)), 11);
        assert_eq!(standby.speak(6).map(|command| command.sequence), Some(12));
    }

    #[test]
    fn it_parks_once() {
        let standby = Standby::new(Answer::Park);
        standby.note(&command(7));
        let parked =
            MirrorCommand { sequence: 8, answers: 0, time_ns: 6, roll: vec![0.0; 2], yaw: vec![0.0; 2], ..command(7) };
        assert_eq!((standby.speak(6), standby.speak(6)), (Some(parked), None));
        standby.note(&command(9));
        assert!(standby.speak(6).is_some(), "it answered in between");
    }

    #[test]
    fn it_holds() {
        let standby = Standby::new(Answer::Hold);
        standby.note(&command(7));
        assert_eq!(standby.speak(6), None);
        assert_eq!(standby.note(&command(8)), 8);
    }

    #[test]
    fn it_says_nothing_while_the_array_is_stopped() {
        let standby = Standby::new(Answer::LastGood);
        standby.note(&command(7));
        let order = |action, time_ns| {
            let stamp = Stamp { time_ns, ..Stamp::default() };
            standby.heed(&EmergencyStop { stamp, action, ..EmergencyStop::default() });
        };
        order(StopAction::Stop, 5);
        assert_eq!(standby.speak(6), None);
        order(StopAction::Rearm, 5);
        assert_eq!(standby.speak(6), None, "too early a re-arm");
        order(StopAction::Rearm, 6);
        assert!(standby.speak(7).is_some());
    }

    #[test]
    fn noting_does_not_allocate() {
        let standby = Standby::new(Answer::LastGood);
        standby.note(&command(1));
        let next = command(2);
        let noted = allocation_counter::measure(|| assert_eq!(standby.note(&next), 2));
        assert_eq!(noted.count_total, 0);
    }
}
