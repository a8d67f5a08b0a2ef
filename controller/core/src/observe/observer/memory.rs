//! The state of an observer, as a recording holds it.

use heliostat_channel::Vec3;
use heliostat_proto::MAX_USERS;
use serde::{Deserialize, Serialize};

use super::Observer;
use crate::belief::{
    Belief,
    memory::{AbsentMemory, DeviceMemory, LaterMemories, TiltMemory},
};
use crate::observe::prediction::PredictionMemory;

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
