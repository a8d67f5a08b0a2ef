//! The state of a controller, for a replay that begins while the controller runs.
//!
//! [`Controller::memory`] copies everything that later decisions depend on besides later inputs,
//! and [`Controller::restore`] sets another controller of the same scenario and policy to it. From
//! then on both give the same commands for the same inputs, bit for bit. Counters, the tenure and
//! the fit of the array are not in it, because they change no angle; the last observation is not,
//! because each decision that reads one makes it.

use heliostat_channel::MirrorAngles;
use heliostat_proto::{ControllerInput, MirrorCommand, Nanos, StateError, decode, decode_state, encode, encode_state};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{
    Controller,
    array_output::{ArrayOutput, ArrayOutputMemory},
    degraded_actions::LastReport,
    journal::Journal,
};
use crate::{
    belief::memory::{AbsentMemory, DeviceMemory, LaterMemories, TiltMemory},
    input::inbox::memory::{ArrayInboxMemory, InboxMemory, OrientationMemory},
    observe::observer::memory::ObserverMemory,
    output::{guard::GuardMemory, safety::check_finite},
    policy::FallbackMemory,
};

/// Number of the layout of [`Memory`]. Raise it when a field of any part changes.
const LAYOUT: u32 = 6;
/// The layout that ends before the orientations.
const LAYOUT_WITHOUT_ORIENTATIONS: u32 = 1;
/// The layout that ends before the arrays and the tilted receivers.
const LAYOUT_WITHOUT_ARRAYS: u32 = 2;
/// The layout that ends before the devices.
const LAYOUT_WITHOUT_DEVICES: u32 = 3;
/// The layout that ends before the positions of former policies.
const LAYOUT_WITHOUT_POSITIONS: u32 = 4;
/// The layout that ends before the number of absent users.
const LAYOUT_WITHOUT_ABSENT: u32 = 5;

/// What policies of earlier versions kept of channel reports, and of positions, for each user. It is
/// read, so that their recordings replay under another policy, and written empty.
type FormerReadings = (Vec<(u32, Nanos, [f64; 5], [[f64; 5]; 3])>, [f64; 6], Nanos);
type FormerPositions = Vec<(u32, usize, [(Nanos, [f64; 2], [f64; 2]); 10])>;

/// The state of a controller.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Memory {
    layout: u32,
    inbox: InboxMemory,
    observer: ObserverMemory,
    policy: FallbackMemory,
    /// Smallest and largest roll, then yaw, in rad.
    axes_rad: [[f64; 2]; 2],
    guard: GuardMemory,
    last_report: Option<LastReport>,
    /// The last command as it was on the wire, without its sequence number.
    command: Vec<u8>,
    has_command: bool,
    /// Roll and yaw of the observation: those of the last command before they are rounded.
    angles_rad: [Vec<f64>; 2],
    /// After all fields of the first layout.
    orientation: OrientationMemory,
    /// Each of several arrays; empty in a room with one, whose state is in the fields above. This
    /// and the fields below are after all fields of the second layout.
    arrays: Vec<ArrayMemory>,
    /// What is believed about tilted receivers.
    tilt: TiltMemory,
    former_readings: FormerReadings,
    /// What orientation reports have shown of devices; after all fields of the third layout.
    devices: DeviceMemory,
    /// After all fields of the fourth layout.
    former_positions: FormerPositions,
    /// Which users are absent from the last report; after all fields of the fifth layout.
    absent: AbsentMemory,
}

/// The state of one of several arrays.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct ArrayMemory {
    inbox: ArrayInboxMemory,
    output: ArrayOutputMemory,
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
        let found = bytes.first().map_or(0, |byte| u32::from(*byte));
        match found {
            LAYOUT => Ok(decode_state(bytes)?),
            LAYOUT_WITHOUT_ORIENTATIONS..=LAYOUT_WITHOUT_ABSENT => {
                let mut complete = bytes.to_vec();
                if found == LAYOUT_WITHOUT_ORIENTATIONS {
                    complete.extend(encode_state(&OrientationMemory::default())?);
                }
                if found <= LAYOUT_WITHOUT_ARRAYS {
                    complete.extend(encode_state(&Vec::<ArrayMemory>::new())?);
                    complete.extend(encode_state(&TiltMemory::default())?);
                    complete.extend(encode_state(&FormerReadings::default())?);
                }
                if found <= LAYOUT_WITHOUT_DEVICES {
                    complete.extend(encode_state(&DeviceMemory::default())?);
                }
                if found <= LAYOUT_WITHOUT_POSITIONS {
                    complete.extend(encode_state(&FormerPositions::default())?);
                }
                complete.extend(encode_state(&AbsentMemory::default())?);
                Ok(Self { layout: LAYOUT, ..decode_state(&complete)? })
            }
            _ => Err(MemoryError::Layout { found }),
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
        let first = self.arrays[0].memory();
        let array = |(index, array): (usize, &ArrayOutput)| ArrayMemory {
            inbox: self.inbox.array_memory(index),
            output: array.memory(),
        };
        let several = self.arrays.iter().enumerate().filter(|_| self.arrays.len() > 1);
        Memory {
            layout: LAYOUT,
            inbox: self.inbox.memory(),
            observer: self.observer.memory(),
            policy: self.policy.memory(),
            axes_rad: first.axes_rad,
            guard: first.guard,
            last_report: self.last_report,
            command,
            has_command: self.has_command(),
            arrays: several.map(array).collect(),
            orientation: self.inbox.orientation_memory(),
            tilt: self.observer.tilt_memory(),
            former_readings: FormerReadings::default(),
            devices: self.observer.device_memory(),
            former_positions: FormerPositions::new(),
            absent: self.observer.absent_memory(),
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
        if !self.arrays[0].limits.restore_axes(memory.axes_rad) {
            return Err(other("range of the mirrors"));
        }
        if !self.inbox.restore(&memory.inbox, &memory.orientation) {
            return Err(other("reports"));
        }
        let later = LaterMemories { tilt: &memory.tilt, devices: &memory.devices, absent: memory.absent };
        if !self.observer.restore(&memory.observer, later) {
            return Err(other("belief"));
        }
        self.policy.restore(&memory.policy);
        self.arrays[0].guard.restore(&memory.guard);
        self.arrays[0].commanded_ns = memory.has_command.then_some(command.time_ns);
        self.restore_arrays(&memory.arrays)?;
        self.last_report = memory.last_report;
        self.command = command;
        self.observation.set_angles(&angles);
        Ok(())
    }

    /// Replaces the states of several arrays.
    fn restore_arrays(&mut self, memories: &[ArrayMemory]) -> Result<(), MemoryError> {
        let other = |part| MemoryError::Scenario { part };
        let expected = if self.arrays.len() > 1 { self.arrays.len() } else { 0 };
        if memories.len() != expected {
            return Err(other("number of arrays"));
        }
        for (index, ArrayMemory { inbox, output }) in memories.iter().enumerate() {
            if !self.inbox.restore_array(index, inbox) {
                return Err(other("telemetry"));
            }
            if !self.arrays[index].restore(output) {
                return Err(other("range of the mirrors"));
            }
        }
        Ok(())
    }
}
