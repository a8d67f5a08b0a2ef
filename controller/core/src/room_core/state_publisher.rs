//! Publishes the belief about the users and the state of the controller, after a command was
//! published and never before it.

use heliostat_proto::{BeliefReport, ControllerMemory, Message, Nanos, Stamp};

use super::input::{Output, Publish, publish};
use crate::core::{Controller, memory::Memory};

/// Shortest time between two belief reports, of position reports: 20 Hz is the rate at which viewers
/// receive a frame.
const BELIEF_INTERVAL_NS: Nanos = 50_000_000;

/// Shortest time between two states, of position reports: the longest part of a recording that a
/// replay cannot compare.
const MEMORY_INTERVAL_NS: Nanos = 1_000_000_000;

/// Publishes both messages of one room.
pub(super) struct StatePublisher {
    belief: Stream<BeliefReport>,
    memory: Stream<ControllerMemory>,
}

/// A message, its key, and when it was due last.
struct Stream<T> {
    message: T,
    output: Output,
    payload: Vec<u8>,
    interval_ns: Nanos,
    last_ns: Option<Nanos>,
}

impl StatePublisher {
    /// A publisher of a controller with this source id.
    pub fn new(source: u64) -> Self {
        let stamp = Stamp { source, ..Stamp::default() };
        let belief = BeliefReport { stamp, ..BeliefReport::buffer() };
        Self {
            belief: Stream::new(belief, Output::Belief, BELIEF_INTERVAL_NS),
            memory: Stream::new(ControllerMemory { stamp, ..Default::default() }, Output::Memory, MEMORY_INTERVAL_NS),
        }
    }

    /// Publishes what is due after the in-time decision that the controller made at `now`.
    pub fn after_decision(&mut self, controller: &mut Controller, now: Nanos, out: &mut dyn Publish) {
        let Some(report) = controller.inbox().users() else { return };
        let (tick, report_ns) = (report.tick, report.stamp.time_ns);
        if self.belief.is_due(report_ns) && controller.report_beliefs(now, &mut self.belief.message) {
            let stamp = &mut self.belief.message.stamp;
            (stamp.sequence, stamp.time_ns) = (stamp.sequence + 1, now);
            self.belief.publish(out);
        }
        if self.memory.is_due(report_ns) {
            self.publish_memory(controller, (tick, now), out);
        }
    }

    /// Publishes the state, with the inputs since the one before. A number is left out where inputs
    /// are missing, or where the state is not published: it has no subscriber, or commands are not
    /// the controller's.
    fn publish_memory(&mut self, controller: &mut Controller, (tick, now): (u64, Nanos), out: &mut dyn Publish) {
        let message = &mut self.memory.message;
        let is_complete = controller.take_inputs(&mut message.inputs);
        message.stamp.sequence += 1 + u64::from(!is_complete);
        message.stamp.time_ns = now;
        (message.epoch, message.tick) = (controller.epoch(), tick);
        let is_of_use = message.epoch > 0 && controller.unfit().is_none();
        if !is_of_use || !out.has_subscribers(Output::Memory) {
            return;
        }
        if let Ok(state) = Memory::to_bytes(&controller.memory()) {
            message.state = state;
            self.memory.publish(out);
        }
    }
}

impl<T: Message> Stream<T> {
    fn new(message: T, output: Output, interval_ns: Nanos) -> Self {
        Self { message, output, payload: Vec::new(), interval_ns, last_ns: None }
    }

    /// Whether the interval has passed at a report of this time; a clock that steps ends it too.
    fn is_due(&mut self, report_ns: Nanos) -> bool {
        let is_due = self.last_ns.is_none_or(|last_ns| report_ns.abs_diff(last_ns) >= self.interval_ns);
        if is_due {
            self.last_ns = Some(report_ns);
        }
        is_due
    }

    fn publish(&mut self, out: &mut dyn Publish) {
        publish(self.output, &self.message, &mut self.payload, out);
    }
}
