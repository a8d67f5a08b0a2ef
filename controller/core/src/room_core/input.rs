//! What a room's core receives and publishes, and the keys of both.

use heliostat_proto::{Message, NodeKind, Room, encode};

use super::Examination;
use crate::{input::refusal::Stream, output::capabilities::Unfit, policy::Policy};

/// A stream of reports, and for telemetry the array that it describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputChannel {
    /// The stream.
    pub stream: Stream,
    /// Index of the array; 0 for reports about the room.
    pub array: usize,
}

impl From<Stream> for InputChannel {
    fn from(stream: Stream) -> Self {
        Self { stream, array: 0 }
    }
}

/// The key of a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputKey {
    /// Reports and telemetry.
    Report(InputChannel),
    /// Capabilities of an array.
    Capabilities(usize),
    /// Stop reports of an array.
    Stops(usize),
    /// Safety reports of an array.
    Safety(usize),
    /// Orders about the emergency stop.
    Stop,
    /// The geometry of the simulator.
    Geometry,
}

impl InputKey {
    /// The keys of announcements and orders in a room with so many arrays, in the order in which to
    /// subscribe to them.
    pub fn announcements(arrays: usize) -> impl Iterator<Item = Self> {
        let reports = move |array| [Self::Stops(array), Self::Safety(array)];
        let arrays = 0..arrays;
        let capabilities = arrays.clone().map(Self::Capabilities);
        capabilities.chain([Self::Stop]).chain(arrays.flat_map(reports)).chain([Self::Geometry])
    }

    /// The keys of reports in a room with so many arrays. Positions come last, so that the other
    /// reports are there when the first decision is due.
    pub fn reports(arrays: usize) -> impl Iterator<Item = InputChannel> {
        let telemetry = (0..arrays).map(|array| InputChannel { stream: Stream::Telemetry, array });
        let streams = [Stream::Obstacles, Stream::Orientation, Stream::Leds, Stream::Channel, Stream::Users];
        telemetry.chain(streams.map(InputChannel::from))
    }

    /// The key in a room.
    pub fn in_room(self, room: &Room) -> String {
        match self {
            Self::Report(InputChannel { stream, array }) => match stream {
                Stream::Users => room.users(),
                Stream::Channel => room.channel(),
                Stream::Obstacles => room.obstacles(),
                Stream::Orientation => room.orientation(),
                Stream::Leds => room.leds(),
                Stream::Telemetry => room.array(array).telemetry(),
            },
            Self::Capabilities(array) => room.array(array).capabilities(),
            Self::Stops(array) => room.array(array).stops(),
            Self::Safety(array) => room.array(array).safety(),
            Self::Stop => room.stop(),
            Self::Geometry => room.geometry(NodeKind::SimNode),
        }
    }

    /// Whether an array answers a query of this key; the answer is an input before the first command.
    pub fn is_queried(self) -> bool {
        matches!(self, Self::Capabilities(_) | Self::Stops(_) | Self::Safety(_))
    }
}

/// An input of a room's core.
pub enum Input<'a> {
    /// A payload that arrived.
    Payload {
        /// Its key.
        key: InputKey,
        /// The payload.
        bytes: &'a [u8],
    },
    /// A liveliness token appeared or ended.
    Presence {
        /// The key of the token.
        token: &'a str,
        /// Whether it appeared.
        is_alive: bool,
    },
    /// The result of an [`Examination`].
    Examined(Box<Examination>, Result<(), Unfit>),
    /// A policy after its start-up warm-up, which replaces the present one.
    Policy(Box<dyn Policy>),
    /// [`WAKE_INTERVAL_NS`](super::WAKE_INTERVAL_NS) has passed since the last one.
    Wake,
}

/// What follows from an input.
pub enum Handled {
    /// Nothing.
    Nothing,
    /// A decision is due: call [`decide`](super::RoomCore::decide), at once or after further inputs.
    DecisionDue,
    /// Capabilities are to be examined.
    Examination(Box<Examination>),
    /// The former policy, whose end may take long.
    Replaced(Box<dyn Policy>),
}

/// The key of a payload that a room's core publishes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// The command to an array.
    Command(usize),
    /// The repetition of a stop to an array.
    StopRepetition(usize),
    /// The repetition of a stop to an array that understands no other.
    Stop,
    /// The geometry of this controller.
    Geometry,
    /// The belief about the users.
    Belief,
    /// The state of the controller.
    Memory,
}

impl Output {
    /// The key in a room.
    pub fn in_room(self, room: &Room) -> String {
        match self {
            Self::Command(array) => room.array(array).command(),
            Self::StopRepetition(array) => room.array(array).stop_repetition(),
            Self::Stop => room.stop(),
            Self::Geometry => room.geometry(NodeKind::Controller),
            Self::Belief => room.belief(),
            Self::Memory => room.controller_memory(),
        }
    }
}

/// Where a room's core publishes. A payload that is refused is lost like one on the network.
pub trait Publish {
    /// Publishes a payload.
    fn publish(&mut self, output: Output, payload: &[u8]);

    /// Whether a process subscribes to an output.
    fn has_subscribers(&mut self, _output: Output) -> bool {
        true
    }
}

/// Publishes a message. One that does not encode is lost like one on the network. Does not allocate in
/// a payload with memory for it.
pub(super) fn publish<M: Message>(output: Output, message: &M, payload: &mut Vec<u8>, out: &mut dyn Publish) {
    if encode(message, payload).is_ok() {
        out.publish(output, payload);
    }
}

/// Collects what is published.
impl Publish for Vec<(Output, Vec<u8>)> {
    fn publish(&mut self, output: Output, payload: &[u8]) {
        self.push((output, payload.to_vec()));
    }
}
