//! Mirror drivers: the session that puts an array of `heliostat-array` on the bus, and drivers for hardware.
//!
//! A real array takes the place of a simulated one when somebody implements [`Device`] for it.
//!
//! - [`lines`], [`inbox`]: what an array publishes and receives.
//! - [`run`]: a driver as a process; [`cli`] is its command line, [`config`] its file.
//! - [`devices`]: drivers for hardware.
//! - [`check`]: plays traffic at any driver and reports which rules it keeps.
//! - [`clock`]: both times of a room; [`calibration_store`]: calibration files on disk.

pub mod calibration_store;
pub mod check;
pub mod cli;
pub mod clock;
pub mod config;
pub mod devices;
pub mod inbox;
pub mod lines;
mod metrics;
pub mod run;

pub use heliostat_array::{Device, DeviceError, Health, Kit};
