//! What a controller publishes at intervals, whether or not it decides: its geometry, and each held
//! stop to the arrays that have not reported it.
//!
//! The core holds the stops; this is the list that is due for repetition. It has a lock of its own,
//! so that a caller can repeat stops while a policy does not return: the order that then arrives is
//! noted by [`note_order`](Repeater::note_order) until the core holds it.

use heliostat_proto::{
    EmergencyStop, Nanos, RoomGeometry, Stamp, StopAction, decode,
    stop_hold::{HeldStop, STOP_REPEAT_NS, StopHold},
};
use heliostat_scenario::Scenario;

use super::input::{Output, Publish, publish};

/// Time between two announcements of the geometry.
const GEOMETRY_INTERVAL_NS: Nanos = 1_000_000_000;

/// A stop that an array has not reported.
pub(super) struct Unreported {
    pub array: usize,
    /// Whether the array is present and understands no repetition.
    pub is_older: bool,
    pub stop: HeldStop,
}

/// The geometry of this controller, and the stops that are due for repetition.
pub struct Repeater {
    geometry: RoomGeometry,
    announced_ns: Option<Nanos>,
    source: u64,
    /// The number of the last repetition to each array.
    sequences: Vec<u64>,
    unreported: Vec<Unreported>,
    /// Orders that the core does not hold yet.
    waiting: StopHold,
    repeated_ns: Option<Nanos>,
}

impl Repeater {
    /// The geometry of a scenario and no stop, by a controller with this source id.
    pub(super) fn new(source: u64, scenario: &Scenario) -> Self {
        let stamp = Stamp { source, ..Stamp::default() };
        Self {
            geometry: RoomGeometry { stamp, scenario: scenario.geometry_toml() },
            announced_ns: None,
            source,
            sequences: vec![0; scenario.mirrors.arrays().len()],
            unreported: Vec::new(),
            waiting: StopHold::default(),
            repeated_ns: None,
        }
    }

    /// Notes the payload of an order that arrived at `now`, before the core holds it; true for a stop.
    pub fn note_order(&mut self, now: Nanos, payload: &[u8]) -> bool {
        // The core counts a payload that does not decode.
        decode::<EmergencyStop>(payload).is_ok_and(|order| {
            self.waiting.order(now, &order);
            order.action == StopAction::Stop
        })
    }

    /// The noted orders, also those that a full queue has dropped: the core holds them from now on.
    pub(super) fn take_waiting(&mut self) -> Vec<EmergencyStop> {
        std::mem::take(&mut self.waiting).stops().iter().map(HeldStop::order).collect()
    }

    /// Replaces the list by what the core knows.
    pub(super) fn update(&mut self, unreported: Vec<Unreported>) {
        self.unreported = unreported;
    }

    /// Publishes what is due at `now`: the geometry once a second, each stop at most five times.
    pub fn repeat(&mut self, now: Nanos, out: &mut dyn Publish) {
        let is_due = |last: Option<Nanos>, interval_ns| last.is_none_or(|last| now.abs_diff(last) >= interval_ns);
        let mut payload = Vec::new();
        if is_due(self.announced_ns, GEOMETRY_INTERVAL_NS) {
            self.announced_ns = Some(now);
            self.geometry.stamp.sequence += 1;
            self.geometry.stamp.time_ns = now;
            publish(Output::Geometry, &self.geometry, &mut payload, out);
        }
        if is_due(self.repeated_ns, STOP_REPEAT_NS) {
            self.repeated_ns = Some(now);
            self.repeat_stops(now, &mut payload, out);
        }
    }

    fn repeat_stops(&mut self, now: Nanos, payload: &mut Vec<u8>, out: &mut dyn Publish) {
        for array in 0..self.sequences.len() {
            let known = self.unreported.iter().filter(|unreported| unreported.array == array);
            let known = known.map(|unreported| (&unreported.stop, unreported.is_older));
            for (stop, is_older) in known.chain(self.waiting.stops().iter().map(|stop| (stop, false))) {
                if is_older {
                    publish(Output::Stop, &stop.order(), payload, out);
                    continue;
                }
                self.sequences[array] += 1;
                let stamp = Stamp { source: self.source, sequence: self.sequences[array], time_ns: now };
                publish(Output::StopRepetition(array), &stop.repetition(stamp), payload, out);
            }
        }
    }
}
