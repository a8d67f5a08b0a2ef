//! The kit for mirror drivers: one small trait for the hardware, and everything that the contract asks around it.
//!
//! A real array takes the place of a simulated one when somebody implements [`Device`] for it: say what it can do, apply angles,
//! measure them where that is possible, stop. The kit owns the rest, and the simulated room runs the same code.
//!
//! # Without clock or transport
//! - [`device`]: the trait, and what hardware may answer.
//! - [`rules`]: which commands are followed, and when an array holds, parks and stops.
//! - [`calibration`]: the correction of each mirror's mounting; [`calibration_file`]: where it is kept.
//! - [`kit`]: device, rules and correction together; telemetry; which mirrors do not follow; reconnection.
//!
//! # On the bus
//! - [`lines`], [`inbox`]: what an array says and hears.
//! - [`run`]: a driver as a process; [`cli`] is its command line, [`config`] its file.
//! - [`devices`]: drivers for hardware.
//! - [`check`]: plays traffic at any driver and tells which rules it keeps.
//! - [`clock`], [`refused`]: the two times of a room; what was refused.

pub mod calibration;
pub mod calibration_file;
pub mod check;
pub mod cli;
pub mod clock;
pub mod config;
pub mod device;
pub mod devices;
mod follow;
pub mod inbox;
pub mod kit;
pub mod lines;
mod metrics;
pub mod refused;
pub mod rules;
pub mod run;

pub use device::{Device, DeviceError, Health};
pub use kit::Kit;
