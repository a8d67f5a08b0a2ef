//! Records the messages of a room into an MCAP file, and replays the file into a controller.
//!
//! A recording holds every payload of a room byte for byte, in the order of arrival, so that a
//! replay is exact. Derived channels for Foxglove stand beside them: a scene, and series of rates,
//! times and counts. A replay does not read derived channels.
//!
//! - [`recorder`]: from the bus through a queue into a file; a slow disk does not slow the room
//!   down.
//! - `ring`: files of bounded size together, and those around a fault.
//! - `place`: whether the path still leads to the file that is being written.
//! - [`mod@file`]: the file format, written in complete chunks and readable up to the last of them.
//! - [`received`]: a payload, decoded.
//! - [`account`]: counts of received, missing and unreadable messages.
//! - [`scene`] and [`series`]: derived channels for Foxglove.
//! - [`replay`]: from the file into a controller of this process, with a comparison of every
//!   command.
//! - [`play`]: from the file onto a bus, for a controller in a process of its own.
//!
//! `docs/recording.md` describes the file format, and what a replay can verify.

pub mod account;
#[cfg(feature = "live")]
pub mod cli;
pub mod file;
#[cfg(feature = "live")]
mod place;
#[cfg(feature = "live")]
pub mod play;
pub mod received;
#[cfg(feature = "live")]
pub mod recorder;
#[cfg(feature = "live")]
pub mod replay;
#[cfg(feature = "live")]
mod ring;
#[cfg(feature = "live")]
pub mod scene;
#[cfg(feature = "live")]
pub mod series;
