//! Mirror drivers: the session of an array of `heliostat-array` on the bus, and drivers for
//! hardware.
//!
//! Any hardware for which [`Device`] is implemented can replace the simulated mirrors.
//!
//! - [`session`], [`receive_queue`]: what an array publishes and receives.
//! - [`claim`]: one process for each array.
//! - [`run`]: the loop of a driver process; [`cli`] is its command line, [`config`] its file.
//! - [`direct_commands`]: commands of a controller in the same process.
//! - [`devices`]: drivers for hardware.
//! - [`check`]: the conformance check, which tests any driver against the contract.
//! - [`clock`]: both times of a room; [`calibration_store`]: calibration files on disk;
//!   [`stop_record`]: the emergency stop on disk.

pub mod calibration_store;
pub mod check;
pub mod claim;
pub mod cli;
pub mod clock;
pub mod config;
mod device_log;
pub mod devices;
pub mod direct_commands;
mod end_watch;
mod metrics;
pub mod receive_queue;
mod record_thread;
pub mod run;
pub mod session;
pub mod stop_record;
pub mod summary;

pub use heliostat_array::{Device, DeviceError, Health, Kit};
