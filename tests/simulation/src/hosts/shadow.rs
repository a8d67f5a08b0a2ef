//! A replay beside a controller: the inputs of its journal, from each of its states.
//!
//! The replay follows `heliostat replay`: it handles the messages that the journal names, repeats the
//! decisions, and takes the recorded state again from time to time.

use heliostat_core::core::{Controller, Timing, memory::Memory};
use heliostat_core::inbox::Message;
use heliostat_proto::{
    ChannelReport, ControllerInput, EmergencyStop, InputKind, MirrorCommand, MirrorTelemetry, NodeKind, SafetyReport,
    StopReport, UserReport, decode,
};

use super::adapter::{Adapter, Input};
use super::policy::{PolicySwitch, policy};
use crate::plan::PolicyFault;
use crate::room::Room;
use crate::topic::Topic;

/// Decisions between two states.
const STATE_DECISIONS: u64 = 50;

/// A second controller of the same room.
pub(crate) struct Shadow {
    controller: Controller,
    switch: PolicySwitch,
    inputs: Vec<ControllerInput>,
    /// Whether it has the state of the first one.
    is_known: bool,
    decisions: u64,
    /// Commands that were compared.
    pub compared: u64,
}

impl Shadow {
    pub fn new(room: &Room) -> Self {
        let switch = PolicySwitch::default();
        let controller = Controller::new(&room.scenario, (*room.model).clone(), policy(room, &switch), 1);
        Self { controller, switch, inputs: Vec::new(), is_known: false, decisions: 0, compared: 0 }
    }

    /// The policy fails in this way.
    pub fn set_fault(&self, fault: Option<PolicyFault>) {
        self.switch.set(fault);
    }

    /// Repeats what the first controller did about an input; the difference of the commands, if there is
    /// one. A deliberate bug gives an outdated state.
    pub fn follow(
        &mut self,
        adapter: &mut Adapter,
        input: &Input,
        published: &[(Topic, Vec<u8>)],
        outdated: Option<Memory>,
    ) -> Result<(), String> {
        self.announce(input);
        let mut inputs = std::mem::take(&mut self.inputs);
        self.is_known &= adapter.take_inputs(&mut inputs);
        for recorded in &inputs {
            self.step(recorded, input, published)?;
        }
        let is_decision = inputs.iter().any(|recorded| recorded.input == InputKind::Decision && recorded.command);
        self.inputs = inputs;
        if is_decision {
            self.decisions += 1;
            if !self.is_known || self.decisions.is_multiple_of(STATE_DECISIONS) {
                self.load(&outdated.unwrap_or_else(|| adapter.memory()))?;
            }
        }
        Ok(())
    }

    fn load(&mut self, memory: &Memory) -> Result<(), String> {
        let bytes = memory.to_bytes().map_err(|error| format!("the state cannot be written: {error}"))?;
        let state = Memory::from_bytes(&bytes).map_err(|error| format!("the state cannot be read: {error}"))?;
        self.controller.restore(&state).map_err(|error| format!("the state cannot be restored: {error}"))?;
        self.is_known = true;
        Ok(())
    }

    /// Messages that the journal does not name.
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

    fn step(
        &mut self,
        recorded: &ControllerInput,
        input: &Input,
        published: &[(Topic, Vec<u8>)],
    ) -> Result<(), String> {
        let now = recorded.time_ns;
        if !matches!(
            recorded.input,
            InputKind::Decision | InputKind::LateDecision | InputKind::StaleDecision | InputKind::SilenceDecision
        ) {
            self.handle(recorded, input);
            return Ok(());
        }
        if recorded.command {
            self.controller.repeat_withheld(recorded.sequence);
        }
        let ours = self.decide(recorded);
        if !recorded.command {
            self.is_known &= ours.is_empty();
            return Ok(());
        }
        let theirs = published.iter().filter_map(|(topic, payload)| match topic {
            Topic::Command(array) => Some((*array, decode::<MirrorCommand>(payload).ok()?)),
            _ => None,
        });
        let unnumbered =
            |(array, command): (usize, MirrorCommand)| (array, MirrorCommand { epoch: 0, sequence: 0, ..command });
        let theirs: Vec<_> = theirs.map(unnumbered).collect();
        let ours: Vec<_> = ours.into_iter().map(unnumbered).collect();
        self.compared += u64::from(self.is_known);
        if self.is_known && ours != theirs {
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
            Topic::Users => {
                if let Ok(mut report) = decode::<UserReport>(payload) {
                    self.controller.handle_message(now, Message::Users(&mut report));
                }
            }
            Topic::Channel => {
                if let Ok(mut report) = decode::<ChannelReport>(payload) {
                    self.controller.handle_message(now, Message::Channel(&mut report));
                }
            }
            Topic::Telemetry(array) => {
                if let Ok(mut report) = decode::<MirrorTelemetry>(payload) {
                    self.controller.handle_message(now, Message::Telemetry(*array, &mut report));
                }
            }
            _ => {}
        }
    }

    fn decide(&mut self, recorded: &ControllerInput) -> Vec<(usize, MirrorCommand)> {
        let now = recorded.time_ns;
        let decision = match recorded.input {
            InputKind::LateDecision => self.controller.poll_command(now, Timing::Late, &mut |_| {}),
            InputKind::StaleDecision => self.controller.poll_stale_command(now),
            InputKind::SilenceDecision => match self.controller.poll_timeout_command(now) {
                Some(decision) => decision,
                None => return Vec::new(),
            },
            _ => self.controller.poll_command(now, Timing::InTime, &mut |_| {}),
        };
        decision.commands().map(|(array, command)| (array, command.clone())).collect()
    }
}
