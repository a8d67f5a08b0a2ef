//! The array's side of the contract: which commands an array follows, and when it holds, parks and stops.
//!
//! Simulated and real arrays share this code. It does no I/O, reads no clock and starts no thread: messages and time come in, the
//! [`Device`] receives what follows. Crate `heliostat-driver` adds sessions and hardware, crate `heliostat-sim` a simulated device.
//!
//! - [`device`]: the trait for hardware, and what it may answer.
//! - [`rules`]: which commands are followed, and when an array holds, parks and stops.
//! - [`calibration`]: the correction of each mirror's mounting; [`calibration_file`]: its text form.
//! - [`kit`]: device, rules and correction together; telemetry; which mirrors do not follow; reconnection.
//! - [`content`]: what arrives for an array; [`refused`]: counts of refusals.
//! - [`moment`]: the two times of a room.

pub mod calibration;
pub mod calibration_file;
pub mod content;
pub mod device;
mod follow;
pub mod kit;
pub mod moment;
pub mod refused;
pub mod rules;

pub use device::{Device, DeviceError, Health};
pub use kit::Kit;
