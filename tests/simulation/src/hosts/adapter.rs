//! The production [`RoomCore`] with what its process does around it: the clock of its wakes, and
//! decisions that take time.

use std::rc::Rc;

use heliostat_array::moment::Moment;
use heliostat_core::capabilities::Force;
use heliostat_core::core::{Controller, DegradedMode, Timing};
use heliostat_core::refusal::Stream;
use heliostat_core::room_core::{
    Handled, Input as CoreInput, InputChannel, InputKey, Output, RoomCore, RoomSettings, WAKE_INTERVAL_NS,
};
use heliostat_core::tenure::{Standing, Tenure, TenureEvent};
use heliostat_proto::NodeKind;
use heliostat_proto::keys::Room as RoomKeys;

use super::policy::{PolicySwitch, policy};
use crate::monitor::Tally;
use crate::plan::PolicyFault;
use crate::room::Room;
use crate::topic::Topic;

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

/// Outputs and payloads that are published.
pub(crate) type Published = Vec<(Output, Vec<u8>)>;

/// A controller process without transport, clock and thread.
pub(crate) struct Adapter {
    core: RoomCore,
    keys: RoomKeys,
    switch: PolicySwitch,
    interval_ns: u64,
    wake_ns: u64,
    /// How long the last decision took.
    decision_ns: u64,
    was_late: bool,
    /// Whether a decision is due.
    is_due: bool,
}

impl Adapter {
    /// A controller process of a room.
    pub fn new(room: &Room, source: u64, standby: Standby, at: Moment) -> Self {
        let switch = PolicySwitch::default();
        let tenure = Tenure::live(source, room.interval_ns);
        let tenure = if standby.is_reserve { tenure.in_reserve(standby.rank) } else { tenure };
        let force = Force { small_range: true, paper_angles: false };
        let settings = RoomSettings { force, ..RoomSettings::new(source, tenure) };
        let core = RoomCore::new(&room.scenario, policy(room, &switch), settings)
            .unwrap_or_else(|error| panic!("the scenario of the simulation: {error}"));
        let keys = RoomKeys::new("simulated").unwrap_or_else(|error| panic!("the name of the room: {error}"));
        Self {
            core,
            keys,
            switch,
            interval_ns: room.interval_ns,
            wake_ns: at.local_ns,
            decision_ns: 0,
            was_late: false,
            is_due: false,
        }
    }

    /// Handles an input, and decides if that is due and this is the last input before a decision; whether it
    /// decided.
    pub fn handle(&mut self, at: Moment, input: &Input, is_last: bool, published: &mut Published) -> bool {
        let now = at.room_ns;
        match input {
            Input::Payload(topic, bytes) => {
                if let Some(key) = key(*topic) {
                    self.handle_payload(now, CoreInput::Payload { key, bytes }, published);
                }
            }
            Input::Presence { node, source, is_alive } => {
                let token = self.keys.alive(*node, *source);
                self.core.advance(now, CoreInput::Presence { token: &token, is_alive: *is_alive }, published);
            }
            Input::Wake if at.local_ns >= self.wake_ns => {
                self.wake_ns = at.local_ns + WAKE_INTERVAL_NS;
                self.core.advance(now, CoreInput::Wake, published);
            }
            Input::Wake => {}
        }
        is_last && self.decide(now, published)
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
        let counters = self.controller().counters();
        Tally {
            commands: counters.commands,
            degraded: DegradedMode::ALL.iter().map(|mode| counters.degraded(*mode)).sum(),
            refused: self.controller().inbox().refused().total(),
            superseded: self.core.superseded(),
            due: u64::from(self.is_due),
        }
    }

    /// The epoch that an array follows, as far as the telemetry shows.
    pub fn followed_epoch(&self, array: usize) -> Option<u64> {
        self.controller().tenure(array).followed_epoch()
    }

    /// The epoch of its commands to each array; 0 before the first.
    pub fn epochs(&self) -> Vec<u64> {
        (0..self.controller().arrays()).map(|array| self.controller().tenure(array).epoch()).collect()
    }

    /// Whether it commands every array, or stands by for every one.
    pub fn is_everywhere(&self, standing: Standing) -> bool {
        (0..self.controller().arrays()).all(|array| self.controller().tenure(array).standing() == standing)
    }

    /// Whether it stands by for every array, and is the first to take over each one.
    pub fn is_next(&self) -> bool {
        let is_next = |array| self.controller().tenure(array).rank() == 1;
        self.is_everywhere(Standing::Standby) && (0..self.controller().arrays()).all(is_next)
    }

    /// Whether it leads an array, and another controller could take over: it then commands on while
    /// it ends.
    pub fn awaits_successor(&self) -> bool {
        (0..self.controller().arrays()).any(|array| {
            let tenure = self.controller().tenure(array);
            !tenure.peers().is_empty() && tenure.standing() == Standing::Leading
        })
    }

    /// How often an event occurred.
    pub fn count(&self, event: TenureEvent) -> u64 {
        self.controller().counters().tenure(event)
    }

    /// The names of what has occurred: events of the tenure, degraded modes, refusals of reports.
    pub fn occurred(&self) -> Vec<String> {
        let counters = self.controller().counters();
        let events = TenureEvent::ALL.iter().filter(|event| counters.tenure(**event) > 0).map(|event| event.name());
        let modes = DegradedMode::ALL.iter().filter(|mode| counters.degraded(**mode) > 0).map(|mode| mode.name());
        let refused = self.controller().inbox().refused().named().map(|(name, _)| name);
        events.chain(modes).map(str::to_owned).chain(refused).collect()
    }

    /// The largest number of stops that are held for an array.
    pub fn stops_held(&self) -> usize {
        (0..self.controller().arrays()).map(|array| self.controller().stops(array).len()).max().unwrap_or_default()
    }

    fn controller(&self) -> &Controller {
        self.core.controller()
    }

    fn handle_payload(&mut self, now: u64, input: CoreInput<'_>, published: &mut Published) {
        match self.core.handle(now, input, published) {
            Handled::DecisionDue => self.is_due = true,
            Handled::Examination(examination) => drop(self.core.handle(now, examination.run(), published)),
            Handled::Nothing | Handled::Replaced(_) => {}
        }
    }

    /// A decision that takes longer than the interval of reports is followed by one for the report
    /// that waits: its thread calls it late.
    fn decide(&mut self, now: u64, published: &mut Published) -> bool {
        if !std::mem::take(&mut self.is_due) {
            return false;
        }
        let is_late = !self.was_late && self.decision_ns > self.interval_ns;
        self.was_late = is_late;
        let timing = if is_late { Timing::Late } else { Timing::InTime };
        self.core.decide(now, timing, &mut |_| {}, published);
        self.core.publish_state(published);
        true
    }
}

/// The key of a topic to which a controller subscribes.
fn key(topic: Topic) -> Option<InputKey> {
    let report = |stream| InputKey::Report(InputChannel::from(stream));
    match topic {
        Topic::Users => Some(report(Stream::Users)),
        Topic::Channel => Some(report(Stream::Channel)),
        Topic::Obstacles => Some(report(Stream::Obstacles)),
        Topic::Orientation => Some(report(Stream::Orientation)),
        Topic::Leds => Some(report(Stream::Leds)),
        Topic::Telemetry(array) => Some(InputKey::Report(InputChannel { stream: Stream::Telemetry, array })),
        Topic::Capabilities(array) => Some(InputKey::Capabilities(array)),
        Topic::Safety(array) => Some(InputKey::Safety(array)),
        Topic::Stops(array) => Some(InputKey::Stops(array)),
        Topic::Stop => Some(InputKey::Stop),
        Topic::Geometry => Some(InputKey::Geometry),
        Topic::Command(_) | Topic::Repetition(_) | Topic::Rearm | Topic::Query => None,
    }
}
