//! The state of an observer, as a recording holds it.

use heliostat_proto::MAX_USERS;
use serde::{Deserialize, Serialize};

use super::{Observer, Seen};
use crate::belief::{Belief, memory::BeliefMemory};
use crate::observe::lead::Lead;

/// Everything that an observer keeps from one report to the next.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ObserverMemory {
    lead: Lead,
    belief: Option<BeliefMemory>,
    /// The users in the order of their slots.
    slots: Vec<u32>,
    /// Slot by slot.
    headings: Vec<[f64; 3]>,
}

impl Observer {
    /// The present state.
    pub fn memory(&self) -> ObserverMemory {
        ObserverMemory {
            lead: self.lead,
            belief: self.belief.as_ref().map(Belief::memory),
            slots: self.slots.ids().to_vec(),
            headings: self.seen.iter().map(|seen| seen.heading.into()).collect(),
        }
    }

    /// Replaces the state; false where it is not one of this scenario.
    pub fn restore(&mut self, memory: &ObserverMemory) -> bool {
        let ObserverMemory { lead, belief, slots, headings } = memory;
        let is_heading = |heading: &[f64; 3]| heading.iter().all(|part| part.abs() <= 1.0 + 1e-9);
        let is_sound = slots.len() <= MAX_USERS && headings.len() == slots.len() && headings.iter().all(is_heading);
        if !is_sound || !lead.is_sound() {
            return false;
        }
        self.lead = *lead;
        self.set_settling(lead.settling_s);
        let fits = match (&mut self.belief, belief) {
            (Some(belief), Some(memory)) => belief.restore(memory),
            (None, None) => true,
            _ => false,
        };
        self.slots.follow(slots);
        self.seen.clear();
        self.seen.extend(headings.iter().map(|heading| Seen { heading: (*heading).into(), ..Seen::default() }));
        fits
    }
}
