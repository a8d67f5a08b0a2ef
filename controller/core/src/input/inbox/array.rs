//! The telemetry of one array, and who publishes it.

use heliostat_proto::MirrorTelemetry;
use serde::{Deserialize, Serialize};

use super::slot::{Owner, Slot};
use crate::input::{
    refusal::{Checked, Found, Refusal, TelemetrySizes},
    sequence::SequenceTrack,
};

/// The latest telemetry of one array.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct ArrayInbox {
    /// Index of its first mirror among those of the room.
    pub first: usize,
    /// Number of its mirrors.
    pub mirrors: usize,
    pub owner: Option<Owner>,
    /// The source of telemetry that left last.
    pub lost: Option<u64>,
    pub telemetry: Slot<MirrorTelemetry>,
    pub track: SequenceTrack,
    /// Its driver has a synchronised clock.
    pub has_clock: bool,
}

impl ArrayInbox {
    pub fn new(first: usize, mirrors: usize) -> Self {
        let (telemetry, track) = (Slot::default(), SequenceTrack::default());
        Self { first, mirrors, owner: None, lost: None, telemetry, track, has_clock: true }
    }

    /// Whether telemetry is of an array of this shape.
    pub fn check(&self, telemetry: &MirrorTelemetry) -> Checked {
        let (roll, yaw) = (telemetry.roll_commanded.len(), telemetry.yaw_commanded.len());
        let sizes = TelemetrySizes { roll, yaw, expected: self.mirrors };
        if [roll, yaw] == [self.mirrors; 2] { Ok(()) } else { Err((Refusal::WrongMirrorCount, Found::Sizes(sizes))) }
    }

    /// Whether a recorded state is one of this array.
    pub fn admits(&self, state: &Self) -> bool {
        (state.first, state.mirrors) == (self.first, self.mirrors)
            && state.telemetry.get().is_none_or(|telemetry| self.check(telemetry).is_ok())
    }

    /// The source has left: its delayed telemetry is refused.
    pub fn handle_source_lost(&mut self, source: u64) {
        self.track.forget(source);
        self.lost = Some(source);
        if self.owner.is_some_and(|owner| owner.source == source) {
            self.owner = None;
            self.telemetry.forget();
        }
    }

    /// Indices in the room of the mirrors that do not follow.
    pub fn unusable(&self) -> impl Iterator<Item = u32> {
        let unusable = self.telemetry.get().map_or(&[][..], |telemetry| &telemetry.unusable);
        let (first, mirrors) = (self.first as u32, self.mirrors as u32);
        unusable.iter().filter(move |mirror| **mirror < mirrors).map(move |mirror| first + mirror)
    }
}
