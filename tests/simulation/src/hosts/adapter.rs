//! The production [`Controller`] with what its process does around it: decoding, announcements,
//! repetition of stops, timeouts.
//!
//! Everything about the controller process is behind [`Adapter::handle`] and [`Adapter::next_ns`], so
//! that another driver of the core can replace this file.

use std::rc::Rc;

use heliostat_array::moment::Moment;
use heliostat_core::capabilities::{Examiner, Force};
use heliostat_core::core::{Controller, Decision, DegradedMode, Due, Timing, memory::Memory};
use heliostat_core::inbox::Message;
use heliostat_core::refusal::{Refusal, Stream};
use heliostat_core::tenure::{Standing, Tenure, TenureEvent};
use heliostat_proto::{
    Capabilities, ChannelReport, ControllerInput, EmergencyStop, MirrorTelemetry, NodeKind, RoomGeometry, SafetyReport,
    Stamp, StopRepetition, StopReport, UserReport, decode,
};

use super::encoded;
use super::policy::{PolicySwitch, policy};
use crate::monitor::Tally;
use crate::plan::PolicyFault;
use crate::room::Room;
use crate::topic::Topic;

/// Time between two polls of the timeouts in ns.
const TIMEOUT_NS: u64 = 50_000_000;

/// Time between two repetitions of a stop in ns.
const REPEAT_NS: u64 = 200_000_000;

/// Time between two announcements of the geometry in ns.
const GEOMETRY_NS: u64 = 1_000_000_000;

/// What a controller process handles.
#[derive(Clone, Debug)]
pub(crate) enum Input {
    /// A payload of a topic.
    Payload(Topic, Rc<[u8]>),
    /// A liveliness token appeared or ended.
    Presence { node: NodeKind, source: u64, is_alive: bool },
    /// Nothing arrived in time.
    Wake,
}

/// How a controller stands by.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Standby {
    /// Whether it begins in standby, as by `--standby`.
    pub is_reserve: bool,
    /// The rank that the operator gave.
    pub rank: Option<u8>,
}

/// Topics and payloads that are published.
pub(crate) type Published = Vec<(Topic, Vec<u8>)>;

/// A controller process without transport, clock and thread.
pub(crate) struct Adapter {
    controller: Controller,
    switch: PolicySwitch,
    examiner: Examiner,
    source: u64,
    geometry: Rc<str>,
    interval_ns: u64,
    /// The last capabilities of each array that were examined.
    known: Vec<Option<Capabilities>>,
    /// Sequence of the last repetition to each array.
    repetitions: Vec<u64>,
    geometries: u64,
    wake_ns: u64,
    repeat_ns: u64,
    geometry_ns: u64,
    /// How long the last decision took.
    decision_ns: u64,
    was_late: bool,
}

impl Adapter {
    /// A controller process of a room.
    pub fn new(room: &Room, source: u64, standby: Standby, at: Moment) -> Self {
        let (scenario, switch) = (&*room.scenario, PolicySwitch::default());
        let tenure = Tenure::live(source, room.interval_ns);
        let tenure = if standby.is_reserve { tenure.in_reserve(standby.rank) } else { tenure };
        let controller = Controller::new(scenario, (*room.model).clone(), policy(room, &switch), 0);
        let controller = controller.with_tenure(tenure).with_journal();
        let arrays = controller.arrays();
        Self {
            controller,
            switch,
            examiner: Examiner::new(scenario, &room.model, Force { small_range: true, paper_angles: false }),
            source,
            geometry: room.geometry.clone(),
            interval_ns: room.interval_ns,
            known: vec![None; arrays],
            repetitions: vec![0; arrays],
            geometries: 0,
            wake_ns: at.local_ns,
            repeat_ns: at.local_ns,
            geometry_ns: at.local_ns,
            decision_ns: 0,
            was_late: false,
        }
    }

    /// Handles an input.
    pub fn handle(&mut self, at: Moment, input: &Input, published: &mut Published) {
        match input {
            Input::Payload(topic, payload) => self.handle_payload(at, *topic, payload, published),
            Input::Presence { node, source, is_alive: true } => self.controller.handle_source_found(*node, *source),
            Input::Presence { node, source, is_alive: false } => self.controller.handle_source_lost(*node, *source),
            Input::Wake => {}
        }
        if at.local_ns >= self.wake_ns {
            self.wake(at, published);
        }
    }

    /// When an input must have been handled, in local time.
    pub fn next_ns(&self) -> u64 {
        self.wake_ns
    }

    /// The next decisions take so long, and fail in this way.
    pub fn set_policy(&mut self, (decision_ns, fault): (u64, Option<PolicyFault>)) {
        self.decision_ns = decision_ns;
        self.switch.set(fault);
    }

    /// What became of the position reports so far.
    pub fn tally(&self) -> Tally {
        let counters = self.controller.counters();
        Tally {
            commands: counters.commands,
            degraded: DegradedMode::ALL.iter().map(|mode| counters.degraded(*mode)).sum(),
            refused: self.controller.inbox().refused().total(),
        }
    }

    /// The epoch that an array follows, as far as the telemetry shows.
    pub fn followed_epoch(&self, array: usize) -> Option<u64> {
        self.controller.tenure(array).followed_epoch()
    }

    /// The epoch of its commands to each array; 0 before the first.
    pub fn epochs(&self) -> Vec<u64> {
        (0..self.controller.arrays()).map(|array| self.controller.tenure(array).epoch()).collect()
    }

    /// Whether it commands every array, or stands by for every one.
    pub fn is_everywhere(&self, standing: Standing) -> bool {
        (0..self.controller.arrays()).all(|array| self.controller.tenure(array).standing() == standing)
    }

    /// Whether it leads an array, and another controller could take over: it then commands on while
    /// it ends.
    pub fn awaits_successor(&self) -> bool {
        (0..self.controller.arrays()).any(|array| {
            let tenure = self.controller.tenure(array);
            tenure.has_peers() && tenure.standing() == Standing::Leading
        })
    }

    /// How often an event occurred.
    pub fn count(&self, event: TenureEvent) -> u64 {
        self.controller.counters().tenure(event)
    }

    /// The names of what has occurred: events of the tenure, degraded modes, refusals of reports.
    pub fn occurred(&self) -> Vec<String> {
        let counters = self.controller.counters();
        let events = TenureEvent::ALL.iter().filter(|event| counters.tenure(**event) > 0).map(|event| event.name());
        let modes = DegradedMode::ALL.iter().filter(|mode| counters.degraded(**mode) > 0).map(|mode| mode.name());
        let refused = self.controller.inbox().refused().named().map(|(name, _)| name);
        events.chain(modes).map(str::to_owned).chain(refused).collect()
    }

    /// Exchanges `into` for the inputs that the journal has; false where some are missing.
    pub fn take_inputs(&mut self, into: &mut Vec<ControllerInput>) -> bool {
        self.controller.take_inputs(into)
    }

    /// The present state.
    pub fn memory(&self) -> Memory {
        self.controller.memory()
    }

    /// The largest number of stops that are held for an array.
    pub fn stops_held(&self) -> usize {
        (0..self.controller.arrays()).map(|array| self.controller.stops(array).len()).max().unwrap_or_default()
    }

    fn handle_payload(&mut self, at: Moment, topic: Topic, payload: &[u8], published: &mut Published) {
        match topic {
            Topic::Users => match decode::<UserReport>(payload) {
                Ok(mut report) => self.report(at, Message::Users(&mut report), published),
                Err(error) => self.controller.handle_malformed((Stream::Users, 0), Refusal::from(&error)),
            },
            Topic::Channel => match decode::<ChannelReport>(payload) {
                Ok(mut report) => self.report(at, Message::Channel(&mut report), published),
                Err(error) => self.controller.handle_malformed((Stream::Channel, 0), Refusal::from(&error)),
            },
            Topic::Telemetry(array) => match decode::<MirrorTelemetry>(payload) {
                Ok(mut report) => {
                    self.report(at, Message::Telemetry(array, &mut report), published);
                }
                Err(error) => self.controller.handle_malformed((Stream::Telemetry, array), Refusal::from(&error)),
            },
            _ => self.handle_announcement(at, topic, payload),
        }
    }

    fn handle_announcement(&mut self, at: Moment, topic: Topic, payload: &[u8]) {
        match topic {
            Topic::Capabilities(array) => {
                if let Ok(capabilities) = decode(payload) {
                    self.examine(array, capabilities);
                }
            }
            Topic::Safety(array) => {
                if let Ok(report) = decode::<SafetyReport>(payload) {
                    self.controller.handle_safety(array, &report);
                }
            }
            Topic::Stops(array) => {
                if let Ok(report) = decode::<StopReport>(payload) {
                    self.controller.handle_stops(array, &report);
                }
            }
            Topic::Stop => {
                if let Ok(order) = decode::<EmergencyStop>(payload) {
                    self.controller.handle_stop_order(at.room_ns, &order);
                }
            }
            _ => {}
        }
    }

    fn report(&mut self, at: Moment, message: Message<'_>, published: &mut Published) {
        let now = at.room_ns;
        let due = self.controller.handle_message(now, message);
        let decision = match due {
            Due::Nothing => return,
            Due::StaleCommand => self.controller.poll_stale_command(now),
            Due::Command => {
                let is_late = !self.was_late && self.decision_ns > self.interval_ns;
                self.was_late = is_late;
                let timing = if is_late { Timing::Late } else { Timing::InTime };
                self.controller.poll_command(now, timing, &mut |_| {})
            }
        };
        send(decision, published);
    }

    fn examine(&mut self, array: usize, new: Capabilities) {
        let is_known = |known: &Capabilities| *known == Capabilities { stamp: known.stamp, ..new.clone() };
        let is_admitted = self.controller.admits_array(array, new.stamp.source);
        if is_admitted && self.known[array].as_ref().is_some_and(is_known) {
            return;
        }
        let verdict = if is_admitted { self.examiner.examine(array, &new) } else { Ok(()) };
        if self.controller.handle_capabilities(array, &new, verdict) {
            self.known[array] = Some(new);
        }
    }

    fn wake(&mut self, at: Moment, published: &mut Published) {
        self.wake_ns = at.local_ns + TIMEOUT_NS;
        if at.local_ns >= self.repeat_ns {
            self.repeat_ns = at.local_ns + REPEAT_NS;
            self.repeat_stops(at, published);
        }
        if at.local_ns >= self.geometry_ns {
            self.geometry_ns = at.local_ns + GEOMETRY_NS;
            self.geometries += 1;
            let stamp = Stamp { source: self.source, sequence: self.geometries, time_ns: at.room_ns };
            let geometry = RoomGeometry { stamp, scenario: self.geometry.to_string() };
            published.push((Topic::Geometry, encoded(&geometry)));
        }
        if let Some(decision) = self.controller.poll_timeout_command(at.room_ns) {
            send(decision, published);
        }
    }

    fn repeat_stops(&mut self, at: Moment, published: &mut Published) {
        for (array, sequence) in self.repetitions.iter_mut().enumerate() {
            for held in self.controller.unreported_stops(array) {
                *sequence += 1;
                let stamp = Stamp { source: self.source, sequence: *sequence, time_ns: at.room_ns };
                let repetition = StopRepetition {
                    stamp,
                    stop_source: held.name.source,
                    stop_sequence: held.name.sequence,
                    operator: held.operator.clone(),
                    reason: held.reason.clone(),
                };
                published.push((Topic::Repetition(array), encoded(&repetition)));
            }
        }
    }
}

/// Publishes the commands of a decision.
fn send(decision: Decision<'_>, published: &mut Published) {
    published.extend(decision.commands().map(|(array, command)| (Topic::Command(array), encoded(command))));
}
