//! The contract between rooms, controllers and mirror drivers: messages, keys and the codec.
//!
//! A room's trackers say where its users are, its receivers what light reaches them, a controller how the mirrors are to
//! turn, and a mirror driver what became of that. This crate says how each of them is written in bytes and under which key.
//! It knows no transport and reads no clock. `CONTRACT.md` at the root of the repository tells the same byte by byte, for
//! drivers in other languages.
//!
//! - [`messages`]: what reports, commands and telemetry hold.
//! - [`hardware`]: what drivers and operators say besides: capabilities, emergency stop, calibration.
//! - [`operator`]: what operators change in a running room or controller.
//! - [`codec`]: the one way to bytes and the one way back; everything malformed is refused by name.
//! - [`keys`]: where each message travels.
//!
//! # Versions
//! [`VERSION`] stands in every key and in the first byte of every payload.
//!
//! | version | change |
//! | --- | --- |
//! | 1 | first |
//!
//! Within a version the layout of a message never changes; new kinds of message may join.

pub mod codec;
mod error;
mod fields;
pub mod hardware;
pub mod keys;
pub mod messages;
pub mod operator;

pub use codec::{Kind, Message, decode, decode_into, encode};
pub use error::CodecError;
pub use hardware::{AxisLimits, Calibration, Capabilities, EmergencyStop, Feedback, StopAction, ValidityClock};
pub use keys::{NodeKind, Room, RoomError};
pub use messages::{
    ArrayState, ChannelReport, Counters, MirrorCommand, MirrorTelemetry, NodeStatus, Obstacle, ObstacleReport,
    Quantiles, RoomTruth, Stamp, SumRates, TruthUser, UserChannel, UserReport, UserState,
};
pub use operator::{ControllerControl, FaultKind, MirrorFault, SimulatorControl};

/// Version of the contract: the number in each key and the first byte of each payload.
pub const VERSION: u8 = 1;

/// Longest payload in bytes, header included.
pub const MAX_PAYLOAD: usize = 1 << 20;

/// Most users in one report.
pub const MAX_USERS: usize = 64;

/// Most mirrors in one array.
pub const MAX_MIRRORS: usize = 16_384;

/// Most obstacles in one report.
pub const MAX_OBSTACLES: usize = 1024;

/// Most entries in each list of a [`NodeStatus`].
pub const MAX_ENTRIES: usize = 256;

/// Longest text in bytes of UTF-8.
pub const MAX_TEXT: usize = 1024;

/// How far a sender's clock may be ahead of a receiver's before a message counts as one from the future.
pub const CLOCK_LEAD_MAX_NS: Nanos = 50_000_000;

/// Room time in ns: UTC since 1970 in live operation, simulated time in lockstep.
pub type Nanos = u64;
