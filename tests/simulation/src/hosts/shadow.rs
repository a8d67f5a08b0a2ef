//! A replay beside a controller, as `heliostat replay` does it: from the states that the controller
//! publishes, with the inputs that they list.

use std::rc::Rc;

use heliostat_core::core::{Controller, memory::Memory};
use heliostat_core::inbox::Message;
use heliostat_core::room_core::Output;
use heliostat_proto::{
    ChannelReport, ControllerInput, ControllerMemory, EmergencyStop, InputKind, LedReport, MirrorCommand,
    MirrorTelemetry, Nanos, NodeKind, ObstacleReport, OrientationReport, SafetyReport, Stamp, StopReport, UserReport,
    decode,
};

use super::adapter::{Input, Published};
use super::policy::{PolicySwitch, policy};
use crate::plan::PolicyFault;
use crate::room::Room;
use crate::topic::Topic;

/// What the first controller handled at one time, and the commands that it gave.
struct Handled {
    at_ns: Nanos,
    fault: Option<PolicyFault>,
    input: Input,
    commands: Vec<(usize, MirrorCommand)>,
}

/// A second controller of the same room.
pub(crate) struct Shadow {
    controller: Controller,
    switch: PolicySwitch,
    fault: Option<PolicyFault>,
    /// What the first controller handled since its last state.
    handled: Vec<Handled>,
    /// Whether it has the state of the first one.
    is_known: bool,
    /// The number and the state of the last message.
    last: (u64, Rc<[u8]>),
}

impl Shadow {
    pub fn new(room: &Room) -> Self {
        let switch = PolicySwitch::default();
        let controller = Controller::new(&room.scenario, (*room.model).clone(), policy(room, &switch), 1);
        let last = (0, Rc::from([]));
        Self { controller, switch, fault: None, handled: Vec::new(), is_known: false, last }
    }

    /// The policy fails in this way from now on.
    pub fn set_fault(&mut self, fault: Option<PolicyFault>) {
        self.fault = fault;
    }

    /// Notes what the first controller did. At a state of it, repeats what it did since the state
    /// before; the difference of the commands, if there is one. A deliberate bug gives an outdated
    /// state.
    pub fn follow(
        &mut self,
        at_ns: Nanos,
        input: &Input,
        published: &Published,
        is_outdated: bool,
    ) -> Result<(), String> {
        let command = |(output, payload): &(Output, Vec<u8>)| match output {
            Output::Command(array) => Some((*array, unnumbered(decode::<MirrorCommand>(payload).ok()?))),
            _ => None,
        };
        let commands = published.iter().filter_map(command).collect();
        self.handled.push(Handled { at_ns, fault: self.fault, input: input.clone(), commands });
        let state = published.iter().find(|(output, _)| *output == Output::Memory);
        let Some((_, payload)) = state else { return Ok(()) };
        let message = decode(payload).map_err(|error| format!("the message of the state does not decode: {error}"))?;
        self.repeat(message, is_outdated)
    }

    fn repeat(&mut self, message: ControllerMemory, is_outdated: bool) -> Result<(), String> {
        let (last, last_state) = std::mem::replace(&mut self.last, (message.stamp.sequence, Rc::from(&*message.state)));
        self.is_known &= message.stamp.sequence == last + 1;
        let mut handled = std::mem::take(&mut self.handled);
        let mut next = 0;
        for input in &message.inputs {
            let candidates: Vec<usize> = (next..handled.len()).filter(|index| is_of(&handled[*index], input)).collect();
            if candidates.is_empty() {
                return Err(format!("the state lists {input:?}, which was not handled"));
            }
            for index in candidates {
                handled[next..index].iter().for_each(|passed| self.announce(&passed.input));
                next = index;
                self.switch.set(handled[index].fault);
                let refused = self.controller.inbox().refused().total();
                self.step(input, &mut handled[index])?;
                // A forged message has the number of one that the controller accepts.
                if is_decision(input.input) || self.controller.inbox().refused().total() == refused {
                    break;
                }
            }
        }
        handled[next..].iter().for_each(|passed| self.announce(&passed.input));
        let has_former = is_outdated && !last_state.is_empty();
        self.load(if has_former { &last_state } else { &message.state })
    }

    fn load(&mut self, state: &[u8]) -> Result<(), String> {
        let state = Memory::from_bytes(state).map_err(|error| format!("the state cannot be read: {error}"))?;
        self.controller.restore(&state).map_err(|error| format!("the state cannot be restored: {error}"))?;
        self.is_known = true;
        Ok(())
    }

    /// Messages that no state lists.
    fn announce(&mut self, input: &Input) {
        match input {
            Input::Payload(Topic::Capabilities(array), payload) => {
                if let Ok(capabilities) = decode(payload) {
                    self.controller.handle_capabilities(*array, &capabilities, Ok(()));
                }
            }
            Input::Payload(Topic::Safety(array), payload) => {
                if let Ok(report) = decode::<SafetyReport>(payload) {
                    self.controller.handle_safety(*array, &report);
                }
            }
            Input::Payload(Topic::Stops(array), payload) => {
                if let Ok(report) = decode::<StopReport>(payload) {
                    self.controller.handle_stops(*array, &report);
                }
            }
            Input::Payload(Topic::Stop, payload) => {
                if let Ok(order) = decode::<EmergencyStop>(payload) {
                    self.controller.handle_stop_order(0, &order);
                }
            }
            Input::Presence { node, source, is_alive: true } => self.controller.handle_source_found(*node, *source),
            Input::Presence { node, source, is_alive: false } => self.controller.handle_source_lost(*node, *source),
            _ => {}
        }
    }

    fn step(&mut self, recorded: &ControllerInput, handled: &mut Handled) -> Result<(), String> {
        if !is_decision(recorded.input) {
            self.handle(recorded, &handled.input);
            return Ok(());
        }
        // What was handled before the decision, at the same time, and no state lists.
        self.announce(&handled.input);
        if recorded.command {
            self.controller.repeat_withheld(recorded.sequence);
        }
        let ours = self.decide(recorded);
        let theirs = std::mem::take(&mut handled.commands);
        if !recorded.command {
            self.is_known &= ours.is_empty();
        } else if self.is_known && ours != theirs {
            let now = recorded.time_ns;
            return Err(format!("the replay from a state at {now} gives {ours:?}, expected {theirs:?}"));
        }
        Ok(())
    }

    fn handle(&mut self, recorded: &ControllerInput, input: &Input) {
        let Input::Payload(topic, payload) = input else { return };
        let node = if recorded.input == InputKind::Telemetry { NodeKind::Driver } else { NodeKind::Tracker };
        self.controller.handle_source_found(node, recorded.source);
        let now = recorded.time_ns;
        match topic {
            Topic::Users => self.pass(now, payload, |report| Message::Users(report)),
            Topic::Channel => self.pass(now, payload, |report| Message::Channel(report)),
            Topic::Obstacles => self.pass(now, payload, |report| Message::Obstacles(report)),
            Topic::Orientation => self.pass(now, payload, |report| Message::Orientation(report)),
            Topic::Leds => self.pass(now, payload, |report| Message::Leds(report)),
            Topic::Telemetry(array) => self.pass(now, payload, |report| Message::Telemetry(*array, report)),
            _ => {}
        }
    }

    fn pass<T: heliostat_proto::Message>(
        &mut self,
        now: Nanos,
        payload: &[u8],
        message: impl for<'a> Fn(&'a mut T) -> Message<'a>,
    ) {
        if let Ok(mut report) = decode::<T>(payload) {
            self.controller.handle_message(now, message(&mut report));
        }
    }

    fn decide(&mut self, recorded: &ControllerInput) -> Vec<(usize, MirrorCommand)> {
        let Some(decision) = self.controller.poll_recorded(recorded.input, recorded.time_ns) else { return Vec::new() };
        decision.commands().map(|(array, command)| (array, unnumbered(command.clone()))).collect()
    }
}

/// A command without the numbers that a replay does not have.
fn unnumbered(command: MirrorCommand) -> MirrorCommand {
    MirrorCommand { epoch: 0, sequence: 0, ..command }
}

fn is_decision(input: InputKind) -> bool {
    use InputKind::{Decision, LateDecision, SilenceDecision, StaleDecision};
    matches!(input, Decision | LateDecision | StaleDecision | SilenceDecision)
}

/// Whether an input of a state is what was handled.
fn is_of(handled: &Handled, input: &ControllerInput) -> bool {
    let stamp_of = |topic: Topic, payload: &[u8]| -> Option<(InputKind, usize, Stamp)> {
        Some(match topic {
            Topic::Users => (InputKind::Users, 0, decode::<UserReport>(payload).ok()?.stamp),
            Topic::Channel => (InputKind::Channel, 0, decode::<ChannelReport>(payload).ok()?.stamp),
            Topic::Obstacles => (InputKind::Obstacles, 0, decode::<ObstacleReport>(payload).ok()?.stamp),
            Topic::Orientation => (InputKind::Orientation, 0, decode::<OrientationReport>(payload).ok()?.stamp),
            Topic::Leds => (InputKind::Leds, 0, decode::<LedReport>(payload).ok()?.stamp),
            Topic::Telemetry(array) => (InputKind::Telemetry, array, decode::<MirrorTelemetry>(payload).ok()?.stamp),
            _ => return None,
        })
    };
    if handled.at_ns != input.time_ns {
        return false;
    }
    match &handled.input {
        _ if is_decision(input.input) => !input.command || !handled.commands.is_empty(),
        Input::Payload(topic, payload) => stamp_of(*topic, payload).is_some_and(|(kind, array, stamp)| {
            let sequence = ControllerInput::sequence_of(array, stamp.sequence);
            (kind, stamp.source, sequence) == (input.input, input.source, input.sequence)
        }),
        _ => false,
    }
}
