//! The state of an inbox, as a recording holds it.

use heliostat_proto as proto;
use serde::{Deserialize, Serialize};

use super::slot::{Owner, Slot};
use super::{Inbox, check_channel, check_obstacles, check_orientation};
use crate::input::{refusal::Stream, sequence::SequenceTrack};

/// The streams of [`InboxMemory`], in the order of its sequence numbers.
const STREAMS: [Stream; 4] = [Stream::Users, Stream::Channel, Stream::Obstacles, Stream::Telemetry];

/// The owners, and the latest reports and sequence numbers of all streams but the orientations,
/// with the telemetry of the first array. Counters of refusals are not in it.
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

/// The latest LED report and its sequence numbers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct LedMemory {
    report: Payload,
    track: SequenceTrack,
}

/// Owner, latest telemetry and sequence numbers of an array after the first.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct ArrayInboxMemory {
    owner: Option<Owner>,
    lost: Option<u64>,
    telemetry: Payload,
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

    /// Reads the report into a slot; false where it is no such report.
    fn restore<T: proto::Message>(&self, slot: &mut Slot<T>) -> bool {
        slot.filled = false;
        if self.0.is_empty() {
            return true;
        }
        slot.filled = proto::decode_into(&mut slot.report, &self.0).is_ok();
        slot.filled
    }
}

impl Inbox {
    /// The present state without the orientations and the arrays after the first.
    pub fn memory(&self) -> InboxMemory {
        let first = &self.arrays[0];
        InboxMemory {
            room: self.room,
            array: first.owner,
            lost_room: self.lost_room,
            lost_array: first.lost,
            users: Payload::of(&self.users),
            channel: Payload::of(&self.channel),
            obstacles: Payload::of(&self.obstacles),
            telemetry: Payload::of(&first.telemetry),
            tracks: STREAMS.map(|stream| *self.track(stream, 0)),
        }
    }

    /// The present state of the orientations.
    pub fn orientation_memory(&self) -> OrientationMemory {
        OrientationMemory { report: Payload::of(&self.orientation), track: self.tracks[Stream::Orientation as usize] }
    }

    /// The present state of the LED reports.
    pub fn led_memory(&self) -> LedMemory {
        LedMemory { report: Payload::of(&self.leds), track: self.tracks[Stream::Leds as usize] }
    }

    /// Replaces the state of the LED reports; false where the report is not one of this scenario.
    pub fn restore_leds(&mut self, memory: &LedMemory) -> bool {
        self.tracks[Stream::Leds as usize] = memory.track;
        memory.report.restore(&mut self.leds) && self.check_restored()
    }

    /// The present state of an array after the first.
    pub fn array_memory(&self, array: usize) -> ArrayInboxMemory {
        let array = &self.arrays[array];
        let telemetry = Payload::of(&array.telemetry);
        ArrayInboxMemory { owner: array.owner, lost: array.lost, telemetry, track: array.track }
    }

    /// Replaces the state of an array after the first; false where its telemetry is not of this
    /// scenario.
    pub fn restore_array(&mut self, array: usize, memory: &ArrayInboxMemory) -> bool {
        let place = &mut self.arrays[array];
        (place.owner, place.lost, place.track) = (memory.owner, memory.lost, memory.track);
        memory.telemetry.restore(&mut place.telemetry) && self.check_restored()
    }

    /// Replaces the state; false where a report in it is not one of this scenario.
    pub fn restore(&mut self, memory: &InboxMemory, orientation: &OrientationMemory) -> bool {
        (self.room, self.lost_room) = (memory.room, memory.lost_room);
        let first = &mut self.arrays[0];
        (first.owner, first.lost) = (memory.array, memory.lost_array);
        for (stream, track) in STREAMS.into_iter().zip(memory.tracks) {
            *self.track_mut(stream, 0) = track;
        }
        self.tracks[Stream::Orientation as usize] = orientation.track;
        memory.users.restore(&mut self.users)
            && memory.channel.restore(&mut self.channel)
            && memory.obstacles.restore(&mut self.obstacles)
            && memory.telemetry.restore(&mut self.arrays[0].telemetry)
            && orientation.report.restore(&mut self.orientation)
            && self.check_restored()
    }

    /// Whether every report is one that this inbox accepts.
    fn check_restored(&mut self) -> bool {
        self.collect_unusable();
        let mut reports = [
            self.users.filled.then(|| self.rules.check_users(&self.users.report)),
            self.channel.filled.then(|| check_channel(&self.channel.report)),
            self.obstacles.filled.then(|| check_obstacles(&self.obstacles.report)),
            self.orientation.filled.then(|| check_orientation(&self.orientation.report)),
            self.leds.filled.then(|| self.rules.check_leds(&self.leds.report)),
        ]
        .into_iter()
        .flatten();
        let arrays = self.arrays.iter().filter_map(|array| Some(array.check(array.telemetry.get()?)));
        reports.all(|checked| checked.is_ok()) && { arrays }.all(|checked| checked.is_ok())
    }
}
