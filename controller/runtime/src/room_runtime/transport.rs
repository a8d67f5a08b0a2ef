//! Where a room's commands go: to arrays that this process drives, and to the publishers of the room.

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
}

/// Publishes commands, belief and state.
pub struct Transport {
    local: Vec<LocalArray>,
    /// One for each array.
    commands: Vec<Publisher>,
    belief: Publisher,
    memory: Publisher,
    unsent: u64,
}

impl Transport {
    /// Declares the publishers of a room with so many arrays, whose commands have this class.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn open(bus: &Bus, arrays: usize, class: Class) -> Result<Self, BusError> {
        let publisher = |output: Output, class| bus.publisher(&output.in_room(bus.room()), class);
        Ok(Self {
            local: Vec::new(),
            commands: (0..arrays).map(|array| publisher(Output::Command(array), class)).collect::<Result<_, _>>()?,
            belief: publisher(Output::Belief, Class::LowDrop)?,
            memory: publisher(Output::Memory, Class::LowDrop)?,
            unsent: 0,
        })
    }

    /// Passes each command to these arrays too, before it is published.
    #[must_use]
    pub fn with_local(mut self, local: Vec<LocalArray>) -> Self {
        self.local = local;
        self
    }

    /// Commands that the transport refused.
    pub fn unsent(&self) -> u64 {
        self.unsent
    }

    fn of(&self, output: Output) -> Option<&Publisher> {
        match output {
            Output::Command(array) => self.commands.get(array),
            Output::Belief => Some(&self.belief),
            Output::Memory => Some(&self.memory),
            Output::StopRepetition(_) | Output::Stop | Output::Geometry => None,
        }
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
        let is_sent = self.of(output).is_some_and(|publisher| publisher.put(payload).is_ok());
        self.unsent += u64::from(!is_sent && matches!(output, Output::Command(_)));
    }

    fn has_subscribers(&mut self, output: Output) -> bool {
        self.of(output).is_some_and(|publisher| publisher.has_subscribers().unwrap_or(false))
    }
}

/// The publishers of repetitions. Those of stops wait for the network, so they have no lock.
pub struct Repetitions {
    /// One for each array.
    arrays: Vec<Publisher>,
    /// For arrays that understand no repetition.
    stop: Publisher,
    geometry: Publisher,
}

impl Repetitions {
    /// Declares the publishers for so many arrays.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn open(bus: &Bus, arrays: usize) -> Result<Self, BusError> {
        let publisher = |output: Output, class| bus.publisher(&output.in_room(bus.room()), class);
        let to_array = |array| publisher(Output::StopRepetition(array), Class::RealTimeBlock);
        Ok(Self {
            arrays: (0..arrays).map(to_array).collect::<Result<_, _>>()?,
            stop: publisher(Output::Stop, Class::RealTimeBlock)?,
            geometry: publisher(Output::Geometry, Class::LowDrop)?,
        })
    }

    /// Publishes repetitions.
    pub fn publish(&self, repetitions: &[(Output, Vec<u8>)]) {
        for (output, payload) in repetitions {
            let publisher = match output {
                Output::StopRepetition(array) => self.arrays.get(*array),
                Output::Stop => Some(&self.stop),
                Output::Geometry => Some(&self.geometry),
                Output::Command(_) | Output::Belief | Output::Memory => None,
            };
            // A closed session shows in the count of commands that were refused.
            publisher.into_iter().for_each(|publisher| drop(publisher.put(payload)));
        }
    }
}
