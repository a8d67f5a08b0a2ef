//! Where a room's commands go: to arrays that this process drives, and to the publishers of the room.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use heliostat_bus::{Bus, BusError, Class, Publisher};
use heliostat_core::room_core::{Output, Publish};

/// Takes the payload of each command before it is published. Runs in the decision path, so it must not
/// wait.
pub type TakeCommand = Box<dyn FnMut(&[u8]) + Send>;

/// An array of the room that this process drives.
pub struct LocalArray {
    /// Index of the array.
    pub array: usize,
    /// Takes its commands.
    pub take_command: TakeCommand,
    /// Whether its present stop is in the record.
    pub is_recorded: Arc<AtomicBool>,
}

/// The publishers of some outputs.
pub struct Publishers(Vec<(Output, Publisher)>);

impl Publishers {
    /// Those of the repetitions to so many arrays. They wait for the network, so they have no lock.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn of_repetitions(bus: &Bus, arrays: usize) -> Result<Self, BusError> {
        let stops = (0..arrays).map(Output::StopRepetition).chain([Output::Stop]);
        let stops = stops.map(|output| (output, Class::RealTimeBlock));
        Self::open(bus, stops.chain([(Output::Geometry, Class::LowDrop)]))
    }

    fn open(bus: &Bus, outputs: impl Iterator<Item = (Output, Class)>) -> Result<Self, BusError> {
        let publisher = |(output, class): (Output, Class)| -> Result<_, BusError> {
            Ok((output, bus.publisher(&output.in_room(bus.room()), class)?))
        };
        Ok(Self(outputs.map(publisher).collect::<Result<_, _>>()?))
    }

    /// Publishes a payload; false where the session is closed.
    pub fn put(&self, output: Output, payload: &[u8]) -> bool {
        self.of(output).is_some_and(|publisher| publisher.put(payload).is_ok())
    }

    fn of(&self, output: Output) -> Option<&Publisher> {
        self.0.iter().find(|(of, _)| *of == output).map(|(_, publisher)| publisher)
    }
}

/// Publishes commands, belief and state.
pub struct Transport {
    local: Vec<LocalArray>,
    publishers: Publishers,
    unsent: u64,
}

impl Transport {
    /// Declares the publishers of a room with so many arrays, whose commands have this class. Each
    /// command goes to the `local` arrays before it is published.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn open(bus: &Bus, arrays: usize, class: Class, local: Vec<LocalArray>) -> Result<Self, BusError> {
        let commands = (0..arrays).map(|array| (Output::Command(array), class));
        let state = [Output::Belief, Output::Memory].map(|output| (output, Class::LowDrop));
        Ok(Self { local, publishers: Publishers::open(bus, commands.chain(state))?, unsent: 0 })
    }

    /// Commands that the transport refused.
    pub fn unsent(&self) -> u64 {
        self.unsent
    }
}

impl Publish for Transport {
    /// A closed session shows in the count of commands that were refused.
    fn publish(&mut self, output: Output, payload: &[u8]) {
        if let Output::Command(commanded) = output {
            self.local
                .iter_mut()
                .filter(|local| local.array == commanded)
                .for_each(|local| (local.take_command)(payload));
        }
        let is_sent = self.publishers.put(output, payload);
        self.unsent += u64::from(!is_sent && matches!(output, Output::Command(_)));
    }

    fn has_subscribers(&mut self, output: Output) -> bool {
        self.publishers.of(output).is_some_and(|publisher| publisher.has_subscribers().unwrap_or(false))
    }
}
