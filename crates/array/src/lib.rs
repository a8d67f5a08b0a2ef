//! The array's side of the contract: which commands an array follows, and when it holds, parks and
//! stops.
//!
//! Simulated and real arrays share this code. It does no I/O, has no clock and starts no thread:
//! messages and time come in, and the [`Device`] receives the resulting angles. Crate
//! `heliostat-driver` adds sessions and hardware, crate `heliostat-room` a simulated device.
//!
//! - [`device`]: the trait that hardware implements.
//! - [`rules`]: which commands are followed, and when an array holds, parks and stops;
//!   [`bounds`]: bounds on the numbers of commands; [`latch`]: the emergency stop in force;
//!   [`refusal`]: why a command or a re-arm is refused.
//! - [`calibration`]: the correction of each mirror's mounting; [`calibration_file`]: its file
//!   format.
//! - [`kit`]: device, rules and correction together, with telemetry and reconnection.
//! - [`station`]: kit, record of the stop and reports of a driver process, without its transport;
//!   [`stop_record`]: the record of the emergency stop.
//! - [`others`]: other processes with the same mirrors, and which of them has to end.
//! - [`content`]: the messages that arrive; [`arrivals`]: their queue; [`refusal_counts`]: counts of
//!   refusals.
//! - [`watch`]: what a kit asks before each movement.
//! - [`moment`]: the two times of a room.

pub mod arrivals;
pub mod bounds;
pub mod calibration;
pub mod calibration_file;
pub mod content;
pub mod device;
mod follow_check;
pub mod kit;
pub mod latch;
pub mod moment;
pub mod others;
pub mod refusal;
pub mod refusal_counts;
pub mod rules;
pub mod station;
pub mod stop_record;
pub mod watch;

pub use device::{CapabilitiesError, Device, DeviceError, Health, Waker, check_capabilities};
pub use kit::Kit;
pub use watch::Watch;
