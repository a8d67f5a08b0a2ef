//! The state of an inbox, as a recording holds it.

use heliostat_proto as proto;
use serde::{Deserialize, Serialize};

use super::{Inbox, Message, Owner, Rules, Slot};
use crate::input::{refusal::Stream, sequence::SequenceTrack};

/// The owners, the latest reports and the sequence numbers. Counters of refusals are not in it.
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
    tracks: [SequenceTrack; Stream::ALL.len()],
}

/// A report as it was on the wire; empty for none.
#[derive(Clone, Debug, Serialize, Deserialize)]
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
    /// The present state.
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
            tracks: self.tracks,
        }
    }

    /// Replaces the state; false where a report in it is not one of this scenario.
    pub fn restore(&mut self, memory: &InboxMemory) -> bool {
        (self.room, self.array) = (memory.room, memory.array);
        (self.lost_room, self.lost_array) = (memory.lost_room, memory.lost_array);
        self.tracks = memory.tracks;
        let rules = &self.rules;
        memory.users.restore(&mut self.users, rules, |report| Message::Users(report))
            && memory.channel.restore(&mut self.channel, rules, |report| Message::Channel(report))
            && memory.obstacles.restore(&mut self.obstacles, rules, |report| Message::Obstacles(report))
            && memory.telemetry.restore(&mut self.telemetry, rules, |report| Message::Telemetry(report))
    }
}
