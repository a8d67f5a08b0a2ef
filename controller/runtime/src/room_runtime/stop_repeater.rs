//! Repeats each held stop to the arrays that have not reported it.
//!
//! None of this is in the decision path, and none of it waits for the decision loop: a policy that
//! does not return delays no repetition. So these stops are held apart from those of the core.

use std::{
    sync::Mutex,
    time::{Duration, Instant},
};

use heliostat_bus::{Bus, BusError, Class, Publisher};
use heliostat_proto::stop_hold::{HeldStop, StopHold, unknown_stops};
use heliostat_proto::{
    EmergencyStop, LatchedStopReport, Message, SafetyReport, Stamp, StopAction, StopRepetition, StopReport, encode,
};
use heliostat_service::clock::utc_ns;

use super::locks::lock;

/// Time between two repetitions.
const INTERVAL: Duration = Duration::from_millis(200);

/// An array whose last telemetry is older than this is absent.
const PRESENT: Duration = Duration::from_secs(1);

/// The stops that are held for one array.
#[derive(Clone, Debug, Default)]
struct HeldArray {
    hold: StopHold,
    /// Arrival of its last telemetry.
    heard: Option<Instant>,
}

/// The stops that are held for each array.
pub struct HeldStops(Mutex<Vec<HeldArray>>);

impl HeldStops {
    /// No stop, for so many arrays.
    pub fn new(arrays: usize) -> Self {
        Self(Mutex::new(vec![HeldArray::default(); arrays]))
    }

    /// Applies a stop order, which concerns all arrays.
    pub fn handle_order(&self, order: &EmergencyStop) {
        let now = utc_ns();
        lock(&self.0).iter_mut().for_each(|array| array.hold.order(now, order));
    }

    /// Applies a stop report of an array.
    pub fn handle_stops(&self, array: usize, report: &StopReport) {
        self.handle_reported(array, &report.stops, |hold| hold.handle_stops(report));
    }

    /// Applies a safety report of an array.
    pub fn handle_safety(&self, array: usize, report: &SafetyReport) {
        self.handle_reported(array, report.stop().as_slice(), |hold| hold.handle_safety(report));
    }

    /// Applies the state in telemetry of an array.
    pub fn handle_state(&self, array: usize, source: u64, is_stopped: bool) {
        if let Some(array) = lock(&self.0).get_mut(array) {
            array.heard = Some(Instant::now());
            array.hold.handle_state(source, is_stopped);
        }
    }

    /// Applies a report; a stop in it that was not known concerns all arrays.
    fn handle_reported(&self, array: usize, reported: &[LatchedStopReport], apply: impl FnOnce(&mut StopHold) -> bool) {
        let arrays = &mut *lock(&self.0);
        let unknown = unknown_stops(reported, arrays.iter().map(|array| &array.hold));
        if apply(&mut arrays[array].hold) {
            for stop in &unknown {
                arrays.iter_mut().for_each(|array| array.hold.learn(stop));
            }
        }
    }

    /// The stops that an array has not reported; whether it is a present array that understands no
    /// repetition.
    fn unreported(&self, array: usize) -> (Vec<HeldStop>, bool) {
        let array = &lock(&self.0)[array];
        let is_present = array.heard.is_some_and(|heard| heard.elapsed() < PRESENT);
        (array.hold.unreported().cloned().collect(), is_present && !array.hold.has_stop_reports())
    }
}

/// The publishers of the repetitions.
pub struct StopRepeater {
    source: u64,
    /// One for each array, with the number of its last message.
    arrays: Vec<(Publisher, u64)>,
    /// For arrays that understand no repetition.
    stop: Publisher,
    last: Option<Instant>,
}

impl StopRepeater {
    /// Declares the publishers for so many arrays.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn open(bus: &Bus, arrays: usize, source: u64) -> Result<Self, BusError> {
        let room = bus.room();
        let publisher = |array| Ok((bus.publisher(&room.array(array).stop_repetition(), Class::RealTimeBlock)?, 0));
        let arrays = (0..arrays).map(publisher).collect::<Result<_, BusError>>()?;
        Ok(Self { source, arrays, stop: bus.publisher(&room.stop(), Class::RealTimeBlock)?, last: None })
    }

    /// Repeats the stops that are due.
    pub fn repeat(&mut self, stops: &HeldStops) {
        if self.last.is_some_and(|last| last.elapsed() < INTERVAL) {
            return;
        }
        self.last = Some(Instant::now());
        for array in 0..self.arrays.len() {
            let (unreported, is_older) = stops.unreported(array);
            for stop in unreported {
                self.send(array, stop, is_older);
            }
        }
    }

    fn send(&mut self, array: usize, stop: HeldStop, is_older: bool) {
        let HeldStop { name, operator, reason, since_ns, .. } = stop;
        if is_older {
            let stamp = Stamp { source: name.source, sequence: name.sequence, time_ns: since_ns };
            put(&self.stop, &EmergencyStop { stamp, action: StopAction::Stop, operator, reason });
            return;
        }
        let (publisher, sequence) = &mut self.arrays[array];
        *sequence += 1;
        let stamp = Stamp { source: self.source, sequence: *sequence, time_ns: utc_ns() };
        let (stop_source, stop_sequence) = (name.source, name.sequence);
        put(publisher, &StopRepetition { stamp, stop_source, stop_sequence, operator, reason });
    }
}

fn put<T: Message>(publisher: &Publisher, message: &T) {
    let mut payload = Vec::new();
    // A closed session shows in the count of commands that could not be sent.
    match encode(message, &mut payload) {
        Ok(()) => drop(publisher.put(&payload)),
        Err(error) => tracing::warn!("a stop cannot be repeated: {error}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_stop_is_due_for_repetition_until_its_array_has_it() {
        let stops = HeldStops::new(2);
        stops.handle_order(&EmergencyStop::default());
        assert_eq!(stops.unreported(1).0.len(), 1);
        // The second array has it by its state alone, and then drops it.
        stops.handle_state(1, 7, true);
        assert_eq!((stops.unreported(0).0.len(), stops.unreported(1).0.len()), (1, 0));
        stops.handle_state(1, 7, false);
        assert_eq!((stops.unreported(0).0.len(), stops.unreported(1).0.len()), (1, 0));
    }
}
