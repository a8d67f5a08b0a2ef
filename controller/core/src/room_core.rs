//! The controller of one room without transport, clock and threads: payloads and time in, payloads
//! out.
//!
//! # Calling order
//!
//! 1. [`RoomCore::new`], then [`RoomCore::warm_up`] before the first input.
//! 2. [`RoomCore::handle`] for each [`Input`], in the order of arrival. The keys are those of
//!    [`InputKey::announcements`] and [`InputKey::reports`]. [`Handled`] names what follows:
//!    - a decision is due: [`RoomCore::decide`], and then [`RoomCore::publish_state`]. Several
//!      payloads may be handled before it; it then decides for the newest tick;
//!    - [`Handled::Examination`]: [`Examination::run`] takes long and needs no lock. Its result is
//!      the next input;
//!    - the former policy: drop it, which may take long.
//! 3. [`Input::Wake`] every [`WAKE_INTERVAL_NS`] for absent reports, and then [`Repeater::repeat`]:
//!    announcements, and repetitions of stops.
//!
//! [`RoomCore::advance`] does all of this for a caller with one thread.
//!
//! Time is UTC in ns, or the time of a simulation. In lockstep the decisions have the time of the
//! newest report instead.
//!
//! The [`Repeater`] has a lock of its own, so that it publishes also while a policy does not return.
//!
//! # Example
//!
//! ```
//! use heliostat_core::{
//!     policy::Fixed,
//!     refusal::Stream,
//!     room_core::{Input, InputKey, Output, RoomCore, RoomSettings},
//!     tenure::Tenure,
//! };
//! use heliostat_proto::{Stamp, UserReport, UserState, encode};
//! use heliostat_scenario::Scenario;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scenario = Scenario::builtin("specular")?.with_overrides(&["users.count=1"])?;
//! let policy = Box::new(Fixed::flat(scenario.mirror_count()));
//! let mut room = RoomCore::new(&scenario, policy, RoomSettings::new(9, Tenure::fixed(1)))?;
//! let mut published: Vec<(Output, Vec<u8>)> = Vec::new();
//!
//! let now = 10_000_000;
//! let user = UserState { position_m: [1.0, 0.5, 0.85], ..UserState::default() };
//! let stamp = Stamp { source: 7, sequence: 1, time_ns: now };
//! let mut payload = Vec::new();
//! encode(&UserReport { stamp, tick: 1, users: vec![user] }, &mut payload)?;
//! let key = InputKey::Report(Stream::Users.into());
//! room.advance(now, Input::Payload { key, bytes: &payload }, &mut published);
//! assert_eq!(published[0].0, Output::Command(0));
//! # Ok(())
//! # }
//! ```

mod drivers;
mod input;
mod message_buffers;
mod repeater;
mod state_publisher;
mod undecodable;

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use heliostat_channel::ChannelError;
use heliostat_proto::{
    Capabilities, CodecError, EmergencyStop, LostDriver, Nanos, NodeKind, RoomGeometry, SafetyReport, StopReport,
    keys::parse_alive,
};
use heliostat_scenario::Scenario;

pub use input::{Handled, Input, InputChannel, InputKey, Output, Publish};
pub use repeater::Repeater;
pub use undecodable::UndecodableCounts;

use crate::{
    core::{Controller, Decision, Due, Stage, Timing},
    input::{
        inbox::{Message, publishes},
        refusal::{Refusal, Stream},
    },
    output::{
        capabilities::{Examiner, Force},
        tenure::Tenure,
    },
    policy::Policy,
};
use drivers::Drivers;
use message_buffers::MessageBuffers;
use repeater::Unreported;
use state_publisher::StatePublisher;

/// Time between two wakes; several fit into the validity of a command.
pub const WAKE_INTERVAL_NS: Nanos = 50_000_000;

/// A geometry older than this is of a simulator that has left.
const GEOMETRY_EXPIRY_NS: Nanos = 5_000_000_000;

/// Who a controller is, and how it commands.
#[derive(Clone, Debug)]
pub struct RoomSettings {
    /// Random id of this controller, in its stamps.
    pub source: u64,
    /// How it chooses its epochs.
    pub tenure: Tenure,
    /// Whether the room waits for each command. Time is then that of the newest report.
    pub is_lockstep: bool,
    /// Mismatches between array and scenario that the operator accepts.
    pub force: Force,
}

impl RoomSettings {
    /// A controller of a live room that accepts no mismatch.
    pub fn new(source: u64, tenure: Tenure) -> Self {
        Self { source, tenure, is_lockstep: false, force: Force::default() }
    }
}

/// The result of [`RoomCore::decide`] where commands were published.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Answered {
    /// Tick of the report that the commands answer.
    pub tick: u64,
    /// Age of the positions on which the decision is based, in ns.
    pub age_ns: Nanos,
}

/// The controller of one room; the [module](self) describes the calling order.
pub struct RoomCore {
    controller: Controller,
    examiner: Arc<Examiner>,
    /// Time of the newest report, in lockstep.
    newest_ns: Option<Nanos>,
    /// Decoded into, and swapped with the controller's former reports.
    buffers: MessageBuffers,
    /// The capabilities of each array that were applied last.
    known: Vec<Capabilities>,
    /// The sources of nodes that must not receive the scenario's angles.
    unfit_nodes: Vec<u64>,
    drivers: Drivers,
    /// Kind and source of the trackers and simulators whose liveliness tokens are there.
    trackers: BTreeSet<(&'static str, u64)>,
    /// Arrival and text of the simulator's geometry.
    announced: Option<(Nanos, String)>,
    repeater: Arc<Mutex<Repeater>>,
    states: StatePublisher,
    /// Whether a decision is due.
    is_due: bool,
    /// Time of the last in-time decision, if its state is to be published.
    decided_ns: Option<Nanos>,
    superseded: u64,
    undecodable: UndecodableCounts,
    last_malformed: Option<CodecError>,
    payload: Vec<u8>,
}

/// Capabilities that are compared with the scenario, which takes long.
pub struct Examination {
    array: usize,
    capabilities: Capabilities,
    examiner: Arc<Examiner>,
}

impl Examination {
    /// Compares them.
    pub fn run(self: Box<Self>) -> Input<'static> {
        let verdict = self.examiner.examine(self.array, &self.capabilities);
        Input::Examined(self, verdict)
    }
}

impl RoomCore {
    /// A controller of a scenario's room with this policy.
    ///
    /// # Errors
    /// [`ChannelError`] where the channel refuses the values of the scenario.
    pub fn new(scenario: &Scenario, policy: Box<dyn Policy>, settings: RoomSettings) -> Result<Self, ChannelError> {
        let RoomSettings { source, tenure, is_lockstep, force } = settings;
        let model = scenario.channel_model()?;
        let examiner = Arc::new(Examiner::new(scenario, &model, force));
        let controller = Controller::new(scenario, model, policy, 0).with_tenure(tenure).with_journal();
        let arrays = controller.arrays();
        Ok(Self {
            examiner,
            newest_ns: is_lockstep.then_some(0),
            buffers: MessageBuffers::new(),
            known: vec![Capabilities::default(); arrays],
            unfit_nodes: Vec::new(),
            drivers: Drivers::new(arrays),
            trackers: BTreeSet::new(),
            announced: None,
            repeater: Arc::new(Mutex::new(Repeater::new(source, scenario))),
            states: StatePublisher::new(source),
            is_due: false,
            decided_ns: None,
            superseded: 0,
            undecodable: UndecodableCounts::default(),
            last_malformed: None,
            // Two f32 per mirror, and less than 100 bytes for the other fields.
            payload: Vec::with_capacity(100 + 8 * scenario.mirror_count()),
            controller,
        })
    }

    /// The start-up warm-up: [`Controller::warm_up`].
    pub fn warm_up(&mut self, runs: impl Iterator) {
        self.controller.warm_up(runs);
    }

    /// Handles an input that arrived at `now`. Does not allocate for reports, after the start-up
    /// warm-up.
    pub fn handle(&mut self, now: Nanos, input: Input<'_>, out: &mut dyn Publish) -> Handled {
        match input {
            Input::Payload { key: InputKey::Report(channel), bytes } => self.handle_report(now, channel, bytes, out),
            Input::Payload { key, bytes } => self.handle_announcement(now, key, bytes),
            Input::Presence { token, is_alive } => {
                self.handle_token(now, token, is_alive);
                Handled::Nothing
            }
            Input::Examined(examination, verdict) => {
                let Examination { array, capabilities, .. } = *examination;
                if self.controller.handle_capabilities(array, &capabilities, verdict) {
                    self.known[array] = capabilities;
                }
                Handled::Nothing
            }
            Input::Policy(policy) => Handled::Replaced(self.controller.replace_policy(policy)),
            Input::Wake => {
                self.wake(now, out);
                Handled::Nothing
            }
        }
    }

    /// Handles an input, and everything that follows from it at once, for a caller with one thread.
    pub fn advance(&mut self, now: Nanos, input: Input<'_>, out: &mut dyn Publish) {
        let is_wake = matches!(input, Input::Wake);
        match self.handle(now, input, out) {
            Handled::Nothing | Handled::Replaced(_) => {}
            Handled::DecisionDue => {
                self.decide(now, Timing::InTime, &mut |_| {}, out);
                self.publish_state(out);
            }
            Handled::Examination(examination) => drop(self.handle(now, examination.run(), out)),
        }
        if is_wake {
            self.locked_repeater().repeat(now, out);
        }
    }

    /// Decides at `now` for the newest tick, if one is due, and publishes the commands; the result is
    /// absent where none is given. `mark` is called as each stage ends. Does not allocate.
    pub fn decide(
        &mut self,
        now: Nanos,
        timing: Timing,
        mark: &mut dyn FnMut(Stage),
        out: &mut dyn Publish,
    ) -> Option<Answered> {
        if !std::mem::take(&mut self.is_due) {
            return None;
        }
        let now = self.room_time_ns(now);
        let decision = self.controller.poll_command(now, timing, mark);
        publish(decision, &mut self.payload, out);
        let answered = match decision {
            Decision::Move { command, age_ns, .. } => Some(Answered { tick: command.answers, age_ns }),
            Decision::Hold(_) => None,
        };
        mark(Stage::Published);
        self.decided_ns = (timing == Timing::InTime).then_some(now);
        answered
    }

    /// Publishes belief and state after an in-time decision, where they are due.
    pub fn publish_state(&mut self, out: &mut dyn Publish) {
        if let Some(now) = self.decided_ns.take() {
            self.states.after_decision(&mut self.controller, now, out);
        }
    }

    /// What is published at intervals, with a lock of its own.
    pub fn repeater(&self) -> Arc<Mutex<Repeater>> {
        Arc::clone(&self.repeater)
    }

    /// The controller.
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// Room time at `now`: in lockstep the time of the newest report.
    pub fn room_time_ns(&self, now: Nanos) -> Nanos {
        self.newest_ns.unwrap_or(now)
    }

    /// Whether the room waits for each command.
    pub fn is_lockstep(&self) -> bool {
        self.newest_ns.is_some()
    }

    /// The arrays without a sign of a driver for 2 s, although this controller expects one, by index.
    pub fn without_driver(&mut self, now: Nanos) -> Vec<usize> {
        self.drivers.absent(now, &self.controller)
    }

    /// The drivers that have left since the last release of a stop, and have neither returned nor been replaced; of each
    /// whether another driver served its array then.
    pub fn lost_drivers(&self) -> impl Iterator<Item = (LostDriver, bool)> + '_ {
        self.drivers.lost()
    }

    /// Number of trackers and simulators in the room, by their liveliness tokens.
    pub fn trackers(&self) -> usize {
        self.trackers.len()
    }

    /// The geometry that the simulator announces, as TOML; `None` where none does.
    pub fn announced_geometry(&self, now: Nanos) -> Option<&str> {
        let fresh = self.announced.as_ref().filter(|(at, _)| now.abs_diff(*at) < GEOMETRY_EXPIRY_NS);
        fresh.map(|(_, text)| text.as_str())
    }

    /// Ticks that a newer one superseded before a decision.
    pub fn superseded(&self) -> u64 {
        self.superseded
    }

    /// The error of the last report that did not decode.
    pub fn last_malformed(&self) -> Option<&CodecError> {
        self.last_malformed.as_ref()
    }

    /// Payloads that did not decode, of the keys that are no streams of reports.
    pub fn undecodable(&self) -> &UndecodableCounts {
        &self.undecodable
    }

    fn handle_report(&mut self, now: Nanos, channel: InputChannel, payload: &[u8], out: &mut dyn Publish) -> Handled {
        let message = match self.buffers.decode(channel, payload) {
            Ok(message) => message,
            Err(error) => {
                let place = (channel.stream, channel.array);
                self.controller.handle_malformed(place, Refusal::from(&error), payload);
                self.last_malformed = Some(error);
                return Handled::Nothing;
            }
        };
        if let Message::Telemetry(array, telemetry) = &message {
            self.drivers.handle_telemetry(*array, telemetry);
        }
        if let Some(newest_ns) = &mut self.newest_ns {
            *newest_ns = message.origin().2.time_ns.max(*newest_ns);
        }
        let now = self.newest_ns.unwrap_or(now);
        match self.controller.handle_message(now, message) {
            Due::Command => {
                self.superseded += u64::from(std::mem::replace(&mut self.is_due, true));
                Handled::DecisionDue
            }
            Due::StaleCommand => {
                publish(self.controller.poll_stale_command(now), &mut self.payload, out);
                Handled::Nothing
            }
            Due::Nothing => Handled::Nothing,
        }
    }

    fn handle_announcement(&mut self, now: Nanos, key: InputKey, payload: &[u8]) -> Handled {
        let room_ns = self.room_time_ns(now);
        let Self { controller, undecodable, drivers, .. } = self;
        match key {
            InputKey::Report(_) => {}
            InputKey::Capabilities(array) => {
                if let Some(capabilities) = undecodable.decode::<Capabilities>(key, payload) {
                    return self.meet_array(array, capabilities);
                }
            }
            InputKey::Stops(array) => {
                if let Some(report) = undecodable.decode::<StopReport>(key, payload) {
                    controller.handle_stops(array, &report);
                    drivers.handle_stops(array, &report);
                }
            }
            InputKey::Safety(array) => {
                if let Some(report) = undecodable.decode::<SafetyReport>(key, payload) {
                    controller.handle_safety(array, &report);
                }
            }
            InputKey::Stop => {
                if let Some(order) = undecodable.decode::<EmergencyStop>(key, payload) {
                    controller.handle_stop_order(room_ns, &order);
                }
            }
            InputKey::Geometry => {
                if let Some(announced) = undecodable.decode::<RoomGeometry>(key, payload) {
                    self.announced = Some((now, announced.scenario));
                }
                return Handled::Nothing;
            }
        }
        self.list_stops(now);
        Handled::Nothing
    }

    /// Capabilities of an array; repetitions are ignored.
    fn meet_array(&mut self, array: usize, capabilities: Capabilities) -> Handled {
        if !self.controller.admit_array(array, capabilities.stamp.source) {
            return Handled::Nothing;
        }
        let known = &self.known[array];
        if *known == (Capabilities { stamp: known.stamp, ..capabilities.clone() }) {
            return Handled::Nothing;
        }
        let examiner = Arc::clone(&self.examiner);
        Handled::Examination(Box::new(Examination { array, capabilities, examiner }))
    }

    fn handle_token(&mut self, now: Nanos, token: &str, is_alive: bool) {
        self.drivers.handle_token(now, token, is_alive);
        let Some((node, source)) = parse_alive(token) else { return };
        if is_alive {
            self.controller.handle_source_found(node, source);
        } else {
            self.controller.handle_source_lost(node, source);
        }
        // A token of another kind of process can name the source of a tracker.
        if publishes(node, Stream::Users) {
            if is_alive {
                self.trackers.insert((node.name(), source));
            } else {
                self.trackers.remove(&(node.name(), source));
            }
        }
        self.examine_node(node, source, is_alive);
    }

    /// Withholds commands while a node that does not fit the scenario is in the room.
    fn examine_node(&mut self, node: NodeKind, source: u64, is_alive: bool) {
        let Err(unfit) = self.examiner.examine_node(node) else { return };
        self.unfit_nodes.retain(|known| *known != source);
        if is_alive {
            self.unfit_nodes.push(source);
        }
        self.controller.handle_unfit_node((!self.unfit_nodes.is_empty()).then_some(unfit));
    }

    fn wake(&mut self, now: Nanos, out: &mut dyn Publish) {
        if let Some(decision) = self.controller.poll_timeout_command(self.newest_ns.unwrap_or(now)) {
            publish(decision, &mut self.payload, out);
        }
        self.list_stops(now);
    }

    /// Lists the stops that arrays have not reported, for repetition.
    fn list_stops(&mut self, now: Nanos) {
        let (mut unreported, mut is_stopped) = (Vec::new(), false);
        let room_ns = self.room_time_ns(now);
        let waiting = self.locked_repeater().take_waiting();
        waiting.iter().for_each(|order| self.controller.handle_stop_order(room_ns, order));
        for array in 0..self.controller.arrays() {
            is_stopped |= !self.controller.stops(array).is_empty();
            let is_older = !self.controller.understands_repetitions(room_ns, array);
            let stops = self.controller.unreported_stops(array);
            unreported.extend(stops.map(|stop| Unreported { array, is_older, stop: stop.clone() }));
        }
        self.drivers.set_stopped(is_stopped);
        self.locked_repeater().update(unreported);
    }

    fn locked_repeater(&self) -> MutexGuard<'_, Repeater> {
        self.repeater.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Publishes the commands of a decision, if it has any. Does not allocate.
fn publish(decision: Decision<'_>, payload: &mut Vec<u8>, out: &mut dyn Publish) {
    for (array, command) in decision.commands() {
        input::publish(Output::Command(array), command, payload, out);
    }
}
