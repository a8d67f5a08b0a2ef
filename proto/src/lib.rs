//! The contract between rooms, controllers and mirror drivers: messages, keys and the codec.
//!
//! Trackers publish the positions of the users, receivers the measured channel gains, a controller
//! the mirror angles, and a mirror driver the state of the array. This crate defines the bytes and
//! the key of each message. It knows no transport and reads no clock. `CONTRACT.md` at the root of
//! the repository describes the same bytes for drivers in other languages.
//!
//! - `table.rs`: the message table, the only place where a message or one of its fields is written
//!   down.
//! - [`messages`]: the messages that the table yields.
//! - `structures.rs` and `enumerations.rs`: the types of the fields of messages.
//! - [`codec`]: messages to bytes and back; it refuses a malformed payload with a
//!   specific error.
//! - [`keys`]: the name of a room, and the key of each message; [`array_keys`]: the keys of each
//!   mirror array.
//!
//! - [`takeover_reason`]: why a controller took over, in words.
//!
//! - [`stop_hold`]: which emergency stops an array still has to report, for each process that holds
//!   one; [`reported_stops`]: what the arrays of a room report about them, and when the room is called
//!   stopped.
//!
//! # Example
//! ```
//! use heliostat_proto::{MirrorCommand, Room, decode, encode};
//!
//! let (roll, yaw) = (vec![0.1], vec![0.0]);
//! let command = MirrorCommand { epoch: 1, sequence: 1, roll, yaw, ..Default::default() };
//! let mut payload = Vec::new();
//! encode(&command, &mut payload)?;
//! assert_eq!(decode::<MirrorCommand>(&payload)?, command);
//! assert_eq!(Room::new("lab")?.command(), "heliostat/v1/lab/mirrors/command");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Versions
//! [`VERSION`] is part of every key and the first byte of every payload.
//!
//! | version | change |
//! | --- | --- |
//! | 1 | first |
//!
//! Within a version the layout of a message never changes; new kinds of message may be added.

pub mod array_keys;
pub mod codec;
mod enumerations;
mod error;
mod fields;
pub mod gauges;
pub mod keys;
mod kind;
mod limits;
mod lost_driver;
pub mod messages;
mod present_driver;
pub mod reported_stops;
mod sources;
mod stamp;
pub mod stop_hold;
mod structures;
mod table;
mod takeover;

pub use array_keys::ArrayKeys;
pub use codec::{Message, StateError, decode, decode_into, decode_state, encode, encode_state};
pub use enumerations::{ArrayState, FaultKind, Feedback, InputKind, NodeKind, StopAction, ValidityClock};
pub use error::CodecError;
pub use keys::{Room, RoomError};
pub use kind::Kind;
pub use limits::{
    CLOCK_LEAD_MAX_NS, EPOCH_SLOTS, LENGTH_TOLERANCE, MAX_ARRAYS, MAX_BRANCHES, MAX_ENTRIES, MAX_GEOMETRY, MAX_INPUTS,
    MAX_LED_GAINS, MAX_MIRRORS, MAX_OBSTACLES, MAX_PAYLOAD, MAX_STATE, MAX_STOPS, MAX_TEXT, MAX_USERS, Nanos,
    SIMULATED_UNTIL_NS, SPEED_MAX_M_S, START_WINDOW_NS, STATUS_WITHIN, UNLISTED_STOPS, VERSION, clock_time, cut,
};
pub use lost_driver::LostDriver;
pub use messages::{
    BeliefReport, BranchReport, Calibration, Capabilities, ChannelReport, ControllerControl, ControllerMemory,
    EmergencyStop, LedReport, MirrorCommand, MirrorTelemetry, NodeStatus, ObstacleReport, OrientationReport, Rearm,
    RoomGeometry, RoomTruth, SafetyReport, SimulatorControl, StopRepetition, StopReport, UserReport,
};
pub use present_driver::PresentDriver;
pub use sources::{SOURCES_MAX, make_place};
pub use stamp::sender_of;
pub use structures::{
    AxisLimits, ControllerInput, Counters, LatchedStopReport, LedGain, MirrorFault, Obstacle, Quantiles, Stamp,
    StopName, SumRates, TruthUser, UserBelief, UserBranches, UserChannel, UserLeds, UserOrientation, UserState,
};
pub use takeover::takeover_reason;
