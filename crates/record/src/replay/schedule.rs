//! The inputs of a recorded controller in the order in which it handled them.
//!
//! Each memory message of a controller lists its inputs since the one before, and has the state after
//! the last of them. A replay repeats these inputs, whatever the order in which the recorder
//! received the messages, and whichever of them the controller refused, dropped or never received.
//! Where a listed message is not in the recording, or a list is missing, the state is unknown until
//! the next state.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::iter;
use std::rc::Rc;

use heliostat_proto::{ControllerInput, ControllerMemory, InputKind, Nanos};

/// Number of an entry of the recording, from 0.
pub(super) type EntryIndex = u64;

/// One step of a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// It handled a message at this time; without an entry, the recording lacks the message.
    Handle { entry: Option<EntryIndex>, now: Nanos },
    /// It decided at this time.
    /// `withheld` has the bits of the arrays that got no command.
    Decide { input: InputKind, now: Nanos, gave_command: bool, withheld: u64 },
    /// The steps before this one are not known.
    Gap,
    /// It had the state of this entry.
    Load { entry: EntryIndex },
}

/// The steps of a controller in one epoch.
#[derive(Debug, Default)]
pub(super) struct Schedule {
    pub steps: Vec<Step>,
    /// The entries that the steps name.
    named: HashSet<EntryIndex>,
    /// The later messages with the number of a message, where there are some. A forged message may be before
    /// the one that the controller accepted.
    others: HashMap<EntryIndex, Vec<EntryIndex>>,
    /// The last sequence number of each stream and source in the steps.
    last: HashMap<Sender, u64>,
}

impl Schedule {
    /// Whether a step names this entry.
    pub fn names(&self, entry: EntryIndex) -> bool {
        self.named.contains(&entry)
    }

    /// The messages with the number of that of a step, in the order of the recording.
    pub fn candidates(&self, entry: EntryIndex) -> impl Iterator<Item = EntryIndex> {
        iter::once(entry).chain(self.others.get(&entry).into_iter().flatten().copied())
    }

    /// Whether a message is later than all messages of its source in the steps: the controller may
    /// have handled it after the last state.
    pub fn is_later(&self, input: InputKind, source: u64, sequence: u64) -> bool {
        self.last.get(&sender(input, source, sequence)).is_none_or(|last| sequence > *last)
    }
}

/// A stream and its source, with the index of the array for telemetry.
type Sender = (InputKind, u64, u64);

/// The sender of a message with this sequence number, as a [`ControllerInput`] has it.
fn sender(input: InputKind, source: u64, sequence: u64) -> Sender {
    let array = if input == InputKind::Telemetry { sequence >> ControllerInput::ARRAY_SHIFT } else { 0 };
    (input, source, array)
}

/// Collects messages and memories in a first pass over a recording.
#[derive(Default)]
pub(super) struct ScheduleBuilder {
    messages: HashMap<(InputKind, u64, u64), EntryIndex>,
    others: HashMap<EntryIndex, Vec<EntryIndex>>,
    memories: Vec<(EntryIndex, ControllerMemory)>,
}

impl ScheduleBuilder {
    /// Notes a report or a telemetry message, with its sequence number as a [`ControllerInput`] has
    /// it. Of messages with one number a controller accepts one.
    pub fn add_message(&mut self, entry: EntryIndex, input: InputKind, source: u64, sequence: u64) {
        let first = *self.messages.entry((input, source, sequence)).or_insert(entry);
        if first != entry {
            self.others.entry(first).or_default().push(entry);
        }
    }

    /// Notes the inputs of a memory message; its state is read when the step is replayed.
    pub fn add_memory(&mut self, entry: EntryIndex, memory: ControllerMemory) {
        self.memories.push((entry, ControllerMemory { state: Vec::new(), ..memory }));
    }

    /// The schedules by epoch.
    pub fn build(self) -> BTreeMap<u64, Rc<Schedule>> {
        let mut schedules: BTreeMap<u64, Schedule> = BTreeMap::new();
        let mut last: HashMap<u64, u64> = HashMap::new();
        for (entry, memory) in &self.memories {
            let stamp = &memory.stamp;
            let former = last.insert(stamp.source, stamp.sequence);
            let schedule = schedules.entry(memory.epoch).or_default();
            if former.is_none_or(|former| stamp.sequence.checked_sub(former) != Some(1)) {
                schedule.steps.push(Step::Gap);
            }
            memory.inputs.iter().for_each(|input| schedule.add(input, &self));
            schedule.steps.push(Step::Load { entry: *entry });
            schedule.named.insert(*entry);
        }
        schedules.into_iter().map(|(epoch, schedule)| (epoch, Rc::new(schedule))).collect()
    }
}

impl Schedule {
    fn add(&mut self, input: &ControllerInput, builder: &ScheduleBuilder) {
        let ControllerInput { input: kind, source, sequence, time_ns: now, command: gave_command } = *input;
        match kind {
            InputKind::Users
            | InputKind::Channel
            | InputKind::Obstacles
            | InputKind::Orientation
            | InputKind::Leds
            | InputKind::Telemetry => {
                let entry = builder.messages.get(&(kind, source, sequence)).copied();
                if let Some((first, others)) = entry.and_then(|entry| builder.others.get_key_value(&entry)) {
                    self.named.extend(others);
                    self.others.insert(*first, others.clone());
                }
                self.named.extend(entry);
                self.last.insert(sender(kind, source, sequence), sequence);
                self.steps.push(Step::Handle { entry, now });
            }
            InputKind::Decision | InputKind::LateDecision | InputKind::StaleDecision | InputKind::SilenceDecision => {
                self.steps.push(Step::Decide { input: kind, now, gave_command, withheld: sequence })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Stamp;

    use super::*;

    fn memory(sequence: u64, users: &[u64]) -> ControllerMemory {
        let report = |sequence: &u64| ControllerInput {
            source: 5,
            sequence: *sequence,
            time_ns: 10 * sequence,
            ..ControllerInput::default()
        };
        let stamp = Stamp { source: 9, sequence, time_ns: 0 };
        ControllerMemory { stamp, epoch: 3, inputs: users.iter().map(report).collect(), ..Default::default() }
    }

    #[test]
    fn steps_follow_the_controller_and_gaps_and_missing_messages_are_visible() {
        let mut builder = ScheduleBuilder::default();
        for (entry, sequence) in [(0, 7), (1, 9), (2, 8), (3, 9)] {
            builder.add_message(entry, InputKind::Users, 5, sequence);
        }
        for (entry, sequence, users) in [(4, 20, &[7, 8][..]), (5, 21, &[9, 10]), (6, 23, &[])] {
            builder.add_memory(entry, memory(sequence, users));
        }
        let schedules = builder.build();
        let schedule = &schedules[&3];
        let handle = |entry, now| Step::Handle { entry, now };
        let expected = [
            Step::Gap,
            handle(Some(0), 70),
            handle(Some(2), 80),
            Step::Load { entry: 4 },
            handle(Some(1), 90),
            handle(None, 100),
            Step::Load { entry: 5 },
            Step::Gap,
            Step::Load { entry: 6 },
        ];
        assert_eq!(schedule.steps, expected);
        assert!(schedule.names(1) && schedule.names(3), "a number may be that of two messages");
        assert_eq!(schedule.candidates(1).collect::<Vec<_>>(), [1, 3]);
        assert!(!schedule.is_later(InputKind::Users, 5, 10) && schedule.is_later(InputKind::Users, 5, 11));
    }
}
