//! A controller that repeats the inputs of a schedule.

use std::collections::HashMap;
use std::rc::Rc;

use heliostat_core::core::Controller;
use heliostat_core::core::memory::Memory;
use heliostat_proto::{ControllerMemory, InputKind, MirrorCommand, Nanos, NodeKind, decode};

use super::inputs::{Input, cloned, handle};
use super::plan::RecordedCommand;
use super::schedule::{EntryIndex, Schedule, Step};

/// A message of a stream that was read from the recording.
#[derive(Clone, Debug)]
pub(super) struct Offered {
    pub entry: EntryIndex,
    pub input: Input,
    pub source: u64,
    /// As a [`ControllerInput`](heliostat_proto::ControllerInput) has it.
    pub sequence: u64,
    pub data: Vec<u8>,
}

/// A message that the current controller may have handled after its last recorded state.
pub(super) struct Tail {
    pub input: Input,
    pub data: Vec<u8>,
    pub arrived_ns: Nanos,
    /// Of a position report.
    pub answer: Option<RecordedCommand>,
}

/// What a schedule does with a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// It waits for its step.
    Step,
    /// It comes after the last step.
    Tail,
    /// The controller did not accept it.
    Nowhere,
}

/// A decision of a step.
pub(super) struct Decided {
    /// The command for each array, unless the controller held.
    pub commands: Vec<(usize, MirrorCommand)>,
    /// Whether the state was known.
    pub counts: bool,
}

/// What became of the message of a step.
enum Passed {
    Handled,
    /// The recording does not have it.
    Missing,
    /// It comes later in the recording.
    Unread,
}

/// A message of a step.
struct Waiting {
    input: Input,
    source: u64,
    data: Vec<u8>,
}

/// The progress in a schedule.
pub(super) struct Progress {
    schedule: Rc<Schedule>,
    next: usize,
    waiting: HashMap<EntryIndex, Waiting>,
    /// Whether the controller has the recorded state.
    pub is_known: bool,
    /// Why a state was not restored.
    pub problem: Option<String>,
}

impl Progress {
    pub fn new(schedule: Rc<Schedule>) -> Self {
        Self { schedule, next: 0, waiting: HashMap::new(), is_known: false, problem: None }
    }

    /// Whether every step was taken.
    pub fn is_complete(&self) -> bool {
        self.next == self.schedule.steps.len()
    }

    /// Decides where a message belongs; a message of a step is kept.
    pub fn place(&mut self, offered: &Offered) -> Place {
        let Offered { entry, input, source, sequence, data } = offered;
        if self.schedule.names(*entry) {
            self.waiting.insert(*entry, Waiting { input: *input, source: *source, data: data.clone() });
            return Place::Step;
        }
        if self.schedule.is_later(input.0, *source, *sequence) { Place::Tail } else { Place::Nowhere }
    }

    /// Keeps a memory message for its step.
    pub fn keep_memory(&mut self, entry: EntryIndex, data: &[u8]) {
        if self.schedule.names(entry) {
            self.waiting.insert(entry, Waiting { input: Input::default(), source: 0, data: data.to_vec() });
        }
    }

    /// Takes all steps whose messages were read, up to the entry `read`, and returns the decisions
    /// to which the recorded controller gave a command.
    pub fn advance(&mut self, controller: &mut Controller, read: EntryIndex) -> Vec<Decided> {
        let mut decisions = Vec::new();
        while let Some(step) = self.schedule.steps.get(self.next).copied() {
            match step {
                Step::Gap => self.is_known = false,
                Step::Handle { entry: None, .. } => self.is_known = false,
                Step::Handle { entry: Some(entry), now } => match self.pass(controller, entry, now, read) {
                    Passed::Unread => return decisions,
                    Passed::Missing => self.is_known = false,
                    Passed::Handled => {}
                },
                Step::Decide { input, now, gave_command, withheld } => {
                    // A state does not say which reports of an array count for its stops.
                    if gave_command {
                        controller.repeat_withheld(withheld);
                    }
                    let commands = controller.poll_recorded(input, now).map(cloned).unwrap_or_default();
                    if gave_command {
                        decisions.push(Decided { commands, counts: self.is_known });
                    } else {
                        // A replay does not know why the controller held, for example in standby.
                        self.is_known &= commands.is_empty();
                    }
                }
                Step::Load { entry } => match self.waiting.remove(&entry) {
                    Some(Waiting { data, .. }) if !self.is_known => self.load(controller, &data),
                    Some(_) => {}
                    None if entry > read => return decisions,
                    None => {}
                },
            }
            self.next += 1;
        }
        decisions
    }

    /// Passes the message of a step. Where the controller refuses it, passes the next one with its number.
    fn pass(&mut self, controller: &mut Controller, entry: EntryIndex, now: Nanos, read: EntryIndex) -> Passed {
        let schedule = Rc::clone(&self.schedule);
        let mut passed = Passed::Missing;
        for candidate in schedule.candidates(entry) {
            match self.waiting.remove(&candidate) {
                Some(Waiting { input, source, data }) => {
                    // The recorded controller accepted the message, so it knew that its source
                    // was alive. The recorder may have missed its return, or received it later.
                    controller.handle_source_found(publisher(input.0), source);
                    let refused = controller.inbox().refused().total();
                    handle(controller, input, &data, now);
                    passed = Passed::Handled;
                    if controller.inbox().refused().total() == refused {
                        break;
                    }
                }
                None if candidate > read => return Passed::Unread,
                None => {}
            }
        }
        passed
    }

    fn load(&mut self, controller: &mut Controller, data: &[u8]) {
        let Ok(message) = decode::<ControllerMemory>(data) else { return };
        let restored = Memory::from_bytes(&message.state).and_then(|memory| controller.restore(&memory));
        self.is_known = restored.is_ok();
        if let Err(error) = restored {
            self.problem.get_or_insert(error.to_string());
        }
    }
}

/// A kind of process that publishes the stream of an input.
fn publisher(input: InputKind) -> NodeKind {
    if input == InputKind::Telemetry { NodeKind::Driver } else { NodeKind::Tracker }
}
