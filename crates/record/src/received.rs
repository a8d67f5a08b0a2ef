//! A received payload, decoded: its message, its source and its sequence number.

use std::fmt;

use heliostat_proto::{
    BeliefReport, BranchReport, Calibration, Capabilities, ChannelReport, CodecError, ControllerControl,
    ControllerMemory, EmergencyStop, Kind, LedReport, Message, MirrorCommand, MirrorTelemetry, NodeStatus,
    ObstacleReport, OrientationReport, Rearm, Room, RoomGeometry, RoomTruth, SafetyReport, SimulatorControl, Stamp,
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

/// The payloads of a recording that do not decode.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Unreadable {
    /// Their number.
    pub count: u64,
    /// What is wrong with the first one.
    pub first: Option<CodecError>,
}

impl Unreadable {
    /// Decodes a payload under a key of a room; counts one that does not decode.
    pub fn read(&mut self, room: &Room, key: &str, payload: &[u8]) -> Option<Received> {
        let refused = match Received::read(room, key, payload) {
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
    /// Decodes a payload under a key of a room. The key decides what a sender may publish: a status under the key of
    /// another kind of process, and a message under a key that the contract does not have, keep their stamp alone.
    ///
    /// # Errors
    /// The payload has no known kind, or another one than its key, or does not decode.
    pub fn read(room: &Room, key: &str, payload: &[u8]) -> Result<Self, CodecError> {
        let (found, expected) = (kind_of(payload)?, room.kind_of(key));
        if let Some(expected) = expected.filter(|expected| *expected != found) {
            return Err(CodecError::WrongKind { found, expected });
        }
        let received = Self::decoded(found, payload)?;
        let is_of_key = match &received {
            Self::Status(status) => room.status_array(key, status).is_some(),
            _ => expected.is_some(),
        };
        Ok(if is_of_key { received } else { Self::Other(found, received.origin()) })
    }

    fn decoded(kind: Kind, payload: &[u8]) -> Result<Self, CodecError> {
        fn stamped<T: Message>(payload: &[u8], stamp: fn(&T) -> Stamp) -> Result<Received, CodecError> {
            decode::<T>(payload).map(|message| Received::Other(T::KIND, stamp(&message)))
        }
        match kind {
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

    /// The stamp; of a command the epoch in place of a source, its number and its time.
    pub fn origin(&self) -> Stamp {
        match self {
            Self::Command(MirrorCommand { epoch, sequence, time_ns, .. }) => {
                Stamp { source: *epoch, sequence: *sequence, time_ns: *time_ns }
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
        }
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{NodeKind, encode};

    use super::*;

    #[test]
    fn a_message_counts_under_the_key_of_its_kind_and_of_its_process_only() {
        let room = Room::new("lab").unwrap();
        let status = NodeStatus { node: NodeKind::Controller, ..NodeStatus::default() };
        let mut payload = Vec::new();
        encode(&status, &mut payload).unwrap();
        let read = |key: &str| Received::read(&room, key, &payload);
        assert_eq!(read(&room.status(NodeKind::Controller)), Ok(Received::Status(status)));
        let stamp_alone = Ok(Received::Other(Kind::NodeStatus, Stamp::default()));
        assert_eq!(read(&room.status(NodeKind::Viewer)), stamp_alone);
        assert_eq!(read("heliostat/v1/lab/own/status"), stamp_alone);
        let expected = Kind::EmergencyStop;
        assert_eq!(read(&room.stop()), Err(CodecError::WrongKind { found: Kind::NodeStatus, expected }));
    }
}
