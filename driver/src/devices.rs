//! Drivers for hardware: boards that hold two-axis mirrors, the ways to them, and the map that makes one array of many.
//!
//! - [`Board`]: what a kind of hardware has to provide.
//! - [`playzerx`]: one mirror of a PlayzerX at a serial port, open loop.
//! - [`servo_board`]: many mirrors at a board that understands lines of text.
//! - [`port`]: serial ports and sockets, behind one type.
//! - [`wall`]: boards and their channels as one array.

use heliostat_proto::AxisLimits;

use heliostat_array::device::DeviceError;

pub mod playzerx;
pub mod port;
pub mod servo_board;
pub mod wall;

/// Hardware with channels of two axes each. Angles are mechanical, in rad, roll first.
pub trait Board: Send {
    /// How many mirrors it has.
    fn channels(&self) -> usize;

    /// Maker and model.
    fn model(&self) -> &'static str;

    /// How far and how fast each axis goes, as far as the hardware itself is concerned.
    fn axis(&self) -> AxisLimits;

    /// Whether it measures angles.
    fn measures(&self) -> bool;

    /// Opens the way to it and brings it up.
    ///
    /// # Errors
    /// [`DeviceError`] where nobody answers, or somebody else does.
    fn connect(&mut self) -> Result<(), DeviceError>;

    /// Turns all its mirrors, in one go where the hardware can do that.
    ///
    /// # Errors
    /// [`DeviceError`] where it did not take them.
    fn set(&mut self, angles: &[[f64; 2]]) -> Result<(), DeviceError>;

    /// Reads where the mirrors are; called only where it measures.
    ///
    /// # Errors
    /// [`DeviceError`] where it does not answer.
    fn read(&mut self, angles: &mut [[f64; 2]]) -> Result<(), DeviceError>;

    /// Stops all motion.
    ///
    /// # Errors
    /// [`DeviceError`] where that may not have happened.
    fn stop(&mut self) -> Result<(), DeviceError>;
}
