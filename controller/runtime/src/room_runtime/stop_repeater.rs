//! Repeats each held stop to the arrays that have not reported it.
//!
//! None of this is in the decision path, and none of it waits for the decision loop.

use std::time::{Duration, Instant};

use heliostat_bus::{Bus, BusError, Class, Publisher};
use heliostat_proto::stop_hold::HeldStop;
use heliostat_proto::{EmergencyStop, Message, Stamp, StopAction, StopRepetition, encode};
use heliostat_service::clock::utc_ns;

use super::watchdog::Watchdog;

/// Time between two repetitions.
const INTERVAL: Duration = Duration::from_millis(200);

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
    pub fn repeat(&mut self, watchdog: &Watchdog) {
        if self.last.is_some_and(|last| last.elapsed() < INTERVAL) {
            return;
        }
        self.last = Some(Instant::now());
        for array in 0..self.arrays.len() {
            let (stops, is_older) = watchdog.unreported(array);
            for stop in stops {
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
