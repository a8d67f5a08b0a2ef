//! The state of an observer, as a recording holds it.

use heliostat_channel::Vec3;
use heliostat_proto::MAX_USERS;
use serde::{Deserialize, Serialize};

use super::Observer;
use crate::belief::{
    Belief,
    memory::{AbsentMemory, DeviceMemory, LaterMemories, TiltMemory},
};
use crate::observe::evidence::{Evidence, EvidenceMemory};
use crate::observe::prediction::PredictionMemory;
use crate::observe::walk_history::{WalkHistory, WalkMemory};

/// Everything that an observer keeps from one report to the next.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ObserverMemory {
    prediction: PredictionMemory,
    /// The users in the order of their slots.
    slots: Vec<u32>,
    /// Slot by slot.
    headings: Vec<[f64; 3]>,
}

impl Observer {
    /// The state of the evidence; empty where none is kept.
    pub fn evidence_memory(&self) -> EvidenceMemory {
        self.evidence.as_ref().map(Evidence::memory).unwrap_or_default()
    }

    /// Replaces the state of the evidence, where it is kept; false where it is none.
    pub fn restore_evidence(&mut self, memory: &EvidenceMemory) -> bool {
        self.evidence.as_mut().is_none_or(|evidence| evidence.restore(memory))
    }

    /// The last reports about the users; empty where none are kept.
    pub fn walk_memory(&self) -> WalkMemory {
        self.walks.as_ref().map(WalkHistory::memory).unwrap_or_default()
    }

    /// Replaces the last reports about the users, where they are kept; false where they are none.
    pub fn restore_walks(&mut self, memory: &WalkMemory) -> bool {
        self.walks.as_mut().is_none_or(|walks| walks.restore(memory))
    }

    /// The present state.
    pub fn memory(&self) -> ObserverMemory {
        ObserverMemory {
            prediction: self.prediction.memory(),
            slots: self.slots.ids().to_vec(),
            headings: self.headings.iter().map(|heading| (*heading).into()).collect(),
        }
    }

    /// Whether users tilt their receivers.
    pub fn tilt_memory(&self) -> TiltMemory {
        self.prediction.belief().map_or_else(TiltMemory::default, Belief::tilt_memory)
    }

    /// What orientation reports have shown of devices.
    pub fn device_memory(&self) -> DeviceMemory {
        self.prediction.belief().map_or_else(DeviceMemory::default, Belief::device_memory)
    }

    /// Which users are absent from the last report.
    pub fn absent_memory(&self) -> AbsentMemory {
        self.prediction.belief().map_or_else(AbsentMemory::default, Belief::absent_memory)
    }

    /// Replaces the state; false where it is not one of this scenario.
    pub fn restore(&mut self, memory: &ObserverMemory, later: LaterMemories<'_>) -> bool {
        let ObserverMemory { prediction, slots, headings } = memory;
        let is_heading = |heading: &[f64; 3]| heading.iter().all(|part| part.abs() <= 1.0 + 1e-9);
        let is_sound = slots.len() <= MAX_USERS && headings.len() == slots.len() && headings.iter().all(is_heading);
        if !is_sound || !self.prediction.restore(prediction, later) {
            return false;
        }
        self.slots.follow(slots);
        self.headings.clear();
        self.headings.extend(headings.iter().map(|heading| Vec3::from(*heading)));
        true
    }
}
