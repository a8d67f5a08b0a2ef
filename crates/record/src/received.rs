//! A received payload, decoded: its message, its source and its sequence number.

use std::fmt;

use heliostat_proto::{
    BeliefReport, BranchReport, Calibration, Capabilities, ChannelReport, CodecError, ControllerControl,
    ControllerMemory, EmergencyStop, Kind, LedReport, Message, MirrorCommand, MirrorTelemetry, Nanos, NodeStatus,
    ObstacleReport, OrientationReport, Rearm, RoomGeometry, RoomTruth, SafetyReport, SimulatorControl, Stamp,
    StopRepetition, StopReport, UserReport, codec::kind_of, decode,
};

/// A decoded payload; kinds that are only recorded keep their stamp alone.
#[derive(Clone, Debug, PartialEq)]
pub enum Received {
    /// Positions of the users.
    Users(UserReport),
    /// Measured gains.
    Channel(ChannelReport),
    /// Reported obstacles.
    Obstacles(ObstacleReport),
    /// How users hold their receivers.
    Orientation(OrientationReport),
    /// Which LEDs the users' receivers detect.
    Leds(LedReport),
    /// A command to an array.
    Command(MirrorCommand),
    /// Telemetry of an array.
    Telemetry(MirrorTelemetry),
    /// Times and counts of a process.
    Status(NodeStatus),
    /// The truth of a simulated room.
    Truth(RoomTruth),
    /// The geometry that a room announces.
    Geometry(RoomGeometry),
    /// A controller's belief about the users.
    Belief(BeliefReport),
    /// The state of a decision core.
    Memory(ControllerMemory),
    /// Another kind.
    Other(Kind, Stamp),
}

/// Source, sequence number and time of a message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Origin {
    /// The source; for a command, the epoch.
    pub source: u64,
    /// Rises by one with each message of the source on its key.
    pub sequence: u64,
    /// The time of the content.
    pub time_ns: Nanos,
}

/// The payloads of a recording that do not decode.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Unreadable {
    /// Their number.
    pub count: u64,
    /// What is wrong with the first one.
    pub first: Option<CodecError>,
}

impl Unreadable {
    /// Decodes a payload; counts one that does not decode.
    pub fn read(&mut self, payload: &[u8]) -> Option<Received> {
        let refused = match Received::read(payload) {
            Ok(received) => return Some(received),
            Err(refused) => refused,
        };
        self.count += 1;
        self.first.get_or_insert(refused);
        None
    }
}

impl fmt::Display for Unreadable {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "messages that cannot be read: {}", self.count)?;
        self.first.as_ref().map_or(Ok(()), |first| write!(formatter, ", the first one: {first}"))
    }
}

impl Received {
    /// Decodes a payload.
    ///
    /// # Errors
    /// The payload has no known kind, or does not decode.
    pub fn read(payload: &[u8]) -> Result<Self, CodecError> {
        fn stamped<T: Message>(payload: &[u8], stamp: fn(&T) -> Stamp) -> Result<Received, CodecError> {
            decode::<T>(payload).map(|message| Received::Other(T::KIND, stamp(&message)))
        }
        match kind_of(payload)? {
            Kind::UserReport => decode(payload).map(Self::Users),
            Kind::ChannelReport => decode(payload).map(Self::Channel),
            Kind::ObstacleReport => decode(payload).map(Self::Obstacles),
            Kind::OrientationReport => decode(payload).map(Self::Orientation),
            Kind::LedReport => decode(payload).map(Self::Leds),
            Kind::BranchReport => stamped::<BranchReport>(payload, |message| message.stamp),
            Kind::MirrorCommand => decode(payload).map(Self::Command),
            Kind::MirrorTelemetry => decode(payload).map(Self::Telemetry),
            Kind::NodeStatus => decode(payload).map(Self::Status),
            Kind::RoomTruth => decode(payload).map(Self::Truth),
            Kind::Capabilities => stamped::<Capabilities>(payload, |message| message.stamp),
            Kind::EmergencyStop => stamped::<EmergencyStop>(payload, |message| message.stamp),
            Kind::Calibration => stamped::<Calibration>(payload, |message| message.stamp),
            Kind::SimulatorControl => stamped::<SimulatorControl>(payload, |message| message.stamp),
            Kind::ControllerControl => stamped::<ControllerControl>(payload, |message| message.stamp),
            Kind::Rearm => stamped::<Rearm>(payload, |message| message.stamp),
            Kind::SafetyReport => stamped::<SafetyReport>(payload, |message| message.stamp),
            Kind::StopReport => stamped::<StopReport>(payload, |message| message.stamp),
            Kind::StopRepetition => stamped::<StopRepetition>(payload, |message| message.stamp),
            Kind::RoomGeometry => decode(payload).map(Self::Geometry),
            Kind::BeliefReport => decode(payload).map(Self::Belief),
            Kind::ControllerMemory => decode(payload).map(Self::Memory),
        }
    }

    /// Source, sequence number and time.
    pub fn origin(&self) -> Origin {
        let stamp = match self {
            Self::Command(command) => {
                return Origin { source: command.epoch, sequence: command.sequence, time_ns: command.time_ns };
            }
            Self::Users(report) => report.stamp,
            Self::Channel(report) => report.stamp,
            Self::Obstacles(report) => report.stamp,
            Self::Orientation(report) => report.stamp,
            Self::Leds(report) => report.stamp,
            Self::Telemetry(telemetry) => telemetry.stamp,
            Self::Status(status) => status.stamp,
            Self::Truth(truth) => truth.stamp,
            Self::Geometry(geometry) => geometry.stamp,
            Self::Belief(belief) => belief.stamp,
            Self::Memory(memory) => memory.stamp,
            Self::Other(_, stamp) => *stamp,
        };
        Origin { source: stamp.source, sequence: stamp.sequence, time_ns: stamp.time_ns }
    }
}
