//! The array's side of the contract: which commands an array follows, and when it holds, parks and
//! stops.
//!
//! Simulated and real arrays share this code. It does no I/O, reads no clock and starts no thread:
//! messages and time come in, and the [`Device`] receives the resulting angles. Crate
//! `heliostat-driver` adds sessions and hardware, crate `heliostat-sim` a simulated device.
//!
//! - [`device`]: the trait that hardware implements.
//! - [`rules`]: which commands are followed, and when an array holds, parks and stops.
//! - [`calibration`]: the correction of each mirror's mounting; [`calibration_file`]: its file
//!   format.
//! - [`kit`]: device, rules and correction together, with telemetry and reconnection.
//! - [`content`]: the messages that arrive; [`refusal_counts`]: counts of refusals.
//! - [`moment`]: the two times of a room.

pub mod calibration;
pub mod calibration_file;
pub mod content;
pub mod device;
mod follow_check;
pub mod kit;
pub mod moment;
pub mod refusal_counts;
pub mod rules;

pub use device::{Device, DeviceError, Health};
pub use kit::Kit;
