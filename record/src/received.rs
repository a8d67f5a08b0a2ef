//! A payload as a recorder sees it: what it is, and who said it as which of how many.

use heliostat_proto::{
    Calibration, Capabilities, ChannelReport, CodecError, ControllerControl, EmergencyStop, Kind, Message,
    MirrorCommand, MirrorTelemetry, Nanos, NodeStatus, ObstacleReport, RoomTruth, SimulatorControl, Stamp, UserReport,
    codec::kind_of, decode,
};

/// A decoded payload; kinds that only pass through are told by their stamp.
#[derive(Clone, Debug, PartialEq)]
pub enum Heard {
    Users(UserReport),
    Channel(ChannelReport),
    Obstacles(ObstacleReport),
    Command(MirrorCommand),
    Telemetry(MirrorTelemetry),
    Status(NodeStatus),
    Truth(RoomTruth),
    Other(Kind, Stamp),
}

/// Who said it, as which of theirs, and when it was true.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Origin {
    /// The source; of a command, the epoch.
    pub source: u64,
    /// Counts up by one with each message of the source on its key.
    pub sequence: u64,
    /// The time of the content.
    pub time_ns: Nanos,
}

impl Heard {
    /// Reads a payload.
    pub fn read(payload: &[u8]) -> Result<Self, CodecError> {
        fn stamped<T: Message>(payload: &[u8], stamp: fn(&T) -> Stamp) -> Result<Heard, CodecError> {
            decode::<T>(payload).map(|message| Heard::Other(T::KIND, stamp(&message)))
        }
        match kind_of(payload)? {
            Kind::UserReport => decode(payload).map(Self::Users),
            Kind::ChannelReport => decode(payload).map(Self::Channel),
            Kind::ObstacleReport => decode(payload).map(Self::Obstacles),
            Kind::MirrorCommand => decode(payload).map(Self::Command),
            Kind::MirrorTelemetry => decode(payload).map(Self::Telemetry),
            Kind::NodeStatus => decode(payload).map(Self::Status),
            Kind::RoomTruth => decode(payload).map(Self::Truth),
            Kind::Capabilities => stamped::<Capabilities>(payload, |message| message.stamp),
            Kind::EmergencyStop => stamped::<EmergencyStop>(payload, |message| message.stamp),
            Kind::Calibration => stamped::<Calibration>(payload, |message| message.stamp),
            Kind::SimulatorControl => stamped::<SimulatorControl>(payload, |message| message.stamp),
            Kind::ControllerControl => stamped::<ControllerControl>(payload, |message| message.stamp),
        }
    }

    /// Who said it.
    pub fn origin(&self) -> Origin {
        let stamp = match self {
            Self::Command(command) => {
                return Origin { source: command.epoch, sequence: command.sequence, time_ns: command.time_ns };
            }
            Self::Users(report) => report.stamp,
            Self::Channel(report) => report.stamp,
            Self::Obstacles(report) => report.stamp,
            Self::Telemetry(telemetry) => telemetry.stamp,
            Self::Status(status) => status.stamp,
            Self::Truth(truth) => truth.stamp,
            Self::Other(_, stamp) => *stamp,
        };
        Origin { source: stamp.source, sequence: stamp.sequence, time_ns: stamp.time_ns }
    }
}
