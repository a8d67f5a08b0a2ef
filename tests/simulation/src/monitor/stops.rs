//! The stops that an array has to hold, by CONTRACT.md, section 4.

use std::collections::{BTreeMap, VecDeque};

use heliostat_array::arrivals::Arrival;
use heliostat_array::content::Content;
use heliostat_proto::{EmergencyStop, MAX_STOPS, Nanos, StopAction, StopName};

/// The stops in force, each with the time that a re-arm of kind 9 is compared with.
#[derive(Clone, Debug, Default)]
pub(super) struct StopModel {
    stops: BTreeMap<StopName, Nanos>,
    /// Names that were released since the start of the process.
    released: VecDeque<StopName>,
}

impl StopModel {
    /// The process starts. Where the record is not complete, the last state is unknown: it starts stopped.
    pub fn start(&mut self, room_ns: Nanos, is_unknown: bool) {
        self.released.clear();
        self.stops.values_mut().for_each(|time_ns| *time_ns = (*time_ns).min(room_ns));
        if is_unknown {
            self.stops = BTreeMap::from([(StopName::default(), room_ns)]);
        }
    }

    /// A message arrives.
    pub fn handle(&mut self, arrival: &Arrival) {
        let now = arrival.at.room_ns;
        match &arrival.content {
            Content::Stop(Ok(order)) if order.action == StopAction::Stop => self.stop(order, now),
            Content::Stop(Ok(order)) => {
                let earlier = |(name, time_ns): (&StopName, &Nanos)| (*time_ns < order.stamp.time_ns).then_some(*name);
                let names: Vec<StopName> = self.stops.iter().filter_map(earlier).collect();
                names.into_iter().for_each(|name| self.release(name));
            }
            Content::Repetition(Ok(order)) => {
                let name = order.name();
                let is_later = |held: &StopName| held.source == name.source && held.sequence >= name.sequence;
                if !self.stops.keys().chain(&self.released).any(is_later) {
                    self.insert(name, now);
                }
            }
            Content::Rearm(Ok(order)) => self.release(order.name()),
            _ => {}
        }
    }

    pub fn is_stopped(&self) -> bool {
        !self.stops.is_empty()
    }

    pub fn names(&self) -> impl Iterator<Item = StopName> {
        self.stops.keys().copied()
    }

    fn stop(&mut self, order: &EmergencyStop, now: Nanos) {
        self.insert(order.name(), order.stamp.time_ns.min(now));
    }

    /// A later stop of one sender replaces its earlier one, and its time is never earlier.
    fn insert(&mut self, name: StopName, mut time_ns: Nanos) {
        self.released.retain(|released| *released != name);
        let former = self.stops.iter().find(|(held, _)| held.source == name.source).map(|(held, at)| (*held, *at));
        let mut kept = name;
        if let Some((held, at)) = former {
            self.stops.remove(&held);
            time_ns = time_ns.max(at);
            kept = kept.max(held);
        }
        self.stops.insert(kept, time_ns);
    }

    fn release(&mut self, name: StopName) {
        if self.stops.remove(&name).is_some() {
            self.released.push_back(name);
            if self.released.len() > MAX_STOPS {
                self.released.pop_front();
            }
        }
    }
}
