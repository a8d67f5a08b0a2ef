//! Numbers, encodes and publishes the commands of one room.
//!
//! For each array the sender owns the publisher, the sequence number, the payload buffer and a copy
//! of the last command behind one lock. The decision loop holds the lock for one publication. The watchdog
//! shares the sender, and sends nothing if the lock is held.

use std::sync::Mutex;

use heliostat_bus::Publisher;
use heliostat_proto::{MirrorCommand, Nanos, encode};

use super::locks::{lock, try_lock};

/// Sends the commands of one room.
pub struct CommandSender {
    /// One for each array.
    states: Vec<Mutex<State>>,
}

struct State {
    publisher: Publisher,
    payload: Vec<u8>,
    last: LastCommand,
}

/// A command that is sent on behalf of the policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnBehalf {
    /// The last command, again at each call.
    RepeatLast,
    /// A valid command with zero roll and yaw, once until the policy decides again.
    Park,
}

impl CommandSender {
    /// A sender for arrays of these numbers of mirrors.
    pub fn new(arrays: impl IntoIterator<Item = (Publisher, usize)>) -> Self {
        let state = |(publisher, mirrors): (Publisher, usize)| {
            // Two f32 per mirror, and less than 100 bytes for the other fields.
            let payload = Vec::with_capacity(100 + 8 * mirrors);
            Mutex::new(State { publisher, payload, last: LastCommand::default() })
        };
        Self { states: arrays.into_iter().map(state).collect() }
    }

    /// Numbers and publishes a command to an array; false where the transport refuses it. Does not
    /// allocate after the first command.
    pub fn send(&self, array: usize, command: &mut MirrorCommand) -> bool {
        let State { publisher, payload, last } = &mut *lock(&self.states[array]);
        last.number(command);
        publish(publisher, payload, command)
    }

    /// Number of arrays.
    pub fn arrays(&self) -> usize {
        self.states.len()
    }

    /// Epoch and sequence number of the last command to an array; 0 before the first.
    pub fn last_sent(&self, array: usize) -> (u64, u64) {
        let state = lock(&self.states[array]);
        (state.last.command.epoch, state.last.command.sequence)
    }

    /// Publishes a command to an array on behalf of the policy at `now`; false where the transport
    /// refuses it.
    ///
    /// Sends nothing before the first command, while another command is being sent, and to park a
    /// second time.
    pub fn send_on_behalf(&self, array: usize, action: OnBehalf, now: Nanos) -> bool {
        let Some(mut state) = try_lock(&self.states[array]) else { return true };
        let State { publisher, payload, last } = &mut *state;
        match last.on_behalf(action, now) {
            Some(command) => publish(publisher, payload, command),
            None => true,
        }
    }
}

/// Encodes and publishes. A command of the core always encodes, so only the transport fails.
fn publish(publisher: &Publisher, payload: &mut Vec<u8>, command: &MirrorCommand) -> bool {
    encode(command, payload).is_ok() && publisher.put(payload).is_ok()
}

/// The last command and its number.
#[derive(Default)]
struct LastCommand {
    /// Its sequence number is 0 before the first command.
    command: MirrorCommand,
    /// Whether it was sent on behalf of the policy.
    on_behalf: bool,
}

impl LastCommand {
    /// Assigns the next sequence number of its epoch to a command of the policy, and keeps a copy.
    /// Does not allocate after the first command.
    fn number(&mut self, command: &mut MirrorCommand) {
        let last = if self.command.epoch == command.epoch { self.command.sequence } else { 0 };
        command.sequence = last + 1;
        let MirrorCommand { roll, yaw, .. } = &mut self.command;
        let (mut roll, mut yaw) = (std::mem::take(roll), std::mem::take(yaw));
        roll.clear();
        roll.extend_from_slice(&command.roll);
        yaw.clear();
        yaw.extend_from_slice(&command.yaw);
        self.command = MirrorCommand { roll, yaw, ..*command };
        self.on_behalf = false;
    }

    /// The next command on behalf of the policy, if one is due.
    fn on_behalf(&mut self, action: OnBehalf, now: Nanos) -> Option<&MirrorCommand> {
        let is_parked = action == OnBehalf::Park && self.on_behalf;
        if is_parked || self.command.sequence == 0 {
            return None;
        }
        if action == OnBehalf::Park {
            self.command.roll.fill(0.0);
            self.command.yaw.fill(0.0);
        }
        self.on_behalf = true;
        self.command.sequence += 1;
        self.command.answers = 0;
        self.command.time_ns = now;
        Some(&self.command)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A command as the core gives it: without a sequence number.
    fn command(answers: u64) -> MirrorCommand {
        MirrorCommand {
            epoch: 3,
            sequence: 0,
            answers,
            time_ns: 5,
            validity_ms: 200,
            roll: vec![0.1, 0.2],
            yaw: vec![-0.1, 0.3],
        }
    }

    fn number(last: &mut LastCommand, answers: u64) -> u64 {
        let mut command = command(answers);
        last.number(&mut command);
        command.sequence
    }

    #[test]
    fn commands_are_numbered_from_one_without_a_gap() {
        let mut last = LastCommand::default();
        assert_eq!([1, 2, 3].map(|answers| number(&mut last, answers)), [1, 2, 3]);
    }

    #[test]
    fn numbers_begin_again_with_each_epoch() {
        let mut last = LastCommand::default();
        let mut sequence = |epoch| {
            let mut command = MirrorCommand { epoch, ..command(1) };
            last.number(&mut command);
            command.sequence
        };
        assert_eq!([3, 3, 4, 4].map(&mut sequence), [1, 2, 1, 2]);
    }

    #[test]
    fn repeated_commands_and_later_commands_share_one_numbering() {
        let mut last = LastCommand::default();
        assert_eq!(last.on_behalf(OnBehalf::RepeatLast, 6), None, "there is no last command yet");
        number(&mut last, 7);
        for sequence in [2, 3] {
            let expected = MirrorCommand { sequence, answers: 0, time_ns: 6, ..command(7) };
            assert_eq!(last.on_behalf(OnBehalf::RepeatLast, 6), Some(&expected));
        }
        assert_eq!([8, 9].map(|answers| number(&mut last, answers)), [4, 5]);
    }

    #[test]
    fn the_array_is_parked_once_until_the_policy_decides() {
        let mut last = LastCommand::default();
        number(&mut last, 7);
        let parked =
            MirrorCommand { sequence: 2, answers: 0, time_ns: 6, roll: vec![0.0; 2], yaw: vec![0.0; 2], ..command(7) };
        assert_eq!(last.on_behalf(OnBehalf::Park, 6), Some(&parked));
        assert_eq!(last.on_behalf(OnBehalf::Park, 6), None);
        number(&mut last, 9);
        assert!(last.on_behalf(OnBehalf::Park, 6).is_some(), "the policy decided in between");
    }

    #[test]
    fn numbering_does_not_allocate() {
        let (mut last, mut next) = (LastCommand::default(), command(2));
        number(&mut last, 1);
        assert_eq!(allocation_counter::measure(|| last.number(&mut next)).count_total, 0);
        assert_eq!(next.sequence, 2);
    }
}
