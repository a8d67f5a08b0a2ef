//! The state of an inbox, as a recording holds it.

use heliostat_proto as proto;
use serde::{Deserialize, Serialize};

use super::{Inbox, Message, Owner, Rules, Slot};
use crate::input::{refusal::Stream, sequence::SequenceTrack};

/// The streams of [`InboxMemory`], in the order of its sequence numbers.
const STREAMS: [Stream; 4] = [Stream::Users, Stream::Channel, Stream::Obstacles, Stream::Telemetry];

/// The owners, and the latest reports and sequence numbers of all streams but the orientations.
/// Counters of refusals are not in it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct InboxMemory {
    room: Option<Owner>,
    array: Option<Owner>,
    lost_room: Option<u64>,
    lost_array: Option<u64>,
    users: Payload,
    channel: Payload,
    obstacles: Payload,
    telemetry: Payload,
    tracks: [SequenceTrack; STREAMS.len()],
}

/// The latest orientation report and its sequence numbers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct OrientationMemory {
    report: Payload,
    track: SequenceTrack,
}

/// A report as it was on the wire; empty for none.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Payload(Vec<u8>);

impl Payload {
    fn of<T: proto::Message>(slot: &Slot<T>) -> Self {
        let mut bytes = Vec::new();
        if let Some(report) = slot.get() {
            // A report that was decoded is valid, so it can be encoded.
            let _ = proto::encode(report, &mut bytes);
        }
        Self(bytes)
    }

    /// Reads the report into a slot; false where it is none that the inbox accepts.
    fn restore<T: proto::Message>(
        &self,
        slot: &mut Slot<T>,
        rules: &Rules,
        message: fn(&mut T) -> Message<'_>,
    ) -> bool {
        slot.filled = false;
        if self.0.is_empty() {
            return true;
        }
        slot.filled = proto::decode_into(&mut slot.report, &self.0).is_ok()
            && rules.check_content(&message(&mut slot.report)).is_ok();
        slot.filled
    }
}

impl Inbox {
    /// The present state without the orientations.
    pub fn memory(&self) -> InboxMemory {
        InboxMemory {
            room: self.room,
            array: self.array,
            lost_room: self.lost_room,
            lost_array: self.lost_array,
            users: Payload::of(&self.users),
            channel: Payload::of(&self.channel),
            obstacles: Payload::of(&self.obstacles),
            telemetry: Payload::of(&self.telemetry),
            tracks: STREAMS.map(|stream| self.tracks[stream as usize]),
        }
    }

    /// The present state of the orientations.
    pub fn orientation_memory(&self) -> OrientationMemory {
        OrientationMemory { report: Payload::of(&self.orientation), track: self.tracks[Stream::Orientation as usize] }
    }

    /// Replaces the state; false where a report in it is not one of this scenario.
    pub fn restore(&mut self, memory: &InboxMemory, orientation: &OrientationMemory) -> bool {
        (self.room, self.array) = (memory.room, memory.array);
        (self.lost_room, self.lost_array) = (memory.lost_room, memory.lost_array);
        for (stream, track) in STREAMS.into_iter().zip(memory.tracks) {
            self.tracks[stream as usize] = track;
        }
        self.tracks[Stream::Orientation as usize] = orientation.track;
        let rules = &self.rules;
        memory.users.restore(&mut self.users, rules, |report| Message::Users(report))
            && memory.channel.restore(&mut self.channel, rules, |report| Message::Channel(report))
            && memory.obstacles.restore(&mut self.obstacles, rules, |report| Message::Obstacles(report))
            && memory.telemetry.restore(&mut self.telemetry, rules, |report| Message::Telemetry(report))
            && orientation.report.restore(&mut self.orientation, rules, |report| Message::Orientation(report))
    }
}
