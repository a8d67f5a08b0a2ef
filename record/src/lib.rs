//! What a room said, as an MCAP file; and back from the file into a controller.
//!
//! A recording holds every payload of a room byte for byte, in the order of arrival, so that a replay is exact. Beside them stand channels that
//! Foxglove draws by itself: a scene, and series of rates, times and counts. They are derived; a replay never reads them.
//!
//! - [`recorder`]: from the bus into a file, by way of a queue, so that a slow disk never slows the room down.
//! - [`mod@file`]: the file itself, written in whole chunks and readable up to the last of them wherever it was cut.
//! - [`account`]: what came, what is missing by sequence number, what could not be read.
//! - [`scene`] and [`series`]: what Foxglove shows.
//! - [`replay`]: from the file into the deciding core of a controller, and whether it decides as it did.
//! - [`play`]: from the file onto a bus, for a controller that runs by itself.
//!
//! `docs/recording.md` says what is in a file and what a replay can prove.

pub mod account;
pub mod cli;
pub mod file;
mod heard;
pub mod play;
pub mod recorder;
pub mod replay;
pub mod scene;
pub mod series;
