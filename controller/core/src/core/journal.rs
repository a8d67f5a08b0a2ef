//! The inputs of a controller in the order in which it handled them, so that a replay can repeat
//! them.

use heliostat_proto::{ControllerInput, InputKind, MAX_INPUTS, Nanos, Stamp};

use crate::input::refusal::Stream;

/// Inputs since they were last taken; by default none is kept. Does not allocate after its creation.
#[derive(Clone, Default)]
pub(super) struct Journal {
    inputs: Vec<ControllerInput>,
    is_complete: bool,
}

impl Journal {
    /// A journal of at most [`MAX_INPUTS`] inputs.
    pub fn enabled() -> Self {
        Self { inputs: Vec::with_capacity(MAX_INPUTS), is_complete: true }
    }

    /// Records an accepted message.
    pub fn record_message(&mut self, (stream, array): (Stream, usize), stamp: &Stamp, now: Nanos) {
        let input = match stream {
            Stream::Users => InputKind::Users,
            Stream::Channel => InputKind::Channel,
            Stream::Obstacles => InputKind::Obstacles,
            Stream::Telemetry => InputKind::Telemetry,
            Stream::Orientation => InputKind::Orientation,
            Stream::Leds => InputKind::Leds,
        };
        let source = stamp.source;
        let sequence = ControllerInput::sequence_of(array, stamp.sequence);
        self.push(ControllerInput { input, source, sequence, time_ns: now, command: false });
    }

    /// Records a decision that begins.
    pub fn record_decision(&mut self, input: InputKind, now: Nanos) {
        self.push(ControllerInput { input, source: 0, sequence: 0, time_ns: now, command: false });
    }

    /// The last recorded decision gives a command, to all arrays but those whose bits are set.
    pub fn record_command(&mut self, withheld: u64) {
        if let Some(decision) = self.inputs.last_mut() {
            (decision.command, decision.sequence) = (true, withheld);
        }
    }

    /// Exchanges the inputs for an empty list; false where inputs are missing since the last call.
    pub fn take(&mut self, into: &mut Vec<ControllerInput>) -> bool {
        into.clear();
        into.reserve(self.inputs.capacity());
        std::mem::swap(&mut self.inputs, into);
        std::mem::replace(&mut self.is_complete, self.inputs.capacity() > 0)
    }

    fn push(&mut self, input: ControllerInput) {
        if self.inputs.len() < self.inputs.capacity() {
            self.inputs.push(input);
        } else {
            self.is_complete = false;
        }
    }
}
