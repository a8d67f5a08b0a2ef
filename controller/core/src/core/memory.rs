//! The state of a controller, for a replay that begins while the controller runs.
//!
//! [`Controller::memory`] copies everything that later decisions depend on besides later inputs,
//! and [`Controller::restore`] sets another controller of the same scenario and policy to it. From
//! then on both give the same commands for the same inputs, bit for bit. Counters, the tenure and
//! the fit of the array are not in it, because they change no angle; the last observation is not,
//! because each decision that reads one makes it.

use heliostat_channel::MirrorAngles;
use heliostat_proto::{ControllerInput, MirrorCommand, StateError, decode, decode_state, encode, encode_state};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{
    Controller, LastReport,
    array_output::{ArrayOutput, ArrayOutputMemory},
    journal::Journal,
};
use crate::{
    input::inbox::InboxState, observe::observer::memory::ObserverMemory, output::safety::check_finite,
    policy::FallbackMemory,
};

/// Number of the layout of [`Memory`]. Raise it when a field of any part changes.
const LAYOUT: u32 = 8;

/// The state of a controller.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Memory {
    layout: u32,
    inbox: InboxState,
    observer: ObserverMemory,
    policy: FallbackMemory,
    arrays: Vec<ArrayOutputMemory>,
    last_report: Option<LastReport>,
    /// The last command to each array, of this controller or by telemetry, without its sequence number.
    command: Vec<u8>,
    /// Roll and yaw of the observation: those of the last command before they are rounded.
    angles_rad: [Vec<f64>; 2],
}

/// Why a state cannot be restored.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum MemoryError {
    /// The bytes are no state.
    #[error(transparent)]
    Bytes(#[from] StateError),
    /// The state is of another version of this program.
    #[error("the state has layout {found}: expected {LAYOUT}, that of this version")]
    Layout {
        /// Layout found.
        found: u32,
    },
    /// The state is of another scenario.
    #[error("the state does not fit the scenario: {part} differs")]
    Scenario {
        /// The part that does not fit.
        part: &'static str,
    },
}

impl Memory {
    /// Writes the state.
    ///
    /// # Errors
    /// [`StateError`], never for a state of a controller.
    pub fn to_bytes(&self) -> Result<Vec<u8>, StateError> {
        encode_state(self)
    }

    /// Reads a state that [`to_bytes`](Self::to_bytes) has written.
    ///
    /// # Errors
    /// [`MemoryError`] where the bytes are no state of this version.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MemoryError> {
        // The layout comes first: a state of another layout is no value of this type.
        match bytes.first().map_or(0, |byte| u32::from(*byte)) {
            LAYOUT => Ok(decode_state(bytes)?),
            found => Err(MemoryError::Layout { found }),
        }
    }
}

impl Controller {
    /// Records accepted messages and decisions for [`take_inputs`](Self::take_inputs).
    pub fn with_journal(mut self) -> Self {
        self.journal = Journal::enabled();
        self
    }

    /// Exchanges `into` for the inputs since the last call. False where some are missing, because
    /// they were too many or are not recorded.
    pub fn take_inputs(&mut self, into: &mut Vec<ControllerInput>) -> bool {
        self.journal.take(into)
    }

    /// The present state. Allocates.
    pub fn memory(&self) -> Memory {
        let mut command = Vec::new();
        // A command of the core always encodes.
        let _ = encode(&MirrorCommand { sequence: 0, ..self.command.clone() }, &mut command);
        Memory {
            layout: LAYOUT,
            inbox: self.inbox.state().clone(),
            observer: self.observer.memory(),
            policy: self.policy.memory(),
            arrays: self.arrays.iter().map(ArrayOutput::memory).collect(),
            last_report: self.last_report,
            command,
            angles_rad: [self.observation.angles.roll.clone(), self.observation.angles.yaw.clone()],
        }
    }

    /// Replaces the state by one of a controller with the same scenario. The state of another
    /// policy than this controller's is left out.
    ///
    /// # Errors
    /// [`MemoryError`] where the state is of another scenario; some parts are then replaced, so the
    /// controller must not be used before another state is restored.
    pub fn restore(&mut self, memory: &Memory) -> Result<(), MemoryError> {
        let other = |part| MemoryError::Scenario { part };
        let [roll, yaw] = &memory.angles_rad;
        let mirrors = self.observation.mirrors();
        let command: MirrorCommand = decode(&memory.command).map_err(|_| other("command"))?;
        if [roll.len(), yaw.len(), command.roll.len()] != [mirrors; 3] {
            return Err(other("number of mirrors"));
        }
        let angles = MirrorAngles { roll: roll.clone(), yaw: yaw.clone() };
        check_finite(&angles).map_err(|_| other("angles"))?;
        if memory.arrays.len() != self.arrays.len() {
            return Err(other("number of arrays"));
        }
        if !self.arrays.iter_mut().zip(&memory.arrays).all(|(array, memory)| array.restore(memory)) {
            return Err(other("range of the mirrors"));
        }
        if !self.inbox.restore(&memory.inbox) {
            return Err(other("reports"));
        }
        if !self.observer.restore(&memory.observer) {
            return Err(other("belief"));
        }
        self.policy.restore(&memory.policy);
        self.last_report = memory.last_report;
        self.command = command;
        self.observation.angles.copy_from(&angles);
        Ok(())
    }
}
